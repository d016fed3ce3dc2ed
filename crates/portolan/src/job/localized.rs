//! Writes the results of localisation.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use portolan_atomic_file::AtomicFile;
use portolan_export::{
    ColouredLine, PictureError, PictureOptions, Rgb, draw_path, rgb, write_picture, write_tum,
};
use portolan_geometry::{Dimension, Rigid3, Time, roll_pitch_yaw, yaw};
use portolan_ingest::SensorPlan;
use portolan_issue::IssueLog;
use portolan_localization::{Change, Corrections, Estimate, Jumps, Place, StartPose, State};
use portolan_mapfile::PlacedTexture;
use portolan_numeric::median;
use portolan_spool::Spool;

use super::REPORT_VERSION;
use super::change_map::{geojson, outlines};
use super::error::{JobError, write_file};
use super::event::{Observer, Remark, remark};
use super::output_folder::{OutputFolder, Stale};
use super::saved_map::SavedMap;
use crate::silence::is_silence;

/// A recording that was localised in a map.
pub struct LocalizedRecording {
    /// The estimate after each scan, in order.
    pub estimates: Spool<Estimate>,
    /// Whether it was localised in 2D or in 3D.
    pub dimension: Dimension,
    /// Which topics were used as which sensors.
    pub plan: SensorPlan,
    /// Start given by the user; otherwise the satellite fix that was used while the recording was searched.
    pub start: Option<StartPose>,
    /// Whether the start was a fix.
    pub starts_at_fix: bool,
    /// How a consumer of the poses takes in corrections; none if not requested.
    pub jumps: Option<Jumps>,
    /// Whether the start agrees with the pose found; none without a start, or if the pose is unknown at the
    /// end.
    pub start_agrees: Option<bool>,
    /// Contradictions between scans and map.
    pub changes: Vec<Change>,
    /// Repairs and losses.
    pub issues: IssueLog,
    /// Scans whose stamps were changed: their times here, and the stamps as recorded.
    pub recorded_times: BTreeMap<Time, Time>,
    /// Pictures of the map.
    pub textures: Vec<PlacedTexture>,
    /// Result of saving the map; none if it was not to be saved.
    pub saved_map: Option<SavedMap>,
    /// Whether it was stopped before the end.
    pub interrupted: bool,
}

/// Whether a recording was found in a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// It was never lost after it was found, and hardly ever uncertain.
    Throughout,
    /// It was lost at times, or left the area of the map.
    InParts,
    /// It was not found.
    Never,
}

impl Found {
    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Throughout => "throughout",
            Self::InParts => "in_parts",
            Self::Never => "never",
        }
    }
}

/// Frequency and duration of a state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StateCount {
    /// Number of scans after which the state was this one.
    pub scans: usize,
    /// Seconds until the next scan, summed up. Across long gaps between scans only one scan interval counts.
    pub seconds: f64,
}

/// Fraction of scans since it was found that must be localised for [`Found::Throughout`].
const THROUGHOUT: f64 = 0.95;

impl LocalizedRecording {
    /// How completely the recording was localised.
    pub fn found(&self) -> Found {
        let states = self.estimates.iter().map(|e| e.state);
        let (mut all, mut localised, mut was_lost) = (0, 0, false);
        for state in states.skip_while(|state| *state != State::Localised) {
            all += 1;
            localised += usize::from(state == State::Localised);
            was_lost |= state == State::Lost;
        }
        if all == 0 {
            return Found::Never;
        }
        if was_lost || f64::from(localised as u32) < THROUGHOUT * f64::from(all) {
            return Found::InParts;
        }
        Found::Throughout
    }

    /// Seconds of the recording until it was first localised.
    pub fn found_after_seconds(&self) -> Option<f64> {
        let first = self.estimates.iter().next()?;
        let found = self.estimates.iter().find(|e| e.state == State::Localised)?;
        Some(found.time.seconds_since(first.time))
    }

