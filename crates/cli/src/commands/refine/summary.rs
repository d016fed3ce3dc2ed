//! Summary of a refinement for the user.

use std::path::PathBuf;

use portolan::job::refine::RefineResults;
use portolan_refinement::continuous::{Agreement, CrossValidation, Mounting, RefineReport};
use portolan_spatial::Sharpness;

use crate::output::counted;

fn mounting_line(mounting: &Mounting) -> String {
    let numbers = |values: &[f64; 3], deviations: &[f64; 3], scale: f64, places: usize| {
        let one = |(v, d): (&f64, &f64)| format!("{:.places$} ± {:.places$}", scale * v, scale * d);
        values.iter().zip(deviations).map(one).collect::<Vec<_>>().join(", ")
    };
    let degrees = 1.0_f64.to_degrees();
    let mut text = format!(
        "{}: translated by ({}) cm, rotated by ({}) deg, delayed by {:.4} ± {:.4} s",
        mounting.name,
        numbers(&mounting.translation, &mounting.translation_deviation, 100.0, 2),
        numbers(&mounting.rotation, &mounting.rotation_deviation, degrees, 3),
        mounting.delay,
        mounting.delay_deviation
    );
    if !mounting.undetermined.is_empty() {
        text += &format!("; not determined by the motion: {}", mounting.undetermined.join(", "));
    }
    text + "\n"
}

/// Summary of a refinement: size, sharpness before and after, cross-validation, notes, issues and files.
pub fn summary(results: &RefineResults, files: &[PathBuf]) -> String {
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
        "largest translation {:.3} m, largest rotation {:.2} deg{}\n",
        report.largest_translation,
        report.largest_rotation.to_degrees(),
        report.planar_fraction.map_or_else(String::new, |fraction| format!(
            "; {:.0} % of the points lie on surfaces",
            100.0 * fraction
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

/// Result of the cross-validation: agreement of surfaces that were kept out of the fit.
fn cross_validation_lines(found: &CrossValidation) -> String {
    let agreement = |a: &Agreement| format!("{:.2} -> {:.2} cm", 100.0 * a.before, 100.0 * a.after);
    let mut text =
        format!("held-out surfaces: seen seconds apart they agree to {}", agreement(&found.near_in_time));
    if found.between_passes.pairs > 0 {
        text += &format!(", seen in different passes to {}", agreement(&found.between_passes));
    }
    text += "\n";
    for [from, to] in &found.refused {
        text += &format!(
            "from {from:.0} s to {to:.0} s they agree less than before: the motion of the input is kept there\n"
        );
    }
    text
}

/// Undetermined directions, estimated mountings, removed jumps of the trajectory, and warnings.
fn notes(report: &RefineReport, without_results: bool) -> String {
    let mut text = String::new();
    for u in &report.undetermined {
        let what = if u.is_rotation { "rotation about" } else { "translation along" };
        let [x, y, z] = u.direction;
        text += &format!(
            "not determined from {:.0} s to {:.0} s: {what} ({x:.2}, {y:.2}, {z:.2}); kept as in the input\n",
            u.from, u.to
        );
    }
    if report.calibrated {
        report.mountings.iter().for_each(|mounting| text += &mounting_line(mounting));
    }
    report.imu.iter().for_each(|imu| text += &mounting_line(imu));
    for jump in &report.jumps {
        text += &format!(
            "repaired: a jump of the trajectory at {:.2} s by {:.3} m and {:.2} deg was removed\n",
            jump.seconds,
            jump.translation,
            jump.rotation.to_degrees()
        );
    }
    if report.kept_input {
        text += "REFUSED: the refined trajectory is worse than the input and was discarded";
        text += "; refined.tum is the input";
        text += if without_results { ", no cloud and no map are written without --force\n" } else { "\n" };
    }
    for warning in &report.warnings {
        text += &format!("warning: {warning}\n");
    }
    if report.stopped {
        text += "stopped before the end; these are the results so far\n";
    }
    text
}
