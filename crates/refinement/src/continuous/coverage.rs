//! Determines the times that a trajectory covers, and the points in them.

use portolan_geometry::{Rigid3, Time};

use super::correction::Corrections;
use crate::MAX_SENSORS;
use crate::point_store::StoredPoint;

/// Maximum interval between poses for interpolation, as a multiple of the usual one. Longer intervals are
/// gaps if they are also longer than [`SECONDS`].
const INTERVALS: f64 = 5.0;
/// Minimum duration of a gap, seconds.
const SECONDS: f64 = 0.5;

/// Maximum density of points for finding surfaces, points per second; denser ones are thinned. Surfaces are
/// then known accurately enough, and the computing time is bounded.
const MAX_POINTS_PER_SECOND: usize = 125_000;

/// Points of a recording in the time of a trajectory.
#[derive(Clone)]
pub(crate) struct TimedPoints<'a> {
    /// In order of time.
    pub points: &'a [StoredPoint],
    /// Offset added to a point's seconds to get those of the trajectory.
    pub offset: f64,
    /// Number of their sensors.
    pub sensors: usize,
    /// Corrections of these sensors.
    pub corrections: Corrections,
}

impl<'a> TimedPoints<'a> {
    /// By the clock of the recording.
    pub fn seconds(&self, point: &StoredPoint) -> f64 {
        point.seconds() + self.offset
    }

    /// Corrected time, and position in the tracking frame.
    #[inline]
    pub fn place(&self, point: &StoredPoint) -> (f64, [f32; 3]) {
        self.corrections.place(point.sensor(), self.seconds(point), point.in_tracking)
    }

    /// Points from a time up to (not at) another.
    pub fn between(&self, [from, to]: [f64; 2]) -> &'a [StoredPoint] {
        let start = self.points.partition_point(|p| self.seconds(p) < from);
        let end = self.points.partition_point(|p| self.seconds(p) < to);
        &self.points[start..end]
    }

    /// Points thinned to the density for finding surfaces, evenly for each sensor, so that the cost of later
    /// steps does not depend on the density of the recording; none if it is not denser.
    pub fn thinned(&self) -> Option<Vec<StoredPoint>> {
        let (first, last) = (self.seconds(self.points.first()?), self.seconds(self.points.last()?));
        let blocks = (last - first).floor() as usize + 1;
        let block = |i: usize| self.between([first + i as f64, first + (i + 1) as f64]);
        let stride = |count: usize| count.div_ceil(MAX_POINTS_PER_SECOND).max(1);
        let strides: Vec<usize> = (0..blocks).map(|i| stride(block(i).len())).collect();
        if strides.iter().all(|s| *s == 1) {
            return None;
        }
        let enough = (0..blocks).map(|i| block(i).len() / strides[i] + self.sensors).sum();
        let mut kept = Vec::with_capacity(enough);
        let mut seen = [0_usize; MAX_SENSORS];
        for (i, stride) in strides.iter().enumerate() {
            for point in block(i) {
                let seen = &mut seen[point.sensor()];
                *seen += 1;
                if *seen >= *stride {
                    *seen = 0;
                    kept.push(*point);
                }
            }
        }
        Some(kept)
    }
}

/// Intervals of time without gaps, in seconds since the first pose.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Coverage {
    /// Ascending, disjoint.
    pub intervals: Vec<[f64; 2]>,
    /// Intervals between them.
    pub gaps: Vec<[f64; 2]>,
    /// Usual interval from one pose to the next, seconds.
    pub usual_step: f64,
}

impl Coverage {
    /// Finds gaps in poses of ascending time.
    pub fn of(poses: &[(Time, Rigid3)]) -> Self {
        let Some(start) = poses.first().map(|p| p.0) else {
            return Self { intervals: Vec::new(), gaps: Vec::new(), usual_step: 0.0 };
        };
        let times: Vec<f64> = poses.iter().map(|p| p.0.seconds_since(start)).collect();
        let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
        steps.sort_by(f64::total_cmp);
        let usual = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
        let limit = SECONDS.max(INTERVALS * usual);
        let mut coverage = Self { intervals: Vec::new(), gaps: Vec::new(), usual_step: usual };
        let mut from = 0.0;
        for w in times.windows(2).filter(|w| w[1] - w[0] > limit) {
            coverage.intervals.push([from, w[0]]);
            coverage.gaps.push([w[0], w[1]]);
            from = w[1];
        }
        coverage.intervals.push([from, times.last().copied().unwrap_or(0.0)]);
        coverage.intervals.retain(|[from, to]| to > from);
        coverage
    }

    /// Windows of about `seconds` seconds.
    pub fn windows(&self, seconds: f64) -> Vec<[f64; 2]> {
        let mut windows = Vec::new();
        for [from, to] in &self.intervals {
            let count = ((to - from) / seconds).ceil().max(1.0);
            let length = (to - from) / count;
            windows.extend(
                (0..count as usize).map(|i| [from + i as f64 * length, from + (i + 1) as f64 * length]),
            );
        }
        windows
    }

    /// Number of points within the intervals.
    pub fn count(&self, points: &TimedPoints) -> usize {
        self.intervals.iter().map(|interval| points.between(*interval).len()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dense_points_are_thinned_evenly_and_others_are_left() {
        let point = |i: usize, rate: f64| StoredPoint::new([0.0; 3], i as f64 / rate, i % 2).unwrap();
        let timed = |points: &'static [StoredPoint]| TimedPoints {
            points,
            offset: -1.0,
            sensors: 2,
            corrections: Corrections::default(),
        };
        let sparse: Vec<StoredPoint> = (0..1000).map(|i| point(i, 500.0)).collect();
        assert!(timed(sparse.leak()).thinned().is_none());
        let dense: Vec<StoredPoint> = (0..900_000).map(|i| point(i, 300_000.0)).collect();
        let kept = timed(dense.leak()).thinned().unwrap();
        assert!((299_000..301_000).contains(&kept.len()), "{}", kept.len());
        let first = kept.iter().filter(|p| p.sensor() == 0).count();
        assert!((2 * first).abs_diff(kept.len()) < 10);
        assert!(kept.windows(2).all(|w| w[1].seconds() - w[0].seconds() < 3e-5));
    }

    #[test]
    fn gaps_are_found_and_windows_do_not_span_them() {
        let times = [0.0, 0.1, 0.2, 0.3, 5.0, 5.1, 5.2, 5.3, 5.4];
        let poses: Vec<_> = times.map(|t| (Time::from_unix_seconds(t), Rigid3::identity())).to_vec();
        let coverage = Coverage::of(&poses);
        assert_eq!(coverage.gaps.len(), 1);
        let windows = coverage.windows(0.25);
        assert_eq!(windows.len(), 4);
        assert!(windows.iter().all(|w| w[1] <= 0.31 || w[0] >= 4.99));
        let points = [0.1, 1.0, 5.2, 9.0].map(|s| StoredPoint::new([0.0; 3], s, 0).unwrap());
        let corrections = Corrections::default();
        assert_eq!(coverage.count(&TimedPoints { points: &points, offset: 0.0, sensors: 1, corrections }), 2);
    }
}
