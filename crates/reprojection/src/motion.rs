//! Interpolates the pose of the tracking frame at any time from the poses of a finished trajectory.

use std::ops::RangeInclusive;

use portolan_geometry::{
    Duration, Rigid3, Time, Vector3, angle_axis_from_quaternion, nalgebra as na, quaternion_from_angle_axis,
};

/// An interval between poses is a gap if it is longer than this many median intervals and than `GAP_SECONDS`.
const GAP_INTERVALS: f64 = 5.0;
const GAP_SECONDS: f64 = 1.0;
/// Rotations between poses above this angle are interpolated by slerp instead of the cubic, radians.
const SMALL_TURN: f64 = 0.7;

/// A smooth motion through poses: cubic between neighbours (Catmull-Rom on positions and on rotation vectors
/// relative to the pose before), so that the vertical bobbing of a walking person between scans is kept.
#[derive(Clone, Debug)]
pub struct SmoothMotion {
    poses: Vec<(Time, Rigid3)>,
    gap_seconds: f64,
}

impl SmoothMotion {
    /// Builds the motion from timed `map_from_tracking`; of several poses of the same time the first is used.
    pub fn new(mut poses: Vec<(Time, Rigid3)>) -> Self {
        poses.sort_by_key(|(time, _)| *time);
        poses.dedup_by_key(|(time, _)| *time);
        let mut steps: Vec<f64> = poses.windows(2).map(|w| w[1].0.seconds_since(w[0].0)).collect();
        steps.sort_by(f64::total_cmp);
        let usual = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
        Self { poses, gap_seconds: GAP_SECONDS.max(GAP_INTERVALS * usual) }
    }

    /// First and last time; none if there are no poses.
    pub fn span(&self) -> Option<(Time, Time)> {
        Some((self.poses.first()?.0, self.poses.last()?.0))
    }

    /// `map_from_tracking`; none before the first pose, after the last one, and in gaps.
    pub fn pose(&self, time: Time) -> Option<Rigid3> {
        let after = self.poses.partition_point(|(t, _)| *t < time);
        let (end_time, end) = self.poses.get(after)?;
        if *end_time == time {
            return Some(*end);
        }
        let before = after.checked_sub(1)?;
        let span = self.step(before)?;
        Some(self.between(before, time.seconds_since(self.poses[before].0) / span))
    }

    /// Whether the motion is known at all of these times: both ends are in one segment without gaps.
    pub fn covers(&self, times: RangeInclusive<Time>) -> bool {
        let (from, to) = (times.start(), times.end());
        let first = self.poses.partition_point(|(t, _)| t <= from);
        let last = self.poses.partition_point(|(t, _)| t < to);
        let starts = first > 0 && last < self.poses.len();
        starts && (first - 1..last).all(|i| self.step(i).is_some())
    }

    /// Seconds from pose `index` to the next; none if there is a gap or no next pose.
    fn step(&self, index: usize) -> Option<f64> {
        let seconds = self.poses.get(index + 1)?.0.seconds_since(self.poses.get(index)?.0);
        (seconds <= self.gap_seconds).then_some(seconds)
    }

    /// Pose between `index` and the next one at a fraction of the time between them, 0 to 1.
    fn between(&self, index: usize, share: f64) -> Rigid3 {
        let (start, end) = (&self.poses[index].1, &self.poses[index + 1].1);
        let start_from = |pose: &Rigid3| {
            let turn = angle_axis_from_quaternion(&(start.rotation.inverse() * pose.rotation));
            (turn, pose.translation.vector)
        };
        let (turn, place) = start_from(end);
        let span = self.step(index).unwrap_or(1.0);
        let neighbour = |at: Option<usize>, index_of_step: Option<usize>| {
            let step = self.step(index_of_step?)?;
            let (turn, place) = start_from(&self.poses.get(at?)?.1);
            (turn.norm() < SMALL_TURN).then_some((turn, place, step / span))
        };
        let before = neighbour(index.checked_sub(1), index.checked_sub(1));
        let after = neighbour(Some(index + 2), Some(index + 1));
        let smooth =
            |v0: Vector3, v1: Vector3, before: Option<(Vector3, f64)>, after: Option<(Vector3, f64)>| {
                hermite(v0, v1, before, after, share)
            };
        let rotation = if turn.norm() < SMALL_TURN {
            let vector =
                smooth(Vector3::zeros(), turn, before.map(|(t, _, s)| (t, s)), after.map(|(t, _, s)| (t, s)));
            start.rotation * quaternion_from_angle_axis(&vector)
        } else {
            start.rotation.try_slerp(&end.rotation, share, 1e-12).unwrap_or(start.rotation)
        };
        let position = smooth(
            start.translation.vector,
            place,
            before.map(|(_, p, s)| (p, s)),
            after.map(|(_, p, s)| (p, s)),
        );
        Rigid3::from_parts(na::Translation3::from(position), rotation)
    }
}

