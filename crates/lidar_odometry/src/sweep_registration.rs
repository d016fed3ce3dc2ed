//! Registers one sweep under one hypothesis of its motion: selects the points, sets the prior, and
//! computes the fit of the result.

use portolan_geometry::{Rigid3, Vector3};
use portolan_sensor::{TimedPoint, voxel_filter_indices};

use crate::deskew::PiecewiseLinearTrajectory;
use crate::innovations::Innovations;
use crate::odometry_prior::MeasuredPlace;
use crate::plane_map::PlaneMap;
use crate::poles::PolesToRegister;
use crate::pose_status::SweepFit;
use crate::predict::{Reason, Registered};
use crate::registration::{MotionPrior, Registration, RegistrationResult, Sigmas};
use crate::segment::{MotionSource, SegmentCorrection, TrajectorySegment};
use crate::settings::constants::initialise::COARSE;
use crate::settings::constants::innovations;
use crate::settings::{MotionPriorSettings, OdometrySettings, SweepSettings};
use crate::sweep::Sweep;

impl MotionPriorSettings {
    /// Displacement of a platform by unmeasured accelerations over this time, seconds; metres.
    pub(crate) fn by_acceleration(&self, seconds: f64) -> f64 {
        0.5 * self.acceleration * seconds * seconds
    }
}

/// A sweep after registration, successful or not.
pub(crate) struct RegisteredSegment {
    /// At the end of the sweep.
    pub local_from_tracking: Rigid3,
    /// Motion compensation to the end.
    pub to_end: PiecewiseLinearTrajectory,
    /// None where the sweep does not fit; the pose is then the prediction.
    pub found: Option<RegistrationResult>,
    /// Fit: the fraction of points on planes, reduced by their distance from them.
    pub fit: f64,
    /// Fit of the points that constrain the motion.
    pub evidence: f64,
    /// Whether the sweep fits only far from the predicted rotation.
    pub contradicts_rotation: bool,
}

impl RegisteredSegment {
    /// Its fit, for comparison with other sweeps.
    pub fn sweep_fit(&self) -> SweepFit {
        SweepFit { fit: self.fit, rms: self.found.as_ref().map(|found| found.rms) }
    }

    /// Degenerate translations by planes, orthonormal, in the local map: all where it does not fit.
    pub fn open_translations(&self) -> Vec<Vector3> {
        let Some(found) = &self.found else { return vec![Vector3::x(), Vector3::y(), Vector3::z()] };
        let local_from_map = self.local_from_tracking.rotation * found.pose.rotation.inverse();
        found.degenerate.translations.iter().map(|open| local_from_map * open).collect()
    }
}

/// The map that a sweep is registered to.
pub(crate) struct Target<'a> {
    pub local_from_map: &'a Rigid3,
    pub planes: &'a PlaneMap,
    pub poles: Option<&'a PolesToRegister>,
}

/// Registers sweeps.
#[derive(Clone)]
pub(crate) struct SweepRegistration {
    registration: Registration,
    settings: SweepSettings,
    prior: MotionPriorSettings,
    outlier_sigmas: f64,
    /// Drift of rotations with a bias that may still be unknown, rad/s.
    gyroscope_drift: f64,
    /// Scale of the loss after a coarse alignment, metres.
    coarse_scale: f64,
    /// Distance from their plane beyond which points have little weight, metres.
    final_scale: f64,
    /// Minimum edge of the sampling voxels: closer points are redundant.
    least_spacing: f32,
    /// Edge of the sampling voxels, of which one point each is registered; adapted from sweep to sweep.
    spacing: f32,
    /// Innovations of predicted rotations.
    innovations: Innovations,
    /// Whether a gyroscope measured the rotation until the end of the last sweep, where the next segment starts.
    start_is_measured: bool,
}

