//! State of motion between sweeps: the inertial filter if there is an IMU, an extrapolator of poses and
//! odometry, and detectors of rest and of saturation of the gyroscope.

use portolan_geometry::nalgebra::Matrix3;
use portolan_geometry::{Duration, Quaternion, Rigid3, Time, Vector3};
use portolan_motion::{DegenerateDirections, PoseExtrapolator, SaturationDetector, ZeroVelocityDetector};
use portolan_sensor::{ImuData, OdometryData};

use crate::gap::{GapMotion, Velocities};
use crate::inertial::{InertialFilter, InertialPrediction, InertialStart, PoseMeasurement};
use crate::issues::Issue;
use crate::odometry_prior::{MeasuredPlace, OdometryPrediction, OdometryPrior};
use crate::predict::{self, Alternative, Prediction, Reason};
use crate::segment::{MotionSource, TrajectorySegment};
use crate::settings::constants::initialise::VELOCITY_INTERVAL;
use crate::settings::{HypothesisSettings, OdometrySettings};

/// Estimates the motion.
#[derive(Clone, Debug)]
pub(crate) struct MotionState {
    pub extrapolator: PoseExtrapolator,
    pub has_imu: bool,
    saturation: SaturationDetector,
    /// Time at which the gyroscope was last saturated.
    saturated_at: Option<Time>,
    last_sample: Option<Time>,
    /// Time at which samples last resumed after a gap.
    resumed_at: Option<Time>,
    zero_velocity: ZeroVelocityDetector,
    inertial: InertialFilter,
    odometry: OdometryPrior,
    hypotheses: HypothesisSettings,
    /// Error of a velocity from two sparse sweeps, m/s.
    first_velocity_error: f64,
}

/// Measurements of the motion at the end of a sweep.
pub(crate) struct SweepEnd<'a> {
    pub time: Time,
    pub local_from_tracking: &'a Rigid3,
    /// Degenerate directions of the sweep, in the tracking frame.
    pub degenerate: &'a DegenerateDirections,
    /// Covariance of attenuation, m² in the local map. None where the sweep does not fit.
    pub attenuation: Option<Matrix3<f64>>,
    /// Position by its points alone; none where the sweep does not fit.
    pub measured: Option<&'a MeasuredPlace>,
    pub is_standing: bool,
    /// Whether the rotation calibrates the gyroscope. Before the map is warmed up it does not: errors of
    /// the first sweeps fit the map that was made of them.
    pub measures_rotation: bool,
    /// Velocities of the platform at this time, where they do not follow from the pose before.
    pub velocities: Option<Velocities>,
}

impl MotionState {
    /// State with this extrapolator and the samples that it was started with.
    pub fn new(
        settings: &OdometrySettings,
        extrapolator: PoseExtrapolator,
        imu: &[ImuData],
    ) -> (Self, Vec<Issue>) {
        let mut state = Self {
            extrapolator,
            has_imu: !imu.is_empty(),
            saturation: settings.gyroscope.saturation_detector(),
            saturated_at: None,
            last_sample: imu.first().map(|sample| sample.time),
            resumed_at: None,
            zero_velocity: ZeroVelocityDetector::new(&settings.standstill_tolerances()),
            inertial: InertialFilter::new(settings),
            odometry: OdometryPrior::new(&settings.motion_prior),
            hypotheses: settings.hypotheses.clone(),
            first_velocity_error: settings.inertial.first_velocity,
        };
        if let Some(first) = imu.first() {
            // The extrapolator already has it.
            state.inertial.add_imu(first);
        }
        let issues = imu.iter().skip(1).filter_map(|data| state.add_imu(data)).collect();
        (state, issues)
    }

    /// Takes a sample, in order of time. Gives its fault, if any.
    pub fn add_imu(&mut self, data: &ImuData) -> Option<Issue> {
        let max_gap = Duration::from_seconds(self.hypotheses.long_gap);
        if self.last_sample.is_some_and(|last| data.time - last > max_gap) {
            self.resumed_at = Some(data.time);
        }
        self.last_sample = self.last_sample.max(Some(data.time));
        if self.saturation.is_saturated(&data.angular_velocity) {
            self.saturated_at = self.saturated_at.max(Some(data.time));
        }
        let corrected = self.inertial.corrected(data);
        if self.extrapolator.add_imu(&corrected).is_err() {
            return Some(Issue::ImuSampleTooOld);
        }
        self.odometry.add_imu(&corrected);
        self.zero_velocity.add_imu(&corrected);
        self.inertial.add_imu(data);
        (!self.has_imu).then_some(Issue::ImuAfterStart)
    }

