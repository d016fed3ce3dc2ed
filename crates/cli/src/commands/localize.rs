//! `portolan localize`: localises a recording in a saved map.

use std::f64::consts::PI;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use portolan::job::{
    Event, Found, JobError, LOCALIZED_FILES, LocalizeRequest, LocalizedRecording, OutputFolder, SaveMap,
    SavedMap, Start, is_same_file, last_pose, localize, write_localized,
};
use portolan_geometry::Rigid3;
use portolan_localization::{ChangeKind, Growth, Jumps, StartPose, State};
use portolan_recording::{Recording, open_all};

use super::argument::{start_pose, start_sigma};
use super::map::{
    ConfigArgs, CutArgs, SensorArgs, ingest_options, no_scans_in_cut, remarks, requested_options,
};
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::interrupt::Saving;
use crate::output::{counted, make_folder, print_summary};
use crate::progress::Progress;

/// Localise a recording in a saved map, scan by scan: pose, covariance, and the intervals in which it was
/// lost.
///
/// Without a start, the pose is searched in the whole map. The map file is not changed, and memory does not
/// grow with time. `poses.tum` has the poses of the tracking frame while it was localised; `poses.csv` has
/// every scan with state, reason and covariance; `path.png` shows the path in the map, coloured by state
/// (green localised, orange uncertain, violet dots tentative); `changes.geojson` has the places that have
/// changed since the map was made; `report.json` has the rest. Exit codes: 0 localised in nearly
/// all scans since it was found, and never lost; 3 localised in parts, or data were lost; 4 never localised.
#[derive(clap::Args, Clone, Debug)]
#[command(after_help = "Examples:\n  portolan localize house/map.pbstream today.bag -o today\n  \
    portolan localize house/map.pbstream today.bag --start 3.5,-2,90\n  \
    portolan localize house/map.pbstream today.bag --start 3.5,-2,90 --start-sigma 2,45\n  \
    portolan localize house/map.pbstream today.bag --start gnss\n  \
    portolan localize house/map.pbstream today.bag --start-from yesterday/poses.csv\n  \
    portolan localize house/map.pbstream today.bag --update house/map_today.pbstream")]
pub struct LocalizeArgs {
    /// The map: a .pbstream of Portolan or Cartographer.
    #[arg(value_name = "MAP.pbstream")]
    pub map: PathBuf,

    /// Recordings, read as one in the order given.
    #[arg(required = true, value_name = "RECORDING")]
    pub recordings: Vec<PathBuf>,

    /// Folder for the results; created if missing. Default: the recording's name with `_localized`.
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,

    /// Pose in the map at which the recording starts, metres and degrees; also X,Y,Z,YAW or
    /// X,Y,Z,ROLL,PITCH,YAW. `gnss`: start at the satellite fixes, in a map that was made with --gnss; this
    /// is the default if the recording has fixes, too. `unknown`: search the whole map, even if there are
    /// fixes. A start must be confirmed by scans; a wrong one usually costs seconds, but where places look
    /// alike it may lead to the wrong one.
    #[arg(long, value_name = "X,Y,YAW", value_parser = start_argument, allow_hyphen_values = true)]
    pub start: Option<StartArgument>,

    /// Start at the landmark of the map with this name, with unknown heading; an unknown name lists the
    /// landmarks. Scans must confirm the start, as for --start.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["start", "start_from"])]
    pub start_landmark: Option<String>,

