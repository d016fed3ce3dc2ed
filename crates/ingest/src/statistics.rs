//! Determines the properties of a range sensor, an IMU and odometry from the first messages.

use portolan_geometry::{Point3f, Vector3};
use portolan_numeric::median;
use portolan_recording::{Imu, LaserScan, MultiEchoLaserScan, PointCloud2};

use crate::azimuth_time::{Turn, is_in_firing_order};
use crate::point_cloud2::CloudLayout;
use crate::point_time::{PointTime, PointTimeOrigin, TimeSpan, detect};
use crate::skew::{Skew, SkewEstimator, Times};

/// Maximum number of scans or clouds that are evaluated.
const MAX_MESSAGES: usize = 200;
/// Number of readings of each that are evaluated.
const MAX_READINGS: usize = 500;
/// Maximum number of IMU samples that are evaluated.
const MAX_SAMPLES: usize = 20_000;
/// Fraction of readings at exactly the largest value from which that value means "no return".
const SATURATED_SHARE: f64 = 0.005;

/// Vertical field of view above which clouds count as those of a 3D lidar, degrees.
const MIN_SPACE: f64 = 5.0;

/// Rates of spinning lidars, turns per second. Clouds that come less often are selected key frames, not
/// turns.
const SPINNING_RATES: std::ops::RangeInclusive<f64> = 4.0..=50.0;

/// Plausible durations of sweeps as fractions of the interval between clouds, by times that may be wrong.
/// Others are not used for the skew.
const DUTIES: std::ops::Range<f64> = 1e-3..5.0;

/// Properties of a range sensor. Angles in radians, distances in metres, times in seconds.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct RangeStatistics {
    /// Number of messages that were evaluated.
    pub messages: usize,
    /// Messages per second; zero if unknown.
    pub rate: f64,
    /// Readings per message (median).
    pub readings: usize,
    /// Readings per message that are distances (median).
    pub returns: usize,
    /// Horizontal field of view.
    pub field_of_view: f64,
    /// Vertical field of view; zero for a scanner in a plane.
    pub vertical_field_of_view: f64,
    /// Angle between neighbouring beams of a scanner in a plane; for clouds the field of view over the
    /// number of directions seen.
    pub angular_resolution: f64,
    /// Median of the distances.
    pub median_range: f64,
    /// 95th percentile of the distances.
    pub p95_range: f64,
    /// The largest distance that does not mean "no return".
    pub max_range: f64,
    /// The largest reading, if it occurs suspiciously often: it seems to mean "no return".
    pub saturation_range: Option<f64>,
    /// Duration of one sweep; zero if all points have the same time.
    pub sweep_duration: f64,
    /// Estimate of the motion that is still in the clouds; none if the lidar did not move in the first look,
    /// or if the clouds are not sweeps of a 3D lidar.
    pub skew: Option<Skew>,
    /// Factor for the times of points, as the motion in the clouds shows; none if nothing contradicts the
    /// recorded times. 0: they are not to be used.
    pub time_scale: Option<f64>,
    /// How the lidar turns, where times by azimuth fit the motion and recorded ones do not.
    #[serde(rename = "turn_told")]
    pub azimuth_turn: Option<Turn>,
    /// Seconds from the stamp of a cloud to its first point, by recorded times; none if these count from
    /// another time.
    pub sweep_begin: Option<f64>,
    /// Whether recorded times are wrong without it being clear which times are right.
    #[serde(rename = "times_in_doubt")]
    pub times_are_uncertain: bool,
    /// Whether the lidar stood still in the first look, so that the skew is unobservable.
    pub only_stood: bool,
    /// Whether the points of clouds without times are in the order in which a spinning lidar measured them.
    pub is_in_firing_order: bool,
}

impl RangeStatistics {
    /// Whether the clouds are those of a spinning 3D lidar.
    pub fn is_spinning(&self) -> bool {
        let degrees = |angle: f64| angle.to_degrees();
        degrees(self.field_of_view) > 355.0
            && degrees(self.vertical_field_of_view) > 5.0
            && SPINNING_RATES.contains(&self.rate)
    }

    /// Whether points have times of their own, so that sweeps can be de-skewed.
    pub fn has_point_times(&self) -> bool {
        self.sweep_duration > 0.0
    }
}

