//! Another look at a sweep that contradicts the map: the platform may have moved otherwise than predicted, because it
//! braked, was pushed, or because sweeps are far apart in time.
//!
//! As at the start of a trajectory the sweep is aligned coarsely to the one before it, with nothing known of the motion,
//! and then registered to the map; where nothing measured the rotation, from several headings.

use portolan_geometry::{Point3f, Rigid3, Vector3, quaternion_from_angle_axis, to_f32};

use crate::belief::FitMonitor;
use crate::coarse_alignment::CoarseReference;
use crate::initialise::Reference;
use crate::predict::{Prediction, Reason, Registered};
use crate::segment::SegmentCorrection;
use crate::settings::OdometrySettings;
use crate::sweep::Sweep;
use crate::sweep_registration::{SweepRegistration, Target};

/// Looks again.
pub(crate) struct WideSearch<'a> {
    pub settings: &'a OdometrySettings,
    pub registration: &'a SweepRegistration,
    pub target: &'a Target<'a>,
    pub fits: &'a FitMonitor,
    /// The last sweep that fitted, in the local map.
    pub before: &'a [Point3f],
}

impl WideSearch<'_> {
    /// The first hypothesis under which the sweep fits about as well as others do, and at least as well as `least_fit` says.
    pub fn find(&self, sweep: &Sweep, prediction: &Prediction, least_fit: f64) -> Option<Registered> {
        let segment = &prediction.segment;
        let end = segment.end();
        let to_end = segment.deskewing(&SegmentCorrection::default());
        // Level, so that the ground is recognised.
        let level = to_f32(&Rigid3::from_parts(Default::default(), end.rotation));
        let level_points: Vec<Point3f> =
            sweep.points.iter().map(|p| level * to_end.moved(&p.position, p.time)).collect();
        let (before, now) =
            (Reference::new(self.before, self.settings), Reference::new(&level_points, self.settings));
        let coarse = &self.settings.coarse_alignment;
        let before = CoarseReference::new(&before.upright, coarse);
        let sample = self.registration.sample(sweep);
        self.headings(segment.rotation_is_measured).find_map(|heading| {
            let turn = quaternion_from_angle_axis(&(Vector3::z() * heading));
            let initial = Rigid3::from_parts(end.translation, turn);
            let found = before.align(&now.upright, &initial, coarse)?;
            let end = Rigid3::from_parts(found.translation, found.rotation * end.rotation);
            let segment = segment.ending_at(&end);
            let registered = self.registration.register_widely(&sample, &segment, self.target);
            let fits = registered.fit >= least_fit && !self.fits.is_poor(&registered.sweep_fit());
            fits.then_some(Registered { segment, registered, reason: Some(Reason::OtherMotion) })
        })
    }

    /// Headings to begin with, relative to the predicted one, radians: small ones first.
    fn headings(&self, is_measured: bool) -> impl Iterator<Item = f64> {
        let settings = &self.settings.hypotheses;
        let (step, each) = (settings.heading_step, if is_measured { 0 } else { settings.headings_each_side });
        let each = i32::try_from(each).unwrap_or(0);
        let sides = (1..=each).flat_map(|i| [i, -i]);
        std::iter::once(0).chain(sides).map(move |i| step * f64::from(i))
    }
}
