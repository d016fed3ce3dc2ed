//! Prediction of the next motion from the odometry of the platform, and estimation of its calibration, its
//! noise and its failures from registered sweeps.

mod calibration;
mod trust;

use portolan_geometry::nalgebra::Matrix3;
use portolan_geometry::{Rigid3, Time, Vector3};
use portolan_motion::PoseExtrapolator;
use portolan_sensor::ImuData;

use crate::predict;
use crate::segment::{MotionSource, TrajectorySegment};
use crate::settings::MotionPriorSettings;
use calibration::{Calibration, OdometryMotion};
use trust::{OdometryTrust, Predicted, TwoMotions};

/// Estimates how far odometry can be trusted.
#[derive(Clone, Debug)]
pub(crate) struct OdometryPrior {
    /// Extrapolator that ignores odometry, once there is odometry.
    without: Option<PoseExtrapolator>,
    calibration: Calibration,
    trust: OdometryTrust,
    /// Whether the last sweep constrained the whole motion. Where it did not, constant velocity continues
    /// an assumed motion.
    velocity_is_known: bool,
    settings: MotionPriorSettings,
}

/// Predictions for a sweep where there is odometry.
#[derive(Clone, Debug)]
pub(crate) struct OdometryPrediction {
    /// By odometry, corrected.
    pub measured: TrajectorySegment,
    /// Without odometry.
    pub otherwise: TrajectorySegment,
    uncorrected: OdometryMotion,
    two: TwoMotions,
}

/// Position at the end of a sweep, as far as its points constrain it.
pub(crate) struct MeasuredPlace {
    pub local_from_tracking: Rigid3,
    /// Covariance of the position by points alone, m² in the local map, and variance of the prior along
    /// each axis, m².
    pub covariance: Matrix3<f64>,
    pub of_prior: f64,
    /// Directions along which points constrain it, orthonormal in the local map, and the variance along
    /// each, m².
    pub constrained: Vec<(Vector3, f64)>,
}

impl OdometryPrior {
    pub fn new(settings: &MotionPriorSettings) -> Self {
        Self {
            without: None,
            calibration: Calibration::new(settings),
            trust: OdometryTrust::default(),
            velocity_is_known: false,
            settings: settings.clone(),
        }
    }

    /// To be called when there is odometry: from now on both motions are predicted. `extrapolator` has not
    /// taken it yet.
    pub fn begin(&mut self, extrapolator: &PoseExtrapolator) {
        if self.without.is_none() {
            self.without = Some(extrapolator.without_odometry());
        }
    }

    /// The extrapolator without odometry, which needs the same poses as the other one.
    pub fn without_odometry(&mut self) -> Option<&mut PoseExtrapolator> {
        self.without.as_mut()
    }

    /// Takes a sample of an IMU that the other extrapolator took.
    pub fn add_imu(&mut self, corrected: &ImuData) {
        if let Some(without) = &mut self.without {
            let _ = without.add_imu(corrected);
        }
    }

    /// Predictions for a sweep. `by_odometry`: the segment by odometry, without correction.
    /// `rotation_is_measured`: both rotations are those of a gyroscope. None where there is no odometry.
    pub fn predict(
        &mut self,
        by_odometry: &TrajectorySegment,
        end: Time,
        rotation_is_measured: bool,
    ) -> Option<OdometryPrediction> {
        let without = self.without.as_mut()?;
        without.prepare(end);
        let otherwise = predict::extrapolated(without, end);
        let motion =
            OdometryMotion { translation: by_odometry.translation(), seconds: by_odometry.seconds() };
        let sigma = self.calibration.sigma(&motion);
        let mut measured = self.calibration.corrected(by_odometry, &motion);
        measured.source = MotionSource::Odometry { translation_sigma: sigma };
        let by_acceleration =
            self.settings.least_translation_error + self.settings.by_acceleration(otherwise.seconds());
        let seconds = by_odometry.seconds();
        let two = TwoMotions {
            measured: Predicted { end: measured.end(), sigma },
            otherwise: Predicted { end: otherwise.end(), sigma: by_acceleration },
            rotation_sigma: (!rotation_is_measured).then_some(
                self.settings.least_rotation_error
                    + 0.5 * self.settings.rotational_acceleration * seconds * seconds,
            ),
        };
        Some(OdometryPrediction { measured, otherwise, uncorrected: motion, two })
    }

    /// Takes the position of a sweep, whether there was odometry or not; none where it does not fit.
    pub fn observe(&mut self, found: Option<&MeasuredPlace>) {
        self.velocity_is_known = found.is_some_and(|found| found.constrained.len() == 3);
    }

    /// Takes the position of a sweep that began at `start` in the local map, and its predictions.
    /// `is_sure`: the sweep fits a map that was not made of the last few sweeps alone.
    pub fn learn(
        &mut self,
        predicted: &OdometryPrediction,
        start: &Vector3,
        found: &MeasuredPlace,
        is_sure: bool,
    ) {
        self.trust.learn(&predicted.two, found);
        if is_sure && self.trust.works() {
            let moved = found.local_from_tracking.translation.vector - start;
            self.calibration.learn(&predicted.uncorrected, &moved, found);
        }
    }

    /// Whether odometry is more likely to work than to fail.
    pub fn works(&self) -> bool {
        self.trust.works()
    }

    /// The likelier of the two motions.
    pub fn likelier<'a>(&self, predicted: &'a OdometryPrediction) -> &'a TrajectorySegment {
        let is_more_precise = predicted.two.measured.sigma <= predicted.two.otherwise.sigma;
        match self.trust.works() && (is_more_precise || !self.velocity_is_known) {
            true => &predicted.measured,
            false => &predicted.otherwise,
        }
    }

    /// Whether the last sweep constrained the whole motion, so that constant velocity from there is as
    /// good as a measurement.
    pub fn velocity_is_known(&self) -> bool {
        self.velocity_is_known
    }

    /// Ratio of the distance by odometry to that by sweeps, where odometry is trusted and the ratio
    /// differs significantly from one.
    pub fn factor(&self) -> Option<f64> {
        self.calibration.factor().filter(|_| self.trust.works())
    }

    /// Whether there is odometry that sweeps contradict.
    pub fn is_contradicted(&self) -> bool {
        self.without.is_some() && !self.trust.works()
    }
}

impl OdometryPrediction {
    /// Whether the two motions differ significantly.
    pub fn motions_differ(&self) -> bool {
        self.two.differ()
    }
}
