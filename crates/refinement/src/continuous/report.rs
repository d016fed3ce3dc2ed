//! The report of a refinement: results, and what could not be determined.

use serde::Serialize;

use super::correction::Corrections;
use super::{
    ContinuousOptions, CrossValidation, DenseTrajectory, Jump, Mounting, OdometryNoise, OtherSensorsFound,
    PoseMatrices, SensorCorrection,
};
use crate::semi_rigid::SemiRigidOptions;
use crate::{LeftOutPoints, PointStore, StoredPoint, StoredSensor};
use portolan_spatial::Sharpness;

/// Progress of a refinement.
#[derive(Clone, Debug)]
pub struct RefineProgress {
    /// The work that was just done or begins, for users.
    pub stage: String,
    /// Fraction that is done, 0 to 1; an estimate, because stages end at convergence.
    pub share: f64,
    /// Root mean square distance of points (or of paired patches) across their surfaces after the last step,
    /// metres; none before the first one.
    pub rms: Option<f64>,
    /// Largest translation of the last step, metres.
    pub shift: Option<f64>,
    /// Mean map entropy after the last round ([`RefineReport::sharpness_by_round`]); lower is sharper.
    pub entropy: Option<f64>,
}

/// Sharpness of the cloud after a round. It is measured with fewer points than before and after the whole
/// refinement, so the values can only be compared with each other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RoundSharpness {
    /// Number of steps made before; 0 for the input.
    pub steps: usize,
    /// Mean of `½ ln det(2πe Σ)` over the neighbourhoods.
    pub mean_map_entropy: f64,
    /// Mean variance across the surfaces, square metres.
    pub mean_plane_variance: f64,
}

/// One step of the optimisation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RefineStep {
    /// "near in time" and "coarse" (pairs of patches), "fine" (planes) or "sections" (semi-rigid).
    pub stage: &'static str,
    /// Seconds between knots.
    pub knot_spacing: f64,
    /// Largest distance of a pair, or the gap that separates planes, metres.
    pub reach: f64,
    /// Pairs of patches, or clusters of points.
    pub terms: usize,
    /// Root of the weighted mean square distance before the step, metres.
    pub rms: f64,
    /// Largest translation of a knot, metres.
    pub shift: f64,
}

/// A direction that the surfaces seen during some time do not determine.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Undetermined {
    /// Seconds since the start of the trajectory.
    pub from: f64,
    /// Seconds since the start of the trajectory.
    pub to: f64,
    /// Whether it is a rotation about the direction rather than a translation along it.
    pub is_rotation: bool,
    /// Unit vector in the world.
    pub direction: [f64; 3],
}

/// A method and its options.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// [`crate::continuous::refine_continuous`].
    Continuous(ContinuousOptions),
    /// [`crate::semi_rigid::refine_semi_rigid`].
    SemiRigid(SemiRigidOptions),
}

/// Report of a refinement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RefineReport {
    /// Method and options.
    pub method: Method,
    /// All steps in order.
    pub steps: Vec<RefineStep>,
    /// Points that were used in each round.
    pub points: usize,
    /// Points before the first pose, after the last, or in gaps of the trajectory; they are not used.
    pub points_outside_trajectory: usize,
    /// Points left out when they were read.
    pub left_out: LeftOutPoints,
    /// Gaps of the trajectory (from, to; seconds since its start) that are too long to interpolate.
    pub gaps: Vec<[f64; 2]>,
    /// Jumps of the trajectory that were removed before it was refined.
    pub jumps: Vec<Jump>,
    /// Fraction of the points on planar patches at the end, 0 to 1, if the method extracts patches.
    pub planar_fraction: Option<f64>,
    /// Sharpness with the input; none if there are too few points.
    pub sharpness_before: Option<Sharpness>,
    /// Sharpness with the result.
    pub sharpness_after: Option<Sharpness>,
    /// Sharpness of the cloud after each round.
    pub sharpness_by_round: Vec<RoundSharpness>,
    /// The lidars.
    pub sensors: Vec<StoredSensor>,
    /// Mountings of the lidars relative to the first one: the result of the calibration, or, without
    /// calibration, what it would be.
    pub mountings: Vec<Mounting>,
    /// Whether they were applied.
    pub calibrated: bool,
    /// Mounting of the IMU relative to the tracking frame; not applied.
    pub imu: Option<Mounting>,
    /// Estimates of the other sensors' parameters.
    pub other_sensors: OtherSensorsFound,
    /// Estimated noise of the motion of the input.
    pub odometry_found: OdometryNoise,
    /// Largest translation of the result against the input, metres.
    pub largest_translation: f64,
    /// Largest rotation of the result against the input, radians.
    pub largest_rotation: f64,
    /// Undetermined directions, in which the input was kept.
    pub undetermined: Vec<Undetermined>,
    /// Seconds without a returning pass: there the motion of the input over more than two seconds was kept,
    /// since nothing determines a correction of it.
    pub long_shape_held_seconds: f64,
    /// Agreement of surfaces that were held out of the fit; none if there are too few, or with another
    /// method.
    pub cross_validation: Option<CrossValidation>,
    /// Whether the input was kept: the result was less sharp, or surfaces held out of the fit agreed less
    /// with it.
    pub kept_input: bool,
    /// Whether it was stopped before convergence.
    pub stopped: bool,
    /// Warnings for the user.
    pub warnings: Vec<String>,
}

