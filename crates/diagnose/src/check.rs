//! Runs all checks of a recording in one pass.

mod kinds;

use std::collections::BTreeMap;
use std::sync::Arc;

use portolan_geometry::{Dimension, Duration, Rigid3, Time, Vector3};
use portolan_ingest::{
    BeamDirections, BeamSmoothing, CloudLayout, IngestOptions, Inventory, PlannedOdometry, RecordingClock,
    ScanCorrections, SensorPlan, TfInput, TfTree, TimedPoints, TopicSurvey, plan, points_of_echoes,
    points_of_laser_scan, upright_frame,
};
use portolan_issue::{Issue, IssueKind, Severity};
use portolan_recording::{
    Message, MultiEchoLaserScan, PointCloud2, RecordedMessage, Recording, RecordingError,
};

use crate::beam_times::ScanDuration;
use crate::clock_offset::{ClockOffset, ImuComparison};
use crate::clouds::CloudChecks;
use crate::coverage::Coverage;
use crate::finding::{Finding, Findings, Kind};
use crate::fixes::FixChecks;
use crate::imu::ImuChecks;
use crate::odometry::OdometryChecks;
use crate::odometry_fault::OdometryFault;
use crate::rotation::Turn;
use crate::scan_comparison::compare_scans;
use crate::scan_turns::{CloudTurns, ScanTurns};
use crate::scans::RangeChecks;
use crate::stamps::{Stamps, check_frames};
use crate::turns::{ImuTurns, Source, Turning, compare_all};
use kinds::{
    ASSUMED, CLOCK_SET, DAMAGE, HELD_BACK, JITTER, MAP_PARENT, NO_PLAN, NOISY, ODOMETRY_ELSEWHERE, REPAIRED,
    SCAN_DURATION, TRANSFORMS,
};

/// Time for which transforms are kept while checking, seconds.
const KEPT_TRANSFORMS: f64 = 10.0;

/// Results of all checks.
#[derive(Clone, Debug, serde::Serialize)]
pub struct CheckReport {
    /// The worst first.
    pub findings: Vec<Finding>,
    /// One histogram of the intervals between messages for each topic with stamps, as text.
    pub histograms: Vec<String>,
}

/// Checks a whole recording. `progress` receives the number of bytes read so far after every 256 messages.
///
/// # Errors
/// If the recording cannot be read.
pub fn check(
    recording: &dyn Recording,
    options: &IngestOptions,
    progress: &mut dyn FnMut(u64),
) -> Result<CheckReport, RecordingError> {
    let inventory = Inventory::of(recording, options)?;
    check_with_clocks(recording, &inventory, options, &ImuComparison::default(), progress)
}

/// The same check where lidars were compared with the IMU before: those sensors are not compared again.
///
/// # Errors
/// If the recording cannot be read.
pub fn check_with_clocks(
    recording: &dyn Recording,
    inventory: &Inventory,
    options: &IngestOptions,
    compared: &ImuComparison,
    progress: &mut dyn FnMut(u64),
) -> Result<CheckReport, RecordingError> {
    let plan = plan(inventory, options);
    let mut check = Check::new(inventory, options);
    let mut reader = recording.read(&|_| true)?;
    let mut messages = 0u64;
    while let Some(message) = reader.next_message()? {
        check.add(&message);
        messages += 1;
        if messages.is_multiple_of(256) {
            progress(reader.position_bytes());
        }
    }
    match &plan {
        Ok(plan) => {
            check.add_plan(plan);
            check.compare_scans(recording, plan)?;
        }
        Err(error) => check.findings.add(&NO_PLAN, "", || error.to_string()),
    }
    Ok(check.finish(plan.as_ref().ok(), compared, &reader.issues()))
}

/// Checks of one topic.
enum TopicChecks {
    Scan { ranges: RangeChecks, turns: ScanTurns, directions: BeamDirections },
    Echoes { ranges: RangeChecks, directions: BeamDirections },
    Cloud { ranges: RangeChecks, clouds: CloudChecks, turns: CloudTurns },
    Imu { imu: Box<ImuChecks>, turns: ImuTurns },
    Odometry(OdometryChecks),
    Fixes(FixChecks),
}

struct Check<'a> {
    inventory: &'a Inventory,
    findings: Findings,
    stamps: BTreeMap<Arc<str>, Stamps>,
    topics: BTreeMap<Arc<str>, TopicChecks>,
    tree: TfTree,
    tf: TfInput,
    messages: u64,
    clock: RecordingClock,
    coverage: Coverage,
}

