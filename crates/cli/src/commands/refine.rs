//! `portolan refine`: adjusts a trajectory in continuous time until the point cloud recorded along it is consistent.

pub mod points;
mod summary;

use std::path::{Path, PathBuf};
use std::time::Instant;

use portolan::job::OutputFolder;
use portolan::job::refine::{REFINED_FILES, ReadPoints, RefineResults, write_refinement};
use portolan::trajectory_file::TrajectoryFile;
use portolan_atomic_file::require_room;
use portolan_geometry::{Duration, Rigid3, Time};
use portolan_pointcloud::CloudFormat;
use portolan_recording::open_all;
use portolan_refinement::continuous::{
    ContinuousOptions, Gauge, RefineProgress, Refined, refine_continuous_with,
};
use portolan_refinement::semi_rigid::{SemiRigidOptions, refine_semi_rigid};

use crate::GlobalArgs;
use crate::commands::evaluate::input::read_trajectory;
use crate::commands::map::remarks;
use crate::error::{CliError, Outcome};
use crate::interrupt::{self, Saving};
use crate::output::{make_folder, print_summary};
use crate::progress::Progress;
use points::{OtherSensor, PointArgs, read_points_and};
use summary::summary;

/// Refine a trajectory in continuous time (6 DoF) until the point cloud is consistent.
///
/// The trajectory may come from any program: TUM, KITTI, a table, or a map (.pbstream of Portolan or
/// Cartographer). It must be that of the tracking frame, whose name is printed: the frame of the IMU if there
/// is one, else that of the robot or of the first range sensor; --tracking-frame names another. Nothing needs
/// to be tuned.
///
/// Results are refined.tum (at the stamps of the input; refined_dense.tum too if those are far apart), the
/// cloud (refined.ply), report.html (one page with sections before and after, plots and figures),
/// report.json, and for a map refined.pbstream with its nodes and submaps moved. Ctrl-C keeps the best result
/// so far.
#[derive(clap::Args, Clone, Debug)]
#[command(after_help = "Examples:\n  \
    portolan refine --recording walk.bag --trajectory walk.tum -o walk_refined\n  \
    portolan refine --recording robot.mcap --map robot.pbstream -o robot_refined\n  \
    portolan refine --recording car.bag --trajectory car.tum --tracking-frame velodyne -o car --no-cloud\n  \
    portolan refine --recording pack.mcap --trajectory pack.tum -o pack --calibrate --with imu --gauge gravity")]
pub struct RefineArgs {
    /// The recording with the raw points; may be given several times, read as one in the order given.
    #[arg(long, required = true, value_name = "RECORDING")]
    recording: Vec<PathBuf>,
    /// Initial trajectory: TUM, KITTI poses, or a table with a header line.
    #[arg(long, value_name = "FILE", required_unless_present = "map", conflicts_with = "map")]
    trajectory: Option<PathBuf>,
    /// Map whose trajectory is the initial one.
    #[arg(long, value_name = "MAP.pbstream")]
    map: Option<PathBuf>,
    /// Id of the trajectory of the map.
    #[arg(long, value_name = "ID", default_value_t = 0)]
    trajectory_id: i32,
    /// Times of KITTI poses, one per line.
    #[arg(long, value_name = "FILE")]
    times: Option<PathBuf>,
    /// Offset added to the stamps of the trajectory, seconds, if its clock is not that of the points. If they
    /// seem to differ, a warning suggests an offset.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_negative_numbers = true)]
    time_offset: f64,
    /// Folder for the results; created if missing.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Write the input as the result if the refinement was rejected (exit code 4), because the cloud became
    /// less sharp, held-out surfaces agree less, or poses are not finite; and overwrite files in the folder
    /// that were not written by an earlier `refine`.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    points: PointArgs,
    /// Format of the refined cloud, named refined.FORMAT; or its name, `hall.laz`, in the folder of the
    /// results, or an absolute path. Several are separated by commas.
    #[arg(
        long,
        value_parser = cloud_name,
        default_value = "ply",
        value_delimiter = ',',
        value_name = "FORMAT | FILE"
    )]
    cloud: Vec<String>,
    /// Write no cloud.
    #[arg(long)]
    no_cloud: bool,
    /// Write no report.html and skip the evaluation of the clouds for it, which takes a second or two.
    #[arg(long)]
    no_report: bool,
    /// Refinement method.
    #[arg(long, value_enum, default_value_t = MethodName::Continuous)]
    method: MethodName,
    #[command(flatten)]
    tuning: TuningArgs,
    #[command(flatten)]
    semi_rigid: SemiRigidArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum MethodName {
    /// Knots at intervals of 0.1 s and all planes are estimated together, from coarse to fine.
    Continuous,
    /// Sections of the trajectory are registered rigidly, then all its elements are estimated, as published
    /// by Elseberg, Borrmann, Nüchter and others.
    SemiRigid,
}