    /// Frequency and duration of each state, in the order of [`State::ALL`].
    pub fn state_counts(&self) -> [(State, StateCount); 5] {
        let mut counts = State::ALL.map(|state| (state, StateCount::default()));
        let (valid_durations, _) = valid_durations(&self.intervals());
        let states = self.estimates.iter().map(|estimate| estimate.state);
        for (state, seconds) in states.zip(valid_durations.into_iter().chain([0.0])) {
            for (_, count) in counts.iter_mut().filter(|(counted, _)| *counted == state) {
                count.scans += 1;
                count.seconds += seconds;
            }
        }
        counts
    }

    /// Total duration of gaps in which scans were due, so that the state is unknown, seconds.
    pub fn seconds_without_scans(&self) -> f64 {
        valid_durations(&self.intervals()).1
    }

    /// Seconds from each scan to the next.
    fn intervals(&self) -> Vec<f64> {
        let later = self.estimates.iter().skip(1);
        self.estimates.iter().zip(later).map(|(scan, next)| next.time.seconds_since(scan.time)).collect()
    }

    /// Poses of the tracking frame in the map where it was localised, under the times of the recording.
    pub fn poses(&self) -> Vec<(Time, Rigid3)> {
        let localised = self.estimates.iter().filter(|e| e.state == State::Localised);
        localised.filter_map(|e| Some((self.recorded(e.time), e.place?.map_from_tracking))).collect()
    }

    /// The poses that a consumer would have used: poses of the tracking frame in the map with corrections
    /// taken in according to the policy, since it was first localised, with the times of the recording.
    pub fn driven(&self, jumps: Jumps) -> Vec<(Time, Rigid3)> {
        let mut corrections = Corrections::new(jumps);
        let mut driven = |e: Estimate| Some((self.recorded(e.time), corrections.add(&e)?));
        self.estimates.iter().filter_map(&mut driven).collect()
    }

    fn recorded(&self, time: Time) -> Time {
        self.recorded_times.get(&time).copied().unwrap_or(time)
    }
}

/// How long the pose of each scan is valid, by the seconds to the next scan, and the total time without a
/// valid pose. Of a gap, only one scan interval counts as valid.
fn valid_durations(intervals: &[f64]) -> (Vec<f64>, f64) {
    let period = median(&mut intervals.to_vec()).unwrap_or_default();
    let valid_durations = |seconds: &f64| if is_silence(*seconds, period) { period } else { *seconds };
    let valid: Vec<f64> = intervals.iter().map(valid_durations).collect();
    let silent = intervals.iter().zip(&valid).map(|(seconds, valid)| seconds - valid).sum();
    (valid, silent)
}

/// The files of [`write_localized`].
pub const LOCALIZED_FILES: [&str; 6] =
    ["poses.tum", "driver.tum", "poses.csv", "changes.geojson", "path.png", "report.json"];

/// Writes [`LOCALIZED_FILES`], `driver.tum` only if requested; returns their paths. `seconds` is the
/// computing time.
///
/// # Errors
/// Fails if something cannot be written.
pub fn write_localized(
    localized: &LocalizedRecording,
    folder: &OutputFolder,
    seconds: f64,
    observe: &mut Observer,
) -> Result<Vec<PathBuf>, JobError> {
    let mut files = Vec::new();
    let whole = || localized.estimates.whole().map_err(|source| JobError::file(folder.path(), source));
    let poses = localized.poses();
    whole()?;
    write_tum(&folder.add("poses.tum", &mut files)?, &poses)?;
    if let Some(jumps) = localized.jumps {
        let driven = localized.driven(jumps);
        whole()?;
        write_tum(&folder.add("driver.tum", &mut files)?, &driven)?;
    }
    write_csv(localized, &folder.add("poses.csv", &mut files)?)?;
    let changes = geojson(&localized.changes, |time| localized.recorded(time));
    let changes = serde_json::to_vec_pretty(&changes)?;
    write_file(&folder.add("changes.geojson", &mut files)?, &changes)?;
    let mut lines = outlines(&localized.changes);
    lines.extend(path(&localized.estimates));
    whole()?;
    match draw_path(&localized.textures, &lines, &PictureOptions::default()) {
        Ok(picture) => write_picture(&folder.add("path.png", &mut files)?, &picture)?,
        Err(error @ PictureError::Empty) => remark(observe, Remark::NoPicture(error)),
        Err(error) => return Err(error.into()),
    }
    let report = serde_json::to_vec_pretty(&report(localized, seconds))?;
    whole()?;
    write_file(&folder.add("report.json", &mut files)?, &report)?;
    let stale = if localized.interrupted { Stale::Name } else { Stale::Remove };
    folder.finish(stale, &[], observe)?;
    Ok(files)
}

