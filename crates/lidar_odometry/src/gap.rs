//! Handles gaps: no sweeps came for a while, and no sensor measured the motion meanwhile.
//!
//! The longer a gap is, the less certain is constant velocity. As at the start of a trajectory, the first
//! two sweeps after it determine the velocity then, with several hypotheses where that is ambiguous.
//! Between the velocity before the gap and that after it a constant acceleration is assumed. Sweeps after
//! the gap are tracked with each hypothesis, and the one under which they fit the map best is accepted.

use portolan_geometry::{
    Duration, Quaternion, Rigid3, Time, Vector3, angle_axis_from_quaternion, quaternion_from_angle_axis,
};

use crate::hypotheses::{self, Other};
use crate::initialise::{FirstSweeps, RotationAt, Start};
use crate::issues::Issues;
use crate::segment::{MotionSource, TrajectorySegment};
use crate::settings::OdometrySettings;
use crate::settings::constants::initialise::VELOCITY_INTERVAL;
use crate::sweep::Sweep;
use crate::tracker::{RegisteredSweep, Tracker};

/// Velocities in the tracking frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Velocities {
    /// m/s.
    pub linear: Vector3,
    /// rad/s.
    pub angular: Vector3,
}

/// Hypothesis of the motion in a gap: constant acceleration.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GapMotion {
    before: Velocities,
    pub after: Velocities,
}

/// Treatment of the next sweep.
pub(crate) enum NextSweep {
    /// It waits for the sweeps after it.
    Waits,
    /// It is registered from its prediction.
    AsPredicted,
    /// It is registered from the pose that this motion leads to.
    After(GapMotion),
}

/// Decides how the first of these sweeps is treated. `is_ended`: no more will come.
pub(crate) fn next_sweep(
    tracker: &Tracker,
    settings: &OdometrySettings,
    sweeps: &[Sweep],
    is_ended: bool,
) -> NextSweep {
    let Some(first) = sweeps.first() else { return NextSweep::Waits };
    if !tracker.is_after_gap(first.end) {
        return NextSweep::AsPredicted;
    }
    let prediction = tracker.motion().clone().predict(first.end);
    if prediction.segment.source != MotionSource::ConstantVelocity {
        return NextSweep::AsPredicted;
    }
    let judges = settings.loss.sweeps;
    if sweeps.len() < judges && !is_ended {
        return NextSweep::Waits;
    }
    let before = Velocities::at_start_of(&prediction.segment);
    let after = Velocities::after(tracker, settings, sweeps).into_iter();
    let motions = after.chain([before]).map(|after| GapMotion { before, after }).collect();
    best(tracker, settings, &sweeps[..sweeps.len().min(judges)], motions)
}

/// The motion under which the sweeps fit best; constant velocity is the first hypothesis.
fn best(
    tracker: &Tracker,
    settings: &OdometrySettings,
    sweeps: &[Sweep],
    motions: Vec<GapMotion>,
) -> NextSweep {
    let fit_better = |least, motion| {
        tracker.fork().fit_better(least, motion, sweeps, &mut Issues::default(), drop::<RegisteredSweep>)
    };
    let as_predicted = fit_better(f64::NEG_INFINITY, None).unwrap_or(0.0);
    let clearly_better = settings.hypotheses.better_over_sweeps;
    let others = motions.into_iter().map(|motion| Other { motion, clearly_better });
    let follow = |motion, least| Some((NextSweep::After(motion), fit_better(least, Some(motion))?));
    hypotheses::best((NextSweep::AsPredicted, as_predicted), others, |followed| followed.1, follow).0
}

impl Velocities {
    /// Velocities at the start of a segment.
    pub fn at_start_of(segment: &TrajectorySegment) -> Self {
        let (motion, seconds) = segment.first_motion();
        let seconds = seconds.max(1e-9);
        Self {
            linear: motion.translation.vector / seconds,
            angular: angle_axis_from_quaternion(&motion.rotation) / seconds,
        }
    }

    /// Velocities by the first two sweeps after a gap, the most likely first.
    fn after(tracker: &Tracker, settings: &OdometrySettings, sweeps: &[Sweep]) -> Vec<Self> {
        let Some(first) = sweeps.first() else { return Vec::new() };
        let measured = tracker.motion().measured_rotation();
        let rotation_at = measured.as_ref().map(|measured| measured as &RotationAt);
        let starts = FirstSweeps::hypotheses(first, sweeps.get(1), rotation_at, settings);
        starts.iter().map(|start| Self::of_start(start, first.end, rotation_at)).collect()
    }

    fn of_start(start: &Start, end: Time, rotation_at: Option<&RotationAt>) -> Self {
        let angular = rotation_at.map(|rotation_at| {
            let turned =
                rotation_at(end).inverse() * rotation_at(end + Duration::from_seconds(VELOCITY_INTERVAL));
            angle_axis_from_quaternion(&turned) / VELOCITY_INTERVAL
        });
        Self { linear: start.velocity_in_tracking(), angular: angular.unwrap_or(start.turn_rate()) }
    }

    fn between(before: &Self, after: &Self, fraction: f64) -> Self {
        Self {
            linear: before.linear.lerp(&after.linear, fraction),
            angular: before.angular.lerp(&after.angular, fraction),
        }
    }

    /// The pose at this time before another one, seconds.
    pub fn earlier(&self, local_from_tracking: &Rigid3, seconds: f64) -> Rigid3 {
        let back = quaternion_from_angle_axis(&(self.angular * -seconds));
        local_from_tracking * Rigid3::from_parts((self.linear * -seconds).into(), back)
    }
}

impl GapMotion {
    /// A predicted segment with this motion; its rotation, too, unless a gyroscope measured it. Only the
    /// heading changes, since a platform that rolls and pitches comes back.
    pub fn applied_to(&self, predicted: &TrajectorySegment) -> TrajectorySegment {
        let (start, whole) = (predicted.start(), predicted.seconds().max(1e-9));
        let (mut place, mut rotation): (Vector3, Quaternion) = (start.translation.vector, start.rotation);
        let mut before = 0.0;
        let is_measured = predicted.rotation_is_measured();
        predicted.clone().changed(|seconds, pose| {
            let step = seconds - before;
            let now = Velocities::between(&self.before, &self.after, 0.5 * (before + seconds) / whole);
            let next = match is_measured {
                true => pose.rotation,
                false => {
                    let rate = (rotation * now.angular).z;
                    quaternion_from_angle_axis(&(Vector3::z() * (rate * step))) * rotation
                }
            };
            place += rotation.slerp(&next, 0.5) * now.linear * step;
            (rotation, before) = (next, seconds);
            *pose = Rigid3::from_parts(place.into(), rotation);
        })
    }
}