/// Properties of an IMU.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct ImuStatistics {
    /// Number of samples that were evaluated.
    pub messages: usize,
    /// Samples per second; zero if unknown.
    pub rate: f64,
    /// Median norm of the measured acceleration, in the units of the messages (9.8 if in m/s²).
    pub median_acceleration: f64,
    /// Mean measured acceleration, in the units of the messages, in the frame of the IMU.
    pub mean_acceleration: [f64; 3],
    /// Median norm of the measured angular velocity, in the units of the messages.
    pub median_angular_velocity: f64,
    /// Fraction of the samples whose angular velocity, in the units of the messages, is above 12: too fast
    /// for rad/s.
    pub fast_share: f64,
    /// Whether the messages declare that acceleration or angular velocity is not measured.
    pub is_partial: bool,
}

/// Collects [`RangeStatistics`].
#[derive(Clone, Debug)]
pub(crate) struct RangeSampler {
    readings: Vec<usize>,
    returns: Vec<usize>,
    ranges: Vec<f32>,
    at_maximum: (f32, u64),
    total_readings: u64,
    directions: [bool; 720],
    elevation: (f32, f32),
    scan: Option<(f64, f64)>,
    sweeps: Vec<f64>,
    time_spans: Vec<TimeSpan>,
    skew: SkewEstimator,
    /// Number of clouds whose points are in the order of firing, minus the number of the others.
    in_firing_order: i64,
    sweep: Vec<Point3f>,
    times: Vec<f64>,
    /// Metres in one unit of the coordinates of clouds, once known from a cloud.
    length_unit: Option<f32>,
}

impl Default for RangeSampler {
    fn default() -> Self {
        Self {
            readings: Vec::new(),
            returns: Vec::new(),
            ranges: Vec::new(),
            at_maximum: (0.0, 0),
            total_readings: 0,
            directions: [false; 720],
            elevation: (f32::INFINITY, f32::NEG_INFINITY),
            scan: None,
            sweeps: Vec::new(),
            time_spans: Vec::new(),
            skew: SkewEstimator::default(),
            in_firing_order: 0,
            sweep: Vec::new(),
            times: Vec::new(),
            length_unit: None,
        }
    }
}

impl RangeSampler {
    /// Whether it has seen enough.
    pub fn is_full(&self) -> bool {
        self.readings.len() >= MAX_MESSAGES
    }

    pub fn add_scan(&mut self, scan: &LaserScan) {
        self.add_beams(scan.ranges.iter().copied(), scan.ranges.len(), (scan.range_min, scan.range_max));
        self.add_shape(scan.angle_increment, scan.time_increment, scan.ranges.len());
    }

    pub fn add_echoes(&mut self, scan: &MultiEchoLaserScan) {
        let first = scan.ranges.iter().map(|echoes| echoes.first().copied().unwrap_or(f32::INFINITY));
        self.add_beams(first, scan.ranges.len(), (scan.range_min, scan.range_max));
        self.add_shape(scan.angle_increment, scan.time_increment, scan.ranges.len());
    }

    fn add_shape(&mut self, angle_increment: f32, time_increment: f32, beams: usize) {
        let gaps = beams.saturating_sub(1) as f64;
        let angle = f64::from(angle_increment.abs());
        if angle.is_finite() {
            self.scan = Some((angle * gaps, angle));
        }
        let duration = f64::from(time_increment) * gaps;
        if duration.is_finite() && duration >= 0.0 {
            self.sweeps.push(duration);
        }
    }

    fn add_beams(&mut self, ranges: impl Iterator<Item = f32>, beams: usize, limits: (f32, f32)) {
        let stride = beams.div_ceil(MAX_READINGS).max(1);
        let mut returns = 0;
        for (i, range) in ranges.enumerate() {
            // Invalid limits are ignored.
            let outside = range < limits.0 || (range > limits.1 && limits.1 > limits.0);
            if !range.is_finite() || range <= 0.0 || outside {
                continue;
            }
            returns += 1;
            self.count_maximum(range);
            if i % stride == 0 {
                self.ranges.push(range);
            }
        }
        self.readings.push(beams);
        self.returns.push(returns);
    }