/// Writes one line for each scan. Numbers are missing where the pose is unknown.
fn write_csv(localized: &LocalizedRecording, path: &Path) -> Result<(), JobError> {
    let axes = Axes::of(localized.dimension);
    let mut file = AtomicFile::create(path)?;
    let header = format!("time,state,reason,{},explained,in_free_space,through_solid\n", axes.header());
    let lines = localized.estimates.iter().map(|e| axes.line(localized.recorded(e.time), &e));
    for line in std::iter::once(header).chain(lines) {
        if let Err(source) = file.write_all(line.as_bytes()) {
            return Err(file.error(source).into());
        }
    }
    localized.estimates.whole().map_err(|source| JobError::file(path, source))?;
    Ok(file.commit()?)
}

/// The axes of a pose that are written, as indices of its covariance, with their names.
struct Axes(&'static [(usize, &'static str)]);

impl Axes {
    fn of(dimension: Dimension) -> Self {
        match dimension {
            Dimension::TwoD => Self(&[(0, "x"), (1, "y"), (5, "yaw")]),
            Dimension::ThreeD => Self(&[(0, "x"), (1, "y"), (2, "z"), (3, "roll"), (4, "pitch"), (5, "yaw")]),
        }
    }

    /// Each pair of axes once.
    fn pairs(&self) -> impl Iterator<Item = ((usize, &'static str), (usize, &'static str))> {
        self.0.iter().enumerate().flat_map(|(i, a)| self.0[i..].iter().map(move |b| (*a, *b)))
    }

    fn columns(&self) -> usize {
        self.0.len() + self.pairs().count()
    }

    fn header(&self) -> String {
        // Names of angles are separated: cov_x_yaw.
        let separator = |a: &str, b: &str| if a.len() + b.len() > 2 { "_" } else { "" };
        let axes = self.0.iter().map(|(_, name)| (*name).to_owned());
        let pairs = self.pairs().map(|((_, a), (_, b))| format!("cov_{a}{}{b}", separator(a, b)));
        axes.chain(pairs).collect::<Vec<_>>().join(",")
    }

    /// The line of an estimate.
    fn line(&self, time: Time, estimate: &Estimate) -> String {
        let mut text = format!("{},{},{}", time.unix_decimal(), estimate.state, estimate.reason.name());
        match &estimate.place {
            Some(place) => {
                self.write(&mut text, place);
                let a = &place.agreement;
                let _ = writeln!(text, ",{:.3},{:.3},{:.3}", a.explained, a.in_free_space, a.through_solid);
            }
            None => {
                let _ = writeln!(text, "{}", ",".repeat(self.columns() + 3));
            }
        }
        text
    }

    fn write(&self, text: &mut String, place: &Place) {
        let Place { map_from_tracking: pose, covariance, .. } = place;
        let (at, turn) = (pose.translation, roll_pitch_yaw(&pose.rotation));
        let turn = [turn.0, turn.1, turn.2];
        for (axis, _) in self.0 {
            let _ = match *axis {
                0..3 => write!(text, ",{:.6}", at.vector[*axis]),
                _ => write!(text, ",{:.7}", turn[*axis - 3]),
            };
        }
        for ((a, _), (b, _)) in self.pairs() {
            let _ = write!(text, ",{:.6e}", covariance[(a, b)]);
        }
    }
}