/// Cubic Hermite interpolation from `v0` to `v1`. `before` and `after` are the neighbours, each with its distance in
/// time in units of the step. An end without a neighbour has the slope of the straight line.
fn hermite(
    v0: Vector3,
    v1: Vector3,
    before: Option<(Vector3, f64)>,
    after: Option<(Vector3, f64)>,
    share: f64,
) -> Vector3 {
    let straight = v1 - v0;
    // Derivative of the parabola through three points.
    let m0 = before.map_or(straight, |(v, s)| (straight * s + (v0 - v) / s) / (1.0 + s));
    let m1 = after.map_or(straight, |(v, s)| (straight * s + (v - v1) / s) / (1.0 + s));
    let (t, t2, t3) = (share, share * share, share * share * share);
    v0 * (2.0 * t3 - 3.0 * t2 + 1.0) + m0 * (t3 - 2.0 * t2 + t) + v1 * (3.0 * t2 - 2.0 * t3) + m1 * (t3 - t2)
}

/// Motion during one sweep as matrices, which are interpolated element by element.
#[derive(Clone, Debug, Default)]
pub(super) struct SweepMotion {
    step: f64,
    rows: Vec<[f64; 12]>,
}

/// Seconds between matrices: at 5 rad/s the error of the linear interpolation is below 0.01 %.
const STEP: f64 = 0.005;
/// Longest sweep that is placed by matrices; in longer ones each pose is interpolated by itself, seconds.
pub(super) const LONGEST_SWEEP: f64 = 20.0;

impl SweepMotion {
    /// Samples the motion between two times, which should be less than `LONGEST_SWEEP` apart; false if it
    /// does not cover them.
    pub fn fill(&mut self, motion: &SmoothMotion, from: Time, to: Time) -> bool {
        self.rows.clear();
        let seconds = to.seconds_since(from);
        let count = (seconds / STEP).ceil().max(1.0);
        self.step = (seconds / count).max(1e-9);
        for i in 0..=count as usize {
            let time = (from + Duration::from_seconds(i as f64 * self.step)).min(to);
            let Some(pose) = motion.pose(time) else { return false };
            self.rows.push(matrix(&pose));
        }
        true
    }

    /// Transforms a point of the tracking frame, `seconds` after the start of the sweep, into the map.
    #[inline]
    pub fn to_map(&self, seconds: f64, point: [f32; 3]) -> [f64; 3] {
        let at = (seconds / self.step).clamp(0.0, (self.rows.len() - 1) as f64);
        let i = (at as usize).min(self.rows.len() - 2);
        let f = at - i as f64;
        let (a, b) = (&self.rows[i], &self.rows[i + 1]);
        apply(&std::array::from_fn(|k| a[k] + (b[k] - a[k]) * f), point)
    }
}

fn matrix(pose: &Rigid3) -> [f64; 12] {
    let (r, t) = (pose.rotation.to_rotation_matrix(), pose.translation.vector);
    let r = r.matrix();
    [r.m11, r.m12, r.m13, t.x, r.m21, r.m22, r.m23, t.y, r.m31, r.m32, r.m33, t.z]
}

#[inline]
fn apply(m: &[f64; 12], point: [f32; 3]) -> [f64; 3] {
    let [x, y, z] = point.map(f64::from);
    [0, 4, 8].map(|row| m[row] * x + m[row + 1] * y + m[row + 2] * z + m[row + 3])
}

/// Transforms a point of the tracking frame into the map.
pub(super) fn place(pose: &Rigid3, point: [f32; 3]) -> [f64; 3] {
    apply(&matrix(pose), point)
}
