//! Tracking: processes every sweep once there is a map.

mod finding;
mod observability;

use std::sync::Arc;

use portolan_geometry::nalgebra::{self, Matrix3};
use portolan_geometry::{Duration, Point3f, Quaternion, Rigid3, Time, to_f32};
use portolan_motion::{DegenerateInterval, DegenerateIntervals, Observability};
use portolan_recall::{Fingerprint, Memory};
use portolan_sensor::{PointCloud, RangeData};

use crate::deskew::deskewed;
use crate::gap::{GapMotion, Velocities};
use crate::initialise::{FirstSweeps, RotationAt, Start};
use crate::issues::{Issue, Issues};
use crate::keyframes::{Candidate, Decision, KeyframePolicy};
use crate::local_map::LocalMap;
use crate::motion_state::{MotionState, SweepEnd};
use crate::pieces::NewPiece;
use crate::plane_map::PlaneMap;
use crate::poles::{RecentPoles, SeenPoles};
use crate::pose_status::{FitMonitor, PoseStatus, Support};
use crate::predict::{Prediction, Registered};
use crate::segment::{MotionSource, TrajectorySegment};
use crate::settings::OdometrySettings;
use crate::settings::constants::initialise::VELOCITY_INTERVAL;
use crate::sweep::Sweep;
use crate::sweep_registration::SweepRegistration;
use crate::travel_correlation::TravelCorrelation;
use finding::Found;

/// A registered sweep.
#[derive(Clone, Debug)]
pub struct RegisteredSweep {
    /// The raw sweep.
    pub sweep: Sweep,
    /// The tracking frame in the local map at the end of the sweep.
    pub local_from_tracking: Rigid3,
    /// Rotation from the tracking frame at the end of the sweep to a gravity-aligned one.
    pub gravity_from_tracking: Quaternion,
    /// The de-skewed points in the tracking frame at the end of the sweep.
    pub deskewed: RangeData,
    /// The de-skewed points in the local map.
    pub in_local: RangeData,
    /// Directions of motion that the sweep constrains.
    pub observability: Observability,
    /// Additional data if it is a key frame.
    pub keyframe: Option<Keyframe>,
    /// Present where the pose was lost before this sweep, which begins a new piece of map.
    pub new_piece: Option<NewPiece>,
    pub(crate) status: PoseStatus,
    /// Fit to the map.
    pub(crate) fit: f64,
    /// Fit of the points that constrain the motion.
    pub(crate) evidence: f64,
}

/// Data of a key frame.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// The planar voxel map that it completed.
    pub completed_map: Option<PlaneMap>,
}

/// Another map than that of planes, for sweeps that fit no plane.
pub trait Fallback {
    /// The pose of de-skewed points (in the tracking frame) near a predicted one. None if they do not fit
    /// this map, either.
    fn locate(&mut self, deskewed: &PointCloud, local_from_tracking: &Rigid3) -> Option<Rigid3>;

    /// Standard deviation of its positions, metres.
    fn error(&self) -> f64;
}

/// Pose at the end of a sweep.
struct Place {
    local_from_tracking: Rigid3,
    /// Covariance of the position error by attenuation, m² in the local map; none where the sweep does not
    /// fit.
    attenuation: Option<Matrix3<f64>>,
    /// Whether it is that of a zero-velocity update.
    is_standing: bool,
}

/// Registers sweep after sweep.
#[derive(Clone)]
pub(crate) struct Tracker {
    settings: OdometrySettings,
    motion: MotionState,
    registration: SweepRegistration,
    local_map: LocalMap,
    poles: RecentPoles,
    travel_correlation: TravelCorrelation,
    keyframes: KeyframePolicy,
    intervals: DegenerateIntervals,
    fits: FitMonitor,
    /// Points of the last sweep that fitted, in the local map.
    last_fitting: Arc<Vec<Point3f>>,
    /// Time at which a sweep last fitted planes.
    fitted_at: Time,
    /// Time between the last two sweeps, seconds.
    last_interval: f64,
    memory: Memory,
    /// Fingerprint of all sweeps so far, if results are remembered.
    seen: Fingerprint,
}

