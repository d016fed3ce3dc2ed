//! The way of a scanner during a sweep: as predicted, and bent to where the sweep fits.

use nalgebra as na;
use portolan_geometry::{
    Duration, Point3f, Quaternion, Rigid3, Time, Vector3, angle_axis_from_quaternion,
    quaternion_from_angle_axis,
};

/// Seconds between the poses of a way; between them it is straight.
const SPACING: f64 = 0.002;
/// A way has at most so many poses; of a longer one they lie further apart.
const MAX_POSES: usize = 512;

/// Predicted poses of a scanner (in the frame of a map), evenly spaced in time from where the sweep before
/// ended to the end of a sweep.
#[derive(Clone, Debug)]
pub struct Way {
    /// Seconds between the poses.
    spacing: f64,
    poses: Vec<Rigid3>,
    /// Whether a gyroscope told how it turned, not only the velocity before.
    pub turn_is_measured: bool,
    /// What told how it went.
    pub going: Going,
}

/// What tells how a scanner goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Going {
    /// Odometry, or that it stands.
    Measured,
    /// Accelerations, since a velocity that may be off by so much, m/s (standard deviation).
    Felt(f64),
    /// Nothing but the velocity before.
    AsBefore,
}

/// What a prediction is wrong by: first three entries a shift in metres, last three a rotation vector about
/// the scanner in radians, both in the frame of the map.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WayCorrection {
    /// At the start, and so everywhere.
    pub start: na::Vector6<f64>,
    /// Grown since, at the end.
    pub bend: na::Vector6<f64>,
}

impl WayCorrection {
    /// At the end.
    pub fn end(&self) -> na::Vector6<f64> {
        self.start + self.bend
    }
}

impl Way {
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
        Self { spacing, poses, turn_is_measured: false, going: Going::AsBefore }
    }

    /// Standing at a pose for no time.
    pub fn standing(pose: Rigid3) -> Self {
        Self { spacing: 0.0, poses: vec![pose; 2], turn_is_measured: true, going: Going::Measured }
    }

    /// The same way with poses changed, each by its seconds from the start.
    #[must_use]
    pub fn changed(mut self, mut change: impl FnMut(f64, &mut Rigid3)) -> Self {
        let spacing = self.spacing;
        self.poses.iter_mut().enumerate().for_each(|(i, pose)| change(spacing * i as f64, pose));
        self
    }

    /// The same way seen from another frame.
    #[must_use]
    pub fn seen_from(&self, other_from_map: &Rigid3) -> Self {
        self.clone().changed(|_, pose| *pose = other_from_map * *pose)
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

    /// How far it goes from the first pose to the last, metres in the frame of the map.
    pub fn shift(&self) -> Vector3 {
        self.end().translation.vector - self.start().translation.vector
    }

    /// Seconds from the first pose to the last.
    pub fn seconds(&self) -> f64 {
        self.spacing * (self.poses.len() - 1) as f64
    }

    /// The last pose, corrected.
    pub fn corrected_end(&self, correction: &WayCorrection) -> Rigid3 {
        corrected(&self.end(), &correction.end())
    }

    /// What takes this way to another end without moving its start.
    pub fn correction_to(&self, end: &Rigid3) -> WayCorrection {
        let predicted = self.end();
        let shift = end.translation.vector - predicted.translation.vector;
        let turn = angle_axis_from_quaternion(&(end.rotation * predicted.rotation.inverse()));
        let bend = na::Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
        WayCorrection { bend, ..WayCorrection::default() }
    }

    /// The share of the bend after a share s of the time, of shifts and of turns.
    ///
    /// What was measured on the way is wrong by a share that grows with time. Where only the velocity of
    /// the sweep before was known, which belongs to the middle of that sweep, a constant acceleration
    /// bends the way by (s + s²)/2 of the error at the end.
    pub(super) fn bows(&self, s: f64) -> [f64; 2] {
        let bow = |is_measured: bool| if is_measured { s } else { 0.5 * (s + s * s) };
        [bow(self.going != Going::AsBefore), bow(self.turn_is_measured)]
    }

    /// The share of the time that has passed so many seconds (not positive) before the end.
    pub(super) fn share_at(&self, offset: f32) -> f64 {
        (1.0 + f64::from(offset) / self.seconds().max(1e-9)).clamp(0.0, 1.0)
    }

    fn bent_poses(&self, correction: &WayCorrection) -> impl Iterator<Item = Rigid3> + '_ {
        let last = (self.poses.len() - 1).max(1) as f64;
        let WayCorrection { start, bend } = *correction;
        self.poses.iter().enumerate().map(move |(i, pose)| {
            let [shift, turn] = self.bows(i as f64 / last);
            let share = na::Vector6::new(shift, shift, shift, turn, turn, turn);
            corrected(pose, &(start + bend.component_mul(&share)))
        })
    }

    /// The corrected way, from the scanner at any time to the map.
    pub fn bent(&self, correction: &WayCorrection) -> StraightPieces {
        StraightPieces::new(self.spacing, self.bent_poses(correction))
    }

    /// The corrected way, from the scanner at any time to the scanner at the end.
    pub fn bent_to_end(&self, correction: &WayCorrection) -> StraightPieces {
        let end_from_map = self.corrected_end(correction).inverse();
        StraightPieces::new(self.spacing, self.bent_poses(correction).map(|pose| end_from_map * pose))
    }
}

