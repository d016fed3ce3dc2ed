//! The trajectory segment of a sweep: its predicted poses, and the correction that registration estimates.

use nalgebra as na;
use portolan_geometry::{
    Duration, Quaternion, Rigid3, Time, Vector3, angle_axis_from_quaternion, quaternion_from_angle_axis,
};

use crate::deskew::PiecewiseLinearTrajectory;
use crate::settings::constants::segment::{MAX_POSES, POSE_SPACING};

/// Predicted poses of the tracking frame in that of a map, evenly spaced in time from the end of the
/// previous sweep to the end of a sweep.
#[derive(Clone, Debug)]
pub struct TrajectorySegment {
    /// Seconds between the poses.
    spacing: f64,
    poses: Vec<Rigid3>,
    /// Standard deviation of the rotation at the end about each axis, radians, if a gyroscope measured it.
    /// None where it was unmeasured: it then continues that of the previous sweep.
    pub gyroscope_sigma: Option<f64>,
    /// Source of the translation.
    pub source: MotionSource,
}

/// Source of the translation of a trajectory segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionSource {
    /// A zero-velocity update.
    Standing,
    /// Odometry.
    Odometry {
        /// Standard deviation at the end along each axis, metres.
        translation_sigma: f64,
    },
    /// The accelerometer, integrated from a velocity of the inertial filter.
    Inertial {
        /// Standard deviation of that velocity, m/s.
        velocity_sigma: f64,
    },
    /// Constant velocity: the translation was unmeasured.
    ConstantVelocity,
}

impl MotionSource {
    /// Whether odometry or a zero-velocity update measured the translation, rather than inference from
    /// velocities.
    pub fn is_measured(self) -> bool {
        matches!(self, Self::Standing | Self::Odometry { .. })
    }
}

/// Error of a predicted segment. The first three entries are a translation in metres, the last three a
/// rotation vector about the scanner in radians, both in the frame of the map.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SegmentCorrection {
    /// At the start, and so everywhere on the segment.
    pub start: na::Vector6<f64>,
    /// Growth from the start to the end.
    pub growth: na::Vector6<f64>,
}

impl SegmentCorrection {
    /// At the end.
    pub fn end(&self) -> na::Vector6<f64> {
        self.start + self.growth
    }
}

impl TrajectorySegment {
    /// The segment that `pose_at` predicts from `start` to `end`, with constant velocity as its source
    /// unless the fields are set.
    pub fn new(start: Time, end: Time, mut pose_at: impl FnMut(Time) -> Rigid3) -> Self {
        let seconds = end.seconds_since(start).max(0.0);
        let pieces = ((seconds / POSE_SPACING).ceil() as usize).clamp(1, MAX_POSES);
        let spacing = seconds / pieces as f64;
        let time = |i: usize| match i == pieces {
            true => end,
            false => start + Duration::from_seconds(i as f64 * spacing),
        };
        let poses = (0..=pieces).map(|i| pose_at(time(i))).collect();
        Self { spacing, poses, gyroscope_sigma: None, source: MotionSource::ConstantVelocity }
    }

    /// A segment of one pose, for a scan without duration.
    pub fn instantaneous(pose: Rigid3) -> Self {
        Self {
            spacing: 0.0,
            poses: vec![pose; 2],
            gyroscope_sigma: Some(0.0),
            source: MotionSource::Standing,
        }
    }

    /// Whether a gyroscope measured the rotation.
    pub fn rotation_is_measured(&self) -> bool {
        self.gyroscope_sigma.is_some()
    }

    /// The segment with its poses changed by `change`, which receives the time of each from the start,
    /// seconds.
    #[must_use]
    pub fn changed(mut self, mut change: impl FnMut(f64, &mut Rigid3)) -> Self {
        let spacing = self.spacing;
        self.poses.iter_mut().enumerate().for_each(|(i, pose)| change(spacing * i as f64, pose));
        self
    }

    /// The segment in the coordinates of another frame.
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

    /// The motion from the first pose to the next, in the tracking frame, and its duration, seconds.
    pub fn first_motion(&self) -> (Rigid3, f64) {
        let next = self.poses.get(1).copied().unwrap_or_else(|| self.start());
        (self.start().inverse() * next, self.spacing)
    }

