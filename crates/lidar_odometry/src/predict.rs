//! Hypotheses of the motion during a sweep: the most likely one, and alternatives where it may be wrong.

use portolan_geometry::{Rigid3, Time, quaternion_from_angle_axis};
use portolan_motion::PoseExtrapolator;

use crate::gap::Velocities;
use crate::hypotheses::{self, Other};
use crate::inertial::InertialPrediction;
use crate::odometry_prior::OdometryPrediction;
use crate::segment::{MotionSource, TrajectorySegment};
use crate::sweep_registration::RegisteredSegment;
use crate::travel_correlation::Discrepancy;

/// Prediction of the motion during a sweep.
pub(crate) struct Prediction {
    /// By odometry, gyroscope and constant velocity.
    pub extrapolated: TrajectorySegment,
    /// With the translation by the accelerometer.
    pub inertial: Option<InertialPrediction>,
    /// Pose of the platform so far, if it stands still.
    pub standing: Option<Rigid3>,
    /// The first hypothesis.
    pub segment: TrajectorySegment,
    /// Alternatives, in the order in which they are tried.
    pub alternatives: Vec<Alternative>,
    /// Whether the gyroscope was saturated.
    pub is_saturated: bool,
    /// Motion by odometry, and without it, if there is odometry.
    pub odometry: Option<OdometryPrediction>,
}

/// Another hypothesis of the motion.
pub(crate) struct Alternative {
    pub reason: Reason,
    pub segment: TrajectorySegment,
    /// Ratio by which its fit has to exceed that of the first.
    pub clearly_better: f64,
}

/// Why the first hypothesis may be wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reason {
    /// A single wrong sample of an accelerometer moves a prediction by metres.
    AccelerometerFails,
    /// In a long gap the platform may have stopped, or a clock jumped.
    LongGap,
    /// A gyroscope may be saturated, or its clock or axes wrong.
    GyroscopeFails,
    /// Odometry may fail, or work again.
    OdometryFails,
    /// A sweep contradicts the map at its prediction, and fits elsewhere.
    OtherMotion,
}

impl Alternative {
    /// Whether it is tried after this registration of the first hypothesis.
    fn is_worth_trying(&self, prediction: &Prediction, first: &RegisteredSegment) -> bool {
        match self.reason {
            Reason::AccelerometerFails => first.found.is_none(),
            // It exists only where it differs from the first.
            Reason::LongGap | Reason::OdometryFails => true,
            // It is not an alternative of the prediction.
            Reason::OtherMotion => false,
            Reason::GyroscopeFails => prediction.is_saturated || first.contradicts_rotation,
        }
    }
}

/// A hypothesis and its registration.
pub(crate) struct Registered {
    pub segment: TrajectorySegment,
    pub registered: RegisteredSegment,
    /// None if it is the first hypothesis.
    pub reason: Option<Reason>,
}

impl Registered {
    /// Its fit to the map.
    pub fn fit(&self) -> f64 {
        self.registered.fit
    }
}

impl Prediction {
    /// Whether an IMU measures the translation: by a reliable accelerometer, or because it is at rest.
    pub fn is_measured_by_imu(&self) -> bool {
        self.standing.is_some() || matches!(self.segment.source, MotionSource::Inertial { .. })
    }

    /// Registers the first hypothesis, then those alternatives that are worth trying.
    pub fn best(&self, register: impl Fn(&TrajectorySegment) -> RegisteredSegment) -> Registered {
        let registered = |segment: &TrajectorySegment, reason| Registered {
            segment: segment.clone(),
            registered: register(segment),
            reason,
        };
        let first = registered(&self.segment, None);
        let worth_trying = |other: &&Alternative| other.is_worth_trying(self, &first.registered);
        let others: Vec<&Alternative> = self.alternatives.iter().filter(worth_trying).collect();
        let others =
            others.into_iter().map(|other| Other { motion: other, clearly_better: other.clearly_better });
        hypotheses::best(first, others, Registered::fit, |other, _| {
            Some(registered(&other.segment, Some(other.reason)))
        })
    }

    /// The prediction corrected by an independent measurement, with the resulting velocities.
    pub fn corrected(self, discrepancy: &Discrepancy) -> (Self, Option<Velocities>) {
        let segment = discrepancy.applied_to(&self.segment);
        let extrapolated = discrepancy.applied_to(&self.extrapolated);
        let velocities = Velocities::at_start_of(&segment);
        (Self { segment, extrapolated, inertial: None, alternatives: Vec::new(), ..self }, Some(velocities))
    }

    /// The segment of the first hypothesis, or of the alternative with this reason.
    pub fn segment_of(&self, reason: Option<Reason>) -> &TrajectorySegment {
        let alternative = self.alternatives.iter().find(|alternative| Some(alternative.reason) == reason);
        alternative.map_or(&self.segment, |alternative| &alternative.segment)
    }
}

fn start_of(extrapolator: &PoseExtrapolator, end: Time) -> Time {
    extrapolator.last_pose_time().unwrap_or(end).min(end)
}

/// Segment predicted by an extrapolator.
pub(crate) fn extrapolated(extrapolator: &mut PoseExtrapolator, end: Time) -> TrajectorySegment {
    TrajectorySegment::new(start_of(extrapolator, end), end, |t| extrapolator.extrapolate_pose(t))
}

/// Segment predicted by an extrapolator, but with the rotation rate of the last poses instead of that of a
/// gyroscope.
pub(crate) fn with_constant_rotation(extrapolator: &mut PoseExtrapolator, end: Time) -> TrajectorySegment {
    let last = extrapolator.last_pose();
    let turn_rate = extrapolator.angular_velocity_from_poses();
    extrapolated(extrapolator, end).changed(|seconds, predicted| {
        if let Some((_, pose)) = last {
            predicted.rotation = pose.rotation * quaternion_from_angle_axis(&(turn_rate * seconds));
        }
    })
}

/// Segment that stands still at `pose` since the last pose.
pub(crate) fn standing(extrapolator: &PoseExtrapolator, end: Time, pose: &Rigid3) -> TrajectorySegment {
    TrajectorySegment::new(start_of(extrapolator, end), end, |_| *pose)
}
