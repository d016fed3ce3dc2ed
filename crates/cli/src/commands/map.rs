//! `portolan map`: from a recording to a map.

mod cloud;
mod weak;
mod xray;

use std::path::{Path, PathBuf};

use portolan::RequestedOptions;
use portolan::pipeline::{
    KnownMap, MappedRecording, PipelineError, PipelineProgress, Preparation, map_recording, prepare,
};
use portolan_config::{Loader, Options, little_effect};
use portolan_geometry::Duration;
use portolan_mapping::{MapperSettings, Planar, Space, Spatial};
use portolan_recording::{
    AzimuthTimes, Dimension, IngestOptions, Recording, StampPolicy, open_all, read_urdf,
};

use super::argument::{seconds, time_offset};
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::interrupt;
use crate::known_map::{KnownMapArgs, Localisation};
use crate::memory::resident_and_peak_bytes;
use crate::output::print;
use crate::progress::{Progress, say};
use crate::results::{ResultSpace, Written, add_to_report, write_results};
pub use cloud::{CloudArgs, CloudResults, write_clouds};

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

    /// Write the trajectory in the times of the map, too (`all_poses.tum`): where stamps came in bursts they are
    /// not those of the recording, which `trajectory.tum` has.
    #[arg(long)]
    pub all_poses: bool,

    /// Leave out the first seconds of the recording.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, value_parser = seconds, allow_negative_numbers = true)]
    pub skip: f64,

    /// Stop after so many seconds of the recording.
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub duration: Option<f64>,
}

/// Which topics and frames are which sensors; found without being told.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Sensors (found without being told)")]
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
    /// Use satellite fixes (sensor_msgs/NavSatFix), as `--set use_nav_sat=true` does. They help on long ways outdoors
    /// that do not come back to where they were; indoors and between high houses fixes are wrong and harm.
    #[arg(long)]
    pub gnss: bool,
    /// Frame whose motion is wanted: that of the IMU if one is used.
    #[arg(long, value_name = "FRAME")]
    pub tracking_frame: Option<String>,
    /// Read another topic in place of a name, as in ROS: `--remap scan:=/front/scan`.
    #[arg(long, value_name = "NAME:=TOPIC")]
    pub remap: Vec<String>,
    /// Robot description whose fixed joints say where the sensors are.
    #[arg(long, value_name = "FILE")]
    pub urdf: Option<PathBuf>,
    /// Whether the points of clouds without times get them from their azimuth, with the stamp at the beginning
    /// or the end of the turn. On their own spinning lidars do, unless motion was taken out of the clouds. Unless
    /// it is `auto`, times that the points of a spinning lidar have are not used.
    #[arg(long, value_name = "HOW", default_value = "auto")]
    pub azimuth_times: AzimuthTimesArg,
    /// Move the stamps of a topic, and the times of its points, by seconds, `/points_rear=-0.05`; `check` tells how far
    /// clocks are off. May be given several times.
    #[arg(long, value_name = "TOPIC=SECONDS", value_parser = time_offset)]
    pub time_offset: Vec<(String, f64)>,
    /// How stamps are taken: a computer that is busy stamps several messages at once, and later than they were
    /// measured.
    #[arg(long, value_name = "HOW", default_value = "auto")]
    pub stamps: StampsArg,
}

/// How stamps are taken.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StampsArg {
    /// As they are, unless those of a sensor come in bursts or go back.
    #[default]
    Auto,
    /// As they are.
    AsIs,
    /// From the order of arrival and the usual rate of each sensor.
    Regular,
}

impl From<StampsArg> for StampPolicy {
    fn from(how: StampsArg) -> Self {
        match how {
            StampsArg::Auto => Self::Auto,
            StampsArg::AsIs => Self::AsIs,
            StampsArg::Regular => Self::Regular,
        }
    }
}

