//! Points with times, between a message and a measurement.

use portolan_geometry::{Duration, Time};
use portolan_sensor::TimedPoint;

/// Points in the frame of their sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedPoints {
    /// Time of the last point.
    pub time: Time,
    /// In order of time. Times are relative to that of the last point and at most zero.
    pub points: Vec<TimedPoint>,
    /// One per point, or empty.
    pub intensities: Vec<f32>,
}

impl TimedPoints {
    /// Room for `count` points; callers make sure that their bytes are in memory already.
    pub(crate) fn with_capacity(count: usize, with_intensities: bool) -> Self {
        Self {
            time: Time::MIN,
            points: Vec::with_capacity(count),
            intensities: Vec::with_capacity(if with_intensities { count } else { 0 }),
        }
    }

    /// Makes times relative to the last point instead of `stamp`, and sorts the points by time (points of the
    /// same time keep their order).
    pub(crate) fn rebase(&mut self, stamp: Time) {
        if !self.points.is_sorted_by(|a, b| a.time <= b.time) {
            self.sort();
        }
        let last = self.points.last().map_or(0.0, |p| p.time);
        self.time = stamp + Duration::from_seconds(f64::from(last));
        if last != 0.0 {
            for point in &mut self.points {
                point.time -= last;
            }
        }
    }

    fn sort(&mut self) {
        if self.intensities.is_empty() {
            self.points.sort_by(|a, b| a.time.total_cmp(&b.time));
            return;
        }
        let mut pairs: Vec<_> = self.points.iter().copied().zip(self.intensities.iter().copied()).collect();
        pairs.sort_by(|(a, _), (b, _)| a.time.total_cmp(&b.time));
        (self.points, self.intensities) = pairs.into_iter().unzip();
    }

    /// Splits the points into `count` pieces of about the same number; piece i has the points from
    /// N·i/n to N·(i+1)/n. Empty pieces are left out (`spec/slam2d.md` §1).
    pub(crate) fn subdivide(self, count: usize) -> Vec<TimedPoints> {
        if count <= 1 {
            return vec![self];
        }
        let total = self.points.len();
        // More pieces than points would only be empty ones.
        let count = count.min(total);
        let mut pieces = Vec::with_capacity(count);
        for i in 0..count {
            let range = total * i / count..total * (i + 1) / count;
            let Some(mut points) = self.points.get(range.clone()).map(<[_]>::to_vec) else { continue };
            let Some(last) = points.last().map(|p| p.time) else { continue };
            for point in &mut points {
                point.time -= last;
            }
            pieces.push(TimedPoints {
                time: self.time + Duration::from_seconds(f64::from(last)),
                points,
                intensities: self.intensities.get(range).map(<[f32]>::to_vec).unwrap_or_default(),
            });
        }
        pieces
    }

    /// Whether all points have the same time.
    pub(crate) fn is_instant(&self) -> bool {
        self.points.first().is_none_or(|p| p.time == 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Point3f;

    fn points(times: &[f32]) -> TimedPoints {
        TimedPoints {
            time: Time::UNIX_EPOCH,
            points: times
                .iter()
                .map(|t| TimedPoint { position: Point3f::new(*t, 0.0, 0.0), time: *t })
                .collect(),
            intensities: times.to_vec(),
        }
    }

    #[test]
    fn points_are_sorted_and_counted_to_the_last() {
        let mut cloud = points(&[0.25, 0.0, 0.5, 0.125]);
        cloud.rebase(Time::UNIX_EPOCH);
        assert_eq!(cloud.time, Time::from_ros(0, 500_000_000));
        assert_eq!(cloud.points.iter().map(|p| p.time).collect::<Vec<_>>(), [-0.5, -0.375, -0.25, 0.0]);
        assert_eq!(cloud.intensities, [0.0, 0.125, 0.25, 0.5]);
    }

    #[test]
    fn pieces_end_at_their_own_last_point() {
        let pieces = points(&[-0.5, -0.375, -0.25, -0.125, 0.0]).subdivide(2);
        assert_eq!(pieces.len(), 2);
        assert_eq!((pieces[0].points.len(), pieces[1].points.len()), (2, 3));
        assert_eq!(pieces[0].time, Time::from_ros(-1, 625_000_000));
        assert_eq!(pieces[0].points[0].time, -0.125);
        assert_eq!(pieces[1].points[2].time, 0.0);
        assert_eq!(points(&[-0.5, 0.0]).subdivide(5).len(), 2);
        assert_eq!(points(&[]).subdivide(5).len(), 0);
        assert_eq!(points(&[-0.5, 0.0]).subdivide(usize::MAX - 1).len(), 2);
    }
}
