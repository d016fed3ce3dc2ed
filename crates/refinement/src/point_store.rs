//! Stores the raw points of a recording, packed and in order of time.

use portolan_geometry::{Duration, Time};
use portolan_sensor::TimedPointCloudData;

/// Ticks of 25 µs: accurate enough for points (0.25 mm at 10 m/s), and 29 bits last for more than three
/// hours.
const TICKS_PER_SECOND: f64 = 4e4;
/// Bits of the time of a point; the other bits hold the number of its sensor.
const TIME_BITS: u32 = 29;
const LAST_TICK: u32 = (1 << TIME_BITS) - 1;
/// Maximum number of sensors that are distinguished; further ones count as the last of them.
pub const MAX_SENSORS: usize = 8;

/// A raw point: in the tracking frame as it was at the point's own time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoredPoint {
    /// Position, metres.
    pub in_tracking: [f32; 3],
    /// Sensor and time.
    stamp: u32,
}

impl StoredPoint {
    /// A point of a sensor (below [`MAX_SENSORS`]); none if the time (seconds since the start of the store)
    /// is out of range.
    pub fn new(in_tracking: [f32; 3], seconds: f64, sensor: usize) -> Option<Self> {
        let ticks = (seconds * TICKS_PER_SECOND).round();
        let holds = ticks >= 0.0 && ticks <= f64::from(LAST_TICK);
        let sensor = sensor.min(MAX_SENSORS - 1) as u32;
        holds.then_some(Self { in_tracking, stamp: sensor << TIME_BITS | ticks as u32 })
    }

    /// Seconds since the start of the store.
    #[inline]
    pub fn seconds(&self) -> f64 {
        f64::from(self.ticks()) / TICKS_PER_SECOND
    }

    /// The number of its sensor.
    #[inline]
    pub fn sensor(&self) -> usize {
        (self.stamp >> TIME_BITS) as usize
    }

    #[inline]
    fn ticks(&self) -> u32 {
        self.stamp & LAST_TICK
    }
}

/// A range sensor of a store.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct StoredSensor {
    /// Its name: the topic.
    pub name: String,
    /// Its position in the tracking frame at its first measurement, metres.
    pub origin_in_tracking: [f64; 3],
    /// Number of its sweeps with points.
    pub sweeps: u64,
    /// Number of its sweeps without points.
    pub empty_sweeps: u64,
    /// Times of its first and its latest sweep.
    #[serde(skip)]
    span: Option<(Time, Time)>,
}

/// Counts of points that were left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct LeftOutPoints {
    /// Coordinates or times that are not finite.
    pub not_finite: u64,
    /// Nearer than the minimum range.
    pub too_near: u64,
    /// More than ten seconds before the first sweep, or more than three hours and forty minutes after it.
    pub outside_of_time: u64,
    /// Good points beyond the limit of the store, evenly over the whole recording.
    pub thinned: u64,
}

/// Default of the maximum number of points: 2.6 GB.
const USUAL_LIMIT: usize = 160_000_000;
/// Usual duration of a turn of a spinning lidar, seconds.
const USUAL_SWEEP: f64 = 0.1;
/// Number of last points among which a sweep is sorted in at once; a sweep that belongs farther back waits
/// for [`PointStore::sort`].
const SETTLED_AT_ONCE: usize = 4_000_000;

/// Raw points of one or several range sensors in the tracking frame, 16 bytes each. Whenever the limit is
/// exceeded every second point is left out, so that memory is bounded for recordings of any length.
#[derive(Clone, Debug)]
pub struct PointStore {
    start: Option<Time>,
    min_range: f32,
    limit: usize,
    /// One of this many points is kept.
    stride: u64,
    /// Good points so far.
    good: u64,
    points: Vec<StoredPoint>,
    is_sorted: bool,
    sensors: Vec<StoredSensor>,
    left_out: LeftOutPoints,
}

impl PointStore {
    /// An empty store that leaves out points nearer than `min_range` metres to their sensor.
    pub fn new(min_range: f32) -> Self {
        Self {
            start: None,
            min_range,
            limit: USUAL_LIMIT,
            stride: 1,
            good: 0,
            points: Vec::new(),
            is_sorted: true,
            sensors: Vec::new(),
            left_out: LeftOutPoints::default(),
        }
    }

    /// The same with another limit to the number of points.
    pub fn with_limit(self, limit: usize) -> Self {
        Self { limit: limit.max(2), ..self }
    }

