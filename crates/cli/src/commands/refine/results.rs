//! What a refinement leaves in its folder.

use std::path::{Path, PathBuf};

use portolan::job::resident_and_peak_bytes;
use portolan_export::write_tum;
use portolan_geometry::{Duration, Rigid3, Time};
use portolan_mapfile::{EditError, MapDraft};
use portolan_pbstream::ReadLimits;
use portolan_pointcloud::{Attributes, BATCH_POINTS, CloudError, PointCloud, WriteOptions, create};
use portolan_refinement::continuous::{Agreement, CrossValidation, Mounting, RefineReport, Refined};
use portolan_spatial::Sharpness;

use super::cloud_pair::CloudPair;
use super::judgement::Judgement;
use super::page::report_page;
use super::pictures::pictures;
use super::points::ReadPoints;
use crate::error::CliError;
use crate::output::{counted, write_file};

/// Poses of the input farther apart than this do not show everything that was found, seconds.
const SPARSE: f64 = 0.05;
/// Seconds between the poses of the dense trajectory.
const DENSE: f64 = 0.02;

/// A finished refinement.
pub struct Results<'a> {
    pub input: &'a [(Time, Rigid3)],
    pub refined: &'a Refined,
    pub read: &'a ReadPoints,
    pub seconds: f64,
    /// Files of the cloud, relative to the folder, their extensions say the format.
    pub clouds: &'a [String],
    /// Recordings, trajectory and map.
    pub files: &'a [PathBuf],
    /// What was typed, for the page; none for no page.
    pub command: Option<&'a str>,
    /// Whether no cloud and no map are written, because there is nothing better than the input.
    pub without_results: bool,
    /// The map the trajectory came from, and which of its trajectories.
    pub map: Option<(&'a Path, i32)>,
}

/// Writes trajectory, cloud and report; returns their names.
pub fn write_results(results: &Results, folder: &Path) -> Result<Vec<PathBuf>, CliError> {
    let mut files = Vec::new();
    let mut file = |name: &str| {
        files.push(folder.join(name));
        folder.join(name)
    };
    let trajectory = &results.refined.trajectory;
    let corrected: Vec<(Time, Rigid3)> =
        results.input.iter().map(|(time, pose)| (*time, trajectory.corrected(*time, pose))).collect();
    // Where the input was kept it is the input.
    write_tum(&file("refined.tum"), &corrected)?;
    let duration = trajectory.duration();
    if !results.without_results && duration > SPARSE * (results.input.len() - 1) as f64 {
        let dense: Vec<(Time, Rigid3)> = (0..=(duration / DENSE) as usize)
            .map(|i| i as f64 * DENSE)
            .map(|s| (trajectory.start() + Duration::from_seconds(s), trajectory.pose(s)))
            .collect();
        write_tum(&file("refined_dense.tum"), &dense)?;
    }
    if let Some((map, id)) = results.map.filter(|_| !results.without_results) {
        let failed = |error: EditError| CliError::in_file(map, error);
        let mut draft = MapDraft::open(map, ReadLimits::default()).map_err(failed)?;
        draft.replace_trajectory(id, &corrected).map_err(failed)?;
        draft.write(file("refined.pbstream")).map_err(failed)?;
    }
    let pair = CloudPair::new(&results.read.store, results.refined);
    let start = results.read.store.start().unix_seconds();
    for name in results.clouds.iter().filter(|_| !results.without_results) {
        write_cloud(&pair, start, &file(name))?;
    }
    let judgement = results.command.map(|_| Judgement::of(&pair));
    if let (Some(judgement), Some(command)) = (&judgement, results.command) {
        let pictures = pictures(&pair, trajectory, &judgement.largest_changes);
        let page = report_page(results, judgement, &pictures, command)?;
        write_file(&file("report.html"), |out| out.write_all(page.as_bytes()))?;
    }
    let report = serde_json::to_vec_pretty(&report(results, judgement.as_ref()))
        .map_err(|e| CliError::Failed(e.to_string()))?;
    write_file(&file("report.json"), |out| out.write_all(&report))?;
    Ok(files)
}

/// All points within the trajectory, in order of time.
fn write_cloud(pair: &CloudPair, start: f64, path: &Path) -> Result<(), CliError> {
    let failed = |error: CloudError| CliError::in_file(path, error);
    let attributes = Attributes { time: true, ..Attributes::default() };
    let mut writer = create(path, attributes, &WriteOptions::default()).map_err(failed)?;
    let mut batch = PointCloud::new(attributes);
    for (seconds, position) in pair.refined() {
        batch.push(position, 0.0, start + seconds, [0; 3]);
        if batch.len() == BATCH_POINTS {
            writer.write(&batch).map_err(failed)?;
            batch.reset(attributes);
        }
    }
    writer.write(&batch).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(())
}