impl RefineReport {
    /// The report of a refinement before its first step.
    pub(crate) fn new(method: Method, odometry: OdometryNoise) -> Self {
        Self {
            method,
            steps: Vec::new(),
            points: 0,
            points_outside_trajectory: 0,
            left_out: LeftOutPoints::default(),
            gaps: Vec::new(),
            jumps: Vec::new(),
            planar_fraction: None,
            sharpness_before: None,
            sharpness_after: None,
            sharpness_by_round: Vec::new(),
            sensors: Vec::new(),
            mountings: Vec::new(),
            calibrated: false,
            imu: None,
            other_sensors: OtherSensorsFound::default(),
            odometry_found: odometry,
            largest_translation: 0.0,
            largest_rotation: 0.0,
            undetermined: Vec::new(),
            long_shape_held_seconds: 0.0,
            cross_validation: None,
            kept_input: false,
            stopped: false,
            warnings: Vec::new(),
        }
    }
}

/// A refined trajectory.
#[derive(Clone, Debug)]
pub struct Refined {
    /// The trajectory.
    pub trajectory: DenseTrajectory,
    /// The report.
    pub report: RefineReport,
    pub(crate) corrections: Corrections,
    /// Intervals of time that the trajectory covers, seconds.
    pub(crate) intervals: Vec<[f64; 2]>,
}

/// A point in the world, before and after.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedPoint {
    /// Seconds since [`PointStore::start`], by the clock of the recording.
    pub seconds: f64,
    /// Index of its sensor in [`PointStore::sensors`].
    pub sensor: usize,
    /// Position with the input, metres.
    pub before: [f64; 3],
    /// Position with the result, metres.
    pub after: [f64; 3],
}

/// Places points with input and result, one by one, so that clouds of any size can be streamed.
#[derive(Clone, Debug)]
pub struct BeforeAndAfter<'a> {
    points: &'a PointStore,
    refined: &'a Refined,
    offset: f64,
    input: PoseMatrices,
    result: PoseMatrices,
}

impl<'a> BeforeAndAfter<'a> {
    /// For the points that were used in the refinement.
    pub fn new(points: &'a PointStore, refined: &'a Refined) -> Self {
        let trajectory = &refined.trajectory;
        Self {
            points,
            refined,
            offset: points.start().seconds_since(trajectory.start()),
            input: trajectory.input_matrices(),
            result: trajectory.matrices(),
        }
    }

    /// All points that the trajectory covers, in order of time.
    pub fn iter(&self) -> impl Iterator<Item = PlacedPoint> {
        let points = self.points.points();
        let of_interval = |[from, to]: &[f64; 2]| {
            let start = points.partition_point(|p| p.seconds() + self.offset < *from);
            let end = points.partition_point(|p| p.seconds() + self.offset < *to);
            &points[start..end]
        };
        self.refined.intervals.iter().flat_map(of_interval).map(|p| self.place(p))
    }

    /// One point.
    #[inline]
    pub fn place(&self, point: &StoredPoint) -> PlacedPoint {
        let (seconds, sensor) = (point.seconds() + self.offset, point.sensor());
        let before = self.input.to_world(seconds, point.in_tracking);
        let (corrected, in_tracking) = self.refined.corrections.place(sensor, seconds, point.in_tracking);
        let after = self.result.to_world(corrected, in_tracking);
        PlacedPoint { seconds: point.seconds(), sensor, before, after }
    }
}

impl Refined {
    /// Estimated correction of the extrinsics and the clock of a sensor; identity without calibration.
    pub fn correction(&self, sensor: usize) -> SensorCorrection {
        *self.corrections.of(sensor.min(crate::MAX_SENSORS - 1))
    }
}
