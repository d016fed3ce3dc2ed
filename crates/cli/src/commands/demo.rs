//! `portolan demo`: a simulated building, mapped and measured against the truth.

use std::path::PathBuf;

use portolan::pipeline::KnownMap;
use portolan_evaluation::{Alignment, Association, TimedPose, Trajectory, absolute_errors};
use portolan_geometry::{Rigid3, Time};
use portolan_mapping::Planar;
use portolan_recording::IngestOptions;
use portolan_simulator::world::Scene;
use portolan_simulator::{ScenarioOptions, Simulation};

use super::map::{map_with_progress, prepared, summary};
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::interrupt;
use crate::output::print;
use crate::results::write_results;

/// Map a simulated office and measure the result against the exact truth.
#[derive(clap::Args)]
pub struct DemoArgs {
    /// Folder for the results.
    #[arg(short, long, value_name = "DIR", default_value = "demo")]
    output: PathBuf,
    /// Another number is another building.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Length of the walk, seconds.
    #[arg(long, default_value_t = 300.0)]
    seconds: f64,
}

pub fn run(args: DemoArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let options =
        ScenarioOptions { duration: Some(args.seconds), ..ScenarioOptions::new(Scene::Office, args.seed) };
    let simulation = Simulation::new(options).map_err(|e| CliError::Usage(e.to_string()))?;
    std::fs::create_dir_all(&args.output)
        .map_err(|source| CliError::File { path: args.output.clone(), source })?;
    interrupt::watch();
    let start = std::time::Instant::now();
    let ingest = IngestOptions::default();
    let preparation = prepared(&simulation, &ingest, None, &[], global)?;
    let known = KnownMap::empty(&preparation.options);
    let mapped = map_with_progress::<Planar>(&simulation, &ingest, preparation, known, global)?;
    let seconds = start.elapsed().as_secs_f64();
    let written = write_results(&mapped, &args.output, seconds, false)?;
    print(&summary(&mapped, &written, seconds))?;
    let estimate = mapped.map.node_poses(portolan_mapping::TrajectoryId(0));
    let truth: Vec<(Time, Rigid3)> = simulation.truth(100.0).collect();
    let errors =
        absolute_errors(&trajectory(&truth), &trajectory(&estimate), Association::default(), Alignment::Se2)
            .map_err(|e| CliError::Failed(e.to_string()))?;
    print(&format!(
        "against the truth: {:.3} m and {:.2} deg rms, {:.3} m at most\n\
         look at {}; then try: portolan map YOUR_RECORDING.bag",
        errors.translation.rmse,
        errors.rotation_degrees.rmse,
        errors.translation.max,
        args.output.join("map.png").display(),
    ))?;
    Ok(Outcome::Done)
}

fn trajectory(poses: &[(Time, Rigid3)]) -> Trajectory {
    let timed = poses.iter().map(|(time, pose)| TimedPose { time: *time, map_from_tracking: *pose });
    Trajectory::new(timed).0
}