fn corrected(pose: &Rigid3, correction: &na::Vector6<f64>) -> Rigid3 {
    let shift: Vector3 = correction.fixed_rows::<3>(0).into();
    let turn = quaternion_from_angle_axis(&correction.fixed_rows::<3>(3).into_owned());
    let rotation = Quaternion::new_normalize((turn * pose.rotation).into_inner());
    Rigid3::from_parts((pose.translation.vector + shift).into(), rotation)
}

/// A rotation and a translation: the images of the axes, and of the origin. With a fourth number, a column is one vector
/// instruction.
type Columns = [[f32; 4]; 4];

/// From the scanner on its way to another frame.
#[derive(Clone, Debug)]
pub struct StraightPieces {
    per_second: f32,
    pieces: Vec<Columns>,
}

impl StraightPieces {
    fn new(spacing: f64, poses: impl Iterator<Item = Rigid3>) -> Self {
        let columns = |pose: Rigid3| pose.to_homogeneous().cast::<f32>().data.0;
        Self { per_second: (1.0 / spacing.max(1e-9)) as f32, pieces: poses.map(columns).collect() }
    }

    /// The direction and distance of a point measured `offset` seconds (not positive) before the end, and where the
    /// scanner was, both in the other frame. Points from before the beginning are taken as measured there.
    #[inline]
    pub(super) fn seen(&self, position: &Point3f, offset: f32) -> (na::Vector3<f32>, na::Vector3<f32>) {
        let last = self.pieces.len() - 1;
        let place = (last as f32 + offset * self.per_second).clamp(0.0, last as f32);
        let whole = (place as usize).min(last.saturating_sub(1));
        let share = place - whole as f32;
        let (a, b) = (&self.pieces[whole], &self.pieces[(whole + 1).min(last)]);
        // Loops, because `map` on arrays is not always compiled into the loop that needs it.
        let mut columns = Columns::default();
        for axis in 0..4 {
            for i in 0..4 {
                columns[axis][i] = a[axis][i] + (b[axis][i] - a[axis][i]) * share;
            }
        }
        let [x, y, z, from] = columns;
        let mut turned = [0.0; 4];
        for i in 0..4 {
            turned[i] = x[i] * position.x + y[i] * position.y + z[i] * position.z;
        }
        (na::Vector3::new(turned[0], turned[1], turned[2]), na::Vector3::new(from[0], from[1], from[2]))
    }

    /// A point measured `offset` seconds (not positive) before the end, in the other frame.
    #[inline]
    pub fn moved(&self, position: &Point3f, offset: f32) -> Point3f {
        let (turned, from) = self.seen(position, offset);
        Point3f::from(turned + from)
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
        let mut way = Way::new(start, end, |t| {
            let t = t.seconds_since(start);
            Rigid3::from_parts((velocity * t).into(), truth(t).rotation)
        });
        way.turn_is_measured = true;
        let correction = way.correction_to(&truth(0.1));
        let (to_end, to_map) = (way.bent_to_end(&correction), way.bent(&correction));
        let fixed = na::Point3::new(5.0, 3.0, 1.0);
        for i in 0..=20 {
            let t = 0.005 * f64::from(i);
            let seen = (truth(t).inverse() * fixed).cast::<f32>();
            let expected = (truth(0.1).inverse() * fixed).cast::<f32>();
            let offset = (t - 0.1) as f32;
            assert!((to_end.moved(&seen, offset) - expected).norm() < 1e-4, "{t}");
            assert!((to_map.moved(&seen, offset) - fixed.cast::<f32>()).norm() < 1e-4, "{t}");
        }
        assert!((way.seconds() - 0.1).abs() < 1e-9);
    }

    #[test]
    fn a_way_of_no_length_moves_nothing() {
        let time = Time::from_ticks(5);
        let way = Way::new(time, time, |_| truth(0.3));
        let point = Point3f::new(1.0, 2.0, 3.0);
        let moved = way.bent_to_end(&WayCorrection::default()).moved(&point, -1.0);
        assert!((moved - point).norm() < 1e-5);
    }
}
