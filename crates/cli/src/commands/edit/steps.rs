//! Performs the steps of `edit` in their order.

use std::collections::BTreeMap;
use std::path::Path;

use portolan_geometry::{Rigid3, Time, Vector3};
use portolan_mapfile::{EditError, EditReport, JoinedMap, LoopResidual, MapDraft, MapOptimization};
use portolan_pbstream::ReadLimits;
use serde::Serialize;

use super::values::{LoopToAdd, Rotation, time};
use super::{EditArgs, LoopArgs, PartArgs, PlaceArgs};
use crate::GlobalArgs;
use crate::commands::optimize::{loop_text, optimize_draft, options, summary};
use crate::error::{CliError, Outcome};
use crate::output::{counted, outcome_of_map, print_json, print_summary};
use crate::progress::print_line;

/// Report of all steps, for JSON.
#[derive(Serialize)]
struct Report {
    output: String,
    merged: Vec<JoinedMap>,
    #[serde(flatten)]
    edit: EditReport,
    optimization: Option<MapOptimization>,
    /// Angle by which the map was rotated, degrees.
    rotated_degrees: f64,
    worst_loops: Vec<LoopResidual>,
}

pub fn run(args: &EditArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let mut draft = MapDraft::open(&args.map, ReadLimits::default())?;
    let mut merged = Vec::new();
    if args.parts.place.is_empty() {
        for path in &args.parts.merge {
            match draft.append_aligned(path, &options(&draft, &args.loops.set)?) {
                Ok(joined) => merged.push(reported(path, joined, global)),
                Err(error @ EditError::NotPlaced { .. }) => {
                    print_line(&format!(
                        "{error}. Nothing was written; if you know the place, say [--place X,Y,YAW]"
                    ));
                    return Ok(Outcome::Untrusted);
                }
                Err(error) => return Err(error.into()),
            }
        }
    }
    choose_parts(&mut draft, &args.parts, global)?;
    let loops_fit = change_loops(&mut draft, &args.loops, global)?;
    let optimization = match args.loops.optimize {
        true => Some(optimize_draft(&mut draft, &args.loops.set, None)?),
        false => None,
    };
    let mut worst_loops = if args.loops.worst > 0 { draft.loop_residuals() } else { Vec::new() };
    worst_loops.truncate(args.loops.worst);
    let rotated_degrees = place(&mut draft, &args.place)?.to_degrees();
    let edit = draft.write(&args.output)?;
    let report = Report {
        output: args.output.display().to_string(),
        merged,
        edit,
        optimization,
        rotated_degrees,
        worst_loops,
    };
    if args.json {
        print_json(&report)?;
    } else {
        print_summary(&report.text());
    }
    match outcome_of_map(&args.output, &report.edit.damage) {
        Outcome::Done if !loops_fit => Ok(Outcome::DataLost),
        outcome => Ok(outcome),
    }
}

fn choose_parts(draft: &mut MapDraft, args: &PartArgs, global: &GlobalArgs) -> Result<(), CliError> {
    for (path, pose) in args.merge.iter().zip(&args.place) {
        let ids = draft.append(path, pose)?;
        if !global.quiet {
            print_line(&format!("{}: {}", path.display(), new_numbers(&ids)));
        }
    }
    for id in args.keep.iter().chain(&args.delete) {
        draft.require_trajectory(*id)?;
    }
    if !args.keep.is_empty() {
        draft.retain_trajectories(|id| args.keep.contains(&id));
    }
    if !args.delete.is_empty() {
        draft.retain_trajectories(|id| !args.delete.contains(&id));
    }
    if draft.trajectory_ids().next().is_none() {
        return Err(match (args.keep.is_empty(), args.delete.is_empty()) {
            (false, _) => empty_map("--keep"),
            (_, false) => empty_map("--delete"),
            _ => CliError::Failed("the map has no trajectories: there is nothing to edit".to_owned()),
        });
    }
    if !args.rename.is_empty() {
        let names: BTreeMap<i32, i32> = args.rename.iter().copied().collect();
        if names.len() < args.rename.len() {
            return Err(CliError::Usage("a trajectory is renamed twice".to_owned()));
        }
        draft.rename_trajectories(&names)?;
    }
    cut_time(draft, args)?;
    if let Some(area) = &args.inside {
        draft.cut_area(area, true).map_err(|error| naming("--inside", error))?;
    }
    if let Some(area) = &args.outside {
        draft.cut_area(area, false).map_err(|error| naming("--outside", error))?;
    }
    Ok(())
}

fn cut_time(draft: &mut MapDraft, args: &PartArgs) -> Result<(), CliError> {
    if args.after.is_none() && args.before.is_none() {
        return Ok(());
    }
    let (first, last) = draft
        .time_span()
        .ok_or_else(|| CliError::Failed("the map has no nodes to cut by time".to_owned()))?;
    let at = |text: &Option<String>, otherwise| match text {
        Some(text) => time(text, first).map_err(CliError::Usage),
        None => Ok(otherwise),
    };
    draft.cut_time(at(&args.after, Time::MIN)?, at(&args.before, Time::MAX)?).map_err(|error| {
        let options = match (&args.after, &args.before) {
            (Some(_), None) => "--after",
            (None, Some(_)) => "--before",
            _ => "--after and --before",
        };
        let span = format!("{options} (the map is of {:.1} s, from +0)", last.seconds_since(first));
        naming(&span, error)
    })
}

/// If nothing is left of the map, an error that names the option.
fn naming(option: &str, error: EditError) -> CliError {
    match error {
        EditError::Empty => empty_map(option),
        other => other.into(),
    }
}