    /// Standard deviations of the start in metres and degrees. Default: 0.5,10; at a landmark 2,180. METRES
    /// alone means 10 degrees. Below 180 degrees, the heading at a landmark is assumed to be that of the
    /// landmark.
    #[arg(long, value_name = "METRES[,DEGREES]", value_parser = start_sigma, allow_hyphen_values = true,
        conflicts_with = "start_from")]
    pub start_sigma: Option<(f64, f64)>,

    /// Overwrite files in the folder that were not written by an earlier `localize`.
    #[arg(long)]
    pub force: bool,

    /// Start at the last localised pose of an earlier run: its poses.csv. Scans must confirm the start, as
    /// for --start.
    #[arg(long, value_name = "POSES.csv", conflicts_with = "start")]
    pub start_from: Option<PathBuf>,

    /// Also write driver.tum, poses for the driver of a robot. Corrections are applied gradually (smooth), at
    /// once (immediate), or gradually except for jumps to another place, which wait for 2 s of confirmation
    /// (hold).
    #[arg(long, value_name = "POLICY", value_enum)]
    pub jumps: Option<JumpPolicy>,

    /// Also write the map with this recording as one more trajectory, where it was reliably localised. The
    /// rest of the map is unchanged. If it was nowhere reliably localised, no file is written (exit code 4).
    #[arg(long, value_name = "FILE.pbstream")]
    pub save_map: Option<PathBuf>,

    /// Also write the map, updated by this recording: objects that are gone fade, new ones appear, and
    /// submaps that the recording covers are replaced, so that the file grows with the area and not with
    /// time. May be the map itself.
    #[arg(long, value_name = "FILE.pbstream", conflicts_with = "save_map")]
    pub update: Option<PathBuf>,

    #[command(flatten)]
    pub sensors: SensorArgs,

    #[command(flatten)]
    pub config: ConfigArgs,

    #[command(flatten)]
    pub cut: CutArgs,
}

/// Value of `--start`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StartArgument {
    At(Rigid3),
    Fixes,
    Unknown,
}

fn start_argument(text: &str) -> Result<StartArgument, String> {
    match text {
        "gnss" => Ok(StartArgument::Fixes),
        "unknown" => Ok(StartArgument::Unknown),
        pose => {
            start_pose(pose).map(StartArgument::At).map_err(|error| format!("{error}; or gnss, or unknown"))
        }
    }
}

/// Values of `--jumps`.
#[derive(clap::ValueEnum, Clone, Copy, Debug)]
pub enum JumpPolicy {
    Smooth,
    Immediate,
    Hold,
}

impl From<JumpPolicy> for Jumps {
    fn from(policy: JumpPolicy) -> Self {
        match policy {
            JumpPolicy::Smooth => Self::Smooth,
            JumpPolicy::Immediate => Self::Immediate,
            JumpPolicy::Hold => Self::Hold,
        }
    }
}

pub fn run(args: &LocalizeArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let begin = Instant::now();
    let output = args.output.clone().unwrap_or_else(|| default_folder(&args.recordings[0]));
    let _made = make_folder(&output)?;
    let mut observe = remarks(global);
    let folder = OutputFolder::begin(&output, "localize", &LOCALIZED_FILES, args.force, &mut observe)?;
    let recording = open_all(&args.recordings)?;
    let requested = requested_options(&args.sensors, &args.config)?;
    let request = LocalizeRequest {
        map: args.map.clone(),
        folder: output,
        ingest: ingest_options(&args.sensors, &args.cut, &requested)?,
        requested,
        start: start(args)?,
        jumps: args.jumps.map(Jumps::from),
        save_map: save_map(args, folder.path())?,
        threads: global.threads,
    };
    let mut saving = None;
    let localized = localize_with_progress(recording.as_ref(), &request, &mut saving, global);
    let localized =
        localized.map_err(|error| no_scans_in_cut(error.into(), recording.as_ref(), &args.cut))?;
    let seconds = begin.elapsed().as_secs_f64();
    let files = write_localized(&localized, &folder, seconds, &mut remarks(global))?;
    drop(saving);
    print_summary(&summary(&localized, &files, seconds));
    let is_refused = matches!(localized.saved_map, Some(SavedMap::Refused(_) | SavedMap::Unsound(_)));
    Ok(match localized.found() {
        _ if is_refused => Outcome::Untrusted,
        Found::Never => Outcome::Untrusted,
        Found::InParts => Outcome::DataLost,
        Found::Throughout if localized.issues.lost_data() => Outcome::DataLost,
        Found::Throughout => Outcome::Done,
    })
}