    /// Takes an odometry pose, in order of time. Gives its fault, if any.
    pub fn add_odometry(&mut self, data: &OdometryData) -> Option<Issue> {
        self.odometry.begin(&self.extrapolator);
        self.extrapolator.add_odometry(data).is_err().then_some(Issue::OdometryTooOld)
    }

    /// Predicts the motion during a sweep that ends at `end`.
    ///
    /// The first hypothesis is standing, if the platform stands; else odometry, where it is trusted; else,
    /// or where it is more precise, the accelerometer, once it is reliable; else constant velocity.
    /// Rotation is that of the gyroscope if there is one.
    pub fn predict(&mut self, end: Time) -> Prediction {
        self.extrapolator.prepare(end);
        let start = self.extrapolator.last_pose_time();
        // 1. Motion by odometry, and without it.
        let (extrapolated, odometry) = self.extrapolated(end);
        // 2. Standing.
        let standing = self.zero_velocity.pose();
        // 3. Motion by the accelerometer.
        let inertial =
            start.filter(|_| self.has_imu).and_then(|start| self.inertial.predict(start, &extrapolated));
        // 4. The likeliest hypothesis.
        let mut segment = self.likeliest(standing.as_ref(), inertial.as_ref(), &extrapolated, end);
        let is_complete = self.resumed_at.is_none_or(|resumed| start.is_some_and(|start| resumed <= start));
        let has_gyroscope = self.has_gyroscope(end) && is_complete;
        segment.gyroscope_sigma = has_gyroscope.then(|| self.inertial.rotation_sigma(&segment));
        // 5. Alternatives, where it may be wrong.
        let is_saturated = self.saturated_at > start;
        let mut alternatives = self.alternatives(end, &segment, &extrapolated, is_saturated);
        alternatives.extend(odometry.as_ref().and_then(|odometry| {
            let mut other = self.other_than(&extrapolated, odometry)?;
            other.gyroscope_sigma = segment.gyroscope_sigma;
            let clearly_better = self.hypotheses.better_over_sweeps;
            Some(Alternative { reason: Reason::OdometryFails, segment: other, clearly_better })
        }));
        Prediction { extrapolated, inertial, standing, segment, alternatives, is_saturated, odometry }
    }

    /// The likeliest motion.
    fn likeliest(
        &self,
        standing: Option<&Rigid3>,
        inertial: Option<&InertialPrediction>,
        extrapolated: &TrajectorySegment,
        end: Time,
    ) -> TrajectorySegment {
        let (mut segment, source) = match (standing, inertial) {
            (Some(pose), _) => (predict::standing(&self.extrapolator, end, pose), MotionSource::Standing),
            (None, Some(inertial)) if self.relies_on(inertial, extrapolated) => {
                let velocity_sigma = self.inertial.velocity_sigma();
                (inertial.segment.clone(), MotionSource::Inertial { velocity_sigma })
            }
            _ => (extrapolated.clone(), extrapolated.source),
        };
        segment.source = source;
        segment
    }

    /// Motion without the accelerometer, and the predictions with and without odometry if there is
    /// odometry.
    fn extrapolated(&mut self, end: Time) -> (TrajectorySegment, Option<OdometryPrediction>) {
        let rotation_is_measured = self.has_gyroscope(end);
        let segment = predict::extrapolated(&mut self.extrapolator, end);
        let has_odometry = self.extrapolator.has_odometry(end);
        let odometry =
            has_odometry.then(|| self.odometry.predict(&segment, end, rotation_is_measured)).flatten();
        let Some(odometry) = odometry else { return (segment, None) };
        // Where odometry may fail, it does not count as evidence of rest.
        if self.odometry.works() && !odometry.motions_differ() {
            self.zero_velocity.add_odometry(&odometry.measured.translation(), segment.seconds());
        }
        (self.odometry.likelier(&odometry).clone(), Some(odometry))
    }