fn empty_map(option: &str) -> CliError {
    CliError::Failed(format!("nothing would be left of the map after {option}"))
}

fn new_numbers(ids: &BTreeMap<i32, i32>) -> String {
    let names: Vec<String> = ids.iter().map(|(there, here)| format!("{there} is {here}")).collect();
    format!("trajectory {}", names.join(", "))
}

/// Reports the pose at which a merged map was found.
fn reported(path: &Path, joined: JoinedMap, global: &GlobalArgs) -> JoinedMap {
    if !global.quiet {
        let place = &joined.map_from_other;
        let (x, y) = (place.translation.x, place.translation.y);
        print_line(&format!(
            "{}: {}; found at {x:.3},{y:.3},{:.2}, {} between the maps; {}",
            path.display(),
            new_numbers(&joined.ids),
            portolan_geometry::yaw(&place.rotation).to_degrees(),
            counted(joined.loop_closures, "loop closure", "loop closures"),
            summary(&joined.optimization)
        ));
    }
    joined
}

/// Removes and adds loop closures. Returns whether the scans of all added ones with a given pose fit their submaps; those
/// that cannot be checked count as fitting.
fn change_loops(draft: &mut MapDraft, args: &LoopArgs, global: &GlobalArgs) -> Result<bool, CliError> {
    for (submap, node) in &args.drop_loop {
        draft.drop_loop(*submap, *node)?;
    }
    if let Some(metres) = args.drop_loops_beyond {
        if metres.is_nan() || metres < 0.0 {
            return Err(CliError::Usage("--drop-loops-beyond takes metres of at least 0".to_owned()));
        }
        draft.drop_loops_beyond(metres, f64::INFINITY);
    }
    let options = options(draft, &args.set)?;
    let mut fit_everywhere = true;
    for new in &args.add_loop {
        let weights = draft.loop_weights();
        let pose = match new.submap_from_node {
            Some(pose) => {
                fit_everywhere &= fits(draft, new, &pose)?;
                pose
            }
            None => {
                let builder = &options.map_builder.pose_graph.constraint_builder;
                let found = draft.find_loop(new.submap, new.node, builder)?;
                if !global.quiet {
                    let [x, y, _] = found.position;
                    print_line(&format!(
                        "found node {},{} in submap {},{} at {x:.3}, {y:.3} with score {:.3}, {:.3} m and {:.2} degrees from \
                         where the map has it",
                        new.node.0,
                        new.node.1,
                        new.submap.0,
                        new.submap.1,
                        found.score,
                        found.off.0,
                        found.off.1.to_degrees()
                    ));
                }
                found.submap_from_node
            }
        };
        draft.add_loop(new.submap, new.node, &pose, weights)?;
    }
    Ok(fit_everywhere)
}

/// Reports how the scan of a node fits a submap at the pose given by the user. Returns whether it fits: more beams are
/// explained than contradicted, or it cannot be checked.
fn fits(draft: &MapDraft, new: &LoopToAdd, pose: &Rigid3) -> Result<bool, CliError> {
    let Some(agreement) = draft.judge_loop(new.submap, new.node, pose)? else { return Ok(true) };
    let (node, submap) = (new.node, new.submap);
    let [explained, contradicted] =
        [agreement.explained, agreement.contradicted()].map(|share| 100.0 * share);
    let fits = explained > contradicted;
    print_line(&format!(
        "{}node {},{} in submap {},{} there: {explained:.0} % of its beams meet what the submap shows, {contradicted:.0} % contradict it",
        if fits { "" } else { "this loop closure does NOT fit: " },
        node.0,
        node.1,
        submap.0,
        submap.1
    ));
    Ok(fits)
}

/// Moves and rotates the map; returns the angle, radians.
fn place(draft: &mut MapDraft, args: &PlaceArgs) -> Result<f64, CliError> {
    if let Some(origin) = args.origin {
        draft.transform(&Rigid3::from_parts((-origin).into(), portolan_geometry::Quaternion::identity()))?;
    }
    let angle = match args.rotate {
        Some(Rotation::By(angle)) => angle,
        Some(Rotation::Walls) => -draft.walls()?.angle,
        None => 0.0,
    };
    if angle != 0.0 {
        draft.transform(&Rigid3::new(Vector3::zeros(), Vector3::z() * angle))?;
    }
    if let Some(shift) = args.shift {
        draft.transform(&Rigid3::from_parts(shift.into(), portolan_geometry::Quaternion::identity()))?;
    }
    Ok(angle)
}

impl Report {
    fn text(&self) -> String {
        let edit = &self.edit;
        let counts = [
            (edit.trajectories_removed, "trajectory removed", "trajectories removed"),
            (edit.submaps_removed, "submap removed", "submaps removed"),
            (edit.nodes_removed, "node removed", "nodes removed"),
            (edit.constraints_removed, "constraint removed", "constraints removed"),
            (edit.constraints_added, "loop closure added", "loop closures added"),
            (edit.cells_cleared, "cell made unknown", "cells made unknown"),
            (edit.sensor_messages_removed, "measurement removed", "measurements removed"),
        ];
        let lines = counts.into_iter().filter(|(n, ..)| *n > 0);
        let mut text: String = lines.map(|(n, one, several)| counted(n, one, several) + "\n").collect();
        if let Some(optimization) = &self.optimization {
            text += &(summary(optimization) + "\n");
        }
        if self.rotated_degrees != 0.0 {
            text += &format!("rotated by {:.3} degrees\n", self.rotated_degrees);
        }
        text.extend(self.worst_loops.iter().map(loop_text));
        text + &format!("{} written\n{}", counted(edit.messages, "message", "messages"), self.output)
    }
}