    /// Adds a sweep of the only sensor.
    pub fn push(&mut self, sweep: &TimedPointCloudData) {
        self.push_from("", sweep);
    }

    /// The number of a sensor; a new sensor gets the next one.
    fn sensor(&mut self, name: &str, sweep: &TimedPointCloudData) -> usize {
        let known = self.sensors.iter().position(|s| s.name == name);
        let number = known.unwrap_or_else(|| {
            let origin_in_tracking = std::array::from_fn(|k| f64::from(sweep.origin_in_tracking[k]));
            self.sensors.push(StoredSensor {
                name: name.to_owned(),
                origin_in_tracking,
                ..StoredSensor::default()
            });
            self.sensors.len() - 1
        });
        let known = &mut self.sensors[number];
        match sweep.points_in_tracking.is_empty() {
            true => known.empty_sweeps += 1,
            false => known.sweeps += 1,
        }
        let (first, last) = known.span.unwrap_or((sweep.time, sweep.time));
        known.span = Some((first.min(sweep.time), last.max(sweep.time)));
        number
    }

    /// Adds a sweep of a sensor.
    pub fn push_from(&mut self, sensor: &str, sweep: &TimedPointCloudData) {
        let sensor = self.sensor(sensor, sweep);
        let start = *self.start.get_or_insert(sweep.time + Duration::from_seconds(-10.0));
        let time = sweep.time.seconds_since(start);
        let least = self.min_range * self.min_range;
        self.points.reserve(sweep.points_in_tracking.len());
        let first_new = self.points.len();
        for point in &sweep.points_in_tracking {
            let (p, seconds) = (point.position, time + f64::from(point.time));
            if !(p.x.is_finite() && p.y.is_finite() && p.z.is_finite() && seconds.is_finite()) {
                self.left_out.not_finite += 1;
            } else if (p - sweep.origin_in_tracking).norm_squared() < least {
                self.left_out.too_near += 1;
            } else if let Some(point) = StoredPoint::new([p.x, p.y, p.z], seconds, sensor) {
                self.good += 1;
                if self.good.is_multiple_of(self.stride) {
                    self.points.push(point);
                } else {
                    self.left_out.thinned += 1;
                }
            } else {
                self.left_out.outside_of_time += 1;
            }
        }
        self.sort_new(first_new);
        if self.points.len() > self.limit {
            self.thin();
        }
    }

    /// Sorts new points by time into those before them. Sweeps come nearly in order, so this touches few
    /// points and needs no memory, whereas sorting everything at the end would need half as much again.
    fn sort_new(&mut self, first_new: usize) {
        let (old, new) = self.points.split_at(first_new);
        let Some(earliest) = new.iter().map(StoredPoint::ticks).min() else { return };
        if !self.is_sorted {
            return;
        }
        // Points of equal time stay in the order in which they came.
        let from = old.partition_point(|p| p.ticks() <= earliest);
        if self.points.len() - from > SETTLED_AT_ONCE.max(2 * new.len()) {
            self.is_sorted = false;
        } else {
            self.points[from..].sort_by_key(StoredPoint::ticks);
        }
    }

    /// Keeps every second point, also of those that are added later.
    fn thin(&mut self) {
        let before = self.points.len();
        let mut index = 0;
        self.points.retain(|_| {
            index += 1;
            index % 2 == 0
        });
        self.left_out.thinned += (before - self.points.len()) as u64;
        self.stride *= 2;
    }

    /// Puts the points in order of time; points of equal time stay in the order in which they came.
    pub fn sort(&mut self) {
        if !self.is_sorted {
            self.points.sort_by_key(StoredPoint::ticks);
            self.is_sorted = true;
        }
        self.points.shrink_to_fit();
    }

    /// The time from which the times of points count.
    pub fn start(&self) -> Time {
        self.start.unwrap_or(Time::UNIX_EPOCH)
    }

    /// The points, in order once sorted.
    pub fn points(&self) -> &[StoredPoint] {
        &self.points
    }

    /// The sensors in the order of their numbers.
    pub fn sensors(&self) -> &[StoredSensor] {
        &self.sensors
    }

    /// Mean time from one sweep of the first sensor to the next, seconds. Messages at more than ten a second
    /// are packets, which are taken as parts of sweeps of a tenth of a second.
    pub fn sweep_seconds(&self) -> f64 {
        let mean = self.sensors.first().and_then(|sensor| {
            let (first, last) = sensor.span?;
            let steps = (sensor.sweeps + sensor.empty_sweeps).checked_sub(1).filter(|s| *s > 0)?;
            Some(last.seconds_since(first) / steps as f64)
        });
        mean.unwrap_or(0.0).max(USUAL_SWEEP)
    }

