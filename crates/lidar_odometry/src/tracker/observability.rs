//! Determines which directions of motion a sweep constrains, and what replaces the others.

use portolan_geometry::{Duration, Time, Vector3};
use portolan_motion::{DegenerateDirections, DegenerateScan, Observability, Substitute};

use super::Tracker;
use crate::issues::{Issue, Issues};
use crate::predict::Registered;
use crate::segment::{MotionSource, TrajectorySegment};

impl Tracker {
    /// Directions of motion that a sweep constrains, in the tracking frame. Adds the degenerate ones to
    /// intervals.
    pub(super) fn observability(
        &mut self,
        end: Time,
        best: &Registered,
        was_standing: bool,
        issues: &mut Issues,
    ) -> Observability {
        let Registered { segment, registered, .. } = best;
        let tracking_from_local = registered.local_from_tracking.rotation.inverse();
        let (up, seconds) = (tracking_from_local * Vector3::z(), segment.seconds());
        let start = end - Duration::from_seconds(seconds);
        self.travel_correlation.set_degenerate(start, registered.open_translations());
        // Where the motion is unmeasured, its direction is unknown, too.
        let translation_is_measured = segment.source.is_measured();
        let found = registered.found.as_ref();
        if translation_is_measured || found.is_some_and(|f| f.degenerate.translations.is_empty()) {
            let translation =
                registered.local_from_tracking.translation.vector - segment.start().translation.vector;
            self.intervals.moved(&(tracking_from_local * translation), seconds, &up);
        }
        let is_assumed = segment.source == MotionSource::ConstantVelocity && !was_standing;
        if is_assumed && self.travel_correlation.is_guess(end) {
            issues.count(Issue::TravelGuessed);
        }
        let Some(found) = found else {
            issues.count(Issue::NoPlaneFits);
            return Observability::default();
        };
        let tracking_from_map = found.pose.rotation.inverse();
        let seen = |directions: &[Vector3]| directions.iter().map(|d| tracking_from_map * d).collect();
        let degenerate = DegenerateDirections {
            translations: seen(&found.degenerate.translations),
            rotations: seen(&found.degenerate.rotations),
        };
        let (by_translation, by_rotation) = self.substitutes(end, segment, was_standing);
        let scan = |taken| DegenerateScan { time: end, seconds, taken, sigma: None };
        self.intervals.add_translations(&scan(by_translation), &degenerate.translations, &up);
        self.intervals.add_rotations(&scan(by_rotation), &degenerate.rotations, &up);
        let rotation_is_measured = segment.rotation_is_measured();
        Observability { degenerate, translation_is_measured, rotation_is_measured }
    }

    /// Source of translation and rotation along degenerate directions.
    fn substitutes(
        &self,
        end: Time,
        segment: &TrajectorySegment,
        was_standing: bool,
    ) -> (Substitute, Substitute) {
        let translation = match segment.source {
            _ if was_standing => Substitute::Rest,
            MotionSource::Standing | MotionSource::Odometry { .. } => Substitute::Odometry,
            MotionSource::Inertial { .. } => Substitute::Accelerometer,
            MotionSource::ConstantVelocity if self.travel_correlation.measured_recently(end) => {
                Substitute::Correlation
            }
            MotionSource::ConstantVelocity => Substitute::Velocity,
        };
        // Where a gyroscope is overruled, the rotation is constant, and not that of odometry.
        let is_overruled = self.motion.has_gyroscope(end);
        let rotation = match (segment.rotation_is_measured(), translation) {
            (true, _) => Substitute::Gyroscope,
            (false, Substitute::Odometry) if is_overruled => Substitute::Velocity,
            (false, Substitute::Accelerometer | Substitute::Correlation) => Substitute::Velocity,
            (false, other) => other,
        };
        (translation, rotation)
    }
}
