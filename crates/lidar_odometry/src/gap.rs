//! Handles gaps: no sweeps came for a while, and no sensor measured the motion meanwhile.
//!
//! The longer a gap is, the less certain is constant velocity. As at the start of a trajectory, the first
//! two sweeps after it determine the velocity then, with several hypotheses where that is ambiguous.
//! Between the velocity before the gap and that after it a constant acceleration is assumed. A platform that
//! brakes and accelerates again ends up elsewhere, so that other places are proposed by correlation with the
//! last sweep that fitted. Sweeps after the gap are tracked with each hypothesis, and the one under which
//! they fit the map best is accepted.

use std::rc::Rc;

use portolan_geometry::{
    Duration, Quaternion, Rigid3, Time, Vector3, angle_axis_from_quaternion, quaternion_from_angle_axis,
};

use crate::correlation::{Peak, Window};
use crate::hypotheses::{self, Other};
use crate::initialise::{FirstSweeps, RotationAt, Start};
use crate::issues::Issues;
use crate::segment::{MotionSource, TrajectorySegment};
use crate::settings::constants::initialise::VELOCITY_INTERVAL;
use crate::settings::{CorrelationSettings, OdometrySettings};
use crate::sweep::Sweep;
use crate::tracker::{RegisteredSweep, Tracker};
use crate::wide_search::{Headings, correlated, headings};

/// Velocities in the tracking frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Velocities {
    /// m/s.
    pub linear: Vector3,
    /// rad/s.
    pub angular: Vector3,
}

/// Hypothesis of the motion in a gap: constant acceleration, which ends at another pose if accelerations
/// changed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GapMotion {
    before: Velocities,
    pub after: Velocities,
    /// Pose at the end relative to that by constant acceleration: position along the axes of the local
    /// map, metres, and heading, radians.
    elsewhere: (Vector3, f64),
}

/// Treatment of the next sweep.
pub(crate) enum NextSweep {
    /// It waits for the sweeps after it.
    Waits,
    /// It is registered from its prediction.
    AsPredicted,
    /// It comes after a gap, and is registered from the pose that this motion leads to, or from its
    /// prediction. Uncertain: the sweeps after the gap fit nearly as well elsewhere, see mostly new
    /// surroundings, or fit after a turn that nothing measured.
    AfterGap { motion: Option<GapMotion>, is_uncertain: bool },
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
    let after = Velocities::after(tracker, settings, sweeps).into_iter().chain([before]);
    let mut motions: Vec<GapMotion> =
        after.map(|after| GapMotion { before, after, elsewhere: (Vector3::zeros(), 0.0) }).collect();
    if let Some(likeliest) = motions.first().copied() {
        motions.extend(likeliest.elsewhere(tracker, settings, first, &prediction.segment));
    }
    best(tracker, settings, &sweeps[..sweeps.len().min(judges)], motions)
}

/// A hypothesis of the motion, followed over the sweeps after a gap.
struct Followed {
    /// None: as predicted.
    motion: Option<GapMotion>,
    /// Total fit.
    fit: f64,
    /// Fit of the first sweep, to the map before the gap.
    fit_of_first: f64,
    /// Pose at the end of the last sweep.
    last: Rigid3,
}

impl Followed {
    /// Follows a hypothesis; none if its total fit is not above `least`.
    fn new(tracker: &Tracker, sweeps: &[Sweep], motion: Option<GapMotion>, least: f64) -> Option<Self> {
        let (mut fit_of_first, mut last) = (None, Rigid3::identity());
        let each = |registered: RegisteredSweep| {
            fit_of_first.get_or_insert(registered.fit);
            last = registered.local_from_tracking;
        };
        let fit = tracker.fork().fit_better(least, motion, sweeps, &mut Issues::default(), each)?;
        Some(Self { motion, fit, fit_of_first: fit_of_first.unwrap_or(0.0), last })
    }

    /// Whether both lead to different places, and not to two starts of registration to the same.
    fn is_elsewhere(&self, other: &Self, settings: &CorrelationSettings) -> bool {
        let between = self.last.inverse() * other.last;
        between.translation.vector.norm() > f64::from(settings.cell)
            || between.rotation.angle() > settings.widest
    }
}

