//! The 2D matcher: occupied space, translation and rotation in one small least-squares problem.

use nalgebra as na;
use portolan_geometry::{Rigid2, Vector2};
use portolan_grids::Grid2d;
use portolan_sensor::PointCloud;
use portolan_solver::{DenseProblem, NormalEquations, SolverOptions, Summary, solve_dense};

use super::occupied_space_2d::OccupiedSpace2d;
use super::signed_distance_2d::SignedDistance;
use crate::MatcherOptionError;

/// Weights of the three kinds of residuals, and stopping criteria.
#[derive(Clone, Debug, PartialEq)]
pub struct GradientMatcherOptions2d {
    /// Weight of the scan against the grid.
    pub occupied_space_weight: f64,
    /// Weight of the distance from the predicted translation, 1/m.
    pub translation_weight: f64,
    /// Weight of the distance from the initial rotation, 1/rad.
    pub rotation_weight: f64,
    /// Stopping criteria.
    pub solver: SolverOptions,
}

impl Default for GradientMatcherOptions2d {
    /// The weights of local SLAM: 1, 10, 40, at most 20 iterations.
    fn default() -> Self {
        let solver = SolverOptions { max_num_iterations: 20, ..Default::default() };
        Self { occupied_space_weight: 1.0, translation_weight: 10.0, rotation_weight: 40.0, solver }
    }
}

/// Result of the 2D gradient matcher.
#[derive(Clone, Debug, PartialEq)]
pub struct GradientMatch2d {
    /// The best pose of the scan in the frame of the grid.
    pub pose: Rigid2,
    /// Costs (half the sum of squared residuals), iterations and why it stopped.
    pub summary: Summary,
    /// `JᵀJ` of (x, y, θ) of the occupied-space residuals alone at the best pose, symmetric: the information
    /// of the scan without the priors. A small eigenvalue means a degenerate direction (a corridor).
    pub information: na::Matrix3<f64>,
}

/// Matches scans to 2D grids by least squares.
#[derive(Clone, Debug, PartialEq)]
pub struct GradientMatcher2d {
    options: GradientMatcherOptions2d,
}

impl GradientMatcher2d {
    /// # Errors
    /// If a weight is not positive.
    pub fn new(options: &GradientMatcherOptions2d) -> Result<Self, MatcherOptionError> {
        MatcherOptionError::check_positive(&[
            ("occupied_space_weight", options.occupied_space_weight),
            ("translation_weight", options.translation_weight),
            ("rotation_weight", options.rotation_weight),
        ])?;
        Ok(Self { options: options.clone() })
    }

    /// Finds the pose near `initial` that puts `points` (metres, in the gravity-aligned tracking frame)
    /// on occupied cells of `grid`, not far from `target_translation` (metres, in the frame of the
    /// grid) and the initial rotation. On a distance field that no point meets the result is the
    /// initial pose, with [`portolan_solver::Termination::EvaluationFailed`].
    pub fn match_scan(
        &self,
        target_translation: Vector2,
        initial: &Rigid2,
        points: &PointCloud,
        grid: &Grid2d,
    ) -> GradientMatch2d {
        let weight = self.options.occupied_space_weight;
        let scan = match grid {
            Grid2d::Probability(g) => {
                ScanResiduals::Probability(OccupiedSpace2d::new(g, &points.points, weight))
            }
            Grid2d::Tsdf(g) => ScanResiduals::Tsdf(SignedDistance::new(g, &points.points, weight)),
        };
        let mut problem = PoseProblem {
            scan,
            target_translation,
            target_angle: initial.angle,
            translation_weight: self.options.translation_weight,
            rotation_weight: self.options.rotation_weight,
        };
        let (pose, summary) = solve_dense(&mut problem, *initial, &self.options.solver);
        let mut normal = NormalEquations::new();
        let _ = problem.scan.evaluate(&pose, Some(&mut normal));
        GradientMatch2d { pose, summary, information: normal.symmetric_hessian() }
    }
}

enum ScanResiduals<'a> {
    Probability(OccupiedSpace2d<'a>),
    Tsdf(SignedDistance<'a>),
}

impl ScanResiduals<'_> {
    fn evaluate(&self, pose: &Rigid2, normal: Option<&mut NormalEquations<3>>) -> Option<f64> {
        match self {
            Self::Probability(r) => Some(r.evaluate(pose, normal)),
            Self::Tsdf(r) => r.evaluate(pose, normal),
        }
    }
}

struct PoseProblem<'a> {
    scan: ScanResiduals<'a>,
    target_translation: Vector2,
    target_angle: f64,
    translation_weight: f64,
    rotation_weight: f64,
}

impl DenseProblem<3> for PoseProblem<'_> {
    type State = Rigid2;

    fn evaluate(&mut self, pose: &Rigid2, mut normal: Option<&mut NormalEquations<3>>) -> Option<f64> {
        let mut cost = self.scan.evaluate(pose, normal.as_deref_mut())?;
        let offset = pose.translation - self.target_translation;
        let priors = [
            (self.translation_weight, offset.x),
            (self.translation_weight, offset.y),
            (self.rotation_weight, pose.angle - self.target_angle),
        ];
        for (i, (weight, difference)) in priors.into_iter().enumerate() {
            cost += 0.5 * (weight * difference).powi(2);
            if let Some(normal) = normal.as_deref_mut() {
                normal.hessian[(i, i)] += weight * weight;
                normal.gradient[i] += weight * weight * difference;
            }
        }
        Some(cost)
    }

    fn plus(&self, pose: &Rigid2, delta: &na::Vector3<f64>) -> Rigid2 {
        Rigid2 { translation: pose.translation + delta.xy(), angle: pose.angle + delta.z }
    }

    fn norm(&self, pose: &Rigid2) -> f64 {
        pose.translation.norm().hypot(pose.angle)
    }
}

#[cfg(test)]
mod tests;
