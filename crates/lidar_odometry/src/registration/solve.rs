//! Solves one Gauss-Newton step of points and prior.

use nalgebra as na;
use portolan_motion::DegenerateDirections;

use super::attenuation::Attenuation;
use super::normal_equations::NormalEquations;
use super::{MotionPrior, Sigmas};
use crate::segment::SegmentCorrection;
use crate::settings::constants::registration::DEGENERATE_PRIOR_FACTOR;

/// A step.
pub(super) struct Step {
    pub correction: SegmentCorrection,
    /// Its squared length in standard deviations of the result: `δᵀ H δ`, with the information of points and prior (the Newton
    /// decrement: Boyd and Vandenberghe, "Convex Optimization", section 9.5.1).
    pub squared_decrement: f64,
}

/// The step of start and growth together, twelve unknowns:
///
/// ```text
/// [ H + P_s    C       ] [ δ_start  ]      [ g   + P_s x_start  ]
/// [ Cᵀ         G + P_g ] [ δ_growth ]  = − [ g_g + P_g x_growth ]
/// ```
///
/// with the information H, C, G of the points and P of the prior, which is increased in degenerate
/// directions.
pub(super) fn solve(
    equations: &NormalEquations,
    correction: &SegmentCorrection,
    prior: &MotionPrior,
    degenerate: &DegenerateDirections,
    attenuation: &Attenuation,
) -> Option<Step> {
    let stiffness = |sigmas: &Sigmas| {
        let mut stiffness = na::Matrix6::zeros();
        for (at, sigma, directions) in
            [(0, sigmas.translation, &degenerate.translations), (3, sigmas.rotation, &degenerate.rotations)]
        {
            let information = equations.hessian.fixed_view::<3, 3>(at, at).into_owned();
            let mut block = na::Matrix3::from_diagonal_element(1.0 / (sigma * sigma));
            if at == 0 && prior.compensates_attenuation {
                block *= attenuation.stiffening(&information);
            } else {
                for direction in directions {
                    let known = direction.dot(&(information * direction)).abs();
                    block += direction * direction.transpose() * (DEGENERATE_PRIOR_FACTOR * known);
                }
            }
            stiffness.fixed_view_mut::<3, 3>(at, at).copy_from(&block);
        }
        stiffness
    };
    let (by_start, by_growth) = (stiffness(&prior.start), stiffness(&prior.growth));
    let mut hessian = na::SMatrix::<f64, 12, 12>::zeros();
    hessian.fixed_view_mut::<6, 6>(0, 0).copy_from(&(equations.hessian + by_start));
    hessian.fixed_view_mut::<6, 6>(0, 6).copy_from(&equations.cross_hessian);
    hessian.fixed_view_mut::<6, 6>(6, 0).copy_from(&equations.cross_hessian.transpose());
    hessian.fixed_view_mut::<6, 6>(6, 6).copy_from(&(equations.growth_hessian + by_growth));
    let mut gradient = na::SVector::<f64, 12>::zeros();
    gradient.fixed_rows_mut::<6>(0).copy_from(&(equations.gradient + by_start * correction.start));
    gradient.fixed_rows_mut::<6>(6).copy_from(&(equations.growth_gradient + by_growth * correction.growth));
    let step = hessian.cholesky()?.solve(&-gradient);
    let (start, growth) = (step.fixed_rows::<6>(0).into(), step.fixed_rows::<6>(6).into());
    let squared_decrement = -gradient.dot(&step);
    let correction = SegmentCorrection { start, growth };
    step.iter().all(|v| v.is_finite()).then_some(Step { correction, squared_decrement })
}
