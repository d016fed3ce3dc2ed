//! What is known of the motion between sweeps: the inertial filter if there is an IMU, an extrapolator of poses and odometry,
//! and what is noticed of their sensors: rest, and the end of the range of the gyroscope.

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

/// Follows the motion.
#[derive(Clone, Debug)]
pub(crate) struct MotionState {
    pub extrapolator: PoseExtrapolator,
    pub has_imu: bool,
    saturation: SaturationDetector,
    /// When the gyroscope was last at the end of its range.
    saturated_at: Option<Time>,
    last_sample: Option<Time>,
    /// When samples last came again after a gap.
    resumed_at: Option<Time>,
    zero_velocity: ZeroVelocityDetector,
    inertial: InertialFilter,
    odometry: OdometryPrior,
    hypotheses: HypothesisSettings,
    /// What two sparse sweeps are off by, m/s.
    first_velocity_error: f64,
}

/// What the end of a sweep says of the motion.
pub(crate) struct SweepEnd<'a> {
    pub time: Time,
    pub local_from_tracking: &'a Rigid3,
    /// What the sweep leaves unconstrained, in the tracking frame.
    pub degenerate: &'a DegenerateDirections,
    /// Covariance of attenuation, m² in the local map. None where the sweep fits nothing.
    pub attenuation: Option<Matrix3<f64>>,
    /// Where its points alone put it; none where the sweep fits nothing.
    pub measured: Option<&'a MeasuredPlace>,
    pub is_standing: bool,
    /// Whether the rotation tells something of the gyroscope. Before the map is warmed up it does not: what the first sweeps
    /// got wrong fits the map that was made of them.
    pub tells_rotation: bool,
    /// Where it does not follow from the pose before: how the platform moves now.
    pub velocities: Option<Velocities>,
}