/// Parameters of the semi-rigid method, as in the paper.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Semi-rigid method (as published)")]
struct SemiRigidArgs {
    /// Duration of an element of the trajectory, seconds: one pose is estimated for each. Default 1/120.
    #[arg(long, value_name = "SECONDS")]
    element: Option<f64>,
    /// Coarse mode: an element is two sweeps. Sections and the time window keep their durations.
    #[arg(long, conflicts_with = "element")]
    coarse: bool,
    /// Number of elements from one section to the next. Default 300.
    #[arg(long, value_name = "N")]
    interval: Option<usize>,
    /// Number of elements of a section on each side of its middle. Default 150.
    #[arg(long, value_name = "N")]
    half_width: Option<usize>,
    /// Edge of the voxels in which one point is kept, metres. Default 0.1.
    #[arg(long, value_name = "METRES")]
    voxel: Option<f64>,
    /// Maximum number of iterations of the rigid registration of the sections. Default 20.
    #[arg(long, value_name = "N")]
    rigid_iterations: Option<usize>,
    /// Link sections with more point pairs than this. Default 400.
    #[arg(long, value_name = "N")]
    min_pairs: Option<usize>,
    /// Maximum distance between the points of a pair, metres. Default 0.5.
    #[arg(long, value_name = "METRES")]
    pair_distance: Option<f64>,
    /// Minimum number of elements between paired points: points measured shortly after each other fit anyway.
    /// Default 180.
    #[arg(long, value_name = "N")]
    time_window: Option<usize>,
    /// Number of outer iterations: sections are made and registered, then elements estimated. Default 1.
    #[arg(long, value_name = "N")]
    outer_iterations: Option<usize>,
}

impl SemiRigidArgs {
    /// Options of the method; `sweep_seconds` is the duration of a sweep of the recording.
    fn options(&self, sweep_seconds: f64) -> SemiRigidOptions {
        let usual = SemiRigidOptions::default();
        let options = SemiRigidOptions {
            element: self.element.unwrap_or(usual.element),
            interval: self.interval.unwrap_or(usual.interval),
            half_width: self.half_width.unwrap_or(usual.half_width),
            voxel: self.voxel.unwrap_or(usual.voxel),
            rigid_iterations: self.rigid_iterations.unwrap_or(usual.rigid_iterations),
            min_pairs: self.min_pairs.unwrap_or(usual.min_pairs),
            max_distance: self.pair_distance.unwrap_or(usual.max_distance),
            time_window: self.time_window.unwrap_or(usual.time_window),
            outer_iterations: self.outer_iterations.unwrap_or(usual.outer_iterations),
            ..usual
        };
        if self.coarse { options.coarse(sweep_seconds) } else { options }
    }
}

/// Parameters of the continuous method.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Continuous method (the defaults are meant for every recording)")]
struct TuningArgs {
    /// Length of the windows within which the input shows a wall as one sheet, seconds. Longer for slow
    /// scanners. Default 2.
    #[arg(long, value_name = "SECONDS")]
    window: Option<f64>,
    /// Time between knots of the result, seconds. A shorter one follows faster errors, if there are enough
    /// points. Default 0.1.
    #[arg(long, value_name = "SECONDS")]
    knots: Option<f64>,
    /// Maximum distance by which drift may have moved surfaces apart, metres. Default 2.
    #[arg(long, value_name = "METRES")]
    reach: Option<f64>,
    /// Also use the motion measured by these sensors. Their accuracy is estimated, and bad ones are
    /// down-weighted.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "SENSORS")]
    with: Vec<OtherSensor>,
    /// Also estimate extrinsics and time offsets of all lidars but the first; report.json has them with
    /// standard deviations. Unobservable ones are reported.
    #[arg(long)]
    calibrate: bool,
    /// Gauge: what determines the pose of the result as a whole.
    #[arg(long, value_enum, default_value_t = GaugeName::FirstPose, value_name = "GAUGE")]
    gauge: GaugeName,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum GaugeName {
    /// The first pose is that of the input.
    FirstPose,
    /// The first position and heading are those of the input, and z points up as measured by the IMU.
    Gravity,
    /// The frame is that of the satellite fixes: z up, the first fix at the origin.
    Fixes,
}

impl TuningArgs {
    fn options(&self) -> ContinuousOptions {
        let usual = ContinuousOptions::default();
        ContinuousOptions {
            window: self.window.unwrap_or(usual.window),
            knot_spacing: self.knots.unwrap_or(usual.knot_spacing),
            reach: self.reach.unwrap_or(usual.reach),
            calibrate_lidars: self.calibrate,
            gauge: match self.gauge {
                GaugeName::FirstPose => Gauge::FirstPose,
                GaugeName::Gravity => Gauge::Gravity,
                GaugeName::Fixes => Gauge::Fixes,
            },
            ..usual
        }
    }