    /// The rotation from the tracking frame at the end to that at the start.
    pub fn rotation(&self) -> Quaternion {
        self.start().rotation.inverse() * self.end().rotation
    }

    /// The translation from the first pose to the last, metres in the frame of the map.
    pub fn translation(&self) -> Vector3 {
        self.end().translation.vector - self.start().translation.vector
    }

    /// Time from the first pose to the last, seconds.
    pub fn seconds(&self) -> f64 {
        self.spacing * (self.poses.len() - 1) as f64
    }

    /// The last pose, corrected.
    pub fn corrected_end(&self, correction: &SegmentCorrection) -> Rigid3 {
        corrected(&self.end(), &correction.end())
    }

    /// The correction that leads to another end without moving the start.
    pub fn correction_to(&self, end: &Rigid3) -> SegmentCorrection {
        let predicted = self.end();
        let shift = end.translation.vector - predicted.translation.vector;
        let turn = angle_axis_from_quaternion(&(end.rotation * predicted.rotation.inverse()));
        let growth = na::Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
        SegmentCorrection { growth, ..SegmentCorrection::default() }
    }

    /// The segment from the same start to another end.
    #[must_use]
    pub(crate) fn ending_at(&self, end: &Rigid3) -> Self {
        let poses = self.corrected_poses(&self.correction_to(end)).collect();
        Self { poses, ..self.clone() }
    }

    /// The fractions of the growth that apply after a fraction s of the time, to translation and to
    /// rotation.
    ///
    /// Measured motion drifts with time: s. Where constant velocity was assumed, the velocity of the
    /// previous sweep belongs to the middle of that sweep, and a constant acceleration adds (s + s²)/2 of
    /// its final effect.
    pub(crate) fn growth_fractions(&self, s: f64) -> [f64; 2] {
        let fraction = |is_measured: bool| if is_measured { s } else { 0.5 * (s + s * s) };
        [fraction(self.source != MotionSource::ConstantVelocity), fraction(self.rotation_is_measured())]
    }

    /// The fraction of the duration that has passed at `time`, seconds from the end (not positive).
    pub(crate) fn fraction_at(&self, time: f32) -> f64 {
        (1.0 + f64::from(time) / self.seconds().max(1e-9)).clamp(0.0, 1.0)
    }

    fn corrected_poses(&self, correction: &SegmentCorrection) -> impl Iterator<Item = Rigid3> + '_ {
        let last = (self.poses.len() - 1).max(1) as f64;
        let SegmentCorrection { start, growth } = *correction;
        self.poses.iter().enumerate().map(move |(i, pose)| {
            let [shift, turn] = self.growth_fractions(i as f64 / last);
            let fraction = na::Vector6::new(shift, shift, shift, turn, turn, turn);
            corrected(pose, &(start + growth.component_mul(&fraction)))
        })
    }

    /// The corrected segment as a trajectory: from the scanner at any time to the map.
    pub fn corrected(&self, correction: &SegmentCorrection) -> PiecewiseLinearTrajectory {
        PiecewiseLinearTrajectory::new(self.spacing, self.corrected_poses(correction))
    }

    /// The corrected segment as motion compensation: from the scanner at any time to the scanner at the end.
    pub fn deskewing(&self, correction: &SegmentCorrection) -> PiecewiseLinearTrajectory {
        let end_from_map = self.corrected_end(correction).inverse();
        let poses = self.corrected_poses(correction).map(|pose| end_from_map * pose);
        PiecewiseLinearTrajectory::new(self.spacing, poses)
    }
}

/// A pose moved by a translation and turned by a rotation vector about itself, both in the frame of the map.
fn corrected(pose: &Rigid3, correction: &na::Vector6<f64>) -> Rigid3 {
    let shift: Vector3 = correction.fixed_rows::<3>(0).into();
    let turn = quaternion_from_angle_axis(&correction.fixed_rows::<3>(3).into_owned());
    let rotation = Quaternion::new_normalize((turn * pose.rotation).into_inner());
    Rigid3::from_parts((pose.translation.vector + shift).into(), rotation)
}