fn report(results: &Results, judgement: Option<&Judgement>) -> serde_json::Value {
    let plan = &results.read.plan;
    let topics: Vec<&str> = plan.range.iter().map(|r| &*r.source.topic).collect();
    serde_json::json!({
        "tracking_frame": plan.tracking_frame,
        "range_topics": topics,
        "poses": results.input.len(),
        "trajectory_seconds": results.refined.trajectory.duration(),
        "wall_seconds": results.seconds,
        "peak_memory_bytes": resident_and_peak_bytes().map(|(_, peak)| peak),
        "refinement": results.refined.report,
        "quality": judgement,
        "issues": results.read.issues,
        "data_lost": results.read.lost_data(),
    })
}

fn mounting_line(mounting: &Mounting) -> String {
    let numbers = |values: &[f64; 3], deviations: &[f64; 3], scale: f64, places: usize| {
        let one = |(v, d): (&f64, &f64)| format!("{:.places$} ± {:.places$}", scale * v, scale * d);
        values.iter().zip(deviations).map(one).collect::<Vec<_>>().join(", ")
    };
    let degrees = 1.0_f64.to_degrees();
    let mut text = format!(
        "{}: shifted by ({}) cm, turned by ({}) deg, delayed by {:.4} ± {:.4} s",
        mounting.what,
        numbers(&mounting.shift, &mounting.shift_deviation, 100.0, 2),
        numbers(&mounting.turn, &mounting.turn_deviation, degrees, 3),
        mounting.delay,
        mounting.delay_deviation
    );
    if !mounting.undetermined.is_empty() {
        text += &format!("; not determined by the motion: {}", mounting.undetermined.join(", "));
    }
    text + "\n"
}

/// What was done, for people.
pub fn summary(results: &Results, files: &[PathBuf]) -> String {
    let report = &results.refined.report;
    let mut text = format!(
        "{} points along {:.0} s of trajectory, refined in {:.1} s\n",
        report.points,
        results.refined.trajectory.duration(),
        results.seconds
    );
    if let (Some(before), Some(after)) = (&report.sharpness_before, &report.sharpness_after) {
        let thickness = |s: &Sharpness| 100.0 * s.mean_plane_variance.sqrt();
        text += &format!(
            "mean map entropy {:.3} -> {:.3} (radius {} m, {:.0} points each), mean thickness {:.2} -> {:.2} cm\n",
            before.mean_map_entropy,
            after.mean_map_entropy,
            after.options.radius,
            after.mean_neighbours,
            thickness(before),
            thickness(after),
        );
    }
    text += &format!(
        "largest shift {:.3} m, largest turn {:.2} deg{}\n",
        report.largest_shift,
        report.largest_turn.to_degrees(),
        report.planar_share.map_or_else(String::new, |share| format!(
            "; {:.0} % of the points lie on surfaces",
            100.0 * share
        ))
    );
    text += &report.cross_validation.as_ref().map_or_else(String::new, cross_validation_lines);
    text += &notes(&results.refined.report, results.without_results);
    for issue in &results.read.issues {
        let label = if issue.lost_data() { "lost" } else { "repaired" };
        text += &format!("{label}: {issue} ({})\n", counted(issue.count, "time", "times"));
    }
    for file in files {
        text += &format!("{}\n", file.display());
    }
    text
}

/// What surfaces say that took no part in the fit.
fn cross_validation_lines(found: &CrossValidation) -> String {
    let agreement = |a: &Agreement| format!("{:.2} -> {:.2} cm", 100.0 * a.before, 100.0 * a.after);
    let mut text = format!(
        "surfaces kept out of the fit: seconds apart they agree to {}",
        agreement(&found.near_in_time)
    );
    if found.between_passes.pairs > 0 {
        text += &format!(", of different passes to {}", agreement(&found.between_passes));
    }
    text += "\n";
    for [from, to] in &found.refused {
        text += &format!(
            "from {from:.0} s to {to:.0} s they agree less than before: the input's motion is kept there\n"
        );
    }
    text
}

/// What was estimated besides, could not be determined, or is wrong with the trajectory.
fn notes(report: &RefineReport, without_results: bool) -> String {
    let mut text = String::new();
    for u in &report.undetermined {
        let what = if u.is_rotation { "turn about" } else { "shift along" };
        let [x, y, z] = u.direction;
        text += &format!(
            "not determined from {:.0} s to {:.0} s: {what} ({x:.2}, {y:.2}, {z:.2}); left as it was\n",
            u.from, u.to
        );
    }
    if report.calibrated {
        report.mountings.iter().for_each(|mounting| text += &mounting_line(mounting));
    }
    report.imu.iter().for_each(|imu| text += &mounting_line(imu));
    for jump in &report.jumps {
        text += &format!(
            "repaired: a jump of the trajectory at {:.2} s by {:.3} m and {:.2} deg was taken out\n",
            jump.seconds,
            jump.shift,
            jump.turn.to_degrees()
        );
    }
    if report.kept_input {
        text += "REFUSED: the cloud would be less sharp with the refined trajectory, which was thrown away";
        text += "; refined.tum is the input";
        text += if without_results { ", no cloud and no map are written without --force\n" } else { "\n" };
    }
    for warning in &report.warnings {
        text += &format!("warning: {warning}\n");
    }
    if report.stopped {
        text += "stopped before the end; this is what was reached\n";
    }
    text
}
