//! A trajectory refined with the points of the recording: walls become thinner.
//!
//! `cargo run --release -p portolan --example 03_refine`

use std::error::Error;
use std::io::Write;

use portolan::geometry::{Rigid3, Time};
use portolan::ingest::{IngestOptions, Ingestion};
use portolan::refinement::PointStore;
use portolan::refinement::continuous::{ContinuousOptions, RefineProgress, refine_continuous};
use portolan::sensor::Measurement;
use portolan::simulator::{Scenario3dOptions, Simulation3d};
use portolan::worlds::three_d::Scene3d;

/// What `cargo run` and the test of the examples call.
pub fn main() -> Result<(), Box<dyn Error>> {
    let simulation = simulate()?;
    // The frame whose poses the trajectory holds.
    let tracking_frame = Some("base_link".to_owned());
    let ingest = IngestOptions { tracking_frame, ..IngestOptions::default() };
    // Points nearer than 0.3 m are of the person who carries the lidar.
    let mut points = PointStore::new(0.3);
    for measurement in Ingestion::new(&simulation, &ingest)? {
        if let (_, Measurement::Range(sweep)) = measurement? {
            points.push(&sweep);
        }
    }
    points.sort();

    // Any trajectory of the frame will do: of a map, or of another program (`portolan::evaluation::read_tum`).
    let truth: Vec<(Time, Rigid3)> = simulation.truth(20.0).collect();
    let input: Vec<(Time, Rigid3)> = truth.iter().enumerate().map(|(i, pose)| drifting(i, pose)).collect();
    let mut out = std::io::stdout();
    let mut observe = |progress: &RefineProgress| {
        // False ends it.
        match progress.rms {
            Some(rms) => writeln!(out, "{}: points scatter by {rms:.4} m", progress.stage).is_ok(),
            None => writeln!(out, "{}", progress.stage).is_ok(),
        }
    };
    let options = ContinuousOptions { max_rounds: 4, ..ContinuousOptions::default() };
    let refined = refine_continuous(&points, &input, &options, &mut observe)?;
    for warning in &refined.report.warnings {
        writeln!(out, "{warning}")?;
    }
    let corrected = input.iter().map(|(time, pose)| (*time, refined.trajectory.corrected(*time, pose)));
    let corrected: Vec<(Time, Rigid3)> = corrected.collect();
    let [before, refined, exact] = [&input, &corrected, &truth].map(|poses| length(poses));
    writeln!(out, "path length: {before:.3} m before, {refined:.3} m refined, {exact:.3} m in truth")?;
    Ok(())
}

/// A museum through which a person carries a lidar and an IMU.
fn simulate() -> Result<Simulation3d, Box<dyn Error>> {
    let mut options = Scenario3dOptions::new(Scene3d::Museum, 1, 1);
    (options.duration, options.rest) = (Some(6.0), 0.5);
    options.lidars.iter_mut().for_each(|lidar| lidar.beams.columns = 300);
    Ok(Simulation3d::new(options)?)
}

/// What a program for SLAM might have found: off by up to 4 cm.
fn drifting(i: usize, (time, pose): &(Time, Rigid3)) -> (Time, Rigid3) {
    let error = 0.04 * (0.05 * i as f64).sin();
    (*time, Rigid3::translation(error, -error, 0.0) * *pose)
}

fn length(poses: &[(Time, Rigid3)]) -> f64 {
    poses.windows(2).map(|w| (w[1].1.translation.vector - w[0].1.translation.vector).norm()).sum()
}
