//! Unknowns besides the trajectory: seven for each sensor that is calibrated.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, SMatrix, SVector};
use portolan_geometry::Vector3;

use super::block_tridiagonal::BlockTridiagonal;
use super::information::LEAST_SHARE;
use crate::MAX_SENSORS;

/// Number of unknowns of a sensor: translation, rotation (tracking frame, about the sensor), and delay.
pub(crate) const PER_SENSOR: usize = 7;
/// Prior standard deviations of extrinsics (metres, radians) and stamps (seconds). They are wide, so that
/// they only affect directions that the motion does not determine.
pub(crate) const PRIOR: [f64; 3] = [0.2, 0.1, 0.1];

/// Which sensors are calibrated.
#[derive(Clone, Debug, Default)]
pub(crate) struct SensorUnknowns {
    /// Their numbers.
    pub sensors: Vec<usize>,
    /// Their positions in the tracking frame.
    pub origins: Vec<Vector3>,
}

impl SensorUnknowns {
    pub fn size(&self) -> usize {
        PER_SENSOR * self.sensors.len()
    }

    pub fn is_empty(&self) -> bool {
        self.sensors.is_empty()
    }

    /// For each sensor its index among the unknowns.
    pub fn columns(&self) -> [Option<usize>; MAX_SENSORS] {
        std::array::from_fn(|sensor| self.sensors.iter().position(|s| *s == sensor))
    }

    /// Inverse variances of the prior.
    pub fn prior(&self) -> Vec<f64> {
        let weight = |k: usize| 1.0 / PRIOR[k / 3].powi(2);
        (0..self.size()).map(|i| weight(i % PER_SENSOR)).collect()
    }
}

/// Estimate for a sensor in one step.
#[derive(Clone, Debug)]
pub(crate) struct SensorIncrement {
    pub sensor: usize,
    pub value: [f64; PER_SENSOR],
    /// Covariance, if requested.
    pub covariance: Option<SMatrix<f64, PER_SENSOR, PER_SENSOR>>,
}

/// The preconditioner: the block-tridiagonal part of the knots, bordered by the other unknowns, exactly.
pub(crate) struct Bordered {
    pub knots: BlockTridiagonal,
    /// Full columns of the matrix for the other unknowns, with their part over the knots.
    border: Vec<Vec<f64>>,
    /// That part with the knots eliminated.
    solved: Vec<Vec<f64>>,
    /// The Schur complement of the other unknowns, factorised.
    rest: Option<Cholesky<f64, Dyn>>,
}

impl Bordered {
    /// With the full columns of the other unknowns; none if the matrix is not positive definite.
    pub fn new(knots: BlockTridiagonal, columns: Vec<Vec<f64>>) -> Option<Self> {
        let count = columns.len();
        if count == 0 {
            return Some(Self { knots, border: Vec::new(), solved: Vec::new(), rest: None });
        }
        let size = columns[0].len() - count;
        let solved: Vec<Vec<f64>> = columns
            .iter()
            .map(|column| {
                let mut x = column[..size].to_vec();
                knots.solve(&mut x);
                x
            })
            .collect();
        let rest = DMatrix::from_fn(count, count, |r, c| {
            let corner = 0.5 * (columns[c][size + r] + columns[r][size + c]);
            corner - 0.5 * (dot(&columns[r][..size], &solved[c]) + dot(&columns[c][..size], &solved[r]))
        });
        Some(Self { knots, border: columns, solved, rest: Some(Cholesky::new(rest)?) })
    }

    /// Solves in place.
    pub fn solve(&self, x: &mut [f64]) {
        let Some(rest) = &self.rest else { return self.knots.solve(x) };
        let size = x.len() - self.border.len();
        let (knots, others) = x.split_at_mut(size);
        self.knots.solve(knots);
        // The border is symmetric: Bᵀ P⁻¹ r, P⁻¹ r being what the knots hold now.
        let right = DVector::from_fn(others.len(), |i, _| others[i] - dot(&self.border[i][..size], knots));
        let solution = rest.solve(&right);
        for (column, value) in self.solved.iter().zip(solution.iter()) {
            for (x, s) in knots.iter_mut().zip(column) {
                *x -= s * value;
            }
        }
        others.copy_from_slice(solution.as_slice());
    }
}

pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The blocks of each sensor on the diagonal of a covariance.
pub(crate) fn blocks(covariance: &DMatrix<f64>) -> Vec<SMatrix<f64, PER_SENSOR, PER_SENSOR>> {
    (0..covariance.nrows() / PER_SENSOR)
        .map(|i| covariance.fixed_view::<PER_SENSOR, PER_SENSOR>(PER_SENSOR * i, PER_SENSOR * i).into_owned())
        .collect()
}

/// Realistic standard deviations: a direction of translation or rotation with much less information than the
/// best one is observed only through errors of normals, that is, not at all.
pub(crate) fn capped_deviations(covariance: &SMatrix<f64, PER_SENSOR, PER_SENSOR>) -> [f64; PER_SENSOR] {
    let mut deviations = [covariance[(6, 6)].max(0.0).sqrt(); PER_SENSOR];
    for (first, prior) in [(0, PRIOR[0]), (3, PRIOR[1])] {
        let block = covariance.fixed_view::<3, 3>(first, first).into_owned();
        let eigen = nalgebra::SymmetricEigen::new((block + block.transpose()) * 0.5);
        let least = eigen.eigenvalues.min().max(0.0);
        for k in 0..3 {
            let variance = (0..3).map(|i| {
                let own = eigen.eigenvalues[i].max(0.0);
                let variance_used = if own * LEAST_SHARE > least { prior * prior } else { own };
                variance_used * eigen.eigenvectors[(k, i)].powi(2)
            });
            deviations[first + k] = variance.sum::<f64>().sqrt();
        }
    }
    deviations
}

/// Seven numbers of a slice.
pub(crate) fn seven(values: &[f64]) -> [f64; PER_SENSOR] {
    SVector::<f64, PER_SENSOR>::from_column_slice(&values[..PER_SENSOR]).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix6;

    #[test]
    fn bordered_systems_are_solved_exactly() {
        let size = 12;
        let full = DMatrix::from_fn(size + 2, size + 2, |r, c| {
            let near = if r < size && c < size && (r / 6).abs_diff(c / 6) > 1 { 0.0 } else { 1.0 };
            near * (((r * 5 + c * 5) % 7) as f64 / 7.0 + if r == c { 9.0 } else { 0.0 })
        });
        let block = |r: usize, c: usize| Matrix6::from_fn(|i, k| full[(6 * r + i, 6 * c + k)]);
        let knots = BlockTridiagonal::factorize(&[block(0, 0), block(1, 1)], vec![block(1, 0)]).unwrap();
        let columns = (0..2).map(|c| full.column(size + c).iter().copied().collect()).collect();
        let bordered = Bordered::new(knots, columns).unwrap();
        let mut x: Vec<f64> = (0..size + 2).map(|i| (i as f64).cos()).collect();
        let right = DVector::from_column_slice(&x);
        bordered.solve(&mut x);
        assert!((full * DVector::from_column_slice(&x) - right).norm() < 1e-9);
    }
}