impl<'a> Check<'a> {
    fn new(inventory: &'a Inventory, options: &IngestOptions) -> Self {
        Self {
            inventory,
            findings: Findings::default(),
            stamps: BTreeMap::new(),
            topics: BTreeMap::new(),
            tree: inventory.tree.clone(),
            tf: TfInput::new(&options.map_frame),
            messages: 0,
            clock: RecordingClock::default(),
            coverage: Coverage::default(),
        }
    }

    fn add(&mut self, recorded: &RecordedMessage) {
        self.messages += 1;
        if let Message::Tf(transforms) = &recorded.message {
            self.tf.insert(&mut self.tree, transforms);
            if self.messages.is_multiple_of(1024) {
                let kept = portolan_geometry::Duration::from_seconds(KEPT_TRANSFORMS);
                self.tree.forget_before(recorded.log_time - kept);
            }
            return;
        }
        let Some(header) = recorded.message.header() else { return };
        if let Some(jump) = self.clock.take(recorded.log_time) {
            self.findings.add(&CLOCK_SET, "", || jump.to_string());
        }
        let sweep = self.add_values(&recorded.topic, &recorded.message);
        let end = sweep.map_or(header.stamp, |(_, end)| end);
        self.coverage.add(&recorded.topic, end, sweep);
        let stamps = self.stamps.entry(recorded.topic.clone());
        let stamps = stamps.or_insert_with(|| Stamps::new(&recorded.message, header, recorded.log_time));
        stamps.add(&recorded.topic, (header, end), recorded.log_time, &mut self.findings);
    }

    /// Checks the values of a message; returns the times of its first and its last point, if it has points.
    fn add_values(&mut self, topic: &Arc<str>, message: &Message) -> Option<(Time, Time)> {
        let checks = match self.topics.get_mut(topic) {
            Some(checks) => checks,
            None => {
                let checks = TopicChecks::of(message)?;
                self.topics.entry(topic.clone()).or_insert(checks)
            }
        };
        let findings = &mut self.findings;
        match (checks, message) {
            (TopicChecks::Scan { ranges, turns, directions }, Message::LaserScan(scan)) => {
                let header = &scan.header;
                let (points, faults) =
                    points_of_laser_scan(header.stamp, (scan, ScanCorrections::default()), false, directions);
                ranges.add_scan(topic, scan, faults, findings);
                ranges.add_points(topic, &header.frame_id, &points, findings);
                turns.add(points.time, scan);
                return span_of(&points);
            }
            (TopicChecks::Echoes { ranges, directions }, Message::MultiEchoLaserScan(scan)) => {
                return add_echoes(topic, scan, ranges, directions, findings);
            }
            (TopicChecks::Cloud { ranges, clouds, turns }, Message::PointCloud2(cloud)) => {
                let survey = self.inventory.topic(topic);
                return add_cloud(topic, cloud, survey, (ranges, clouds, turns), findings);
            }
            (TopicChecks::Imu { imu, turns }, Message::Imu(message)) => {
                imu.add(topic, message, findings);
                turns.add(message);
            }
            (TopicChecks::Odometry(odometry), Message::Odometry(message)) => {
                odometry.add(topic, message, findings);
            }
            (TopicChecks::Fixes(fixes), Message::NavSatFix(message)) => fixes.add(topic, message, findings),
            _ => {}
        }
        None
    }

    /// Reports the choices of mapping.
    fn add_plan(&mut self, plan: &SensorPlan) {
        for notice in &plan.notices {
            self.findings.push(Finding {
                severity: notice.severity,
                topic: String::new(),
                count: 1,
                text: notice.text.clone(),
                effect_on_slam: String::new(),
                advice: if notice.change.is_empty() {
                    String::new()
                } else {
                    format!("nothing, or choose differently: {}", notice.change)
                },
            });
        }
    }

    fn finish(
        mut self,
        plan: Option<&SensorPlan>,
        compared: &ImuComparison,
        issues: &[Issue],
    ) -> CheckReport {
        let common_lag = self.common_lag();
        for (topic, stamps) in &self.stamps {
            stamps.finish(topic, common_lag, &mut self.findings);
        }
        self.check_spans();
        if let Some(plan) = plan {
            self.coverage.finish(plan, &mut self.findings);
        }
        check_frames(self.stamps.iter().map(|(topic, stamps)| (&**topic, stamps)), &mut self.findings);
        self.compare_turns(plan, &compared.offsets);
        compared.add_to(&mut self.findings);
        for (topic, checks) in std::mem::take(&mut self.topics) {
            self.finish_topic(&topic, checks, plan);
        }
        self.add_issues(issues);
        let histograms = self.stamps.iter().filter_map(|(topic, s)| s.histogram_text(topic)).collect();
        CheckReport { findings: self.findings.finish(), histograms }
    }

