//! The normal equations of a scan, summed over all points.
//!
//! Rows are summed in blocks of single precision, blocks in double precision: the inner loop is a few
//! vector instructions per point.

use nalgebra as na;

/// Number of points that are summed in single precision before the sum is added to the total.
const BLOCK: u32 = 64;
/// Entries of a row: three of the translation, three of the rotation, the residual, and a spare one.
const ROW: usize = 8;
const RESIDUAL: usize = 6;

/// Sums over the points of a trajectory segment.
#[derive(Default)]
pub(crate) struct NormalEquations {
    /// With respect to corrections of the start, which move all points alike.
    pub hessian: na::Matrix6<f64>,
    pub gradient: na::Vector6<f64>,
    /// With respect to growing corrections, which move every point by the fraction of its time, and to
    /// both.
    pub growth_hessian: na::Matrix6<f64>,
    pub growth_gradient: na::Vector6<f64>,
    pub cross_hessian: na::Matrix6<f64>,
    /// Sum of weights times the squared errors of normals: information about any translation that may be
    /// spurious, 1/m².
    pub spurious_translation: f64,
    /// Information about rotations that may be spurious, as a quadratic form of their axis: weights times
    /// squared errors of normals times squared distances from the axis.
    pub spurious_rotation: na::Matrix3<f64>,
    /// Information of unreliable planes about translations and rotations: the part of the Hessian that is
    /// ignored in the search for degenerate directions.
    pub unreliable: [na::Matrix3<f64>; 2],
    /// Points that are on planes.
    pub matched: Matched,
}

/// Counts of the points of a scan that are on planes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Matched {
    pub points: usize,
    /// Number of points on reliable planes.
    pub reliable: usize,
    /// The sum of their squared distances, m².
    pub squares: f64,
}

/// Adds up products of rows.
#[derive(Default)]
pub(crate) struct Accumulator {
    block: [[f32; ROW]; 6],
    block_weights: [f32; 2],
    in_block: u32,
    total: [[f64; ROW]; 6],
    weights: [f64; 2],
    moments: na::Matrix3<f64>,
    unreliable: [na::Matrix3<f64>; 2],
    matched: usize,
    matched_unreliable: usize,
    sums: NormalEquations,
    /// Number of neighbouring points that count as one, since they share their error.
    points_per_independent_one: f64,
}

impl Accumulator {
    /// An empty sum, in which this number of points counts as one.
    pub fn new(points_per_independent_one: f64) -> Self {
        Self { points_per_independent_one, ..Self::default() }
    }

    /// Adds a row with its weight, and the spurious information about translations by errors of its
    /// normal.
    #[inline]
    pub fn add(&mut self, row: [f32; ROW], weight: f32, spurious_translation: f32) {
        // Whole rows instead of the upper triangle: these are single vector instructions.
        for (sums, value) in self.block.iter_mut().zip(&row[..6]) {
            let weighted = weight * value;
            for (sum, other) in sums.iter_mut().zip(&row) {
                *sum += weighted * other;
            }
        }
        let residual = row[RESIDUAL];
        self.block_weights[0] += spurious_translation;
        self.block_weights[1] += residual * residual;
        self.in_block += 1;
        if self.in_block == BLOCK {
            self.end_block();
        }
    }

    /// Adds to the spurious information about rotations: `spurious` is the weight times the squared error
    /// of the normal, `arm` is the vector from the scanner to the point.
    pub fn add_arm(&mut self, arm: &na::Vector3<f32>, spurious: f32) {
        let arm: na::Vector3<f64> = arm.cast();
        self.moments += arm * arm.transpose() * f64::from(spurious);
    }

    /// Adds to the information of unreliable planes: the normal and the lever of a row that is also added,
    /// each with the part of its weight that does not count.
    pub fn add_unreliable(&mut self, normal: &na::Vector3<f32>, lever: &na::Vector3<f32>, weights: [f32; 2]) {
        for ((sum, direction), weight) in self.unreliable.iter_mut().zip([normal, lever]).zip(weights) {
            let direction: na::Vector3<f64> = direction.cast();
            *sum += direction * direction.transpose() * f64::from(weight);
        }
        self.matched_unreliable += 1;
    }

