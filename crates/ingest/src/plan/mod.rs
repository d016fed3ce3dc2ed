//! Assigns topics to sensors and chooses the frame whose motion is estimated.
//!
//! Rules choose everything from the first look at the recording, unless the user specifies it. Where there
//! was a choice, a [`Notice`] reports the choice and how to change it.

mod beam_elevation;
mod clocks;
mod odometry;
mod point_times;
mod range;
mod request;
mod robot;
mod tracking;

use std::sync::Arc;

use portolan_geometry::{Dimension, Duration, Quaternion};
use portolan_issue::Severity;
use portolan_sensor::{SensorId, SensorKind};

use crate::azimuth_time::{AzimuthTimes, Turn};
use crate::beam_smoothing::BeamSmoothing;
use crate::options::IngestOptions;
use crate::point_time::PointTime;
use crate::statistics::{ImuStatistics, RangeStatistics};
use crate::steady_clock::StampJitter;
use crate::survey::{Inventory, TopicSurvey};
use request::Request;
pub use robot::upright_frame;

/// A choice that was made and may be changed.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Notice {
    /// The choice and its reason.
    #[serde(rename = "what")]
    pub text: String,
    /// How to change it; empty if there is no alternative.
    pub change: String,
    /// A warning where recorded data cannot be used, or the robot's frame is not known.
    pub severity: Severity,
}

/// Reasons why no plan could be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// The recording has no scans or clouds that can be used.
    #[error("there is nothing to map with: {detail}")]
    NoRangeSensor {
        /// Topics of the recording, and what to do.
        detail: String,
    },
    /// A requested topic does not exist.
    #[error("{asked}: the recording has no topic \"{topic}\"; topics of that kind: {available}")]
    NoTopic {
        /// The option or setting that requested it.
        asked: String,
        /// The topic.
        topic: String,
        /// Topics of the right type.
        available: String,
    },
    /// A requested topic has another type.
    #[error(
        "topic \"{topic}\" is of type {type_name}, but {wanted} is needed; topics of that kind: {available}"
    )]
    WrongType {
        /// The topic.
        topic: String,
        /// Its type.
        type_name: String,
        /// Accepted types.
        wanted: String,
        /// Topics of the right type.
        available: String,
    },
    /// A requested frame does not exist, or no transform leads to it.
    #[error("{detail}")]
    Frame {
        /// What is missing, and what to do.
        detail: String,
    },
    /// The value of an option is invalid.
    #[error("{detail}")]
    Option {
        /// The error.
        detail: String,
    },
}

/// A topic that is used as a sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedSensor {
    /// Name of the sensor: the topic without its slash, or the name in the configuration.
    pub sensor: SensorId,
    /// The topic.
    pub topic: Arc<str>,
    /// Frame of its first message.
    pub frame: Arc<str>,
    /// Offset added to its stamps, where its clock differs from that of the first range sensor.
    pub clock_shift: Duration,
    /// Usual time of recording minus shifted stamp.
    pub usual_lag: Option<Duration>,
    /// Jitter of its stamps, if scans show it.
    pub jitter: Option<StampJitter>,
}

impl PlannedSensor {
    /// Shifts its stamps by a measured delay; returns what was done and how to change it.
    fn delay(&mut self, seconds: f64, sigma: f64) -> (String, String) {
        let delay = Duration::from_seconds(seconds);
        self.clock_shift = self.clock_shift + delay;
        self.usual_lag = self.usual_lag.map(|lag| lag - delay);
        let direction = if seconds < 0.0 { "earlier" } else { "later" };
        let text = format!(
            "stamps of {} are shifted by {seconds:.3} s (sigma {sigma:.3} s): those of scans are {direction} by this, as \
             the rotation of both shows",
            self.topic
        );
        (text, format!("--time-offset {}=0", self.topic))
    }
}

/// A range sensor that is used.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedRange {
    /// Topic and so on.
    pub source: PlannedSensor,
    /// Meaning of the times of points (point clouds only).
    pub point_time: Option<PointTime>,
    /// Whether points without times get them from their azimuth; never [`AzimuthTimes::Auto`] nor
    /// [`AzimuthTimes::Recorded`].
    pub azimuth_times: AzimuthTimes,
    /// Whether the motion in the points contradicts their times, without showing clearly which times are
    /// right, and the user did not choose.
    pub times_are_uncertain: bool,
    /// Seconds from the first beam of a scan to the last, negative if the last comes first; none: as in the
    /// message (laser scans only).
    pub scan_duration: Option<f64>,
    /// Standard deviation of the readings, metres, if they are to be smoothed (laser scans only).
    pub range_noise: Option<f64>,
    /// Metres in one unit of the coordinates (point clouds only).
    pub length_unit: f32,
    /// Angle added to the elevations of all beams (point clouds only), radians.
    pub beam_elevation: f64,
    /// Begin and direction of the turns, where known and where points get times from their azimuth.
    pub turn: Option<Turn>,
    /// Properties of the sensor.
    pub statistics: RangeStatistics,
}