    fn count_maximum(&mut self, range: f32) {
        self.total_readings += 1;
        if range > self.at_maximum.0 {
            self.at_maximum = (range, 0);
        }
        self.at_maximum.1 += u64::from(range == self.at_maximum.0);
    }

    pub fn add_cloud(&mut self, cloud: &PointCloud2) {
        let Ok(layout) = CloudLayout::of(cloud) else { return };
        self.length_unit = self.length_unit.or_else(|| length_unit(&layout, cloud));
        let layout = layout.with_length_unit(self.length_unit());
        let total = cloud.data.len() / (cloud.point_step as usize).max(1);
        let (mut seen, mut returns) = (0usize, 0usize);
        let stride = total.div_ceil(4 * MAX_READINGS).max(1);
        layout.sample(cloud, stride, |point: Point3f| {
            seen += 1;
            let range = point.coords.norm();
            if !range.is_finite() || range == 0.0 {
                return;
            }
            returns += 1;
            self.total_readings += 1;
            if returns % 4 == 0 {
                self.ranges.push(range);
            }
            let turn = (point.y.atan2(point.x) / std::f32::consts::TAU + 0.5) * 719.99;
            if let Some(direction) = self.directions.get_mut(turn as usize) {
                *direction = true;
            }
            let elevation = (point.z / range).asin();
            self.elevation = (self.elevation.0.min(elevation), self.elevation.1.max(elevation));
        });
        self.readings.push(total);
        self.returns.push((total * returns).checked_div(seen).unwrap_or(0));
        self.time_spans.extend(layout.time_span(cloud));
        if !self.skew.is_done() && f64::from(self.elevation.1 - self.elevation.0).to_degrees() > MIN_SPACE {
            self.add_sweep(&layout, cloud);
        }
    }

    /// Adds a sweep to the estimate of the skew.
    fn add_sweep(&mut self, layout: &CloudLayout, cloud: &PointCloud2) {
        self.sweep.clear();
        self.times.clear();
        layout.sample_timed(cloud, |point, time| {
            self.sweep.push(point);
            self.times.extend(time);
        });
        let span = self.time_spans.last().filter(|_| layout.has_time());
        match span {
            None if layout.has_time() => {}
            Some(span) if span.is_usable() => {
                let share = |time: &f64| ((time - span.least) / span.span).clamp(0.0, 1.0) as f32;
                let shares: Vec<f32> = self.times.iter().map(share).collect();
                self.skew.add(cloud.header.stamp, &self.sweep, Some(&shares));
            }
            // Equal times carry no information, or mean that the cloud is de-skewed: the sweeps decide.
            None | Some(_) => {
                self.in_firing_order += if is_in_firing_order(self.sweep.iter()) { 1 } else { -1 };
                self.skew.add(cloud.header.stamp, &self.sweep, None);
            }
        }
    }

    /// Whether clouds have a field of times.
    pub fn has_time_field(&self) -> bool {
        !self.time_spans.is_empty()
    }

    /// Metres in one unit of the coordinates of clouds.
    pub fn length_unit(&self) -> f32 {
        self.length_unit.unwrap_or(METRE)
    }

    /// Whether more clouds would add information on the skew.
    pub fn is_undecided(&self) -> bool {
        !self.sweep.is_empty() && !self.skew.is_done()
    }

    /// Field of view of clouds: a full turn less the largest sector without a point. Sectors below 5° are the
    /// spaces between columns.
    fn view_of_clouds(&self) -> (f64, f64) {
        const SECTOR: f64 = std::f64::consts::TAU / 720.0;
        let directions = self.directions.iter().enumerate();
        let seen: Vec<usize> = directions.filter(|(_, is_seen)| **is_seen).map(|(i, _)| i).collect();
        let (Some(first), Some(last)) = (seen.first(), seen.last()) else { return (0.0, 0.0) };
        let across = 720 - last + first - 1;
        let gaps = seen.iter().zip(seen.iter().skip(1)).map(|(before, after)| after - before - 1);
        let largest = gaps.fold(across, usize::max);
        let view = if largest < 10 { std::f64::consts::TAU } else { (720 - largest) as f64 * SECTOR };
        (view, view / seen.len() as f64)
    }

    /// Meaning of the time field of the clouds.
    pub fn point_time(&self, interval: Option<f64>) -> Option<PointTime> {
        detect(&self.time_spans, interval)
    }

