//! The way of the scanner during a sweep: as predicted, bent so that it ends where the sweep was matched.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{
    Duration, Point3f, Quaternion, Rigid3, Time, Vector3, angle_axis_from_quaternion,
    quaternion_from_angle_axis,
};

use crate::pose_extrapolator::PoseExtrapolator;

/// Seconds between the poses of a way; between them it is straight.
const SPACING: f64 = 0.002;
/// A way has at most so many poses; of a longer one they lie further apart.
const MAX_POSES: usize = 512;

/// Predicted poses (tracking in local) from the last pose to the end of a sweep.
#[derive(Clone, Debug)]
pub(super) struct SweepPath {
    /// Seconds between the poses.
    spacing: f64,
    poses: Vec<Rigid3>,
    /// Whether gyroscope and odometry told how it turned and went, not only the velocity before.
    pub turn_is_measured: bool,
    pub way_is_measured: bool,
}

impl SweepPath {
    /// As `pose_at` says from `start` to `end`.
    pub fn new(start: Time, end: Time, mut pose_at: impl FnMut(Time) -> Rigid3) -> Self {
        let seconds = end.seconds_since(start).max(0.0);
        let pieces = ((seconds / SPACING).ceil() as usize).clamp(1, MAX_POSES);
        let spacing = seconds / pieces as f64;
        let time = |i: usize| match i == pieces {
            true => end,
            false => start + Duration::from_seconds(i as f64 * spacing),
        };
        let poses = (0..=pieces).map(|i| pose_at(time(i))).collect();
        Self { spacing, poses, turn_is_measured: false, way_is_measured: false }
    }

    /// As an extrapolator predicts it, from its last pose on.
    pub fn predicted(extrapolator: &mut PoseExtrapolator, end: Time) -> Self {
        let start = extrapolator.last_pose_time().unwrap_or(end).min(end);
        Self::new(start, end, |t| extrapolator.extrapolate_pose(t))
    }

    /// As an extrapolator predicts it, but turning as the last scans did instead of as a gyroscope says.
    pub fn turning_on(extrapolator: &mut PoseExtrapolator, end: Time) -> Self {
        let last = extrapolator.last_pose();
        let turn_rate = extrapolator.angular_velocity_from_poses();
        let way_is_measured = extrapolator.has_odometry(end);
        let mut path = Self::predicted(extrapolator, end);
        if let Some((_, pose)) = last {
            for (i, predicted) in path.poses.iter_mut().enumerate() {
                let turn = turn_rate * (path.spacing * i as f64);
                predicted.rotation = pose.rotation * quaternion_from_angle_axis(&turn);
            }
        }
        path.way_is_measured = way_is_measured;
        path
    }

    /// Standing at `pose` since the last pose.
    pub fn standing(extrapolator: &PoseExtrapolator, end: Time, pose: &Rigid3) -> Self {
        let start = extrapolator.last_pose_time().unwrap_or(end).min(end);
        Self::new(start, end, |_| *pose)
    }

    /// The first pose.
    pub fn start(&self) -> Rigid3 {
        self.poses.first().copied().unwrap_or_else(Rigid3::identity)
    }

    /// The last pose.
    pub fn end(&self) -> Rigid3 {
        self.poses.last().copied().unwrap_or_else(Rigid3::identity)
    }

    /// How it turns from the first pose to the last.
    pub fn turn(&self) -> Quaternion {
        self.start().rotation.inverse() * self.end().rotation
    }

    /// How far it goes from the first pose to the last, metres in the local map.
    pub fn shift(&self) -> Vector3 {
        self.end().translation.vector - self.start().translation.vector
    }

    /// Seconds from the first pose to the last.
    pub fn seconds(&self) -> f64 {
        self.spacing * (self.poses.len() - 1) as f64
    }