    /// The alternative to `first`: the motion without odometry, or that by odometry; none if both agree.
    fn other_than(
        &self,
        first: &TrajectorySegment,
        odometry: &OdometryPrediction,
    ) -> Option<TrajectorySegment> {
        let is_measured = matches!(first.source, MotionSource::Odometry { .. });
        let other = if is_measured { &odometry.otherwise } else { &odometry.measured };
        odometry.motions_differ().then(|| other.clone())
    }

    /// Whether the accelerometer is reliable, and more precise than the motion without it.
    fn relies_on(&self, inertial: &InertialPrediction, otherwise: &TrajectorySegment) -> bool {
        let sigma = self.inertial.velocity_sigma() * inertial.segment.seconds();
        let is_better = match otherwise.source {
            MotionSource::Odometry { translation_sigma } => {
                self.odometry.velocity_is_known() && sigma < translation_sigma
            }
            _ => true,
        };
        self.inertial.is_reliable() && is_better
    }

    /// Predicts the first sweep after a gap with this motion.
    pub fn predict_after(&mut self, end: Time, motion: &GapMotion) -> Prediction {
        let prediction = self.predict(end);
        let segment = motion.applied_to(&prediction.segment);
        let extrapolated = segment.clone();
        Prediction { extrapolated, segment, inertial: None, alternatives: Vec::new(), ..prediction }
    }

    /// Alternatives to the first hypothesis.
    fn alternatives(
        &mut self,
        end: Time,
        first: &TrajectorySegment,
        extrapolated: &TrajectorySegment,
        is_saturated: bool,
    ) -> Vec<Alternative> {
        let settings = &self.hypotheses;
        let mut alternatives = Vec::new();
        if matches!(first.source, MotionSource::Inertial { .. }) {
            let mut segment = extrapolated.clone();
            segment.gyroscope_sigma = first.gyroscope_sigma;
            let reason = Reason::AccelerometerFails;
            alternatives.push(Alternative { reason, segment, clearly_better: 1.0 });
        }
        if first.seconds() > settings.long_gap
            && let Some((_, last)) = self.extrapolator.last_pose()
        {
            let segment = predict::standing(&self.extrapolator, end, &last);
            alternatives.push(Alternative { reason: Reason::LongGap, segment, clearly_better: 1.0 });
        }
        if first.rotation_is_measured() {
            let segment = predict::with_constant_rotation(&mut self.extrapolator, end);
            let clearly_better = if is_saturated { 1.0 } else { settings.clearly_better };
            alternatives.push(Alternative { reason: Reason::GyroscopeFails, segment, clearly_better });
        }
        alternatives
    }

    /// Zero-velocity update: the pose of the standing platform after a sweep was registered at this pose;
    /// none if it moves.
    pub fn zero_velocity_update(&mut self, end: Time, local_from_tracking: &Rigid3) -> Option<Rigid3> {
        self.zero_velocity.add_pose(end, local_from_tracking);
        self.zero_velocity.pose()
    }

    /// Begins at the end of the first sweep with this velocity (m/s in the local map).
    /// `level_from_tracking` is the rotation of the tracking frame by the IMU alone. Gives the rotation to
    /// a gravity-aligned frame.
    pub fn begin(
        &mut self,
        end: Time,
        local_from_tracking: &Rigid3,
        velocity: Vector3,
        level_from_tracking: &Quaternion,
    ) -> Quaternion {
        let up = local_from_tracking.rotation * (level_from_tracking.inverse() * Vector3::z());
        self.inertial.begin(end, &self.inertial_start(local_from_tracking, velocity), &up);
        self.inertial.level_from_tracking(&local_from_tracking.rotation).unwrap_or(*level_from_tracking)
    }