/// Times of points from their azimuth.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AzimuthTimesArg {
    /// For spinning lidars, as the first clouds and the times of recording show.
    #[default]
    Auto,
    /// No: all points are measured at the stamp.
    Off,
    /// Yes: turns begin at the stamp.
    FromStamp,
    /// Yes: turns end at the stamp.
    UntilStamp,
}

impl From<AzimuthTimesArg> for AzimuthTimes {
    fn from(how: AzimuthTimesArg) -> Self {
        match how {
            AzimuthTimesArg::Auto => Self::Auto,
            AzimuthTimesArg::Off => Self::Off,
            AzimuthTimesArg::FromStamp => Self::FromStamp,
            AzimuthTimesArg::UntilStamp => Self::UntilStamp,
        }
    }
}

/// Settings; defaults are chosen from the recording.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Settings (chosen from the recording without being told)")]
pub struct ConfigArgs {
    /// Cartographer configuration in Lua; used as it is, instead of settings chosen from the recording.
    #[arg(long, value_name = "FILE.lua")]
    pub config: Option<PathBuf>,
    /// Folder to look for included Lua files in; may be given several times.
    #[arg(long, value_name = "DIR")]
    pub config_dir: Vec<PathBuf>,
    /// Change one option: `--set pose_graph.constraint_builder.min_score=0.6`.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

pub fn run(args: MapArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    args.cloud.check()?;
    args.cloud.make_room()?;
    let folder = args.output.clone().unwrap_or_else(|| default_folder(&args.recordings[0]));
    std::fs::create_dir_all(&folder).map_err(|source| CliError::File { path: folder.clone(), source })?;
    let recording = open_all(&args.recordings)?;
    let configuration = load_options(&args.config)?;
    let requested = RequestedOptions { configuration, settings: settings(&args) };
    let ingest = ingest_options(&args, &requested)?;
    interrupt::watch();
    let threads = requested.background_threads();
    let RequestedOptions { configuration, settings } = requested;
    let is_configured = configuration.is_some();
    let mut preparation = looked_through(recording.as_ref(), &ingest, configuration, global)?;
    if !args.known.from.is_empty() && !is_configured {
        let submaps = args.known.count_submaps()?;
        portolan::automatic::search_in_known_map(&mut preparation.options, submaps);
    }
    change_options(&mut preparation, &settings)?;
    preparation.background_threads = threads;
    args.cloud.keep_scans(&mut preparation, &folder);
    match preparation.dimension {
        Dimension::Two => finish::<Planar>(recording.as_ref(), &ingest, preparation, &folder, &args, global),
        Dimension::Three => {
            finish::<Spatial>(recording.as_ref(), &ingest, preparation, &folder, &args, global)
        }
    }
}

fn finish<S: ResultSpace>(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    preparation: Preparation,
    folder: &Path,
    args: &MapArgs,
    global: &GlobalArgs,
) -> Result<Outcome, CliError> {
    let start = std::time::Instant::now();
    let known = args.known.load::<S>(&preparation.options, global.quiet)?;
    let mapped = map_with_progress::<S>(recording, ingest, preparation.clone(), known, global);
    let mapped = mapped.map_err(|error| nothing_left(error, recording, args))?;
    let seconds = start.elapsed().as_secs_f64();
    let written = write_results(&mapped, folder, seconds, args.all_poses)?;
    print(&summary(&mapped, &written, seconds))?;
    let clouds = write_clouds(recording, ingest, &preparation, &mapped, &args.cloud, folder, global)?;
    clouds.map_or(Ok(()), |clouds| report_clouds(&clouds, folder))?;
    let is_whole = !mapped.reading_repairs.iter().any(|r| r.lost_data)
        && !mapped.losses.iter().any(|loss| mapped.is_apart(loss));
    Ok(if is_whole { Outcome::Done } else { Outcome::DataLost })
}

/// Names what the second pass gave, here and in the report.
pub fn report_clouds(clouds: &CloudResults, folder: &Path) -> Result<(), CliError> {
    add_to_report(folder, "cloud", &clouds.report)?;
    let mut lines = vec![clouds.text.clone()];
    lines.extend(clouds.files.iter().map(|file| file.display().to_string()));
    lines.retain(|line| !line.is_empty());
    if lines.is_empty() { Ok(()) } else { print(&lines.join("\n")) }
}

/// Beside the working directory's other results: the recording's name with `_map`.
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

/// Settings to change, in this order: what is said by name of an option comes last.
fn settings(args: &MapArgs) -> Vec<String> {
    let gnss = args.sensors.gnss.then(|| "use_nav_sat=true".to_owned());
    gnss.into_iter().chain(args.config.set.iter().cloned()).collect()
}

/// What the command line and options say of the sensors.
fn ingest_options(args: &MapArgs, requested: &RequestedOptions) -> Result<IngestOptions, CliError> {
    let sensors = &args.sensors;
    let mut ingest = IngestOptions {
        range_topics: sensors.scan.iter().chain(&sensors.points).cloned().collect(),
        odometry_topic: sensors.odom.clone(),
        imu_topic: sensors.imu.clone(),
        tracking_frame: sensors.tracking_frame.clone(),
        azimuth_times: sensors.azimuth_times.into(),
        stamps: sensors.stamps.into(),
        time_offsets: sensors
            .time_offset
            .iter()
            .map(|(topic, seconds)| (topic.clone(), Duration::from_seconds(*seconds)))
            .collect(),
        skip: Duration::from_seconds(args.skip),
        length: args.duration.map(Duration::from_seconds),
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
    if let Some(path) = &sensors.urdf {
        ingest.description = Some(read_urdf(path)?);
    }
    Ok(ingest)
}

/// Looks through a recording, says what was chosen, and changes the options as asked.
pub fn prepared(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    configured: Option<Options>,
    settings: &[String],
    global: &GlobalArgs,
) -> Result<Preparation, CliError> {
    let mut preparation = looked_through(recording, ingest, configured, global)?;
    change_options(&mut preparation, settings)?;
    Ok(preparation)
}

fn looked_through(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    configured: Option<Options>,
    global: &GlobalArgs,
) -> Result<Preparation, CliError> {
    let preparation = prepare(recording, ingest, configured).map_err(failure)?;
    for notice in preparation.plan.notices.iter().filter(|_| !global.quiet) {
        say(&format!("{} {}", notice.what, notice.change));
    }
    Ok(preparation)
}

fn change_options(preparation: &mut Preparation, settings: &[String]) -> Result<(), CliError> {
    for setting in settings {
        preparation.options.set(setting).map_err(|e| CliError::Usage(e.to_string()))?;
    }
    for path in settings.iter().filter_map(|setting| setting.split_once('=')).map(|(path, _)| path) {
        if let Some(why) = little_effect(path, &preparation.options, preparation.plan.imu.is_some()) {
            tracing::warn!("--set {path} has little effect or none: {why}");
        }
    }
    preparation.options.validate().map_err(|errors| {
        let lines: Vec<String> = errors.iter().map(ToString::to_string).collect();
        CliError::Usage(lines.join("\n"))
    })
}

/// Names --skip and --duration where they left no scan.
fn nothing_left(error: CliError, recording: &dyn Recording, args: &MapArgs) -> CliError {
    let length = args.duration.map(|seconds| format!("--duration {seconds}"));
    let skip = (args.skip > 0.0).then(|| format!("--skip {}", args.skip));
    let cuts: Vec<String> = skip.into_iter().chain(length).collect();
    if cuts.is_empty() || interrupt::interrupted() || !matches!(error, CliError::NoScans(_)) {
        return error;
    }
    let range = recording.time_range().map_or(0.0, |(first, last)| last.seconds_since(first));
    CliError::Failed(format!(
        "{} leaves not a single scan that could be used of the {range:.1} s of the recording",
        cuts.join(" with ")
    ))
}

fn failure(error: PipelineError) -> CliError {
    match error {
        PipelineError::Setting(message) => CliError::Usage(message),
        PipelineError::NoScans if interrupt::interrupted() => {
            CliError::Failed("interrupted before the first scan: nothing was written".to_owned())
        }
        PipelineError::NoScans => CliError::NoScans(error.to_string()),
        other => CliError::Failed(other.to_string()),
    }
}

/// Maps with a bar that tells how far it is.
pub fn map_with_progress<S: Space>(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    preparation: Preparation,
    known: KnownMap<S>,
    global: &GlobalArgs,
) -> Result<MappedRecording<S>, CliError> {
    let mut progress = Progress::start("mapping", recording.size_bytes(), global.quiet);
    let start = std::time::Instant::now();
    let threads = global.thread_count_up_to(preparation.background_threads);
    let settings = MapperSettings { threads, ..MapperSettings::default() };
    let mapped = map_recording(recording, ingest, preparation, known, settings, &mut |state| {
        if progress.is_due() {
            progress.update(state.position_bytes, state.total_bytes, describe(state, start));
        }
        !interrupt::interrupted()
    });
    progress.finish();
    mapped.map_err(failure)
}

fn describe(state: &PipelineProgress, start: std::time::Instant) -> String {
    let memory = resident_and_peak_bytes()
        .map_or_else(String::new, |(resident, _)| format!(", {} MB", resident / 1_000_000));
    format!(
        "{:.0} s of the recording, {:.0}x real time, {} nodes, {} constraints, {} waiting{memory}",
        state.recording_seconds,
        state.recording_seconds / start.elapsed().as_secs_f64().max(1e-3),
        state.backend.nodes,
        state.backend.constraints,
        state.backend.backlog,
    )
}

/// What was made, for people.
pub fn summary<S: Space>(mapped: &MappedRecording<S>, written: &Written, seconds: f64) -> String {
    let state = mapped.map.graph.state();
    let loops = state.constraints.iter().filter(|c| c.is_loop_closure()).count();
    let mut text = format!(
        "{} scans, {} nodes, {} submaps, {loops} loop closures; {:.0} s of recording in {seconds:.1} s ({:.0}x real time)\n",
        mapped.scans,
        state.nodes.len(),
        state.submaps.len(),
        mapped.recording_seconds,
        mapped.recording_seconds / seconds.max(1e-3),
    );
    if let Some(localisation) = Localisation::of(mapped) {
        text += &format!("{}\n", localisation.sentence());
    }
    let times = &mapped.scan_times;
    if times.count() > 0 {
        text += &format!(
            "local SLAM {:.2} ms a scan, 99 % within {:.2} ms",
            1e3 * times.total().as_secs_f64() / times.count() as f64,
            1e3 * times.quantile(0.99).as_secs_f64(),
        );
        text += &resident_and_peak_bytes()
            .map_or_else(String::new, |(_, peak)| format!("; memory at most {} MB", peak / 1_000_000));
        text += "\n";
    }
    let contradicted = mapped.map.graph.contradicted_loop_closures();
    if contradicted > 0 {
        text += &format!("{contradicted} more loop closures were left out: the others contradict them\n");
    }
    text += &crate::lost::losses(mapped);
    text += &weak::weak_stretches(&mapped.degenerate_intervals, mapped.recording_seconds);
    for repair in &mapped.reading_repairs {
        text += &format!("repaired: {} ({}x)\n", repair.what, repair.count);
    }
    for (what, count) in &mapped.mapping_repairs {
        text += &format!("repaired: {what} ({count}x)\n");
    }
    if mapped.interrupted {
        text += "interrupted: stopped before the end of the recording; what was mapped is saved\n";
    }
    for file in &written.files {
        text += &format!("{}\n", file.display());
    }
    text.trim_end().to_owned()
}