/// Source of the odometry.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedOdometry {
    /// Topic and so on; its frame is the child frame.
    pub source: PlannedSensor,
    /// The odometry frame, where transforms from it to the child frame are used instead of odometry messages.
    pub transforms_from: Option<Arc<str>>,
}

/// The topic of moving transforms.
pub(crate) const TF: &str = "/tf";

impl PlannedOdometry {
    /// The topic of its messages; none of transforms.
    pub fn topic(&self) -> Option<&Arc<str>> {
        self.transforms_from.is_none().then_some(&self.source.topic)
    }

    /// Its name in messages for users.
    pub fn name(&self) -> String {
        match &self.transforms_from {
            None => self.source.topic.to_string(),
            Some(parent) => format!("of the transforms from \"{parent}\" to \"{}\"", self.source.frame),
        }
    }

    /// The option that requests it; empty where there is none.
    fn option(&self) -> String {
        self.topic().map_or_else(String::new, |topic| format!("--odom {topic}"))
    }
}

/// Factors that convert the samples of an IMU to m/s² and rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuScale {
    /// 9.80665 where accelerations are in g.
    pub acceleration: f64,
    /// π/180 where angular velocities are in degrees per second.
    pub angular_velocity: f64,
}

/// An IMU that is used.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedImu {
    /// Topic and so on.
    pub source: PlannedSensor,
    /// Factors that samples are multiplied by.
    pub scale: ImuScale,
    /// Rotates its measurements in the tracking frame, where its mounting differs from the transforms.
    pub correction: Quaternion,
    /// Properties of the IMU.
    pub statistics: ImuStatistics,
}

/// Assignment of topics to sensors.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorPlan {
    /// In 2D or in 3D.
    pub dimension: Dimension,
    /// The frame whose motion is estimated.
    pub tracking_frame: String,
    /// At least one.
    pub range: Vec<PlannedRange>,
    /// Odometry, if used.
    pub odometry: Option<PlannedOdometry>,
    /// Interval between odometry messages, seconds.
    pub odometry_interval: Option<f64>,
    /// Maximum time for which odometry repeats a pose although the robot moves, seconds, if scans show that
    /// it does.
    pub longest_odometry_hold: Option<f64>,
    /// IMU, if used.
    pub imu: Option<PlannedImu>,
    /// Satellite fixes, if used.
    pub nav_sat: Option<PlannedSensor>,
    /// Poses in a fixed frame, if used.
    pub fixed_frame_pose: Option<PlannedSensor>,
    /// Landmarks, if used.
    pub landmarks: Option<PlannedSensor>,
    /// Choices that were made.
    pub notices: Vec<Notice>,
}

/// Properties of the sensors that the defaults of mapping depend on.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct SensorStatistics {
    /// In 2D or in 3D.
    pub dimension: Dimension,
    /// The range sensors in use, by name.
    pub range: Vec<(String, RangeStatistics)>,
    /// Odometry messages per second, if it is used and known.
    pub odometry_rate: Option<f64>,
    /// The IMU in use.
    pub imu: Option<ImuStatistics>,
}

impl SensorPlan {
    /// All sensors in ascending order, as the collator expects them.
    pub fn sensors(&self) -> Vec<SensorId> {
        let mut sensors: Vec<SensorId> = self.range.iter().map(|r| r.source.sensor.clone()).collect();
        sensors.extend(self.odometry.iter().map(|o| o.source.sensor.clone()));
        sensors.extend(self.imu.iter().map(|i| i.source.sensor.clone()));
        let others = [&self.nav_sat, &self.fixed_frame_pose, &self.landmarks];
        sensors.extend(others.into_iter().flatten().map(|s| s.sensor.clone()));
        sensors.sort();
        sensors
    }

    /// Properties of the sensors that the defaults of mapping depend on.
    pub fn statistics(&self) -> SensorStatistics {
        SensorStatistics {
            dimension: self.dimension,
            range: self
                .range
                .iter()
                .map(|r| (r.source.sensor.id.to_string(), r.statistics.clone()))
                .collect(),
            odometry_rate: self.odometry_interval.map(|i| 1.0 / i),
            imu: self.imu.as_ref().map(|i| i.statistics.clone()),
        }
    }

