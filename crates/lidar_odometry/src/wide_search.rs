//! Wide search for a sweep that contradicts the map: the platform may have moved differently than
//! predicted, because it braked, was pushed, or because sweeps are far apart in time.
//!
//! As at the start of a trajectory the sweep is correlated with the one before it, without a prior of the
//! motion, and then registered to the map; where the rotation was unmeasured, from several headings.

use portolan_geometry::{Point3f, Rigid3, Vector3, quaternion_from_angle_axis, to_f32};

use crate::correlation::{CorrelationReference, Peak, Window, upright};
use crate::hypotheses::{self, Other};
use crate::pose_status::FitMonitor;
use crate::predict::{Prediction, Reason, Registered};
use crate::segment::{SegmentCorrection, TrajectorySegment};
use crate::settings::{CorrelationSettings, OdometrySettings};
use crate::sweep::Sweep;
use crate::sweep_registration::{SweepRegistration, Target};

/// Poses at the end of a sweep relative to the end of its predicted segment (position along the axes of the
/// local map, rotation about its vertical), by correlation with the points of a sweep before it (in the local
/// map): the likeliest first. `headings` are initial ones relative to the predicted heading, radians.
pub(crate) fn correlated(
    before: &[Point3f],
    sweep: &Sweep,
    segment: &TrajectorySegment,
    window: Window,
    headings: impl Iterator<Item = f64>,
    settings: &CorrelationSettings,
) -> Vec<Peak> {
    let end = segment.end();
    let to_end = segment.deskewing(&SegmentCorrection::default());
    // Both relative to the scanner, and level.
    let (level, here) =
        (to_f32(&Rigid3::from_parts(Default::default(), end.rotation)), end.translation.vector.cast());
    let before: Vec<Point3f> = before.iter().map(|p| p - here).collect();
    let now: Vec<Point3f> = sweep.points.iter().map(|p| level * to_end.moved(&p.position, p.time)).collect();
    let before = CorrelationReference::new(&upright(&before, settings), settings);
    let peaks = headings.flat_map(|heading| {
        let turn = quaternion_from_angle_axis(&(Vector3::z() * heading));
        before.peaks(&now, &Rigid3::from_parts(Default::default(), turn), window)
    });
    let mut peaks: Vec<Peak> = peaks.collect();
    peaks.sort_by(|a, b| b.share.total_cmp(&a.share));
    peaks.truncate(settings.max_peaks);
    peaks
}

/// Inputs of a wide search.
pub(crate) struct WideSearch<'a> {
    pub settings: &'a OdometrySettings,
    pub registration: &'a SweepRegistration,
    pub target: &'a Target<'a>,
    pub fits: &'a FitMonitor,
    /// The last sweep that fitted, in the local map.
    pub before: &'a [Point3f],
}

impl WideSearch<'_> {
    /// The hypothesis under which the sweep fits best, if its fit is not poor: the one that was
    /// registered, or another.
    pub fn best(&self, sweep: &Sweep, prediction: &Prediction, first: Registered) -> Registered {
        let segment = &prediction.segment;
        let end = segment.end();
        let window = self.window(segment);
        let headings = headings(segment, Headings::NearPredicted, self.settings);
        let sample = self.registration.sample(sweep);
        let settings = &self.settings.correlation;
        let peaks = correlated(self.before, sweep, segment, window, headings, settings);
        let register = |peak: Peak| {
            let place = end.translation.vector + peak.pose.translation.vector;
            let end = Rigid3::from_parts(place.into(), peak.pose.rotation * end.rotation);
            let segment = segment.ending_at(&end);
            let registered = self.registration.register_widely(&sample, &segment, self.target);
            Registered { segment, registered, reason: Some(Reason::OtherMotion) }
        };
        // Limit: a push right after the last sweep, harder than any unmeasured acceleration.
        let OdometrySettings { motion_prior, hypotheses, registration, .. } = self.settings;
        let push = registration.outlier_sigmas * motion_prior.acceleration;
        let farthest = push * segment.seconds().powi(2);
        let is_possible = |found: &Registered| {
            let from_predicted =
                found.registered.local_from_tracking.translation.vector - end.translation.vector;
            from_predicted.norm() <= farthest && !self.fits.is_poor(&found.registered.sweep_fit())
        };
        let clearly_better = hypotheses.clearly_better;
        let others = peaks.into_iter().map(|peak| Other { motion: peak, clearly_better });
        hypotheses::best(first, others, Registered::fit, |peak, _| Some(register(peak)).filter(is_possible))
    }

    fn window(&self, segment: &TrajectorySegment) -> Window {
        let settings = &self.settings.correlation;
        let is_measured = segment.rotation_is_measured();
        let linear = Window::after(segment.seconds(), is_measured, settings).linear;
        Window { linear, angular: if is_measured { 0.0 } else { settings.widest } }
    }
}

/// Headings that are tried where no gyroscope measured the rotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Headings {
    /// Around the predicted one: a gap between key frames.
    NearPredicted,
    /// The whole circle: after a long gap.
    AllAround,
}

/// Initial headings relative to the predicted one, radians, the smallest first; 0 alone if the rotation was
/// measured. Windows of headings around them do not overlap, unless they close the circle.
pub(crate) fn headings(
    segment: &TrajectorySegment,
    tried: Headings,
    settings: &OdometrySettings,
) -> impl Iterator<Item = f64> {
    let step = 2.0 * settings.correlation.widest;
    let each_side = if segment.rotation_is_measured() || step <= 0.0 {
        0
    } else {
        let circle = (std::f64::consts::PI / step - 0.5).ceil().max(0.0) as i32;
        match tried {
            Headings::NearPredicted => {
                i32::try_from(settings.hypotheses.headings_each_side).unwrap_or(circle).min(circle)
            }
            Headings::AllAround => circle,
        }
    };
    let sides = (1..=each_side).flat_map(|i| [i, -i]);
    std::iter::once(0).chain(sides).map(move |i| step * f64::from(i))
}

#[cfg(test)]
mod tests {
    use portolan_geometry::{Duration, Time};

    use super::*;

    #[test]
    fn windows_of_headings_cover_the_circle_once() {
        let start = Time::from_ticks(0);
        let segment =
            TrajectorySegment::new(start, start + Duration::from_seconds(2.0), |_| Rigid3::identity());
        let mut settings = OdometrySettings::default();
        let widest = settings.correlation.widest;
        let all: Vec<f64> = headings(&segment, Headings::AllAround, &settings).collect();
        let covered = 2.0 * widest * all.len() as f64;
        assert!((std::f64::consts::TAU..std::f64::consts::TAU + 4.0 * widest).contains(&covered), "{all:?}");
        assert_eq!(headings(&segment, Headings::NearPredicted, &settings).count(), 5);
        settings.correlation.widest = 0.0;
        assert_eq!(headings(&segment, Headings::AllAround, &settings).count(), 1);
    }
}