    /// Corrects the state by the pose of a sweep. Gives the rotation from the tracking frame there to a
    /// gravity-aligned one.
    pub fn update(
        &mut self,
        prediction: &Prediction,
        inertial: Option<&InertialPrediction>,
        end: &SweepEnd<'_>,
    ) -> Option<Quaternion> {
        if self.has_imu {
            self.update_inertial(prediction, inertial, end);
        }
        self.odometry.observe(end.measured);
        if let (Some(odometry), Some(found)) = (&prediction.odometry, end.measured) {
            let start = prediction.segment.start().translation.vector;
            self.odometry.learn(odometry, &start, found, end.measures_rotation);
        }
        if let Some(velocities) = end.velocities {
            let before = end.time - Duration::from_seconds(VELOCITY_INTERVAL);
            let earlier = velocities.earlier(end.local_from_tracking, VELOCITY_INTERVAL);
            self.add_pose(before, earlier);
        }
        self.add_pose(end.time, *end.local_from_tracking);
        self.inertial.level_from_tracking(&end.local_from_tracking.rotation)
    }

    /// Adds a known pose to the extrapolators with and without odometry.
    pub fn add_pose(&mut self, time: Time, local_from_tracking: Rigid3) {
        for extrapolator in
            [Some(&mut self.extrapolator), self.odometry.without_odometry()].into_iter().flatten()
        {
            extrapolator.add_pose(time, local_from_tracking);
        }
    }

    /// Resets the predictions to this extrapolator, from poses alone.
    pub fn forget_motion(&mut self, extrapolator: PoseExtrapolator) {
        if let Some(without) = self.odometry.without_odometry() {
            *without = extrapolator.clone();
        }
        self.extrapolator = extrapolator;
    }

    /// Ratio of the distance by odometry to that by sweeps, where it differs significantly from one.
    pub fn odometry_factor(&self) -> Option<f64> {
        self.odometry.factor()
    }

    /// Whether there is odometry that sweeps contradict.
    pub fn odometry_is_contradicted(&self) -> bool {
        self.odometry.is_contradicted()
    }

    /// Corrects the inertial filter, or resets it.
    fn update_inertial(
        &mut self,
        prediction: &Prediction,
        inertial: Option<&InertialPrediction>,
        end: &SweepEnd<'_>,
    ) {
        let turn = end.local_from_tracking.rotation;
        if let Some(inertial) = inertial {
            let in_local = |directions: &[Vector3]| directions.iter().map(|d| turn * d).collect();
            let degenerate = DegenerateDirections {
                translations: in_local(&end.degenerate.translations),
                rotations: in_local(&end.degenerate.rotations),
            };
            let measured = PoseMeasurement {
                local_from_tracking: end.local_from_tracking,
                degenerate: &degenerate,
                attenuation: end.attenuation,
                measures_rotation: end.measures_rotation,
                gyroscope_holds: prediction.segment.rotation_is_measured() && !prediction.is_saturated,
                is_standing: end.is_standing,
            };
            self.inertial.update(end.time, inertial, &measured);
            return;
        }
        let extrapolated = &prediction.extrapolated;
        let translation =
            end.local_from_tracking.translation.vector - extrapolated.start().translation.vector;
        let mean = translation / extrapolated.seconds().max(1e-3);
        let velocity = end.velocities.map_or(mean, |velocities| turn * velocities.linear);
        self.inertial.restart(end.time, &self.inertial_start(end.local_from_tracking, velocity));
    }

    /// Initial state of the inertial filter at this velocity (m/s in the local map).
    fn inertial_start(&self, local_from_tracking: &Rigid3, velocity: Vector3) -> InertialStart {
        let force_at_rest = self.zero_velocity.force_at_rest();
        // An IMU seems at rest in smooth motion, too.
        let seems_to_stand = force_at_rest.is_some() && velocity.norm() < self.first_velocity_error;
        let velocity = if seems_to_stand { Vector3::zeros() } else { velocity };
        InertialStart { local_from_tracking: *local_from_tracking, velocity, force_at_rest }
    }

    /// Rotation by an IMU (from the tracking frame to a gravity-aligned one) at a time; none without an
    /// IMU.
    pub fn measured_rotation(&self) -> Option<impl Fn(Time) -> Quaternion + '_> {
        self.has_imu.then_some(|time| self.extrapolator.estimate_gravity_orientation(time))
    }

    /// Whether there is a gyroscope with samples until `end`, used or not.
    pub fn has_gyroscope(&self, end: Time) -> bool {
        self.has_imu && self.extrapolator.has_gyroscope(end)
    }
}