/// The map to write besides the other results, of `--save-map` or `--update`. Refuses paths of recordings and of other
/// results.
fn save_map(args: &LocalizeArgs, output: &Path) -> Result<Option<SaveMap>, CliError> {
    let (path, growth) = match (&args.save_map, &args.update) {
        (Some(path), _) => (path, Growth::Extend),
        (None, Some(path)) => (path, Growth::Renew),
        (None, None) => return Ok(None),
    };
    if args.recordings.iter().any(|recording| is_same_file(recording, path)) {
        return Err(CliError::Usage(format!(
            "{}: this is a recording, which the map would replace: name another file",
            path.display()
        )));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let is_result = path.file_name().is_some_and(|name| LOCALIZED_FILES.iter().any(|file| name == *file));
    if is_result && (folder == output || is_same_file(folder, output)) {
        return Err(CliError::Usage(format!(
            "{}: another result has this name: name another file for the map",
            path.display()
        )));
    }
    Ok(Some(SaveMap { path: path.clone(), growth }))
}

/// Message for the user whether the map was written, and how it has changed.
fn saved_map(saved: &SavedMap) -> String {
    let (path, grown) = match saved {
        SavedMap::Refused(reason) => return format!("NO map was written: {reason}\n"),
        SavedMap::Unsound(issues) => {
            let issues: Vec<String> = issues.iter().map(|issue| issue.to_string()).collect();
            return format!("NO map was written: {}\n", issues.join("; "));
        }
        SavedMap::Interrupted => return "NO map was written: interrupted\n".to_owned(),
        SavedMap::Written { path, grown } => (path, grown),
    };
    let nodes = format!("{} of {} nodes have a trusted pose", grown.trusted_nodes, grown.nodes);
    let what = match &grown.renewal {
        None => format!(
            "{} added, tied to the map by {}",
            counted(grown.extension.submaps as u64, "submap", "submaps"),
            counted(grown.extension.ties as u64, "constraint", "constraints"),
        ),
        Some(renewal) if renewal.is_nothing() => {
            "nothing has changed in the map, which stays as it was".to_owned()
        }
        Some(renewal) => format!(
            "{:.2} m² appeared, {:.2} m² gone, {:.0} m² new: {} added, {} removed",
            renewal.appeared,
            renewal.gone,
            renewal.discovered,
            counted(renewal.added_submaps as u64, "submap", "submaps"),
            renewal.removed_submaps,
        ),
    };
    format!("{nodes}; {what}\n{}\n", path.display())
}

/// Default standard deviations of a start pose, metres and radians.
const SIGMAS_AT_POSE: (f64, f64) = (0.5, 10.0 * PI / 180.0);
/// Default standard deviations of a start at a landmark, metres and radians.
const SIGMAS_AT_LANDMARK: (f64, f64) = (2.0, PI);

/// The start given by the user, or the last pose of an earlier run (`--start-from`).
fn start(args: &LocalizeArgs) -> Result<Option<Start>, CliError> {
    if let Some(path) = &args.start_from {
        return Ok(Some(Start::At(last_pose(path)?)));
    }
    if let Some(name) = &args.start_landmark {
        let (sigma_metres, sigma_radians) = args.start_sigma.unwrap_or(SIGMAS_AT_LANDMARK);
        return Ok(Some(Start::Landmark { name: name.clone(), sigma_metres, sigma_radians }));
    }
    let start = match args.start {
        Some(StartArgument::At(pose)) => pose,
        _ if args.start_sigma.is_some() => {
            return Err(CliError::Usage(
                "--start-sigma belongs to --start X,Y,YAW or --start-landmark: give one of them".to_owned(),
            ));
        }
        Some(StartArgument::Fixes) => return Ok(Some(Start::Fixes)),
        Some(StartArgument::Unknown) => return Ok(Some(Start::Unknown)),
        None => return Ok(None),
    };
    let (sigma_metres, sigma_radians) = args.start_sigma.unwrap_or(SIGMAS_AT_POSE);
    Ok(Some(Start::At(StartPose { map_from_tracking: start, sigma_metres, sigma_radians })))
}

/// Localises with a progress bar. From the first measurement on there are partial results, so that an interruption saves
/// them.
fn localize_with_progress(
    recording: &dyn Recording,
    request: &LocalizeRequest,
    saving: &mut Option<Saving>,
    global: &GlobalArgs,
) -> Result<LocalizedRecording, JobError> {
    let mut progress = Progress::start("localising", recording.size_bytes(), global.quiet);
    let mut observe = remarks(global);
    let localized = localize(recording, request, &mut |event| -> ControlFlow<()> {
        if let Event::Localizing { position_bytes, total_bytes, state } = event {
            saving.get_or_insert_with(Saving::begin);
            if progress.is_due() {
                progress.update(*position_bytes, *total_bytes, state.to_string());
            }
        }
        observe(event)
    });
    progress.finish();
    localized
}

fn default_folder(recording: &Path) -> PathBuf {
    let name = recording.file_name().map_or_else(|| "recording".into(), |n| n.to_string_lossy());
    PathBuf::from(format!("{}_localized", name.split('.').next().unwrap_or("recording")))
}

/// Summary of a localisation for the user.
fn summary(localized: &LocalizedRecording, files: &[PathBuf], seconds: f64) -> String {
    let found = match (localized.found(), localized.found_after_seconds()) {
        (Found::Throughout, Some(after)) => format!("found after {after:.1} s and never lost"),
        (Found::InParts, Some(after)) => {
            format!(
                "found after {after:.1} s, but lost or uncertain at times since (see path.png and poses.csv)"
            )
        }
        _ => "NOT found in the map. If you know the place, say \
              --start X,Y,YAW; it is used only if scans fit there"
            .to_owned(),
    };
    let mut text = format!("{found}\n");
    let counts = localized.state_counts();
    let silent = localized.seconds_without_scans();
    let all = counts.iter().map(|(_, count)| count.seconds).sum::<f64>() + silent;
    let shares = counts.iter().filter(|(_, count)| count.scans > 0);
    let mut shares: Vec<String> =
        shares.map(|(state, count)| format!("{state} {:.1} s", count.seconds)).collect();
    if silent > 0.0 {
        shares.push(format!("no scans for {silent:.1} s"));
    }
    text += &format!("{} scans: {}\n", localized.estimates.len(), shares.join(", "));
    text += &format!("{all:.0} s of recording in {seconds:.1} s\n");
    match (localized.start_agrees, localized.starts_at_fix) {
        (Some(false), false) => text += "--start is WRONG: the recording starts elsewhere in the map\n",
        (Some(false), true) => text += "the satellite fix is WRONG: the recording is elsewhere in the map\n",
        (Some(true), true) => text += "the start agrees with the satellite fix\n",
        _ => {}
    }
    let last = localized.estimates.last();
    if let Some(estimate) = last.filter(|e| e.state != State::Localised) {
        text += &format!("at the end it is {} ({})\n", estimate.state, estimate.reason.name());
    }
    if !localized.changes.is_empty() {
        let area = |kind| -> f64 {
            localized.changes.iter().filter(|c| c.kind == kind).fold(0.0, |sum, c| sum + c.area)
        };
        text += &format!(
            "{} where the map has changed (changes.geojson): {:.2} m² appeared, {:.2} m² gone\n",
            counted(localized.changes.len() as u64, "place", "places"),
            area(ChangeKind::Appeared),
            area(ChangeKind::Gone),
        );
    }
    for issue in localized.issues.iter() {
        let label = if issue.lost_data() { "lost" } else { "repaired" };
        text += &format!("{label}: {issue} ({}x)\n", issue.count);
    }
    if localized.interrupted {
        text += "interrupted: stopped before the end of the recording; what was found is saved\n";
    }
    if let Some(saved) = &localized.saved_map {
        text += &saved_map(saved);
    }
    for file in files {
        text += &format!("{}\n", file.display());
    }
    text.trim_end().to_owned()
}