    /// Shifts the stamps of odometry by their measured delay against scans, and adds a notice.
    pub fn delay_odometry(&mut self, seconds: f64, sigma: f64) {
        let Some(odometry) = &mut self.odometry else { return };
        let (text, change) = odometry.source.delay(seconds, sigma);
        self.note(text, change);
    }

    /// Shifts the stamps of the IMU by their measured delay against clouds, and adds a notice.
    pub fn delay_imu(&mut self, seconds: f64, sigma: f64) {
        let Some(imu) = &mut self.imu else { return };
        let (text, change) = imu.source.delay(seconds, sigma);
        self.note(text, change);
    }

    /// Marks the stamps of these topics as jittering, as scans showed, and adds a notice.
    pub fn mark_jitter(&mut self, topics: &[Arc<str>], jitter: &StampJitter) {
        let odometry = self.odometry.as_mut().map(|odometry| &mut odometry.source);
        let sources = self.range.iter_mut().map(|range| &mut range.source).chain(odometry);
        for source in sources.filter(|source| topics.contains(&source.topic)) {
            source.jitter = Some(*jitter);
        }
        let text = format!(
            "stamps of {} jitter by {:.3} s: scans move more evenly at times from the order of arrival and the usual \
             rate",
            topics.join(" and "),
            jitter.noise.of_stamps
        );
        self.note(text, "--stamps as-is");
    }

    /// Warns that odometry repeats poses (`how`) while it moves. Leaves out repeats of up to `longest_hold`
    /// seconds, unless the user wants this odometry (`is_wanted`).
    pub fn reject_repeats(&mut self, how: &str, longest_hold: f64, is_wanted: bool) {
        let Some(odometry) = &self.odometry else { return };
        let name = odometry.name();
        let (so, change) = match is_wanted {
            true => ("it is used unchanged all the same", "--no-odometry".to_owned()),
            false => ("poses that repeat are left out", odometry.option()),
        };
        self.warn(format!("the odometry {name} {how}: {so}"), change);
        self.longest_odometry_hold = (!is_wanted).then_some(longest_hold);
    }

    /// Spreads the times of the beams of a scanner over its measured scan duration, seconds, and adds a
    /// notice.
    pub fn time_beams(&mut self, topic: &str, seconds: f64, sigma: f64) {
        let Some(range) = self.range.iter_mut().find(|range| &*range.source.topic == topic) else { return };
        range.scan_duration = Some(seconds);
        let order = if seconds < 0.0 { ", the last beam first" } else { "" };
        let text = format!(
            "scans of {topic} are taken to last {:.3} s (sigma {sigma:.3} s){order}: their distortion where the robot \
             turns shows this",
            seconds.abs()
        );
        self.note(text, "--point-times recorded");
    }

    /// Smooths the readings of a scanner with this measured standard deviation, metres, and adds a notice.
    /// Readings with little noise stay unchanged.
    pub fn smooth_ranges(&mut self, topic: &str, sigma: f64) {
        let Some(range) = self.range.iter_mut().find(|range| &*range.source.topic == topic) else { return };
        if BeamSmoothing::of(sigma).is_none() {
            return;
        }
        range.range_noise = Some(sigma);
        let text = format!("readings of {topic} have noise of {sigma:.3} m: they are smoothed along walls");
        self.note(text, "--range-noise 0");
    }

    /// Rotates the measurements of the IMU in the tracking frame, since its mounting (`is_mounted`) differs
    /// from the transforms, and adds a warning.
    pub fn turn_imu(&mut self, correction: Quaternion, is_mounted: &str) {
        let Some(imu) = &mut self.imu else { return };
        imu.correction = correction;
        let topic = imu.source.topic.clone();
        let text = format!("the IMU {topic} {is_mounted}: its measurements are rotated by this");
        self.warn(text, format!("--imu {topic}"));
    }

    /// Converts angular velocities of the IMU from degrees per second, and adds a notice.
    pub fn turn_in_degrees(&mut self) {
        let Some(imu) = &mut self.imu else { return };
        imu.scale.angular_velocity = 1_f64.to_radians();
        let topic = imu.source.topic.clone();
        self.note_degrees(&topic);
    }

    fn note_degrees(&mut self, topic: &str) {
        let text = "measures angular velocities in degrees per second; they are multiplied by π/180";
        self.note(format!("{topic} {text}"), "");
    }