    /// Reports sensors that do not measure from the beginning to the end.
    fn check_spans(&mut self) {
        let spans = || self.stamps.values().filter_map(Stamps::span);
        let (Some(start), Some(end)) = (spans().map(|s| s.0).min(), spans().map(|s| s.1).max()) else {
            return;
        };
        for (topic, stamps) in &self.stamps {
            stamps.check_span(topic, (start, end), &mut self.findings);
        }
    }

    /// Lag that all sensors share: it comes from recording a recording, which is no fault.
    fn common_lag(&self) -> f64 {
        let lags = || self.stamps.values().filter_map(Stamps::lag);
        let (least, most) = (lags().fold(f64::INFINITY, f64::min), lags().fold(f64::NEG_INFINITY, f64::max));
        match () {
            () if least > 0.5 && least.is_finite() => least,
            () if most < -0.5 && most.is_finite() => most,
            () => 0.0,
        }
    }

    fn finish_topic(&mut self, topic: &str, checks: TopicChecks, plan: Option<&SensorPlan>) {
        let findings = &mut self.findings;
        match checks {
            TopicChecks::Scan { ranges, .. } | TopicChecks::Echoes { ranges, .. } => {
                ranges.finish(topic, findings)
            }
            TopicChecks::Cloud { ranges, clouds, .. } => {
                ranges.finish(topic, findings);
                clouds.finish(topic, findings);
            }
            TopicChecks::Imu { imu, .. } => {
                let mounting = mounting(self.inventory, topic, plan);
                imu.finish(topic, mounting.as_ref(), findings);
            }
            TopicChecks::Odometry(odometry) => odometry.finish(topic, findings),
            TopicChecks::Fixes(_) => {}
        }
    }

    fn add_issues(&mut self, issues: &[Issue]) {
        for issue in self.tf.issues().iter() {
            let kind = if issue.kind == IssueKind::MapTransform { &MAP_PARENT } else { &TRANSFORMS };
            self.findings.push(counted(kind, &issue));
        }
        for issue in issues {
            let kind = match issue.severity {
                Severity::Error => &DAMAGE,
                Severity::Warning => &ASSUMED,
                Severity::Info => &REPAIRED,
            };
            self.findings.push(counted(kind, issue));
        }
    }
}

impl Check<'_> {
    /// Compares scans with each other, and translations of odometry with theirs. Faults in rotation are
    /// reported by the comparison of rotations.
    fn compare_scans(&mut self, recording: &dyn Recording, plan: &SensorPlan) -> Result<(), RecordingError> {
        if plan.dimension != Dimension::TwoD {
            return Ok(());
        }
        let compared = compare_scans(recording, self.inventory, plan)?;
        for (topic, ScanDuration { seconds, sigma }) in compared.durations {
            self.findings.add(&SCAN_DURATION, &topic, || {
                format!(
                    "scans last {:.3} s (sigma {sigma:.3} s), not what time_increment says",
                    seconds.abs()
                )
            });
        }
        for (topic, sigma) in compared.noises {
            if BeamSmoothing::of(sigma).is_some() {
                self.findings.add(&NOISY, &topic, || {
                    format!("readings scatter by {sigma:.3} m around straight walls")
                });
            }
        }
        for (topics, jitter) in compared.jitters {
            self.findings.add(&JITTER, &topics.join(", "), || {
                format!(
                    "stamps jitter by {:.3} s; scans move more evenly at even times",
                    jitter.noise.of_stamps
                )
            });
        }
        let Some(PlannedOdometry { source: odometry, .. }) = &plan.odometry else { return Ok(()) };
        if let Some(hold) = compared.hold {
            self.findings.add(&HELD_BACK, &odometry.topic, || format!("odometry {hold}"));
        }
        if let (Some(turns), Some(TopicChecks::Odometry(checks))) =
            (compared.turns_without_repeats, self.topics.get_mut(&odometry.topic))
        {
            checks.turns = turns;
        }
        if let Some(fault) = compared.fault.filter(|fault| !matches!(fault, OdometryFault::Turns(_))) {
            self.findings.add(&ODOMETRY_ELSEWHERE, &odometry.topic, || format!("odometry {fault}"));
        }
        Ok(())
    }

    /// Compares the rotation of each sensor with odometry, or with the IMU if there is no odometry.
    fn compare_turns(&mut self, plan: Option<&SensorPlan>, offsets: &[ClockOffset]) {
        let (mut all, mut imus) = (Vec::new(), Vec::new());
        for (topic, checks) in &self.topics {
            let base_from_sensor = mounting(self.inventory, topic, plan).unwrap_or_else(Rigid3::identity);
            let up = (base_from_sensor.rotation * Vector3::z()).z;
            let upright =
                |turns: &[Turn]| turns.iter().map(|(a, b, turn)| (*a, *b, up.signum() * turn)).collect();
            let (source, turns) = match checks {
                TopicChecks::Odometry(odometry) => (Source::Odometry, odometry.turns.clone()),
                TopicChecks::Imu { imu, turns } => {
                    let upright = || base_from_sensor.rotation.inverse() * Vector3::z();
                    let up = imu.up().unwrap_or_else(upright);
                    imus.push((&**topic, turns));
                    (Source::Imu, turns.about(&up))
                }
                TopicChecks::Scan { turns, .. } if up.abs() > 0.9 => (Source::Scan, upright(&turns.turns)),
                TopicChecks::Cloud { turns, .. } if up.abs() > 0.9 => {
                    (Source::Cloud { has_times: turns.has_times }, upright(&turns.turns))
                }
                _ => continue,
            };
            all.push(Turning { source, topic, turns });
        }
        compare_all(all, &imus, offsets, &mut self.findings);
    }
}