    /// The way bent to another end.
    ///
    /// What was measured on the way is wrong by a share that grows with time. Where only the velocity of
    /// the sweep before was known, which belongs to the middle of that sweep, a constant acceleration
    /// bends the way by (s + s²)/2 of the error at the end after a share s of the time.
    pub fn bent_to(&self, end: &Rigid3) -> StraightPieces {
        let predicted_end = self.end();
        let shift = end.translation.vector - predicted_end.translation.vector;
        let turn = angle_axis_from_quaternion(&(predicted_end.rotation.inverse() * end.rotation));
        let end_from_local = end.inverse();
        let last = (self.poses.len() - 1).max(1) as f64;
        let bent = |(i, pose): (usize, &Rigid3)| {
            let s = i as f64 / last;
            let bow = |is_measured: bool| if is_measured { s } else { 0.5 * (s + s * s) };
            let rotation = pose.rotation * quaternion_from_angle_axis(&(turn * bow(self.turn_is_measured)));
            let translation = pose.translation.vector + shift * bow(self.way_is_measured);
            let end_from_tracking = end_from_local * Rigid3::from_parts(translation.into(), rotation);
            let matrix = end_from_tracking.to_homogeneous().cast::<f32>();
            matrix.fixed_view::<3, 4>(0, 0).into_owned()
        };
        let pieces = self.poses.iter().enumerate().map(bent).collect();
        StraightPieces { per_second: (1.0 / self.spacing.max(1e-9)) as f32, pieces }
    }
}

/// From the tracking frame on the way to that at its end.
pub(super) struct StraightPieces {
    per_second: f32,
    pieces: Vec<na::Matrix3x4<f32>>,
}

impl StraightPieces {
    /// A point measured `offset` seconds (not positive) before the end, as seen from the pose at the end.
    /// Points from before the beginning are taken as measured there.
    #[inline]
    pub fn in_end(&self, position: &Point3f, offset: f32) -> Point3f {
        let last = self.pieces.len() - 1;
        let place = (last as f32 + offset * self.per_second).clamp(0.0, last as f32);
        let whole = (place as usize).min(last.saturating_sub(1));
        let share = place - whole as f32;
        let (a, b) = (&self.pieces[whole], &self.pieces[(whole + 1).min(last)]);
        let at = |m: &na::Matrix3x4<f32>| m.fixed_view::<3, 3>(0, 0) * position.coords + m.column(3);
        let (from_a, from_b) = (at(a), at(b));
        Point3f::from(from_a + (from_b - from_a) * share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Speeding up along x with 4 m/s², turning with 2 rad/s about z.
    fn truth(t: f64) -> Rigid3 {
        Rigid3::new(Vector3::new(t + 2.0 * t * t, 0.0, 0.0), Vector3::z() * (2.0 * t))
    }

    #[test]
    fn points_come_to_where_they_are_seen_from_the_end() {
        let start = Time::from_ticks(0);
        let end = start + Duration::from_seconds(0.1);
        // The velocity of the sweep before.
        let velocity = (truth(0.0).translation.vector - truth(-0.1).translation.vector) / 0.1;
        let mut path = SweepPath::new(start, end, |t| {
            let t = t.seconds_since(start);
            Rigid3::from_parts((velocity * t).into(), truth(t).rotation)
        });
        path.turn_is_measured = true;
        let bent = path.bent_to(&truth(0.1));
        let fixed = na::Point3::new(5.0, 3.0, 1.0);
        for i in 0..=20 {
            let t = 0.005 * f64::from(i);
            let seen = (truth(t).inverse() * fixed).cast::<f32>();
            let expected = (truth(0.1).inverse() * fixed).cast::<f32>();
            let error = (bent.in_end(&seen, (t - 0.1) as f32) - expected).norm();
            assert!(error < 1e-4, "{t} {error}");
        }
        assert!((path.seconds() - 0.1).abs() < 1e-9);
    }

    #[test]
    fn a_way_of_no_length_moves_nothing() {
        let time = Time::from_ticks(5);
        let path = SweepPath::new(time, time, |_| truth(0.3));
        let point = Point3f::new(1.0, 2.0, 3.0);
        let moved = path.bent_to(&truth(0.3)).in_end(&point, -1.0);
        assert!((moved - point).norm() < 1e-5);
    }
}