impl Tracker {
    /// Begins with the first sweep under a hypothesis of its motion: makes it the first key frame at the
    /// origin of the local map.
    pub fn begin(
        settings: &OdometrySettings,
        mut motion: MotionState,
        first: Sweep,
        start: Start,
    ) -> (Self, RegisteredSweep) {
        // 1. The velocity, and without an IMU the vertical.
        let measured = motion.measured_rotation();
        let rotation_at = measured.as_ref().map(|measured| measured as &RotationAt);
        let sweeps = FirstSweeps::new(&first, rotation_at, settings, start);
        let (to_end, end) = (sweeps.deskewing(&first), sweeps.pose_at(first.end));
        // 2. An earlier pose, which gives the extrapolator the velocity.
        let earliest = motion.extrapolator.last_pose_time().filter(|_| motion.has_imu).unwrap_or(Time::MIN);
        let interval = Duration::from_seconds(VELOCITY_INTERVAL);
        let before = (first.end - interval).max(earliest);
        let pose_before = sweeps.pose_at(before);
        let level = measured.as_ref().map(|measured| measured(first.end));
        drop(measured);
        if !motion.has_imu {
            motion.forget_motion(settings.extrapolator.extrapolator());
        }
        motion.add_pose(before, pose_before);
        motion.add_pose(first.end, end);
        // 3. The first key frame.
        let velocity = end.rotation * start.velocity_in_tracking();
        let gravity = level.map(|level| motion.begin(first.end, &end, velocity, &level));
        let mut keyframes = KeyframePolicy::new(&settings.keyframes);
        keyframes.decide(&Candidate {
            time: first.end,
            local_from_tracking: &end,
            is_standing: false,
            is_wanted: true,
            may_be_ignored: false,
        });
        let deskewed = deskewed(&first.points, &to_end, settings.keeps_intensities);
        let mut registered = RegisteredSweep::new(first, end, gravity, deskewed);
        registered.keyframe = Some(Keyframe { completed_map: None });
        let tracker = Self {
            motion,
            registration: SweepRegistration::new(settings),
            local_map: LocalMap::new(settings, &registered.in_local, registered.local_from_gravity()),
            poles: RecentPoles::new(&settings.poles),
            travel_correlation: TravelCorrelation::new(settings),
            keyframes,
            intervals: settings.degenerate_intervals(),
            fits: FitMonitor::new(&settings.loss),
            last_fitting: Arc::default(),
            fitted_at: registered.sweep.end,
            last_interval: f64::MAX,
            memory: Memory::default(),
            seen: Fingerprint::of("sweeps"),
            settings: settings.clone(),
        };
        (tracker, registered)
    }

    /// Horizontal degenerate translations of the last sweep by planes, in the local map, orthonormal.
    pub fn open_horizontally(&self) -> Vec<nalgebra::Vector2<f64>> {
        self.travel_correlation.horizontal_directions()
    }

    /// A copy of the tracker for trials.
    pub fn fork(&self) -> Self {
        Self { memory: Memory::default(), ..self.clone() }
    }

    /// Points of the last sweep that fitted, in the local map.
    pub fn last_fitting(&self) -> &[Point3f] {
        &self.last_fitting
    }

    /// Whether a sweep with this fit sees mostly surroundings that are not in the map.
    pub fn is_mostly_new(&self, fit: f64) -> bool {
        self.fits.is_mostly_new(fit)
    }

    /// Total fit of sweeps by the points that constrain the motion, if they are tracked from here; the
    /// first of them after the motion `gap`, if given. None, as soon as that is certain, if they do not
    /// fit better than `least`. Passes each sweep to `each`.
    pub fn fit_better(
        &mut self,
        least: f64,
        mut gap: Option<GapMotion>,
        sweeps: &[Sweep],
        issues: &mut Issues,
        mut each: impl FnMut(RegisteredSweep),
    ) -> Option<f64> {
        let mut fit = 0.0;
        for (i, sweep) in sweeps.iter().enumerate() {
            // The fit of a sweep is at most 1, and sums are rounded.
            if fit + (sweeps.len() - i) as f64 + 1e-9 < least {
                return None;
            }
            let registered = self.register(gap.take(), sweep.clone(), None, issues);
            fit += registered.evidence;
            each(registered);
        }
        (fit > least).then_some(fit)
    }

    /// Whether sweeps are missing before one that ends at `end`.
    pub fn is_after_gap(&self, end: Time) -> bool {
        let last = self.motion.extrapolator.last_pose_time();
        let seconds = last.map_or(0.0, |last| end.seconds_since(last));
        // Sweeps of key frames only are always far apart.
        seconds - self.last_interval > self.settings.hypotheses.long_gap
    }

