//! The raw points of a recording, packed and in order of time.

use portolan_geometry::{Duration, Time};
use portolan_sensor::TimedPointCloudData;

/// Ticks of 10 µs: exact enough for points (0.1 mm at 10 m/s), and 32 bits last for eleven hours.
const TICKS_PER_SECOND: f64 = 1e5;

/// A raw point: in the tracking frame as it was at the point's own time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoredPoint {
    /// Metres.
    pub in_tracking: [f32; 3],
    /// Units of 10 µs since [`PointStore::start`].
    pub ticks: u32,
}

impl StoredPoint {
    /// Seconds since the start of the store.
    pub fn seconds(&self) -> f64 {
        f64::from(self.ticks) / TICKS_PER_SECOND
    }
}

/// What was left out when points were added.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct LeftOutPoints {
    /// Coordinates or times that are not finite.
    pub not_finite: u64,
    /// Nearer than the least range.
    pub too_near: u64,
    /// More than ten seconds before the first sweep, or more than eleven hours after it.
    pub outside_of_time: u64,
    /// Good points beyond the limit of the store, evenly over the whole recording.
    pub thinned: u64,
}

/// Most points that are kept unless it is told otherwise: 1.6 GB.
const USUAL_LIMIT: usize = 100_000_000;

/// Raw points of one or several range sensors in the tracking frame, 16 bytes each. Beyond a limit every second
/// point is left out, and again, so that memory stays bounded however long the recording is.
#[derive(Clone, Debug)]
pub struct PointStore {
    start: Option<Time>,
    min_range: f32,
    limit: usize,
    /// One of so many points is kept.
    stride: u64,
    /// Good points so far.
    good: u64,
    points: Vec<StoredPoint>,
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
            left_out: LeftOutPoints::default(),
        }
    }

    /// The same with another limit to the number of points.
    pub fn with_limit(self, limit: usize) -> Self {
        Self { limit: limit.max(2), ..self }
    }

    /// Adds the points of a sweep.
    pub fn push(&mut self, sweep: &TimedPointCloudData) {
        let start = *self.start.get_or_insert(sweep.time + Duration::from_seconds(-10.0));
        let time = sweep.time.seconds_since(start);
        let least = self.min_range * self.min_range;
        self.points.reserve(sweep.points_in_tracking.len());
        for point in &sweep.points_in_tracking {
            let (p, ticks) = (point.position, (time + f64::from(point.time)) * TICKS_PER_SECOND);
            if !(p.x.is_finite() && p.y.is_finite() && p.z.is_finite() && ticks.is_finite()) {
                self.left_out.not_finite += 1;
            } else if (p - sweep.origin_in_tracking).norm_squared() < least {
                self.left_out.too_near += 1;
            } else if ticks < 0.0 || ticks > f64::from(u32::MAX) {
                self.left_out.outside_of_time += 1;
            } else {
                self.good += 1;
                if self.good.is_multiple_of(self.stride) {
                    let in_tracking = [p.x, p.y, p.z];
                    self.points.push(StoredPoint { in_tracking, ticks: ticks.round() as u32 });
                } else {
                    self.left_out.thinned += 1;
                }
            }
        }
        if self.points.len() > self.limit {
            self.thin();
        }
    }

    /// Keeps every second point, also of those that are still to come.
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
        if !self.points.is_sorted_by_key(|p| p.ticks) {
            self.points.sort_by_key(|p| p.ticks);
        }
        self.points.shrink_to_fit();
    }

    /// The time from which points count theirs.
    pub fn start(&self) -> Time {
        self.start.unwrap_or(Time::UNIX_EPOCH)
    }

    /// The points, in order once sorted.
    pub fn points(&self) -> &[StoredPoint] {
        &self.points
    }

    /// What was left out.
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
        let steps: Vec<u32> = store.points().windows(2).map(|w| w[1].ticks - w[0].ticks).collect();
        assert!(steps.iter().all(|s| *s == steps[0]));
    }
}