    /// The statistics, given the interval between messages.
    pub fn finish(mut self, interval: Option<f64>) -> RangeStatistics {
        let saturated = self.at_maximum.1 >= 20
            && self.at_maximum.1 as f64 >= SATURATED_SHARE * self.total_readings as f64
            && f64::from(self.at_maximum.0) > 1.0;
        let saturation_range = saturated.then_some(f64::from(self.at_maximum.0));
        if saturated {
            self.ranges.retain(|r| *r < self.at_maximum.0);
        }
        self.ranges.sort_by(f32::total_cmp);
        let quantile = |share: f64| {
            let index = ((self.ranges.len() as f64 - 1.0) * share).round().max(0.0) as usize;
            self.ranges.get(index).map_or(0.0, |r| f64::from(*r))
        };
        let point_time = self.point_time(interval);
        let unit = point_time.map_or(0.0, |t| t.unit);
        let mut sweeps = std::mem::take(&mut self.sweeps);
        sweeps.extend(self.time_spans.iter().map(|s| s.span * unit));
        let is_sweep_rate = interval.is_some_and(|interval| SPINNING_RATES.contains(&(1.0 / interval)));
        let (field_of_view, angular_resolution) = self.scan.unwrap_or_else(|| self.view_of_clouds());
        let sweep_duration = median(&mut sweeps).unwrap_or(0.0);
        // Sweeps that last a fraction of the interval have that fraction of its motion in them.
        let duty = interval.map_or(0.0, |interval| sweep_duration / interval);
        let duty = if DUTIES.contains(&duty) { duty } else { 1.0 };
        let skew = self.skew.skew().filter(|_| is_sweep_rate).map(|skew| skew.of_part(duty));
        let vertical = f64::from(self.elevation.1 - self.elevation.0);
        let mut statistics = RangeStatistics {
            messages: self.readings.len(),
            rate: interval.map_or(0.0, |i| 1.0 / i),
            readings: median_count(&mut self.readings),
            returns: median_count(&mut self.returns),
            field_of_view,
            vertical_field_of_view: if vertical.is_finite() { vertical } else { 0.0 },
            angular_resolution,
            median_range: quantile(0.5),
            p95_range: quantile(0.95),
            max_range: quantile(1.0),
            saturation_range,
            sweep_duration,
            skew,
            time_scale: None,
            azimuth_turn: None,
            sweep_begin: point_time.and_then(|times| sweep_begin(&self.time_spans, times)),
            times_are_uncertain: false,
            only_stood: self.skew.only_stood(),
            is_in_firing_order: self.in_firing_order > 0,
        };
        self.judge_times(&mut statistics, duty);
        statistics
    }

    /// Checks the times of points by the motion in the clouds.
    fn judge_times(&self, statistics: &mut RangeStatistics, duty: f64) {
        let spins = statistics.is_spinning();
        let Some(skew) = statistics.skew.as_mut().filter(|_| statistics.sweep_duration > 0.0) else { return };
        let Some(right) = self.skew.right_times(skew, duty, spins) else { return };
        if right.is_clear {
            skew.elevation = right.elevation;
        }
        statistics.times_are_uncertain = !right.is_clear;
        match right.times {
            Times::Scaled(scale) => statistics.time_scale = Some(scale),
            Times::ByAzimuth(turn) => statistics.azimuth_turn = Some(turn),
        }
    }
}

/// Seconds from the stamp of clouds to their first points, by times that may belong to other points of the
/// cloud.
fn sweep_begin(spans: &[TimeSpan], times: PointTime) -> Option<f64> {
    let begin = |span: &TimeSpan| match times.origin {
        PointTimeOrigin::Stamp => Some(span.least * times.unit),
        PointTimeOrigin::Epoch => Some(span.least * times.unit - span.stamp.unix_seconds()),
        PointTimeOrigin::OtherClock => None,
    };
    median(&mut spans.iter().filter_map(begin).collect::<Vec<_>>())
}

const METRE: f32 = 1.0;
const MILLIMETRE: f32 = 1e-3;
/// Range of the median of the ranges of a cloud that is in millimetres: no lidar measures that far, and no
/// scene is that near.
const MEDIAN_IN_MILLIMETRES: std::ops::Range<f32> = 500.0..500_000.0;
/// Minimum number of points that determine the unit.
const MIN_POINTS: usize = 50;