impl TopicChecks {
    fn of(message: &Message) -> Option<Self> {
        match message {
            Message::LaserScan(_) => Some(Self::Scan {
                ranges: RangeChecks::default(),
                turns: ScanTurns::default(),
                directions: BeamDirections::default(),
            }),
            Message::MultiEchoLaserScan(_) => {
                Some(Self::Echoes { ranges: RangeChecks::default(), directions: BeamDirections::default() })
            }
            Message::PointCloud2(_) => Some(Self::Cloud {
                ranges: RangeChecks::default(),
                clouds: CloudChecks::default(),
                turns: CloudTurns::default(),
            }),
            Message::Imu(_) => Some(Self::Imu { imu: Box::default(), turns: ImuTurns::default() }),
            Message::Odometry(_) => Some(Self::Odometry(OdometryChecks::default())),
            Message::NavSatFix(_) => Some(Self::Fixes(FixChecks::default())),
            _ => None,
        }
    }
}

fn add_echoes(
    topic: &str,
    scan: &MultiEchoLaserScan,
    ranges: &mut RangeChecks,
    directions: &mut BeamDirections,
    findings: &mut Findings,
) -> Option<(Time, Time)> {
    let (points, faults) = points_of_echoes(scan.header.stamp, (scan, None), false, directions);
    let first_echoes = scan.ranges.iter().map(|e| e.first().copied().unwrap_or(f32::INFINITY));
    let first = scan.with_readings(first_echoes.collect(), Vec::new());
    ranges.add_scan(topic, &first, faults, findings);
    ranges.add_points(topic, &scan.header.frame_id, &points, findings);
    span_of(&points)
}

fn add_cloud(
    topic: &str,
    cloud: &PointCloud2,
    survey: Option<&TopicSurvey>,
    (ranges, clouds, turns): (&mut RangeChecks, &mut CloudChecks, &mut CloudTurns),
    findings: &mut Findings,
) -> Option<(Time, Time)> {
    let layout = match CloudLayout::of(cloud) {
        Ok(layout) => layout.with_length_unit(survey.map_or(1.0, |s| s.length_unit)),
        Err(error) => {
            CloudChecks::add_error(topic, error, findings);
            return None;
        }
    };
    let time = survey.and_then(|s| s.point_time).filter(|_| layout.has_time());
    let (points, faults) = layout.points(cloud.header.stamp, cloud, time, false);
    clouds.add(topic, cloud, &layout, time, faults, findings);
    if cloud.width > 0 && cloud.height > 0 {
        ranges.add_points(topic, &cloud.header.frame_id, &points, findings);
        turns.add(&points);
    }
    span_of(&points)
}

/// Times at which the first and the last point were measured; none without a point.
fn span_of(points: &TimedPoints) -> Option<(Time, Time)> {
    let earliest = points.points.iter().map(|point| point.time).reduce(f32::min)?.min(0.0);
    Some((points.time + Duration::from_seconds(f64::from(earliest)), points.time))
}

/// Pose of the sensor of a topic in the upright frame, if there is one and the sensor is fixed there.
fn mounting(inventory: &Inventory, topic: &str, plan: Option<&SensorPlan>) -> Option<Rigid3> {
    let frame = inventory.topic(topic)?.frame.as_deref()?;
    let scanners = plan.iter().flat_map(|p| &p.range).map(|range| &*range.source.frame);
    let dimension = plan.map_or(Dimension::ThreeD, |p| p.dimension);
    let upright = upright_frame(&inventory.tree, frame, scanners, dimension)?;
    inventory.tree.lookup_static(upright, frame)
}

fn counted(kind: &Kind, issue: &Issue) -> Finding {
    Finding {
        severity: kind.severity,
        topic: String::new(),
        count: issue.count,
        text: issue.to_string(),
        effect_on_slam: kind.effect.to_owned(),
        advice: kind.to_do.to_owned(),
    }
}
