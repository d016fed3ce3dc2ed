//! Scan matching in 3D by gradient descent on smooth residuals.

use nalgebra as na;
use portolan_geometry::{Quaternion, Rigid3, Vector3};
use portolan_grids::{HybridGrid, IntensityGrid};
use portolan_sensor::PointCloud;
use portolan_solver::{DenseProblem, NormalEquations, SolverOptions, Summary, solve_dense};

use super::scan_residuals_3d::{IntensityResiduals, OccupiedSpace3d};
use crate::MatcherOptionError;

/// Weights of intensities.
#[derive(Clone, Debug, PartialEq)]
pub struct IntensityCostOptions {
    /// Weight of the intensities of the scan against those of the grid, 1 per unit of intensity.
    pub weight: f64,
    /// Scale of the Huber loss over all of them together.
    pub huber_scale: f64,
    /// Points brighter than this do not count.
    pub intensity_threshold: f32,
}

/// Weights of the kinds of residuals, and stopping criteria.
#[derive(Clone, Debug, PartialEq)]
pub struct GradientMatcherOptions3d {
    /// Weight of each cloud against its grid.
    pub occupied_space_weights: Vec<f64>,
    /// For each cloud the weights of its intensities, as far as there are entries.
    pub intensity_costs: Vec<IntensityCostOptions>,
    /// Weight of the distance from the predicted translation, 1/m.
    pub translation_weight: f64,
    /// Weight of the half-angle from the initial rotation, 1/rad.
    pub rotation_weight: f64,
    /// Whether rotations about other axes than z are left as they are.
    pub only_optimize_yaw: bool,
    /// Stopping criteria.
    pub solver: SolverOptions,
}

impl Default for GradientMatcherOptions3d {
    /// The weights of local SLAM for a fine and a coarse grid: 1 and 6, 5, 400, at most 12 iterations; no
    /// intensities.
    fn default() -> Self {
        Self {
            occupied_space_weights: vec![1.0, 6.0],
            intensity_costs: Vec::new(),
            translation_weight: 5.0,
            rotation_weight: 4e2,
            only_optimize_yaw: false,
            solver: SolverOptions { max_num_iterations: 12, ..Default::default() },
        }
    }
}

/// A cloud and the grid it is matched with.
#[derive(Clone, Copy, Debug)]
pub struct CloudInGrid<'a> {
    /// Metres, in the tracking frame.
    pub cloud: &'a PointCloud,
    /// The grid of earlier scans.
    pub grid: &'a HybridGrid,
    /// Intensities of earlier scans; used if the options have weights for them and the cloud has intensities.
    pub intensities: Option<&'a IntensityGrid>,
}

/// Result of the gradient matcher in 3D.
#[derive(Clone, Debug, PartialEq)]
pub struct GradientMatch3d {
    /// The best pose of the scan in the frame of the grids.
    pub pose: Rigid3,
    /// Costs (half the sum of squared residuals), iterations and why it stopped.
    pub summary: Summary,
    /// `JᵀJ` of the clouds against their grids alone at the best pose, symmetric: by the translation (x, y,
    /// z) and by a rotation vector, both in the frame of the grids. A small eigenvalue means a degenerate
    /// direction (a corridor, an open field).
    pub information: na::Matrix6<f64>,
}

/// Matches scans to grids in 3D by least squares (`slam3d.md` §3.2).
#[derive(Clone, Debug, PartialEq)]
pub struct GradientMatcher3d {
    options: GradientMatcherOptions3d,
}

impl GradientMatcher3d {
    /// A matcher for `num_clouds` clouds at a time.
    ///
    /// # Errors
    /// If a weight, scale or threshold is not positive, or the number of weights is not that of clouds.
    pub fn new(options: &GradientMatcherOptions3d, num_clouds: usize) -> Result<Self, MatcherOptionError> {
        let found = options.occupied_space_weights.len();
        if found != num_clouds {
            let name = "occupied_space_weight";
            return Err(MatcherOptionError::Count { name, expected: num_clouds, found });
        }
        let weights = options.occupied_space_weights.iter().map(|w| ("occupied_space_weight", *w));
        let intensities = options.intensity_costs.iter().flat_map(|o| {
            [
                ("intensity_cost_function_options weight", o.weight),
                ("intensity_cost_function_options huber_scale", o.huber_scale),
                ("intensity_cost_function_options intensity_threshold", f64::from(o.intensity_threshold)),
            ]
        });
        let priors = [
            ("translation_weight", options.translation_weight),
            ("rotation_weight", options.rotation_weight),
        ];
        MatcherOptionError::check_positive(&weights.chain(intensities).chain(priors).collect::<Vec<_>>())?;
        Ok(Self { options: options.clone() })
    }

    /// Finds the pose near `initial` that puts every cloud on occupied cells of its grid, not far from
    /// `target_translation` (metres, in the frame of the grids) and the initial rotation. The i-th cloud
    /// has the i-th weight; clouds without a weight do not count.
    pub fn match_scan(
        &self,
        target_translation: Vector3,
        initial: &Rigid3,
        clouds: &[CloudInGrid<'_>],
    ) -> GradientMatch3d {
        let mut problem = PoseProblem::new(&self.options, target_translation, initial.rotation, clouds);
        let solver = &self.options.solver;
        let (pose, summary) = if self.options.only_optimize_yaw {
            solve_dense::<_, 4>(&mut problem, *initial, solver)
        } else {
            solve_dense::<_, 6>(&mut problem, *initial, solver)
        };
        GradientMatch3d { pose, summary, information: problem.information(&pose) }
    }
}

struct PoseProblem<'a> {
    occupied: Vec<OccupiedSpace3d<'a>>,
    intensities: Vec<IntensityResiduals<'a>>,
    target_translation: Vector3,
    target_rotation: Quaternion,
    translation_weight: f64,
    rotation_weight: f64,
}