    /// Warns that an IMU does not rotate as the lidar does (`how`), and whether it is used nevertheless.
    pub fn warn_of_imu(&mut self, topic: &str, how: &str, is_used: bool) {
        let (so, change) = match is_used {
            true => ("it is used all the same", "--no-imu".to_owned()),
            false => ("it is left out", format!("--imu {topic}")),
        };
        self.warn(format!("the IMU {topic} {how}: {so}"), change);
    }

    /// Warns that odometry does not move as scans do (`how`), and drops it unless the user wants it
    /// (`is_wanted`).
    pub fn reject_odometry(&mut self, how: &str, is_mirrored: bool, is_wanted: bool) {
        let Some(odometry) = &self.odometry else { return };
        let name = odometry.name();
        let (so, change) = match is_wanted {
            true => ("it is used all the same", "--no-odometry".to_owned()),
            false => ("it is left out", odometry.option()),
        };
        let mirrored = match is_mirrored {
            true => {
                "; a scanner mounted upside down without a transform that says so makes the map a mirror image"
            }
            false => "",
        };
        self.warn(format!("the odometry {name} {how}: {so}{mirrored}"), change);
        if !is_wanted {
            (self.odometry, self.odometry_interval) = (None, None);
        }
    }

    fn note(&mut self, text: impl Into<String>, change: impl Into<String>) {
        self.push_notice(Severity::Info, text.into(), change.into());
    }

    /// As [`SensorPlan::note`], where transforms are missing.
    fn warn(&mut self, text: impl Into<String>, change: impl Into<String>) {
        self.push_notice(Severity::Warning, text.into(), change.into());
    }

    fn push_notice(&mut self, severity: Severity, text: String, change: String) {
        self.notices.push(Notice { text, change, severity });
    }
}

/// A topic that was chosen, with the name of the sensor it becomes.
#[derive(Clone, Debug)]
struct Chosen<'a> {
    name: String,
    survey: &'a TopicSurvey,
}

impl<'a> Chosen<'a> {
    fn named_after_topic(survey: &'a TopicSurvey) -> Self {
        Self { name: survey.info.topic.trim_start_matches('/').to_owned(), survey }
    }

    fn frame(&self) -> &str {
        self.survey.frame.as_deref().unwrap_or("")
    }

    fn topic(&self) -> &str {
        &self.survey.info.topic
    }

    fn planned(&self, kind: SensorKind, frame: &str) -> PlannedSensor {
        PlannedSensor {
            sensor: SensorId::new(kind, self.name.as_str()),
            topic: self.survey.info.topic.clone(),
            frame: frame.into(),
            clock_shift: Duration::ZERO,
            usual_lag: self.survey.lag,
            jitter: None,
        }
    }
}

/// Chooses sensors and the tracking frame.
///
/// # Errors
/// If there is no range sensor, a requested topic is missing or of another type, or transforms or options do
/// not fit.
pub fn plan(inventory: &Inventory, options: &IngestOptions) -> Result<SensorPlan, PlanError> {
    let request = Request::new(inventory, options)?;
    let mut plan = SensorPlan {
        dimension: Dimension::TwoD,
        tracking_frame: String::new(),
        range: Vec::new(),
        odometry: None,
        odometry_interval: None,
        longest_odometry_hold: None,
        imu: None,
        nav_sat: None,
        fixed_frame_pose: None,
        landmarks: None,
        notices: request.notices.clone(),
    };
    let range = range::choose(inventory, options, &request, &mut plan)?;
    let imu = tracking::choose_imu(inventory, &request, &range, &mut plan)?;
    plan.tracking_frame =
        tracking::choose_frame(inventory, options, &request, &range, imu.as_ref(), &mut plan)?;
    range::connect(inventory, options, &request, range, &mut plan)?;
    tracking::connect_imu(inventory, imu, &mut plan)?;
    odometry::choose(inventory, &request, &mut plan)?;
    let other = |chosen: &Option<Chosen>, kind| chosen.as_ref().map(|c| c.planned(kind, c.frame()));
    plan.nav_sat = other(&request.nav_sat, SensorKind::FixedFramePose);
    plan.fixed_frame_pose = other(&request.fixed_frame_pose, SensorKind::FixedFramePose);
    plan.landmarks = other(&request.landmarks, SensorKind::Landmark);
    clocks::join(&mut plan);
    clocks::shift(&options.time_offsets, &mut plan)?;
    Ok(plan)
}

#[cfg(test)]
mod tests;