/// Metres in one unit of the coordinates, from the ranges of the points; none if they are too few.
fn length_unit(layout: &CloudLayout, cloud: &PointCloud2) -> Option<f32> {
    let total = cloud.data.len() / (cloud.point_step as usize).max(1);
    let mut ranges = Vec::new();
    layout.sample(cloud, total.div_ceil(4 * MAX_READINGS).max(1), |point| {
        let range = point.coords.norm();
        ranges.extend((range.is_finite() && range > 0.0).then_some(range));
    });
    if ranges.len() < MIN_POINTS {
        return None;
    }
    let middle = ranges.len() / 2;
    let (_, median, _) = ranges.select_nth_unstable_by(middle, f32::total_cmp);
    Some(if MEDIAN_IN_MILLIMETRES.contains(median) { MILLIMETRE } else { METRE })
}

/// Angular velocity that no platform exceeds for long, rad/s.
pub const FAST_TURN: f64 = 12.0;

/// Collects [`ImuStatistics`].
#[derive(Clone, Debug, Default)]
pub(crate) struct ImuSampler {
    accelerations: Vec<f64>,
    angular_velocities: Vec<f64>,
    sum: Vector3,
    partial: usize,
}

impl ImuSampler {
    pub fn add(&mut self, imu: &Imu) {
        if self.accelerations.len() >= MAX_SAMPLES {
            return;
        }
        let acceleration = Vector3::from(imu.linear_acceleration);
        self.partial += usize::from(is_partial(imu));
        if acceleration.iter().all(|v| v.is_finite()) {
            self.sum += acceleration;
            self.accelerations.push(acceleration.norm());
            self.angular_velocities.push(Vector3::from(imu.angular_velocity).norm());
        }
    }

    pub fn finish(mut self, interval: Option<f64>) -> ImuStatistics {
        let count = self.accelerations.len();
        let fast = self.angular_velocities.iter().filter(|rate| **rate > FAST_TURN).count();
        ImuStatistics {
            messages: count,
            rate: interval.map_or(0.0, |i| 1.0 / i),
            median_acceleration: median(&mut self.accelerations).unwrap_or(0.0),
            mean_acceleration: (self.sum / count.max(1) as f64).into(),
            median_angular_velocity: median(&mut self.angular_velocities).unwrap_or(0.0),
            fast_share: fast as f64 / count.max(1) as f64,
            is_partial: self.partial * 2 > count,
        }
    }
}

/// Whether the message declares that acceleration or angular velocity is missing (−1 in its covariance).
pub fn is_partial(imu: &Imu) -> bool {
    imu.linear_acceleration_covariance[0] == -1.0 || imu.angular_velocity_covariance[0] == -1.0
}

fn median_count(values: &mut [usize]) -> usize {
    values.sort_unstable();
    values.get(values.len() / 2).copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Time;
    use portolan_recording::Header;

    #[test]
    fn the_reading_for_no_return_is_found() {
        let mut sampler = RangeSampler::default();
        for i in 0..10 {
            let mut ranges: Vec<f32> = (0..90).map(|k| 1.0 + 0.1 * k as f32).collect();
            ranges.extend([50.0; 10]);
            ranges.extend([f32::NAN, 81.9]);
            sampler.add_scan(&LaserScan {
                header: Header { stamp: Time::from_ros(i, 0), frame_id: "laser".into() },
                angle_min: 0.0,
                angle_max: 1.0,
                angle_increment: 0.01,
                time_increment: 0.0001,
                scan_time: 0.0,
                range_min: 0.0,
                range_max: 80.0,
                ranges,
                intensities: Vec::new(),
            });
        }
        let statistics = sampler.finish(Some(0.1));
        assert_eq!(statistics.saturation_range, Some(50.0));
        assert!((statistics.max_range - 9.9).abs() < 1e-5);
        assert!((statistics.median_range - 5.5).abs() < 0.11);
        assert_eq!((statistics.readings, statistics.returns, statistics.rate), (102, 100, 10.0));
        assert!((statistics.field_of_view - 1.01).abs() < 1e-5);
        assert!(statistics.has_point_times());
    }
}