/// The colour of a state in pictures.
fn colour(state: State) -> Rgb {
    match state {
        State::Searching | State::Lost => rgb(0xd62728),
        State::Tentative => rgb(0x8073ac),
        State::Localised => rgb(0x2ca02c),
        State::Uncertain => rgb(0xe08214),
    }
}

/// The path in segments of one state; tentative poses jump, so they are drawn as dots.
fn path(estimates: &Spool<Estimate>) -> Vec<ColouredLine> {
    let mut lines: Vec<ColouredLine> = Vec::new();
    let mut last: Option<State> = None;
    for estimate in estimates.iter() {
        let Some(place) = &estimate.place else {
            last = None;
            continue;
        };
        let at = place.map_from_tracking.translation;
        let (point, state) = ([at.x, at.y], estimate.state);
        match lines.last_mut() {
            Some(line) if last == Some(state) && state != State::Tentative => line.points.push(point),
            _ => lines.push(ColouredLine { colour: colour(state), points: vec![point] }),
        }
        last = Some(state);
    }
    lines
}

/// Content of `report.json`.
fn report(localized: &LocalizedRecording, seconds: f64) -> serde_json::Value {
    let counts = localized.state_counts();
    let states = counts.map(|(state, count)| {
        let seconds = (1e3 * count.seconds).round() / 1e3;
        (state.name().to_owned(), serde_json::json!({ "scans": count.scans, "seconds": seconds }))
    });
    let sensors: Vec<String> =
        localized.plan.sensors().iter().map(|s| format!("{:?} {}", s.kind, s.id)).collect();
    serde_json::json!({
        "version": REPORT_VERSION,
        "found": localized.found().name(),
        "found_after_seconds": localized.found_after_seconds(),
        "scans": localized.estimates.len(),
        "states": states.into_iter().collect::<serde_json::Map<_, _>>(),
        "seconds_without_scans": (1e3 * localized.seconds_without_scans()).round() / 1e3,
        "changes": changes(localized),
        "start": localized.start.map(|start| serde_json::json!({
            "from": if localized.starts_at_fix { "satellite_fix" } else { "start" },
            "x": start.map_from_tracking.translation.x,
            "y": start.map_from_tracking.translation.y,
            "yaw": yaw(&start.map_from_tracking.rotation),
            "sigma_metres": start.sigma_metres,
            "sigma_radians": start.sigma_radians,
            "agrees_with_the_place_at_the_end": localized.start_agrees,
        })),
        "saved_map": localized.saved_map.as_ref().map(SavedMap::report),
        "wall_seconds": seconds,
        "interrupted": localized.interrupted,
        "tracking_frame": localized.plan.tracking_frame,
        "sensors": sensors,
        "choices": localized.plan.notices,
        "issues": localized.issues,
        "data_lost": localized.issues.lost_data(),
    })
}

/// Changes of the state: times, new states and reasons.
fn changes(localized: &LocalizedRecording) -> Vec<serde_json::Value> {
    let mut last = None;
    let changed = localized.estimates.iter().filter(|e| last.replace(e.state) != Some(e.state));
    let entry = |e: Estimate| {
        let time = localized.recorded(e.time).unix_seconds();
        serde_json::json!({ "time": time, "state": e.state.name(), "reason": e.reason.name() })
    };
    changed.map(entry).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_hour_without_scans_has_no_valid_pose() {
        let mut intervals = vec![0.1; 60];
        assert_eq!(valid_durations(&intervals), (intervals.clone(), 0.0));
        // Scans at a low rate are not missing.
        assert_eq!(valid_durations(&[3.0, 3.0, 12.0]).1, 0.0);
        intervals[30] = 3600.0;
        let (valid, silent) = valid_durations(&intervals);
        assert!((valid.iter().sum::<f64>() - 6.0).abs() < 1e-9 && (silent - 3599.9).abs() < 1e-9);
        assert_eq!(valid_durations(&[]), (Vec::new(), 0.0));
    }
}
