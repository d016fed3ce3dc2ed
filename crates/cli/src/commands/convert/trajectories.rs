//! Converts trajectories.

use std::io::{BufWriter, Write};

use portolan::trajectory_file::{TrajectoryFile, damaged_behind_poses, nodes, whole_pose_graph_from};
use portolan_evaluation::{
    Trajectory, read_geojson, write_csv, write_csv_all, write_geojson, write_kitti, write_tum,
};
use portolan_geometry::EastNorthUp;
use portolan_input::Forward;
use portolan_mapfile::MapDraft;
use portolan_pbstream::ReadLimits;

use super::ConvertArgs;
use super::format::Format;
use crate::GlobalArgs;
use crate::commands::evaluate::input::{read_trajectory_from, report_notes};
use crate::error::{CliError, Outcome};
use crate::output::{counted, outcome_of_map, print_json, print_summary, write_file};
use crate::progress::print_line;

/// Message for inputs without poses.
pub const NO_POSES: &str = "there are no poses";

type Named = Vec<(i32, Trajectory)>;

/// Trajectories, and whether data of their file were lost.
type Read<T> = (T, bool);

pub fn run(args: &ConvertArgs, input: Forward, to: Format, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let (trajectories, lost_data) = if to.holds_several() {
        read(args, input, global)?
    } else {
        let (trajectory, lost_data) = read_one(args, input, global)?;
        (vec![(0, trajectory)], lost_data)
    };
    let poses: usize = trajectories.iter().map(|(_, t)| t.len()).sum();
    if poses == 0 {
        return Err(CliError::in_file(&args.input, NO_POSES));
    }
    let frame = args.origin.as_ref().map(EastNorthUp::at);
    let mut files = vec![args.output.clone()];
    write_file(&args.output, |out| {
        let mut out = BufWriter::new(out);
        match (to, trajectories.as_slice()) {
            (Format::Geojson, all) => write_geojson(all, frame.as_ref(), &mut out),
            (Format::Csv, [(_, one)]) => write_csv(one, &mut out),
            (Format::Csv, all) => write_csv_all(all, &mut out),
            (Format::Kitti, all) => all.iter().try_for_each(|(_, t)| write_kitti(t, &mut out)),
            (_, all) => all.iter().try_for_each(|(_, t)| write_tum(t, &mut out)),
        }?;
        out.flush()
    })?;
    if let (Format::Kitti, [(_, trajectory)]) = (to, trajectories.as_slice()) {
        let times = args.output.with_extension("times.txt");
        write_file(&times, |out| {
            let mut out = BufWriter::new(out);
            trajectory.poses().iter().try_for_each(|p| writeln!(out, "{}", p.time.unix_decimal()))?;
            out.flush()
        })?;
        files.push(times);
    }
    let names: Vec<String> = files.iter().map(|f| f.display().to_string()).collect();
    if args.json {
        let count = trajectories.len();
        print_json(&serde_json::json!({ "files": names, "trajectories": count, "poses": poses }))?;
    } else {
        print_summary(&format!("{}\n{}", counted(poses as u64, "pose", "poses"), names.join("\n")));
    }
    Ok(if lost_data { Outcome::DataLost } else { Outcome::Done })
}

/// Writes the poses of a trajectory into a map.
pub fn into_map(args: &ConvertArgs, input: Forward, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let Some(map) = &args.into else {
        return Err(CliError::Usage(
            "a trajectory alone is no map: say with --into MAP which map gets its poses".to_owned(),
        ));
    };
    let id = args.trajectory.unwrap_or(0);
    let (trajectory, lost_data) = read_one(args, input, global)?;
    let poses: Vec<_> = trajectory.poses().iter().map(|p| (p.time, p.map_from_tracking)).collect();
    let mut draft = MapDraft::open(map, ReadLimits::default())?;
    let done = draft.replace_trajectory(id, &poses)?;
    let damage = draft.write(&args.output)?.damage;
    let output = args.output.display().to_string();
    if args.json {
        print_json(&serde_json::json!({ "output": output, "replaced": done }))?;
    } else {
        print_summary(&format!(
            "{} at poses of the trajectory, {} moved along with them, {} placed by their nodes\n{output}",
            counted(done.nodes, "node", "nodes"),
            done.nodes_moved_along,
            counted(done.submaps, "submap", "submaps"),
        ));
    }
    let written = outcome_of_map(&args.output, &damage);
    Ok(if lost_data { Outcome::DataLost } else { written })
}

/// Reads the only trajectory of the input, or the one of `--trajectory`.
pub fn read_one(
    args: &ConvertArgs,
    input: Forward,
    global: &GlobalArgs,
) -> Result<Read<Trajectory>, CliError> {
    let (mut trajectories, lost_data) = read(args, input, global)?;
    if trajectories.len() > 1 {
        let ids: Vec<String> = trajectories.iter().map(|(id, _)| id.to_string()).collect();
        return Err(CliError::Usage(format!(
            "there are several trajectories ({}); say which with --trajectory, or write .csv or .geojson",
            ids.join(", ")
        )));
    }
    match trajectories.pop() {
        Some((_, trajectory)) if !trajectory.is_empty() => Ok((trajectory, lost_data)),
        _ => Err(CliError::in_file(&args.input, NO_POSES)),
    }
}

/// Reads all trajectories of the input, or the one of `--trajectory`. With `--into` that option selects the trajectory of
/// the map instead, and all of the input are read.
fn read(args: &ConvertArgs, mut input: Forward, global: &GlobalArgs) -> Result<Read<Named>, CliError> {
    let path = &args.input;
    let mut lost_data = false;
    let mut all = match Format::of_content(&mut input, path)? {
        Format::Map => {
            let (graph, damage) = whole_pose_graph_from(input, path)?;
            if let Some(damage) = damage {
                print_line(&format!("{}: {}", path.display(), damaged_behind_poses(&damage)));
                lost_data = true;
            }
            let ids: Vec<i32> = graph.trajectory.iter().map(|t| t.trajectory_id).collect();
            let read = |id| Ok((id, Trajectory::new(nodes(path, &graph, id)?).0));
            ids.into_iter().map(read).collect::<Result<Named, CliError>>()?
        }
        Format::Geojson => {
            let frame = args.origin.as_ref().map(EastNorthUp::at);
            let (all, repairs) =
                read_geojson(input, frame.as_ref()).map_err(|error| CliError::in_file(path, error))?;
            if !global.quiet {
                report_notes(path, &repairs.notes());
            }
            all
        }
        _ => {
            let times = args.times.as_deref();
            let file = TrajectoryFile { path, trajectory_id: None, times };
            return Ok((
                vec![(args.trajectory.unwrap_or(0), read_trajectory_from(input, file, global.quiet)?)],
                false,
            ));
        }
    };
    if let Some(wanted) = args.trajectory
        && args.into.is_none()
    {
        let ids: Vec<String> = all.iter().map(|(id, _)| id.to_string()).collect();
        all.retain(|(id, _)| *id == wanted);
        if all.is_empty() {
            let text = format!("there is no trajectory {wanted}; there are: {}", ids.join(", "));
            return Err(CliError::in_file(path, text));
        }
    }
    Ok((all, lost_data))
}