    /// Counts of points that were left out.
    pub fn left_out(&self) -> LeftOutPoints {
        self.left_out
    }

    /// Times of the first and the last point of a sorted store.
    pub fn span(&self) -> Option<(Time, Time)> {
        let at = |p: &StoredPoint| self.start() + Duration::from_seconds(p.seconds());
        Some((at(self.points.first()?), at(self.points.last()?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Point3f;
    use portolan_sensor::TimedPoint;

    #[test]
    fn points_are_sorted_and_faults_counted() {
        let point = |x, time| TimedPoint { position: Point3f::new(x, 0.0, 0.0), time };
        let sweep = |seconds: f64, points| TimedPointCloudData {
            time: Time::from_unix_seconds(seconds),
            origin_in_tracking: Point3f::origin(),
            points_in_tracking: points,
            intensities: Vec::new(),
        };
        let mut store = PointStore::new(0.5);
        store.push(&sweep(100.0, vec![point(2.0, -0.1), point(0.1, 0.0), point(f32::NAN, 0.0)]));
        store.push(&sweep(99.9, vec![point(3.0, -0.2), point(3.0, -60.0)]));
        store.sort();
        let xs: Vec<f32> = store.points().iter().map(|p| p.in_tracking[0]).collect();
        assert_eq!(xs, [3.0, 2.0]);
        assert_eq!(
            store.left_out(),
            LeftOutPoints { not_finite: 1, too_near: 1, outside_of_time: 1, thinned: 0 }
        );
        let (first, last) = store.span().unwrap();
        assert!((last.seconds_since(first) - 0.2).abs() < 1e-6);
        assert!((store.sweep_seconds() - 0.1).abs() < 1e-6);
        store.push(&sweep(99.7, Vec::new()));
        store.push(&sweep(100.2, Vec::new()));
        assert!((store.sweep_seconds() - 0.5 / 3.0).abs() < 1e-6);
    }

    #[test]
    fn the_order_of_sweeps_does_not_matter_but_that_of_equal_times_does() {
        let sweep = |seconds: f64, x: f32, count: usize| TimedPointCloudData {
            time: Time::from_unix_seconds(seconds),
            origin_in_tracking: Point3f::origin(),
            points_in_tracking: vec![TimedPoint { position: Point3f::new(x, 0.0, 0.0), time: 0.0 }; count],
            intensities: Vec::new(),
        };
        let mut store = PointStore::new(0.5);
        store.push_from("a", &sweep(10.0, 1.0, 1));
        store.push_from("a", &sweep(12.0, 3.0, 1));
        store.push_from("b", &sweep(11.0, 2.0, 1));
        store.push_from("b", &sweep(12.0, 4.0, 1));
        let xs = |store: &PointStore| store.points().iter().map(|p| p.in_tracking[0]).collect::<Vec<_>>();
        assert_eq!(xs(&store), [1.0, 2.0, 3.0, 4.0]);
        // A sweep far back in time waits.
        store.push_from("a", &sweep(13.0, 5.0, SETTLED_AT_ONCE));
        store.push_from("b", &sweep(9.0, 0.5, 1));
        assert_eq!(store.points().last().unwrap().in_tracking[0], 0.5);
        store.sort();
        assert_eq!(xs(&store)[..6], [0.5, 1.0, 2.0, 3.0, 4.0, 5.0]);
    }

    #[test]
    fn memory_is_bounded_and_points_stay_spread() {
        let mut store = PointStore::new(0.5).with_limit(100);
        for second in 0..1000 {
            store.push(&TimedPointCloudData {
                time: Time::from_unix_seconds(f64::from(second)),
                origin_in_tracking: Point3f::origin(),
                points_in_tracking: vec![TimedPoint { position: Point3f::new(2.0, 0.0, 0.0), time: 0.0 }],
                intensities: Vec::new(),
            });
        }
        store.sort();
        assert!((50..=100).contains(&store.points().len()));
        assert_eq!(store.points().len() as u64 + store.left_out().thinned, 1000);
        let steps: Vec<u32> = store.points().windows(2).map(|w| w[1].ticks() - w[0].ticks()).collect();
        assert!(steps.iter().all(|s| *s == steps[0]));
    }
}
