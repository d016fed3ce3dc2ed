//! `portolan demo`: simulates a building, maps it and evaluates the result against the ground truth.

use std::path::{Path, PathBuf};
use std::time::Instant;

use portolan::job::{Finished, Job, MapRequest};
use portolan::trajectory_file::TrajectoryFile;
use portolan_evaluation::{Alignment, Association, TimedPose, Trajectory, absolute_errors};
use portolan_geometry::{Rigid3, Time};
use portolan_recording::{Recording, RecordingFormat, open};
use portolan_simulator::{Scenario3dOptions, ScenarioOptions, Simulation, Simulation3d};
use portolan_worlds::three_d::Scene3d;
use portolan_worlds::two_d::Scene;

use super::map::{remarks, run_job};
use super::simulate::write_recording;
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{print_summary, write_file};
use crate::progress::print_line;

/// Firings per revolution: half as many as the lidar has, so that the demo takes two minutes.
const COLUMNS: usize = 900;
/// Width and depth of the museum, metres.
const SIZE: [f64; 2] = [26.0, 20.0];
/// Number of storeys of the museum.
const STOREYS: usize = 2;

/// Simulate a walk through a museum in 3D, map it, and evaluate the result against the exact truth.
///
/// A person carries a backpack with two spinning lidars and an IMU through the storeys of a museum, over its
/// stairs and past its visitors. The recording and its truth are written first, as `portolan simulate` does,
/// then mapped like any other recording. The folder then holds the map, the trajectory, X-rays from three
/// sides and a section.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan demo\n  portolan demo --seed 7 --seconds 200 -o another\n  \
    portolan demo --planar             an office, and a robot with a planar lidar")]
pub struct DemoArgs {
    /// Folder for the results.
    #[arg(short, long, value_name = "DIR", default_value = "demo")]
    output: PathBuf,
    /// Seed of the building, the motion and the noise.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Length of the recording. Default 100, with --planar 300.
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<f64>,
    /// Simulate a robot with a planar lidar and wheels in an office instead.
    #[arg(long)]
    planar: bool,
}

pub fn run(args: DemoArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    if args.planar { office(&args, global) } else { museum(&args, global) }
}

fn office(args: &DemoArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let duration = Some(args.seconds.unwrap_or(300.0));
    let options = ScenarioOptions { duration, ..ScenarioOptions::new(Scene::Office, args.seed) };
    let simulation = Simulation::new(options).map_err(|e| CliError::Usage(e.to_string()))?;
    create_folder(&args.output)?;
    map(&simulation, &args.output, global)?;
    let truth: Vec<(Time, Rigid3)> = simulation.truth(100.0).collect();
    print_summary(&format!(
        "{}\nlook at {}; then try: portolan map YOUR_RECORDING.bag",
        errors(&args.output, &truth, Alignment::Se2)?,
        args.output.join("map.png").display(),
    ));
    Ok(Outcome::Done)
}

fn museum(args: &DemoArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let mut options = Scenario3dOptions::new(Scene3d::Museum, args.seed, 2);
    options.duration = Some(args.seconds.unwrap_or(100.0));
    (options.size, options.storeys) = (Some(SIZE), Some(STOREYS));
    options.lidars.iter_mut().for_each(|lidar| lidar.beams.columns = COLUMNS);
    let simulation = Simulation3d::new(options).map_err(|e| CliError::Usage(e.to_string()))?;
    create_folder(&args.output)?;
    let start = Instant::now();
    let (file, truth_file) = (args.output.join("museum.mcap"), args.output.join("museum.truth.tum"));
    record(&simulation, &file, &truth_file, global)?;
    if !global.quiet {
        print_line(&format!("{} simulated in {:.0} s", file.display(), start.elapsed().as_secs_f64()));
    }
    let recording = open(&file)?;
    map(recording.as_ref(), &args.output, global)?;
    let truth: Vec<(Time, Rigid3)> = simulation.truth(100.0).collect();
    let (file, output) = (file.display(), args.output.display());
    print_summary(&format!(
        "{}\nthe demo took {:.0} s\n\
         look at {output}/map_section.png and the X-rays beside it; then try:\n  \
         portolan map {file} -o again --no-imu\n  \
         portolan map {file} -o again --cloud museum.laz --cloud-voxel 0.05\n  \
         portolan evaluate trajectory again/trajectory.tum {truth}\n  \
         portolan map YOUR_RECORDING.bag",
        errors(&args.output, &truth, Alignment::Se3)?,
        start.elapsed().as_secs_f64(),
        truth = truth_file.display(),
    ));
    Ok(Outcome::Done)
}

fn create_folder(path: &Path) -> Result<(), CliError> {
    std::fs::create_dir_all(path).map_err(|source| CliError::File { path: path.to_owned(), source })
}

/// Writes the simulated recording and the true poses.
fn record(simulation: &Simulation3d, path: &Path, truth: &Path, global: &GlobalArgs) -> Result<(), CliError> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(global.thread_count())
        .build()
        .map_err(|error| CliError::Failed(format!("cannot start threads: {error}")))?;
    let format = RecordingFormat::from_path(path)?;
    pool.install(|| write_recording(simulation, path, format, global.quiet))?;
    write_file(truth, |out| simulation.write_truth_tum(out, 200.0))
}

/// Maps the recording as `portolan map` does, with the same result files.
fn map(recording: &dyn Recording, folder: &Path, global: &GlobalArgs) -> Result<Finished, CliError> {
    let request = MapRequest { threads: global.threads, ..MapRequest::new(folder) };
    let job = Job::prepare(recording, request, &mut remarks(global))?;
    run_job(&job, recording, global)
}

/// Errors of the trajectory in the folder of results against the ground truth, as text.
fn errors(folder: &Path, truth: &[(Time, Rigid3)], alignment: Alignment) -> Result<String, CliError> {
    let path = folder.join("trajectory.tum");
    let estimate = TrajectoryFile { path: &path, trajectory_id: None, times: None }.read()?.trajectory;
    let errors = absolute_errors(&trajectory(truth), &estimate, Association::default(), alignment)
        .map_err(|e| CliError::Failed(e.to_string()))?;
    Ok(format!(
        "against the truth: {:.3} m and {:.2} deg rms, {:.3} m at most",
        errors.translation.rmse, errors.rotation_degrees.rmse, errors.translation.max,
    ))
}

fn trajectory(poses: &[(Time, Rigid3)]) -> Trajectory {
    let timed = poses.iter().map(|(time, pose)| TimedPose { time: *time, map_from_tracking: *pose });
    Trajectory::new(timed).0
}
