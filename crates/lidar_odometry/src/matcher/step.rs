//! One step of a match: what planes say and what was believed before, weighed against each other.

use nalgebra as na;
use portolan_geometry::Vector3;

use super::sums::Sums;
use super::{Sigmas, WayPrior, WeakDirections};
use crate::way::WayCorrection;

/// The prior holds this many times more than the points in a direction in which they do not.
const PRIOR_IN_WEAK_DIRECTIONS: f64 = 30.0;
/// Planes whose normals are all that seems to tell a shift hold the scanner where it was when they were made, so far from
/// where it is, metres: it goes so far until other planes are seen. Walks through parks without wheels come out alike
/// with 0.01 to 0.1; without it four of twelve were 0.025 to 0.043 m off instead of 0.005 to 0.014.
const HELD: f64 = 0.03;
const MOST_HELD: f64 = 1.0;

/// How far points may be off because errors of normals pass for information: as with all errors in variables the shift
/// comes out too small, by the feigned share of the information.
pub(super) struct Held {
    /// Unit vectors as columns, in the frame of the surfaces.
    directions: na::Matrix3<f64>,
    /// Along each, m².
    variances: Vector3,
}

impl Held {
    pub fn by(sums: &Sums) -> Self {
        let told = na::SymmetricEigen::new(sums.hessian.fixed_view::<3, 3>(0, 0) - sums.doubtful[0]);
        let variance =
            |told: f64| (HELD * sums.feigned_shift / told.max(f64::MIN_POSITIVE)).min(MOST_HELD).powi(2);
        Self { directions: told.eigenvectors, variances: told.eigenvalues.map(variance) }
    }

    pub fn covariance(&self) -> na::Matrix3<f64> {
        self.directions * na::Matrix3::from_diagonal(&self.variances) * self.directions.transpose()
    }

    /// How many times stiffer a prior is beside points of so much information (1/m²) than if these were not held.
    fn stiffening(&self, information: &na::Matrix3<f64>) -> na::Matrix3<f64> {
        let columns = self.directions.column_iter().zip(&self.variances);
        columns.fold(na::Matrix3::identity(), |sum, (direction, variance)| {
            sum + direction * direction.transpose() * (direction.dot(&(information * direction)) * variance)
        })
    }
}

/// One Gauss-Newton step of points and prior together.
pub(super) fn solve(
    sums: &Sums,
    correction: &WayCorrection,
    prior: &WayPrior,
    weak: &WeakDirections,
    held: Option<&Held>,
) -> Option<WayCorrection> {
    let stiffness = |sigmas: &Sigmas| {
        let mut stiffness = na::Matrix6::zeros();
        for (at, sigma, directions) in
            [(0, sigmas.shift, &weak.translations), (3, sigmas.turn, &weak.rotations)]
        {
            let information = sums.hessian.fixed_view::<3, 3>(at, at).into_owned();
            let mut block = na::Matrix3::from_diagonal_element(1.0 / (sigma * sigma));
            match held.filter(|_| at == 0) {
                Some(held) => block *= held.stiffening(&information),
                None => {
                    for direction in directions {
                        let told = direction.dot(&(information * direction)).abs();
                        block += direction * direction.transpose() * (PRIOR_IN_WEAK_DIRECTIONS * told);
                    }
                }
            }
            stiffness.fixed_view_mut::<3, 3>(at, at).copy_from(&block);
        }
        stiffness
    };
    let (by_start, by_bend) = (stiffness(&prior.start), stiffness(&prior.bend));
    let mut hessian = na::SMatrix::<f64, 12, 12>::zeros();
    hessian.fixed_view_mut::<6, 6>(0, 0).copy_from(&(sums.hessian + by_start));
    hessian.fixed_view_mut::<6, 6>(0, 6).copy_from(&sums.between);
    hessian.fixed_view_mut::<6, 6>(6, 0).copy_from(&sums.between.transpose());
    hessian.fixed_view_mut::<6, 6>(6, 6).copy_from(&(sums.bend_hessian + by_bend));
    let mut gradient = na::SVector::<f64, 12>::zeros();
    gradient.fixed_rows_mut::<6>(0).copy_from(&(sums.gradient + by_start * correction.start));
    gradient.fixed_rows_mut::<6>(6).copy_from(&(sums.bend_gradient + by_bend * correction.bend));
    let step = hessian.cholesky()?.solve(&-gradient);
    let (start, bend) = (step.fixed_rows::<6>(0).into(), step.fixed_rows::<6>(6).into());
    step.iter().all(|v| v.is_finite()).then_some(WayCorrection { start, bend })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_normals_hold_what_they_feign() {
        let mut sums = Sums { feigned_shift: 10.0, ..Sums::default() };
        sums.hessian.fixed_view_mut::<3, 3>(0, 0).set_diagonal(&na::Vector3::new(1e5, 20.0, 0.0));
        let held = Held::by(&sums).covariance();
        let expected = [HELD * 1e-4, HELD * 0.5, MOST_HELD].map(|error| error * error);
        assert!((held.diagonal() - na::Vector3::from(expected)).norm() < 1e-9, "{held}");
        // Beside points whose information is twice what is feigned a prior of their own error weighs as much as they.
        let information = na::Matrix3::from_diagonal_element((HELD * 0.5).powi(-2));
        let stiffer = Held::by(&sums).stiffening(&information);
        assert!((stiffer[(1, 1)] - 2.0).abs() < 1e-9 && (stiffer[(0, 0)] - 1.0).abs() < 1e-6, "{stiffer}");
    }
}