    /// Registers a sweep to the local map; the first one after a gap may come with an assumed motion.
    pub fn register(
        &mut self,
        gap: Option<GapMotion>,
        sweep: Sweep,
        fallback: Option<&mut (dyn Fallback + '_)>,
        issues: &mut Issues,
    ) -> RegisteredSweep {
        // 1. Predict the motion during the sweep: standing, odometry, IMU or constant velocity.
        let (prediction, velocities) = self.predict(gap, &sweep);
        // 2. Register all hypotheses of it to planes and poles, and accept the one that fits best.
        let Found { best, poles } = self.best_hypothesis(&sweep, &prediction, issues);
        // 3. Compare its fit with those of the sweeps before it.
        let is_measured = best.segment.source != MotionSource::ConstantVelocity;
        let support = Support { fit: best.registered.sweep_fit(), is_measured };
        let status = self.fits.after(sweep.end, support, self.is_warming_up());
        // 4. Report directions that the sweep does not constrain.
        let observability = self.observability(sweep.end, &best, prediction.standing.is_some(), issues);
        // 5. De-skew with the registered motion.
        let deskewed = deskewed(&sweep.points, &best.registered.to_end, self.settings.keeps_intensities);
        // 6. Where no plane fits, ask the fallback map; keep a platform at rest at its pose.
        let place = self.place(sweep.end, &best, &deskewed, fallback);
        let measured = self.registration.measured_place(&best, &self.local_map.older().local_from_map);
        // 7. Correct the inertial filter and the extrapolator.
        let measures_rotation =
            best.registered.found.is_some() && status == PoseStatus::Confirmed && !self.is_warming_up();
        let end = SweepEnd {
            time: sweep.end,
            local_from_tracking: &place.local_from_tracking,
            degenerate: &observability.degenerate,
            attenuation: place.attenuation,
            measured: measured.as_ref(),
            is_standing: place.is_standing,
            measures_rotation: place.is_standing || measures_rotation,
            velocities,
        };
        let inertial = prediction.inertial.as_ref().filter(|_| best.reason.is_none());
        let gravity = self.motion.update(&prediction, inertial, &end);
        if prediction.odometry.is_some() && self.motion.odometry_is_contradicted() {
            issues.count(Issue::OdometryOverruled);
        }
        // 8. Insert the sweep into the map, as a key frame or not; not if it contradicts the map.
        let mut result = RegisteredSweep {
            observability,
            status,
            fit: best.registered.fit,
            evidence: best.registered.evidence,
            ..RegisteredSweep::new(sweep, place.local_from_tracking, gravity, deskewed)
        };
        if status == PoseStatus::Confirmed {
            self.show(&mut result, poles, place.is_standing, best.segment.rotation_is_measured());
        } else {
            issues.count(Issue::ContradictsMap);
        }
        result
    }

    /// Prediction for a sweep, and its velocities if they do not follow from the pose before.
    fn predict(&mut self, gap: Option<GapMotion>, sweep: &Sweep) -> (Prediction, Option<Velocities>) {
        let prediction = match &gap {
            Some(motion) => self.motion.predict_after(sweep.end, motion),
            None => self.motion.predict(sweep.end),
        };
        self.last_interval = prediction.segment.seconds();
        match self.travel_correlation.measure(sweep, &prediction.segment) {
            Some(discrepancy) => prediction.corrected(&discrepancy),
            None => (prediction, gap.map(|motion| motion.after)),
        }
    }

    /// Pose at the end of a sweep after this registration.
    fn place(
        &mut self,
        end: Time,
        best: &Registered,
        deskewed: &RangeData,
        fallback: Option<&mut (dyn Fallback + '_)>,
    ) -> Place {
        let mut pose = best.registered.local_from_tracking;
        let mut attenuation = self.attenuation_in_local(best);
        if self.asks_fallback(end, &best.segment, best.registered.found.is_some())
            && let Some(fallback) = fallback
        {
            attenuation = Some(Matrix3::from_diagonal_element(fallback.error().powi(2)));
            pose = fallback.locate(&deskewed.returns, &pose).unwrap_or(pose);
        }
        // Zero-velocity update: a platform at rest stands where the median of its last poses is.
        let standing = self.motion.zero_velocity_update(end, &pose);
        Place { local_from_tracking: standing.unwrap_or(pose), attenuation, is_standing: standing.is_some() }
    }

    /// The covariance of the position error by attenuation, m² in the local map: none where a sweep does
    /// not fit, zero where the accelerometer is not used.
    fn attenuation_in_local(&self, best: &Registered) -> Option<Matrix3<f64>> {
        let found = best.registered.found.as_ref()?;
        if !matches!(best.segment.source, MotionSource::Inertial { .. }) {
            return Some(Matrix3::zeros());
        }
        let turn = self.local_map.older().local_from_map.rotation.to_rotation_matrix();
        Some(turn * found.attenuation * turn.transpose())
    }

    /// Whether the fallback map is asked for a sweep that fits no plane. Grids of a place with few
    /// structures were made by the beams themselves, and hold a scanner at its old position: where a
    /// gyroscope measures the rotation, constant velocity is used for a while first.
    fn asks_fallback(&mut self, end: Time, segment: &TrajectorySegment, fits_planes: bool) -> bool {
        if fits_planes {
            self.fitted_at = end;
        }
        let is_long = end.seconds_since(self.fitted_at) > self.settings.loss.seconds;
        !fits_planes
            && segment.source == MotionSource::ConstantVelocity
            && (!segment.rotation_is_measured() || is_long)
    }

    /// Inserts a sweep that fits into map, poles and travel correlation.
    fn show(
        &mut self,
        registered: &mut RegisteredSweep,
        poles: Option<SeenPoles>,
        is_standing: bool,
        rotation_is_measured: bool,
    ) {
        let end = registered.sweep.end;
        if let Some(poles) = poles {
            self.poles.add(end, registered.local_from_tracking, poles);
        }
        // Without a gyroscope the first sweeps are not de-skewed well enough to be key frames regardless
        // of motion.
        let is_wanted = rotation_is_measured && self.is_warming_up();
        self.last_fitting = Arc::new(registered.in_local.returns.points.clone());
        self.insert(registered, is_standing, is_wanted);
        let place = &registered.local_from_tracking.translation.vector;
        self.travel_correlation.add(end, &registered.in_local.returns.points, place);
    }

    /// Inserts the last sweep into the map, as a key frame if it is one.
    fn insert(&mut self, registered: &mut RegisteredSweep, is_standing: bool, is_wanted: bool) {
        let decision = self.keyframes.decide(&Candidate {
            time: registered.sweep.end,
            local_from_tracking: &registered.local_from_tracking,
            is_standing,
            is_wanted,
            may_be_ignored: !self.is_warming_up(),
        });
        let origin = registered.in_local.origin;
        let is_keyframe = decision == Decision::KeyFrame;
        let is_complete =
            is_keyframe && self.local_map.count_keyframe(origin, registered.local_from_gravity());
        if decision != Decision::Ignored {
            self.local_map.insert(&self.last_fitting, &origin);
        }
        registered.keyframe = is_keyframe.then(|| Keyframe {
            completed_map: is_complete.then(|| self.local_map.take_complete()).flatten(),
        });
    }

    /// Whether the map is made of too few key frames to learn from it.
    pub fn is_warming_up(&self) -> bool {
        self.local_map.is_warming_up()
    }

    /// Sets the memory in which results of sweeps are remembered.
    pub fn remember_with(&mut self, memory: &Memory) {
        self.memory = memory.clone();
    }

    pub fn motion(&self) -> &MotionState {
        &self.motion
    }

    pub fn motion_mut(&mut self) -> &mut MotionState {
        &mut self.motion
    }

    pub fn local_map(&self) -> &LocalMap {
        &self.local_map
    }

    pub fn degenerate_intervals(&self) -> &[DegenerateInterval] {
        self.intervals.all()
    }
}

impl RegisteredSweep {
    /// Without gravity from an IMU, z of the local map has pointed up since the first sweep.
    fn new(
        sweep: Sweep,
        local_from_tracking: Rigid3,
        gravity_from_tracking: Option<Quaternion>,
        deskewed: RangeData,
    ) -> Self {
        Self {
            sweep,
            local_from_tracking,
            gravity_from_tracking: gravity_from_tracking.unwrap_or(local_from_tracking.rotation),
            in_local: deskewed.transformed(&to_f32(&local_from_tracking)),
            deskewed,
            observability: Observability::default(),
            keyframe: None,
            new_piece: None,
            status: PoseStatus::Confirmed,
            fit: 0.0,
            evidence: 0.0,
        }
    }

    /// Moves it to another pose in the local map.
    pub fn place_at(&mut self, local_from_tracking: &Rigid3) {
        self.local_from_tracking = *local_from_tracking;
        self.in_local = self.deskewed.transformed(&to_f32(local_from_tracking));
    }

    /// Rotation from the gravity-aligned frame to the local map, normalised: maps begin with it, and the
    /// next poses follow from them, so that an error of the norm would double with each map.
    pub fn local_from_gravity(&self) -> Quaternion {
        let rotation = self.local_from_tracking.rotation * self.gravity_from_tracking.inverse();
        Quaternion::new_normalize(rotation.into_inner())
    }
}