/// The motion under which the sweeps fit best; constant velocity is the first hypothesis.
fn best(
    tracker: &Tracker,
    settings: &OdometrySettings,
    sweeps: &[Sweep],
    motions: Vec<GapMotion>,
) -> NextSweep {
    let clearly_better = settings.hypotheses.better_over_sweeps;
    let Some(predicted) = Followed::new(tracker, sweeps, None, f64::NEG_INFINITY) else {
        return NextSweep::AsPredicted;
    };
    // Those that are nearly as good as the best one are rivals, which make it uncertain.
    let predicted = Rc::new(predicted);
    let mut rivals = vec![Rc::clone(&predicted)];
    let others = motions.into_iter().map(|motion| Other { motion, clearly_better });
    let best = hypotheses::best(
        predicted,
        others,
        |followed| followed.fit,
        |motion, least| {
            let followed =
                Rc::new(Followed::new(tracker, sweeps, Some(motion), least / clearly_better.powi(2))?);
            rivals.push(Rc::clone(&followed));
            Some(followed)
        },
    );
    let is_rival = |other: &Rc<Followed>| {
        other.fit * clearly_better > best.fit && other.is_elsewhere(&best, &settings.correlation)
    };
    // A large turn, which only the fit of possibly similar surroundings supports.
    let is_turned = best.motion.is_some_and(|m| m.elsewhere.1.abs() > 1.5 * settings.correlation.widest);
    let is_uncertain = is_turned || rivals.iter().any(is_rival) || tracker.is_mostly_new(best.fit_of_first);
    NextSweep::AfterGap { motion: best.motion, is_uncertain }
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
    /// The same velocities at both ends of the gap, with other accelerations between them: as correlation
    /// with the last sweep proposes.
    fn elsewhere(
        self,
        tracker: &Tracker,
        settings: &OdometrySettings,
        first: &Sweep,
        predicted: &TrajectorySegment,
    ) -> Vec<Self> {
        let OdometrySettings { correlation, motion_prior, .. } = settings;
        let segment = self.applied_to(predicted);
        // Accelerating and braking for half of the gap each.
        let farthest = motion_prior.acceleration * (0.5 * segment.seconds()).powi(2);
        let linear = farthest.min(correlation.farthest);
        // Registration finds nearer places; in so short a gap the heading hardly changes.
        if linear < 2.0 * f64::from(correlation.cell) {
            return Vec::new();
        }
        let angular = if segment.rotation_is_measured() { 0.0 } else { correlation.widest };
        let window = Window { linear, angular };
        let headings = headings(&segment, Headings::AllAround, settings);
        let peaks = correlated(tracker.last_fitting(), first, &segment, window, headings, correlation);
        let at = |peak: Peak| {
            let heading = angle_axis_from_quaternion(&peak.pose.rotation).z;
            Self { elsewhere: (peak.pose.translation.vector, heading), ..self }
        };
        peaks.into_iter().map(at).collect()
    }

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
            // Smoothstep: the velocities at both ends stay unchanged.
            let fraction = (seconds / whole).min(1.0);
            let share = fraction * fraction * (3.0 - 2.0 * fraction);
            let (shift, heading) = (self.elsewhere.0 * share, self.elsewhere.1 * share);
            let turn = quaternion_from_angle_axis(&(Vector3::z() * heading));
            *pose = Rigid3::from_parts((place + shift).into(), turn * rotation);
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A gap of two seconds along x, from 5 m/s to 9 m/s.
    fn through_gap(elsewhere: (Vector3, f64)) -> TrajectorySegment {
        let at = |seconds: f64| Time::from_ticks(0) + Duration::from_seconds(seconds);
        let velocity = |x: f64| Velocities { linear: Vector3::x() * x, angular: Vector3::zeros() };
        let predicted = TrajectorySegment::new(at(0.0), at(2.0), |t| {
            Rigid3::translation(5.0 * t.seconds_since(at(0.0)), 0.0, 0.0)
        });
        GapMotion { before: velocity(5.0), after: velocity(9.0), elsewhere }.applied_to(&predicted)
    }

    #[test]
    fn velocity_changes_evenly_between_both_ends_of_a_gap() {
        let end = through_gap((Vector3::zeros(), 0.0)).end();
        assert!((end.translation.vector - Vector3::new(14.0, 0.0, 0.0)).norm() < 0.01, "{end}");
    }

    #[test]
    fn a_gap_may_end_elsewhere_with_the_velocities_that_are_known() {
        let segment = through_gap((Vector3::new(-3.0, 1.0, 0.0), 0.2));
        let end = segment.end();
        assert!((end.translation.vector - Vector3::new(11.0, 1.0, 0.0)).norm() < 0.01, "{end}");
        assert!((end.rotation.angle() - 0.2).abs() < 1e-9, "{end}");
        let (first, seconds) = segment.first_motion();
        let velocity = first.translation.vector / seconds;
        assert!((velocity - Vector3::new(5.0, 0.0, 0.0)).norm() < 0.5, "{velocity}");
    }
}
