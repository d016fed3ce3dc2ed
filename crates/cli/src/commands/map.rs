//! `portolan map`: makes a map from a recording.

mod cloud;
mod degenerate;
mod watching;
mod words;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use portolan::job::{Event, Job, MapRequest, Remark};
use portolan::{LIFELONG, RequestedOptions};
use portolan_config::{Engine, Loader, Options};
use portolan_geometry::Duration;
use portolan_ingest::IngestOptions;
use portolan_recording::{Recording, open_all};

use super::argument::{seconds, shifts, time_offset};
use super::handling::HandlingArgs;
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::interrupt;
use crate::known_map::KnownMapArgs;
use crate::output::make_folder;
use crate::progress::print_line;
use cloud::CloudArgs;
pub use watching::run_job;

/// Make a map of a recording: loop-closed map, trajectory, pictures and a report.
///
/// Nothing needs to be configured: topics, frames and settings are chosen from the recording, and the
/// choice is printed. RECORDING is a ROS 1 bag, a ROS 2 bag (MCAP, db3, or their folder), packets of a
/// Velodyne or Ouster lidar (.pcap), a KITTI folder, a CARMEN log, or a CoreSLAM file; several are read as one, in
/// order.
#[derive(clap::Args, Clone, Debug)]
#[command(after_help = "Examples:\n  portolan map walk.bag -o walk\n  \
    portolan map robot.mcap --scan /front/scan --no-odometry\n  \
    portolan map walk.bag -o walk --cloud walk.laz --cloud-voxel 0.05\n  \
    portolan map log.clf.bz2 --config my_robot.lua --set pose_graph.optimize_every_n_nodes=40\n  \
    portolan map second_day.bag --from house/map.pbstream --frozen -o second_day")]
pub struct MapArgs {
    /// Recordings, read as one in the order given.
    #[arg(required = true, value_name = "RECORDING")]
    pub recordings: Vec<PathBuf>,

    /// Folder for the results; created if missing. Default: the recording's name with `_map`.
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,

    #[command(flatten)]
    pub sensors: SensorArgs,

    #[command(flatten)]
    pub config: ConfigArgs,

    #[command(flatten)]
    pub known: KnownMapArgs,

    #[command(flatten)]
    pub cloud: CloudArgs,

    /// Also write the trajectory with the times of the map (`all_poses.tum`). Where stamps came in bursts,
    /// these are not those of the recording, which `trajectory.tum` has.
    #[arg(long)]
    pub all_poses: bool,

    /// Resume an interrupted run, for example after a power cut: give the same command with this option.
    /// Results that are in `map.journal` in the folder are not computed again; the final results are the same
    /// as without the interruption.
    #[arg(long)]
    pub resume: bool,

    /// Lifelong mapping of one area: of each place, the first submap and the newest four are kept, the others
    /// are dropped with their scans, so that memory and time grow with the area and not with the hours. The
    /// trajectory stays complete.
    #[arg(long)]
    pub lifelong: bool,

    #[command(flatten)]
    pub cut: CutArgs,
}

/// Part of the recording that is used.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct CutArgs {
    /// Skip this many seconds at the start of the recording.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, value_parser = seconds, allow_negative_numbers = true)]
    pub skip: f64,

    /// Use only this many seconds of the recording.
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub duration: Option<f64>,
}

