//! Refines a trajectory with a recording and writes it: `refine_recording RECORDING INPUT.tum OUTPUT.tum`.

use std::time::Instant;

use portolan_evaluation::{TimedPose, Trajectory, read_tum, write_tum};
use portolan_recording::{IngestOptions, Ingestion, open};
use portolan_refinement::PointStore;
use portolan_refinement::continuous::{ContinuousOptions, refine_continuous};
use portolan_sensor::Measurement;

#[allow(clippy::print_stderr)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [recording, input, output] = arguments.as_slice() else {
        return Err("usage: refine_recording RECORDING INPUT.tum OUTPUT.tum".into());
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
    eprintln!(
        "{:.2} s: {} points, {:?}",
        start.elapsed().as_secs_f64(),
        points.points().len(),
        points.left_out()
    );
    let (trajectory, _) = read_tum(std::io::BufReader::new(std::fs::File::open(input)?))?;
    let poses: Vec<_> = trajectory.poses().iter().map(|p| (p.time, p.map_from_tracking)).collect();
    let refined = refine_continuous(&points, &poses, &ContinuousOptions::default(), &mut |p| {
        eprintln!(
            "{:.2} s: {}: rms {:.4} m, shift {:.4} m",
            start.elapsed().as_secs_f64(),
            p.stage,
            p.rms,
            p.shift
        );
        true
    })?;
    eprintln!("{:#?}", portolan_refinement::continuous::RefineReport { steps: Vec::new(), ..refined.report });
    let refined = refined.trajectory;
    let corrected = poses
        .iter()
        .map(|(time, pose)| TimedPose { time: *time, map_from_tracking: refined.corrected(*time, pose) });
    let dense = (0..(refined.duration() / 0.01) as usize).map(|i| {
        let seconds = i as f64 * 0.01;
        let time = refined.start() + portolan_geometry::Duration::from_seconds(seconds);
        TimedPose { time, map_from_tracking: refined.pose(seconds) }
    });
    let chosen = if std::env::var_os("DENSE").is_some() {
        Trajectory::new(dense).0
    } else {
        Trajectory::new(corrected).0
    };
    write_tum(&chosen, std::io::BufWriter::new(std::fs::File::create(output)?))?;
    Ok(())
}
