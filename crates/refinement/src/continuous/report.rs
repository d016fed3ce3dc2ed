//! What a refinement did, and what it could not know.

use serde::Serialize;

use super::{ContinuousOptions, DenseTrajectory, OdometryNoise};
use crate::semi_rigid::SemiRigidOptions;
use crate::{LeftOutPoints, Sharpness};

/// How far a refinement is.
#[derive(Clone, Debug)]
pub struct RefineProgress {
    /// What was just done, for people.
    pub stage: String,
    /// Share that is done, 0 to 1; an estimate, because stages end when nothing moves any more.
    pub share: f64,
    /// Root mean square distance of points (or of paired patches) across their surfaces, metres.
    pub rms: f64,
    /// Largest shift of the last step, metres.
    pub shift: f64,
}

/// One step of the optimisation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RefineStep {
    /// "coarse" (pairs of patches), "fine" (planes) or "sections" (semi-rigid).
    pub stage: &'static str,
    /// Seconds between knots.
    pub knot_spacing: f64,
    /// Largest distance of a pair, or the gap that separates planes, metres.
    pub reach: f64,
    /// Pairs of patches, or clusters of points.
    pub terms: usize,
    /// Root of the weighted mean square distance before the step, metres.
    pub rms: f64,
    /// Largest shift of a knot, metres.
    pub shift: f64,
}

/// A direction that the surfaces seen during some time do not determine.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Undetermined {
    /// Seconds since the start of the trajectory.
    pub from: f64,
    /// Seconds since the start of the trajectory.
    pub to: f64,
    /// Whether it is a turn about the direction rather than a shift along it.
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

/// What a refinement did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RefineReport {
    /// How, and with which options.
    pub method: Method,
    /// All steps in order.
    pub steps: Vec<RefineStep>,
    /// Points that were looked at in each round.
    pub points: usize,
    /// Points before the first pose, after the last, or in gaps of the trajectory; they are not used.
    pub points_outside_trajectory: usize,
    /// Points left out when they were read.
    pub left_out: LeftOutPoints,
    /// Gaps of the trajectory (from, to; seconds since its start) that are too long to interpolate.
    pub gaps: Vec<[f64; 2]>,
    /// Share of the points that lie on planar patches at the end, 0 to 1, if the method looks for patches.
    pub planar_share: Option<f64>,
    /// Sharpness with the input; none if there are too few points.
    pub sharpness_before: Option<Sharpness>,
    /// Sharpness with the result.
    pub sharpness_after: Option<Sharpness>,
    /// How wrong the motion of the input was found to be.
    pub odometry_found: OdometryNoise,
    /// Largest shift of the result against the input, metres.
    pub largest_shift: f64,
    /// Largest turn of the result against the input, radians.
    pub largest_turn: f64,
    /// What is not determined and was left as the input has it.
    pub undetermined: Vec<Undetermined>,
    /// The result was less sharp than the input, which was therefore kept.
    pub kept_input: bool,
    /// It was stopped before it had converged.
    pub stopped: bool,
    /// What the user should look at.
    pub warnings: Vec<String>,
}

/// A refined trajectory.
#[derive(Clone, Debug)]
pub struct Refined {
    /// The trajectory.
    pub trajectory: DenseTrajectory,
    /// What was done.
    pub report: RefineReport,
}