/// Topics and frames of the sensors; detected automatically.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Sensors (detected automatically)")]
pub struct SensorArgs {
    /// Topic of a laser scan; may be given several times.
    #[arg(long, value_name = "TOPIC")]
    pub scan: Vec<String>,
    /// Topic of a point cloud; may be given several times.
    #[arg(long, value_name = "TOPIC")]
    pub points: Vec<String>,
    /// Topic of odometry.
    #[arg(long, value_name = "TOPIC")]
    pub odom: Option<String>,
    /// Topic of the IMU.
    #[arg(long, value_name = "TOPIC")]
    pub imu: Option<String>,
    /// Use no odometry.
    #[arg(long, conflicts_with = "odom")]
    pub no_odometry: bool,
    /// Use no IMU.
    #[arg(long, conflicts_with = "imu")]
    pub no_imu: bool,
    /// Use satellite fixes (sensor_msgs/NavSatFix), as `--set use_nav_sat=true` does. They help on long
    /// outdoor trajectories that do not return to earlier places. Fixes are weighted by their scatter and
    /// rejected where they contradict the map.
    #[arg(long)]
    pub gnss: bool,
    /// Frame whose trajectory is estimated. Default: that of the IMU if one is used, else that of the robot
    /// or the range sensor.
    #[arg(long, value_name = "FRAME")]
    pub tracking_frame: Option<String>,
    /// Use another topic in place of a name, as in ROS: `--remap scan:=/front/scan`.
    #[arg(long, value_name = "NAME:=TOPIC")]
    pub remap: Vec<String>,
    #[command(flatten)]
    pub handling: HandlingArgs,
    /// Add seconds to the stamps of a topic and to the times of its points: `/points_rear=-0.05`. `portolan
    /// check` reports offsets of clocks. May be given several times.
    #[arg(long, value_name = "TOPIC=SECONDS", value_parser = time_offset)]
    pub time_offset: Vec<(String, f64)>,
}

/// Representation of the map that 3D scans are matched to.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum EngineArg {
    /// Planes in voxels.
    Planes,
    /// Occupancy grids, as in Cartographer.
    Grids,
}

impl From<EngineArg> for Engine {
    fn from(engine: EngineArg) -> Self {
        match engine {
            EngineArg::Planes => Self::Planes,
            EngineArg::Grids => Self::Grids,
        }
    }
}