    fn end_block(&mut self) {
        for (total, block) in self.total.iter_mut().flatten().zip(self.block.as_flattened()) {
            *total += f64::from(*block);
        }
        for (total, block) in self.weights.iter_mut().zip(self.block_weights) {
            *total += f64::from(block);
        }
        self.matched += self.in_block as usize;
        (self.block, self.block_weights, self.in_block) = Default::default();
    }

    /// Ends a part of the sweep, to which these fractions of a growing translation and rotation apply.
    pub fn end_part(&mut self, [shift, turn]: [f64; 2]) {
        self.end_block();
        let total = std::mem::take(&mut self.total);
        let entry = |i: usize, j: usize| total[i.min(j)][i.max(j)] / self.points_per_independent_one;
        let hessian = na::Matrix6::from_fn(entry);
        let gradient = na::Vector6::from_fn(|i, _| entry(i, RESIDUAL));
        let fraction = na::Matrix6::from_diagonal(&na::Vector6::new(shift, shift, shift, turn, turn, turn));
        let cross_hessian = hessian * fraction;
        self.sums.hessian += hessian;
        self.sums.gradient += gradient;
        self.sums.cross_hessian += cross_hessian;
        self.sums.growth_hessian += fraction * cross_hessian;
        self.sums.growth_gradient += fraction * gradient;
    }

    /// Counts of the rows added until the last end of a part.
    pub fn matched(&self) -> Matched {
        let reliable = self.matched - self.matched_unreliable;
        Matched { points: self.matched, reliable, squares: self.weights[1] }
    }

    pub fn finish(self) -> NormalEquations {
        NormalEquations {
            spurious_translation: self.weights[0] / self.points_per_independent_one,
            spurious_rotation: (na::Matrix3::from_diagonal_element(self.moments.trace()) - self.moments)
                / self.points_per_independent_one,
            unreliable: self.unreliable.map(|sum| sum / self.points_per_independent_one),
            matched: self.matched(),
            ..self.sums
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Lcg;

    const INDEPENDENT: f64 = 10.0;

    #[test]
    fn sums_are_those_of_the_textbook() {
        let (mut lcg, mut all) = (Lcg::new(3), Accumulator::new(INDEPENDENT));
        let mut hessian = na::Matrix6::<f64>::zeros();
        let mut gradient = na::Vector6::<f64>::zeros();
        for _ in 0..1000 {
            let row = [0; ROW].map(|_| lcg.symmetric(3.0));
            let weight = 1000.0 * lcg.unit();
            all.add(row, weight, 0.0);
            let jacobian = na::Vector6::from_fn(|i, _| f64::from(row[i]));
            hessian += jacobian * jacobian.transpose() * f64::from(weight) / INDEPENDENT;
            gradient += jacobian * f64::from(row[RESIDUAL] * weight) / INDEPENDENT;
        }
        all.end_part([0.5, 0.25]);
        let sums = all.finish();
        assert!((sums.hessian - hessian).norm() < 1e-5 * hessian.norm());
        assert!((sums.gradient - gradient).norm() < 1e-5 * hessian.norm());
        assert_eq!(sums.matched.points, 1000);
        let entry = |i: usize, j: usize| {
            (sums.hessian[(i, j)], sums.cross_hessian[(i, j)], sums.growth_hessian[(i, j)])
        };
        for ((i, j), cross, growth) in [((0, 1), 0.5, 0.25), ((2, 5), 0.25, 0.125), ((4, 3), 0.25, 0.0625)] {
            let (all, by_both, by_growth) = entry(i, j);
            assert!((by_both - cross * all).abs() < 1e-9 && (by_growth - growth * all).abs() < 1e-9);
        }
    }
}