impl SweepRegistration {
    pub fn new(settings: &OdometrySettings) -> Self {
        Self {
            registration: Registration::new(settings.registration.clone()),
            settings: settings.sweep.clone(),
            prior: settings.motion_prior.clone(),
            outlier_sigmas: settings.registration.outlier_sigmas,
            gyroscope_drift: settings.gyroscope.bias,
            coarse_scale: f64::from(settings.correlation.cell),
            final_scale: settings.final_scale(),
            least_spacing: settings.plane_fit.range_noise as f32,
            spacing: settings.first_spacing(),
            innovations: Innovations::default(),
            start_is_measured: false,
        }
    }

    /// A sample of points, evenly over the sweep, in order of time.
    pub fn sample(&self, sweep: &Sweep) -> Vec<TimedPoint> {
        let kept = voxel_filter_indices(&sweep.points, |p| p.position, self.spacing);
        let mut sample: Vec<TimedPoint> =
            kept.into_iter().filter_map(|i| Some(sweep.points.get(i as usize)?.timed())).collect();
        sample.sort_by(|a, b| a.time.total_cmp(&b.time));
        sample
    }

    /// Adapts the spacing to the wanted number of points, after this number was kept.
    pub fn adapt(&mut self, kept: u64) {
        if kept == 0 {
            return;
        }
        // Points are on surfaces, so their number goes with the square of the spacing.
        let wanted = (kept as f32 / self.settings.wanted_points).sqrt();
        self.spacing = (self.spacing * wanted).max(self.least_spacing);
    }

    /// Learns the error of the prediction of a registered segment.
    pub fn learn(&mut self, segment: &TrajectorySegment, registered: &RegisteredSegment) {
        self.start_is_measured = segment.rotation_is_measured();
        let Some(found) = &registered.found else { return };
        if found.degenerate.rotations.is_empty() {
            match segment.gyroscope_sigma {
                Some(sigma) => self.innovations.add_measured(&found.correction, sigma),
                None => {
                    self.innovations.add_constant(&found.correction, self.usual_growth(segment).rotation);
                }
            }
        }
    }

    /// Registers a sample near a predicted segment.
    pub fn register(
        &self,
        sample: &[TimedPoint],
        segment: &TrajectorySegment,
        target: &Target<'_>,
    ) -> RegisteredSegment {
        let prior = self.motion_prior(segment);
        // The largest offset that does not contradict the prediction; points farther from a plane are not
        // in its voxel.
        let possible = self.outlier_sigmas * prior.growth.translation;
        let diagonal = 3_f64.sqrt() * f64::from(target.planes.edge());
        self.register_with(sample, segment, target, &prior, possible.min(diagonal))
    }

    /// Registers a sample near a segment from a coarse search.
    pub fn register_widely(
        &self,
        sample: &[TimedPoint],
        segment: &TrajectorySegment,
        target: &Target<'_>,
    ) -> RegisteredSegment {
        let start = self.motion_prior(segment).start;
        let prior = MotionPrior { start, growth: COARSE, compensates_attenuation: false };
        self.register_with(sample, segment, target, &prior, self.coarse_scale)
    }

    fn register_with(
        &self,
        sample: &[TimedPoint],
        segment: &TrajectorySegment,
        target: &Target<'_>,
        prior: &MotionPrior,
        scale: f64,
    ) -> RegisteredSegment {
        let &Target { local_from_map, planes, poles } = target;
        let in_map = segment.seen_from(&local_from_map.inverse());
        let poles = poles.map(|poles| (&poles.map, &poles.points[..]));
        let found = self.registration.register_sweep(planes, sample, &in_map, prior, scale, poles);
        self.registered(segment, local_from_map, found)
    }

    /// A segment (in the local map) with this result of its registration.
    pub fn registered(
        &self,
        segment: &TrajectorySegment,
        local_from_map: &Rigid3,
        found: Option<RegistrationResult>,
    ) -> RegisteredSegment {
        // However precise a gyroscope was recently, a failure is an error that is unusual for any
        // gyroscope.
        let possible = match segment.rotation_is_measured() {
            true => self.usual_growth(segment).rotation,
            false => self.motion_prior(segment).growth.rotation,
        };
        let in_map = segment.seen_from(&local_from_map.inverse());
        let correction = found.as_ref().map_or_else(SegmentCorrection::default, |found| found.correction);
        let local_from_tracking = local_from_map * in_map.corrected_end(&correction);
        let error = segment.end().rotation.angle_to(&local_from_tracking.rotation);
        RegisteredSegment {
            local_from_tracking,
            to_end: in_map.deskewing(&correction),
            fit: found.as_ref().map_or(0.0, |f| f.fit(self.final_scale)),
            evidence: found.as_ref().map_or(0.0, |f| f.evidence(self.final_scale)),
            contradicts_rotation: found.is_some() && error > self.outlier_sigmas * possible,
            found,
        }
    }