/// Settings; defaults are chosen from the recording.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Settings (chosen automatically from the recording)")]
pub struct ConfigArgs {
    /// Cartographer configuration in Lua: its sensors, frames and weights replace those chosen from the
    /// recording. 3D scans are still matched to planes; `--engine grids` matches them as Cartographer does.
    #[arg(long, value_name = "FILE.lua")]
    pub config: Option<PathBuf>,
    /// What 3D scans are matched to. Default: planes, also with a Lua configuration, which gives sensors,
    /// frames and weights.
    #[arg(long, value_name = "ENGINE")]
    pub engine: Option<EngineArg>,
    /// Folder to search for included Lua files; may be given several times.
    #[arg(long, value_name = "DIR")]
    pub config_dir: Vec<PathBuf>,
    /// Change one option: `--set pose_graph.constraint_builder.min_score=0.6`.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

pub fn run(args: MapArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let cloud = args.cloud.request();
    cloud.check().map_err(|error| CliError::Usage(error.to_string()))?;
    let folder = args.output.clone().unwrap_or_else(|| default_folder(&args.recordings[0]));
    let _made = [cloud.make_room()?, make_folder(&folder)?];
    let recording = open_all(&args.recordings)?;
    let mut requested = requested_options(&args.sensors, &args.config)?;
    if args.lifelong {
        requested.settings.insert(0, LIFELONG.to_owned());
    }
    let ingest = ingest_options(&args.sensors, &args.cut, &requested)?;
    let request = MapRequest {
        folder,
        ingest,
        requested,
        engine: args.config.engine.map(Engine::from),
        known: args.known.maps(),
        force: args.known.force,
        cloud,
        all_poses: args.all_poses,
        resume: args.resume,
        threads: global.threads,
    };
    let mut job = Job::prepare(recording.as_ref(), request, &mut remarks(global))?;
    job.keep_journal(&mut remarks(global))?;
    let finished = run_job(&job, recording.as_ref(), global);
    let summary = finished.map_err(|error| no_scans_in_cut(error, recording.as_ref(), &args.cut))?.summary;
    Ok(match summary {
        _ if summary.is_refused() => Outcome::Untrusted,
        _ if summary.is_partial() => Outcome::DataLost,
        _ => Outcome::Done,
    })
}

/// Default folder for the results, in the working directory: the name of the recording with `_map`.
fn default_folder(recording: &Path) -> PathBuf {
    let name = recording.file_name().map_or_else(|| "recording".into(), |n| n.to_string_lossy());
    PathBuf::from(format!("{}_map", name.split('.').next().unwrap_or("recording")))
}

fn load_options(config: &ConfigArgs) -> Result<Option<Options>, CliError> {
    let Some(path) = &config.config else { return Ok(None) };
    let loader = Loader { directories: config.config_dir.clone(), ..Loader::default() };
    let loaded = loader.load(path).map_err(|e| CliError::Failed(e.to_string()))?;
    for warning in &loaded.warnings {
        tracing::warn!("{warning}");
    }
    Ok(Some(loaded.options))
}

/// The configuration, and the settings that are applied to it in this order: those of `--set` come last and take
/// precedence over other options.
pub fn requested_options(sensors: &SensorArgs, config: &ConfigArgs) -> Result<RequestedOptions, CliError> {
    let gnss = sensors.gnss.then(|| "use_nav_sat=true".to_owned());
    let settings = gnss.into_iter().chain(config.set.iter().cloned()).collect();
    Ok(RequestedOptions { configuration: load_options(config)?, settings })
}

/// Options for the sensors, from the command line and the configuration.
pub fn ingest_options(
    sensors: &SensorArgs,
    cut: &CutArgs,
    requested: &RequestedOptions,
) -> Result<IngestOptions, CliError> {
    let mut ingest = IngestOptions {
        range_topics: sensors.scan.iter().chain(&sensors.points).cloned().collect(),
        odometry_topic: sensors.odom.clone(),
        imu_topic: sensors.imu.clone(),
        tracking_frame: sensors.tracking_frame.clone(),
        time_offsets: shifts(&sensors.time_offset),
        skip: Duration::from_seconds(cut.skip),
        length: cut.duration.map(Duration::from_seconds),
        ..IngestOptions::default()
    };
    requested.configure(&mut ingest).map_err(|e| CliError::Usage(e.to_string()))?;
    if sensors.no_odometry {
        ingest.use_odometry = Some(false);
    }
    if sensors.no_imu {
        ingest.use_imu = Some(false);
    }
    for remapping in &sensors.remap {
        let Some((from, to)) = remapping.split_once(":=") else {
            return Err(CliError::Usage(format!("--remap takes NAME:=TOPIC, not {remapping}")));
        };
        ingest.remappings.push((from.to_owned(), to.to_owned()));
    }
    sensors.handling.configure(&mut ingest)?;
    Ok(ingest)
}

/// Replaces the error that a recording has no usable scan by one that names `--skip` and `--duration`, if they were
/// given.
pub fn no_scans_in_cut(error: CliError, recording: &dyn Recording, cut: &CutArgs) -> CliError {
    let length = cut.duration.map(|seconds| format!("--duration {seconds}"));
    let skip = (cut.skip > 0.0).then(|| format!("--skip {}", cut.skip));
    let cuts: Vec<String> = skip.into_iter().chain(length).collect();
    if cuts.is_empty() || interrupt::interrupted() || !matches!(error, CliError::NoScans(_)) {
        return error;
    }
    let range = recording.time_range().map_or(0.0, |(first, last)| last.seconds_since(first));
    CliError::Failed(format!(
        "{} leaves no usable scan of the {range:.1} s of the recording",
        cuts.join(" with ")
    ))
}

/// Observer of a job: prints its remarks, and stops the job when the user interrupts it.
pub fn remarks(global: &GlobalArgs) -> impl FnMut(&Event) -> ControlFlow<()> + use<> {
    let quiet = global.quiet;
    move |event| {
        if let Event::Remark(remark) = event {
            match remark {
                Remark::LittleEffect { .. } => tracing::warn!("--set {remark}"),
                Remark::KnownMapIssue { .. } => tracing::warn!("{remark}"),
                Remark::Chosen(_) | Remark::KnownMapLoaded { .. } if quiet => {}
                _ => print_line(&remark.to_string()),
            }
        }
        if interrupt::interrupted() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}