impl<'a> PoseProblem<'a> {
    fn new(
        options: &GradientMatcherOptions3d,
        target_translation: Vector3,
        target_rotation: Quaternion,
        clouds: &[CloudInGrid<'a>],
    ) -> Self {
        let weighted = clouds.iter().zip(&options.occupied_space_weights);
        let bright = clouds.iter().zip(&options.intensity_costs);
        Self {
            occupied: weighted.map(|(c, w)| OccupiedSpace3d::new(c.grid, &c.cloud.points, *w)).collect(),
            intensities: bright
                .filter_map(|(c, o)| {
                    let (threshold, huber) = (o.intensity_threshold, o.huber_scale);
                    Some(IntensityResiduals::new(c.intensities?, c.cloud, o.weight, threshold, huber))
                })
                .collect(),
            target_translation,
            target_rotation,
            translation_weight: options.translation_weight,
            rotation_weight: options.rotation_weight,
        }
    }

    fn information(&self, pose: &Rigid3) -> na::Matrix6<f64> {
        let mut normal = NormalEquations::<6>::new();
        for part in &self.occupied {
            part.evaluate(pose, &mut normal);
        }
        // By whole angles, not by half ones.
        let half = na::Vector6::new(1.0, 1.0, 1.0, 0.5, 0.5, 0.5);
        normal.symmetric_hessian().component_mul(&(half * half.transpose()))
    }

    /// Half the sum of squared residuals; adds to the normal equations by the translation and by the
    /// half-angle vector of a rotation applied after the pose's own, or its z alone.
    fn cost<const N: usize>(&self, pose: &Rigid3, normal: &mut NormalEquations<N>) -> f64 {
        let mut cost = 0.0;
        for part in &self.occupied {
            cost += part.evaluate(pose, normal);
        }
        for part in &self.intensities {
            cost += part.evaluate(pose, normal);
        }
        let offset = (pose.translation.vector - self.target_translation) * self.translation_weight;
        let turn = self.target_rotation.inverse() * pose.rotation;
        // q*⁻¹ ⊗ (1, δ) ⊗ q = (1, R*ᵀ δ) ⊗ (q*⁻¹ ⊗ q).
        let by_own_turn = na::Matrix3::identity() * turn.w - turn.imag().cross_matrix();
        let by_turn = by_own_turn * self.target_rotation.inverse().to_rotation_matrix().matrix();
        for i in 0..3 {
            let mut row = na::SVector::<f64, N>::zeros();
            row[i] = self.translation_weight;
            normal.add(offset[i], &row);
            let (residual, by_turn) = (self.rotation_weight * turn.imag()[i], by_turn.row(i));
            let row = na::SVector::<f64, N>::from_fn(|column, _| match column {
                0..3 => 0.0,
                _ if N == 4 => self.rotation_weight * by_turn[2],
                _ => self.rotation_weight * by_turn[column - 3],
            });
            normal.add(residual, &row);
            cost += 0.5 * (offset[i] * offset[i] + residual * residual);
        }
        cost
    }
}

/// The pose moved by `translation`, then rotated by twice a half-angle vector (about the axes of the grid).
fn moved(pose: &Rigid3, translation: Vector3, turn: na::Quaternion<f64>) -> Rigid3 {
    let rotation = Quaternion::new_normalize(turn * pose.rotation.quaternion());
    Rigid3::from_parts((pose.translation.vector + translation).into(), rotation)
}

impl DenseProblem<6> for PoseProblem<'_> {
    type State = Rigid3;

    fn evaluate(&mut self, pose: &Rigid3, normal: Option<&mut NormalEquations<6>>) -> Option<f64> {
        Some(self.cost(pose, normal.unwrap_or(&mut NormalEquations::new())))
    }

    fn plus(&self, pose: &Rigid3, delta: &na::Vector6<f64>) -> Rigid3 {
        let half_angle = Vector3::new(delta[3], delta[4], delta[5]);
        let norm = half_angle.norm();
        let scale = if norm > 0.0 { norm.sin() / norm } else { 1.0 };
        let turn = na::Quaternion::from_parts(norm.cos(), half_angle * scale);
        moved(pose, delta.fixed_rows::<3>(0).into(), turn)
    }

    fn norm(&self, pose: &Rigid3) -> f64 {
        pose.translation.vector.norm().hypot(1.0)
    }
}

impl DenseProblem<4> for PoseProblem<'_> {
    type State = Rigid3;

    fn evaluate(&mut self, pose: &Rigid3, normal: Option<&mut NormalEquations<4>>) -> Option<f64> {
        Some(self.cost(pose, normal.unwrap_or(&mut NormalEquations::new())))
    }

    fn plus(&self, pose: &Rigid3, delta: &na::Vector4<f64>) -> Rigid3 {
        let sine = delta[3].clamp(-0.5, 0.5);
        let turn = na::Quaternion::new((1.0 - sine * sine).sqrt(), 0.0, 0.0, sine);
        moved(pose, delta.fixed_rows::<3>(0).into(), turn)
    }

    fn norm(&self, pose: &Rigid3) -> f64 {
        pose.translation.vector.norm().hypot(1.0)
    }
}

#[cfg(test)]
mod tests;