    /// Warnings for sensors of `--with` that the recording does not have.
    fn without_data(&self, read: &ReadPoints) -> Vec<String> {
        let sensors = &read.sensors;
        let missing = |sensor: &OtherSensor| match sensor {
            OtherSensor::Imu => sensors.imu().is_empty().then_some(("imu", "samples of an IMU")),
            OtherSensor::Odometry => sensors.odometry().is_empty().then_some(("odometry", "odometry")),
            OtherSensor::Fixes => sensors.fixes().is_empty().then_some(("fixes", "satellite fixes")),
        };
        let message = |(name, what)| format!("--with {name} changed nothing: the recording has no {what}");
        self.with.iter().filter_map(missing).map(message).collect()
    }

    /// Sensors to read: those of `--with`, and the one that `--gauge` needs.
    fn sensors(&self) -> Vec<OtherSensor> {
        let mut sensors = self.with.clone();
        match self.gauge {
            GaugeName::FirstPose => {}
            GaugeName::Gravity => sensors.push(OtherSensor::Imu),
            GaugeName::Fixes => sensors.push(OtherSensor::Fixes),
        }
        sensors
    }
}

impl RefineArgs {
    /// Refuses options that would be silently ignored.
    fn check_options(&self) -> Result<(), CliError> {
        if self.trajectory_id != 0 && self.map.is_none() {
            return Err(CliError::Usage("--trajectory-id is for --map only".to_owned()));
        }
        let (s, t) = (&self.semi_rigid, &self.tuning);
        let given = |options: &[(&'static str, bool)]| options.iter().find(|o| o.1).map(|o| o.0);
        let (other, method) = match self.method {
            MethodName::Continuous => {
                let options = [
                    ("--element", s.element.is_some()),
                    ("--coarse", s.coarse),
                    ("--interval", s.interval.is_some()),
                    ("--half-width", s.half_width.is_some()),
                    ("--voxel", s.voxel.is_some()),
                    ("--rigid-iterations", s.rigid_iterations.is_some()),
                    ("--min-pairs", s.min_pairs.is_some()),
                    ("--pair-distance", s.pair_distance.is_some()),
                    ("--time-window", s.time_window.is_some()),
                    ("--outer-iterations", s.outer_iterations.is_some()),
                ];
                (given(&options), "semi-rigid")
            }
            MethodName::SemiRigid => {
                let options = [
                    ("--window", t.window.is_some()),
                    ("--knots", t.knots.is_some()),
                    ("--reach", t.reach.is_some()),
                    ("--with", !t.with.is_empty()),
                    ("--calibrate", t.calibrate),
                    ("--gauge", t.gauge != GaugeName::FirstPose),
                ];
                (given(&options), "continuous")
            }
        };
        match other {
            Some(option) => Err(CliError::Usage(format!("{option} is for --method {method} only"))),
            None => Ok(()),
        }
    }
}

pub fn run(args: &RefineArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let start = Instant::now();
    args.check_options()?;
    let input = read_input(args, global)?;
    let _made = make_folder(&args.output)?;
    let mut observe = remarks(global);
    let output = OutputFolder::begin(&args.output, "refine", &REFINED_FILES, args.force, &mut observe)?;
    // Space for trajectory, report and pictures.
    require_room(&args.output, 1 << 20)?;
    let recording = open_all(&args.recording)?;
    let read = read_points_and(recording.as_ref(), &args.points, &args.tuning.sensors(), global)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(global.thread_count())
        .build()
        .map_err(|error| CliError::Failed(error.to_string()))?;
    let mut refined = {
        let _saving = Saving::begin();
        pool.install(|| refine_with_progress(&read, &input, args, global))?
    };
    refined.report.warnings.extend(args.tuning.without_data(&read));
    let command = command_line();
    let files: Vec<PathBuf> =
        args.recording.iter().chain(&args.trajectory).chain(&args.map).cloned().collect();
    let results = RefineResults {
        input: &input,
        refined: &refined,
        read: &read,
        seconds: start.elapsed().as_secs_f64(),
        clouds: if args.no_cloud { &[] } else { &args.cloud },
        files: &files,
        command: (!args.no_report).then_some(command.as_str()),
        map: args.map.as_deref().map(|map| (map, args.trajectory_id)),
        without_results: refined.report.kept_input && !args.force,
    };
    let files = pool.install(|| write_refinement(&results, &output, &mut remarks(global)))?;
    print_summary(&summary(&results, &files));
    Ok(match refined.report.kept_input {
        true => Outcome::Untrusted,
        false if read.lost_data() => Outcome::DataLost,
        false => Outcome::Done,
    })
}

/// Name of the cloud file: `las` becomes `refined.las`; a file name must end in a format that can be written.
fn cloud_name(text: &str) -> Result<String, String> {
    let name = if text.contains('.') { text.to_owned() } else { format!("refined.{text}") };
    CloudFormat::from_path(Path::new(&name)).map(|_| name).map_err(|_| {
        format!("\"{text}\" is not ply, pcd, xyz, las, laz or e57, nor a file name with such an ending")
    })
}

/// The command line as typed, without options that do not affect the results.
fn command_line() -> String {
    let mut words = std::env::args().skip(1);
    let mut line = "portolan".to_owned();
    while let Some(word) = words.next() {
        match word.as_str() {
            "--threads" => drop(words.next()),
            "-q" | "--quiet" | "-v" | "--verbose" => {}
            word if word.starts_with("--threads=") => {}
            word => {
                let is_plain = word.chars().all(|c| c.is_alphanumeric() || "-_./=,:+@%".contains(c));
                line += &if is_plain {
                    format!(" {word}")
                } else {
                    format!(" '{}'", word.replace('\'', "'\\''"))
                };
            }
        }
    }
    line
}

fn read_input(args: &RefineArgs, global: &GlobalArgs) -> Result<Vec<(Time, Rigid3)>, CliError> {
    let Some(path) = args.trajectory.as_deref().or(args.map.as_deref()) else {
        return Err(CliError::Usage(
            "a trajectory is needed: --trajectory FILE or --map MAP.pbstream".to_owned(),
        ));
    };
    let times = args.times.as_deref();
    let file = TrajectoryFile { path, trajectory_id: Some(args.trajectory_id), times };
    if !args.time_offset.is_finite() {
        return Err(CliError::Usage("--time-offset must be a number of seconds".to_owned()));
    }
    let offset = Duration::from_seconds(args.time_offset);
    let trajectory = read_trajectory(file, global.quiet)?;
    Ok(trajectory.poses().iter().map(|pose| (pose.time + offset, pose.map_from_tracking)).collect())
}

fn refine_with_progress(
    read: &ReadPoints,
    input: &[(Time, Rigid3)],
    args: &RefineArgs,
    global: &GlobalArgs,
) -> Result<Refined, CliError> {
    let mut progress = Progress::start("refining", 1000, global.quiet);
    let start = Instant::now();
    let mut observe = |state: &RefineProgress| {
        let left = start.elapsed().as_secs_f64() * (1.0 / state.share.max(0.01) - 1.0);
        let sharpness = state.entropy.map_or_else(String::new, |e| format!(", entropy {e:.3}"));
        let message = match state.rms {
            Some(rms) => {
                format!("{}: scatter {:.1} mm{sharpness}, about {left:.0} s left", state.stage, 1e3 * rms)
            }
            None => state.stage.clone(),
        };
        progress.update((1000.0 * state.share) as u64, 1000, message);
        !interrupt::interrupted()
    };
    let refined = match args.method {
        MethodName::Continuous => {
            refine_continuous_with(&read.store, &read.sensors, input, &args.tuning.options(), &mut observe)
        }
        MethodName::SemiRigid => {
            let options = args.semi_rigid.options(read.store.sweep_seconds());
            refine_semi_rigid(&read.store, input, &options, &mut observe)
        }
    };
    progress.finish();
    refined.map_err(|error| CliError::Failed(error.to_string()))
}