impl MotionState {
    /// Begins where an extrapolator does, with the samples that it was begun with.
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
            // The extrapolator has it.
            state.inertial.add_imu(first);
        }
        let issues = imu.iter().skip(1).filter_map(|data| state.add_imu(data)).collect();
        (state, issues)
    }

    /// Takes a sample, in order of time. Gives what is wrong with it.
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

    /// Takes an odometry pose, in order of time. Gives what is wrong with it.
    pub fn add_odometry(&mut self, data: &OdometryData) -> Option<Issue> {
        self.odometry.begin(&self.extrapolator);
        self.extrapolator.add_odometry(data).is_err().then_some(Issue::OdometryTooOld)
    }

    /// What is expected of a sweep that ends at `end`.
    ///
    /// The most likely motion is that the platform stands, if it does; else what odometry measured, where it is believed; else, or where
    /// that is more precise, what the accelerometer says, once that is reliable; else constant velocity. Rotation is the gyroscope's if
    /// there is one.
    pub fn predict(&mut self, end: Time) -> Prediction {
        self.extrapolator.prepare(end);
        let start = self.extrapolator.last_pose_time();
        // 1. As odometry says, and as it goes on without.
        let (extrapolated, odometry) = self.extrapolated(end);
        // 2. Standing.
        let standing = self.zero_velocity.pose();
        // 3. As the accelerometer says.
        let inertial =
            start.filter(|_| self.has_imu).and_then(|start| self.inertial.predict(start, &extrapolated));
        // 4. The likeliest.
        let mut segment = self.likeliest(standing.as_ref(), inertial.as_ref(), &extrapolated, end);
        let is_complete = self.resumed_at.is_none_or(|resumed| start.is_some_and(|start| resumed <= start));
        let has_gyroscope = self.has_gyroscope(end) && is_complete;
        segment.gyroscope_sigma = has_gyroscope.then(|| self.inertial.rotation_sigma(&segment));
        // 5. Others, where it may be wrong.
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

    /// As the platform goes on without accelerometer, and what odometry has to do with it.
    fn extrapolated(&mut self, end: Time) -> (TrajectorySegment, Option<OdometryPrediction>) {
        let rotation_is_measured = self.has_gyroscope(end);
        let told = predict::extrapolated(&mut self.extrapolator, end);
        let is_told = self.extrapolator.has_odometry(end);
        let odometry = is_told.then(|| self.odometry.predict(&told, end, rotation_is_measured)).flatten();
        let Some(odometry) = odometry else { return (told, None) };
        // Where it may be odometry that fails, it is no witness of rest.
        if self.odometry.works() && !odometry.they_differ() {
            self.zero_velocity.add_odometry(&odometry.measured.translation(), told.seconds());
        }
        (self.odometry.likelier(&odometry).clone(), Some(odometry))
    }

    /// The motion that is taken if it is odometry that fails, or that works; none if it does not matter.
    fn other_than(
        &self,
        first: &TrajectorySegment,
        odometry: &OdometryPrediction,
    ) -> Option<TrajectorySegment> {
        let is_measured = matches!(first.source, MotionSource::Odometry { .. });
        let other = if is_measured { &odometry.otherwise } else { &odometry.measured };
        odometry.they_differ().then(|| other.clone())
    }

    /// Whether the accelerometer is relied on, and says more than what is known otherwise.
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

    /// What is expected of the first sweep after a gap if the platform moved so meanwhile.
    pub fn predict_after(&mut self, end: Time, motion: &GapMotion) -> Prediction {
        let prediction = self.predict(end);
        let segment = motion.applied_to(&prediction.segment);
        let extrapolated = segment.clone();
        Prediction { extrapolated, segment, inertial: None, alternatives: Vec::new(), ..prediction }
    }

    /// Other hypotheses than the first.
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

    /// Zero-velocity update: where the platform stands after a sweep was registered at this pose, if it stands.
    pub fn zero_velocity_update(&mut self, end: Time, local_from_tracking: &Rigid3) -> Option<Rigid3> {
        self.zero_velocity.add_pose(end, local_from_tracking);
        self.zero_velocity.pose()
    }

    /// Begins at the end of the first sweep, moving so fast (m/s in the local map). `level_from_tracking` is what the IMU alone
    /// says of the tracking frame there. Gives a gravity-aligned frame.
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

    /// Corrects what is known by the pose of a sweep. Gives the gravity-aligned frame of the tracking frame there.
    pub fn update(
        &mut self,
        prediction: &Prediction,
        inertial: Option<&InertialPrediction>,
        end: &SweepEnd<'_>,
    ) -> Option<Quaternion> {
        if self.has_imu {
            self.update_inertial(prediction, inertial, end);
        }
        self.odometry.saw(end.measured);
        if let (Some(odometry), Some(found)) = (&prediction.odometry, end.measured) {
            let start = prediction.segment.start().translation.vector;
            self.odometry.learn(odometry, &start, found, end.tells_rotation);
        }
        if let Some(velocities) = end.velocities {
            let before = end.time - Duration::from_seconds(VELOCITY_INTERVAL);
            let earlier = velocities.earlier(end.local_from_tracking, VELOCITY_INTERVAL);
            self.add_pose(before, earlier);
        }
        self.add_pose(end.time, *end.local_from_tracking);
        self.inertial.level_from_tracking(&end.local_from_tracking.rotation)
    }

    /// Takes a pose that is known, with odometry and without.
    pub fn add_pose(&mut self, time: Time, local_from_tracking: Rigid3) {
        for extrapolator in
            [Some(&mut self.extrapolator), self.odometry.without_odometry()].into_iter().flatten()
        {
            extrapolator.add_pose(time, local_from_tracking);
        }
    }

    /// Begins to predict anew, from poses alone.
    pub fn forget_motion(&mut self, extrapolator: PoseExtrapolator) {
        if let Some(without) = self.odometry.without_odometry() {
            *without = extrapolator.clone();
        }
        self.extrapolator = extrapolator;
    }

    /// How many times as far as sweeps odometry goes, where that is clearly another number than one.
    pub fn odometry_factor(&self) -> Option<f64> {
        self.odometry.factor()
    }

    /// Whether there is odometry that sweeps contradict.
    pub fn doubts_odometry(&self) -> bool {
        self.odometry.is_doubted()
    }

    /// Corrects the inertial filter, or begins it anew.
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
                tells_rotation: end.tells_rotation,
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
        self.inertial.begin_anew(end.time, &self.inertial_start(end.local_from_tracking, velocity));
    }

    /// What the inertial filter begins with, moving so fast (m/s in the local map).
    fn inertial_start(&self, local_from_tracking: &Rigid3, velocity: Vector3) -> InertialStart {
        let force_at_rest = self.zero_velocity.force_at_rest();
        // An IMU rests in smooth motion, too.
        let seems_to_stand = force_at_rest.is_some() && velocity.norm() < self.first_velocity_error;
        let velocity = if seems_to_stand { Vector3::zeros() } else { velocity };
        InertialStart { local_from_tracking: *local_from_tracking, velocity, force_at_rest }
    }

    /// What an IMU says of the rotation (from the tracking frame to a gravity-aligned one) at a time; none without one.
    pub fn measured_rotation(&self) -> Option<impl Fn(Time) -> Quaternion + '_> {
        self.has_imu.then_some(|time| self.extrapolator.estimate_gravity_orientation(time))
    }

    /// Whether there is a gyroscope that measures until `end`, relied on or not.
    pub fn has_gyroscope(&self, end: Time) -> bool {
        self.has_imu && self.extrapolator.has_gyroscope(end)
    }
}
