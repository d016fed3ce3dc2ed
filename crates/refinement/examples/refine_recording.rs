//! Refines a trajectory with a recording and writes it:
//! `refine_recording RECORDING INPUT.tum OUTPUT.tum [semi-rigid]`.

use std::time::Instant;

use portolan_evaluation::{TimedPose, Trajectory, read_tum, write_tum};
use portolan_ingest::{IngestOptions, Ingestion};
use portolan_recording::open;
use portolan_refinement::PointStore;
use portolan_refinement::continuous::{ContinuousOptions, RefineProgress, refine_continuous};
use portolan_refinement::semi_rigid::{SemiRigidOptions, refine_semi_rigid};
use portolan_sensor::Measurement;

#[allow(clippy::print_stderr)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let ([recording, input, output], method) = arguments.split_at(3.min(arguments.len())) else {
        return Err("usage: refine_recording RECORDING INPUT.tum OUTPUT.tum [semi-rigid]".into());
    };
    let start = Instant::now();
    let recording = open(recording)?;
    let mut points = PointStore::new(0.3);
    for measurement in Ingestion::new(recording.as_ref(), &IngestOptions::default())? {
        if let Measurement::Range(sweep) = measurement?.1 {
            points.push(&sweep);
        }
    }
    points.sort();
    let (trajectory, _) = read_tum(std::io::BufReader::new(std::fs::File::open(input)?))?;
    let poses: Vec<_> = trajectory.poses().iter().map(|p| (p.time, p.map_from_tracking)).collect();
    let mut observe = |p: &RefineProgress| {
        let seconds = start.elapsed().as_secs_f64();
        let metres =
            |value: Option<f64>| value.map_or("unknown".to_owned(), |metres| format!("{metres:.4} m"));
        eprintln!("{seconds:.2} s: {}: scatter {}, shift {}", p.stage, metres(p.rms), metres(p.shift));
        true
    };
    let refined = match method {
        [] => refine_continuous(&points, &poses, &ContinuousOptions::default(), &mut observe)?,
        _ => refine_semi_rigid(&points, &poses, &SemiRigidOptions::default(), &mut observe)?,
    };
    for warning in &refined.report.warnings {
        eprintln!("{warning}");
    }
    let corrected = poses.iter().map(|(time, pose)| TimedPose {
        time: *time,
        map_from_tracking: refined.trajectory.corrected(*time, pose),
    });
    write_tum(&Trajectory::new(corrected).0, std::io::BufWriter::new(std::fs::File::create(output)?))?;
    Ok(())
}