    /// Assumed standard deviations of the error that a predicted segment gains until its end. Drifts grow
    /// with time, errors of unmeasured motion with its square.
    fn usual_growth(&self, segment: &TrajectorySegment) -> Sigmas {
        let (prior, seconds) = (&self.prior, segment.seconds());
        let least = prior.least_translation_error;
        Sigmas {
            translation: match segment.source {
                MotionSource::Standing => least + prior.odometry_drift * seconds,
                MotionSource::Odometry { translation_sigma } => translation_sigma,
                MotionSource::Inertial { velocity_sigma } => least + velocity_sigma * seconds,
                MotionSource::ConstantVelocity => least + prior.by_acceleration(seconds),
            },
            rotation: match segment.rotation_is_measured() {
                true => prior.least_rotation_error + self.gyroscope_drift * seconds,
                false => prior.least_rotation_error + 0.5 * prior.rotational_acceleration * seconds * seconds,
            },
        }
    }

    /// Position of a registered sweep by its points alone, along the directions that they constrain more
    /// than the prior does: the pull of the prior is removed. `local_from_map`: of the planes. None where
    /// the points do not fit.
    pub fn measured_place(&self, best: &Registered, local_from_map: &Rigid3) -> Option<MeasuredPlace> {
        let Registered { segment, registered, reason } = best;
        let turn = local_from_map.rotation.to_rotation_matrix();
        let covariance = turn * registered.found.as_ref()?.place_covariance()? * turn.transpose();
        let MotionPrior { start, growth, .. } = self.motion_prior(segment);
        let of_prior = start.translation.powi(2) + growth.translation.powi(2);
        let mut local_from_tracking = registered.local_from_tracking;
        let correction = local_from_tracking.translation.vector - segment.end().translation.vector;
        let mut constrained = Vec::new();
        let eigen = covariance.symmetric_eigen();
        for (direction, &variance) in eigen.eigenvectors.column_iter().zip(&eigen.eigenvalues) {
            if variance > of_prior {
                continue;
            }
            let direction = direction.into_owned();
            // The result of a wide search is not held by a prior.
            let held = if *reason == Some(Reason::OtherMotion) { 0.0 } else { variance / of_prior };
            local_from_tracking.translation.vector += direction * (held * direction.dot(&correction));
            constrained.push((direction, variance));
        }
        Some(MeasuredPlace { local_from_tracking, covariance, of_prior, constrained })
    }

    /// Prior of a predicted segment: the assumed standard deviations, smaller where recent rotations were
    /// more precise.
    fn motion_prior(&self, segment: &TrajectorySegment) -> MotionPrior {
        let (prior, usual) = (&self.prior, self.usual_growth(segment));
        let (start_rotation, rotation) = match segment.gyroscope_sigma {
            Some(sigma) => {
                let least = innovations::LEAST_FRACTION * usual.rotation;
                let rotation = (sigma * self.innovations.of_measured()).clamp(least, usual.rotation);
                let at_start = rotation.max(innovations::REGISTERED_SIGMA);
                (if self.start_is_measured { at_start } else { usual.rotation }, rotation)
            }
            None => (prior.start_rotation, usual.rotation * self.innovations.of_constant()),
        };
        let start = Sigmas { translation: prior.least_translation_error, rotation: start_rotation };
        let growth = Sigmas { rotation, ..usual };
        let compensates_attenuation = matches!(segment.source, MotionSource::Inertial { .. });
        MotionPrior { start, growth, compensates_attenuation }
    }
}
