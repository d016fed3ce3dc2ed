//! What all points of a scan say together, and which planes they are paired with.

use nalgebra as na;

use crate::map::Plane;

/// Neighbouring points share their error, so that so many count as one.
pub(crate) const POINTS_PER_INDEPENDENT_ONE: f64 = 10.0;
/// A point is paired anew when it has moved by this share of the edge of the largest voxels.
const SLACK_SHARE: f32 = 0.03;
/// So many points are summed in single precision before the sum is added to that of all.
const BLOCK: u32 = 64;
/// Entries of a row: three of the translation, three of the rotation, the residual, and one to spare.
const ROW: usize = 8;
const RESIDUAL: usize = 6;

/// The plane that a point was paired with, and where the point was then.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    pub looked_up_at: na::Vector3<f32>,
    pub plane: Option<Plane>,
}

/// The pairs of all points, kept from one iteration to the next.
pub(super) struct Pairs {
    pub pairs: Vec<Pair>,
    /// Points that moved farther are paired anew, m².
    pub squared_slack: f32,
}

impl Pairs {
    pub fn new(num_points: usize, edge: f32) -> Self {
        let nowhere = Pair { looked_up_at: na::Vector3::repeat(f32::INFINITY), plane: None };
        Self { pairs: vec![nowhere; num_points], squared_slack: (SLACK_SHARE * edge).powi(2) }
    }
}

/// Sums over the points on one way.
#[derive(Default)]
pub(crate) struct Sums {
    /// By corrections of the start, which move all points alike.
    pub hessian: na::Matrix6<f64>,
    pub gradient: na::Vector6<f64>,
    /// By bends of the way, which move every point by the share of its time; and by both.
    pub bend_hessian: na::Matrix6<f64>,
    pub bend_gradient: na::Vector6<f64>,
    pub between: na::Matrix6<f64>,
    /// Sum of weights times the squared errors of normals that count for shifts: so much information about any
    /// shift may be feigned.
    pub feigned_shift: f64,
    /// The same about turns, as a quadratic form of their axis: with squared distances from the axis.
    pub feigned_turn: na::Matrix3<f64>,
    /// What doubtful planes say of shifts and turns: the part of the Hessian that may be feigned.
    pub doubtful: [na::Matrix3<f64>; 2],
    pub matched: usize,
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
    doubtful: [na::Matrix3<f64>; 2],
    matched: usize,
    sums: Sums,
}

impl Accumulator {
    /// Adds a row with its weight, and what errors of its normal feign about shifts.
    #[inline]
    pub fn add(&mut self, row: [f32; ROW], weight: f32, feigned_shift: f32) {
        // Whole rows, not only the upper triangle: these are single vector instructions.
        for (sums, value) in self.block.iter_mut().zip(&row[..6]) {
            let weighted = weight * value;
            for (sum, other) in sums.iter_mut().zip(&row) {
                *sum += weighted * other;
            }
        }
        let residual = row[RESIDUAL];
        self.block_weights[0] += feigned_shift;
        self.block_weights[1] += residual * residual;
        self.in_block += 1;
        if self.in_block == BLOCK {
            self.end_block();
        }
    }

    /// Adds to what errors of normals feign about turns: `feigned` is the weight times the squared error of the
    /// normal, `arm` goes from the origin of the scan to the point.
    pub fn add_arm(&mut self, arm: &na::Vector3<f32>, feigned: f32) {
        let arm: na::Vector3<f64> = arm.cast();
        self.moments += arm * arm.transpose() * f64::from(feigned);
    }

    /// Adds to what doubtful planes say: the normal and the lever of a row that is added, too,
    /// each with what is feigned of its weight.
    pub fn add_doubtful(&mut self, normal: &na::Vector3<f32>, lever: &na::Vector3<f32>, weights: [f32; 2]) {
        for ((sum, direction), weight) in self.doubtful.iter_mut().zip([normal, lever]).zip(weights) {
            let direction: na::Vector3<f64> = direction.cast();
            *sum += direction * direction.transpose() * f64::from(weight);
        }
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

    /// Ends a part of the sweep, of which a bend of the way shifts and turns points by these shares.
    pub fn end_part(&mut self, [shift, turn]: [f64; 2]) {
        self.end_block();
        let total = std::mem::take(&mut self.total);
        let entry = |i: usize, j: usize| total[i.min(j)][i.max(j)] / POINTS_PER_INDEPENDENT_ONE;
        let hessian = na::Matrix6::from_fn(entry);
        let gradient = na::Vector6::from_fn(|i, _| entry(i, RESIDUAL));
        let share = na::Matrix6::from_diagonal(&na::Vector6::new(shift, shift, shift, turn, turn, turn));
        let between = hessian * share;
        self.sums.hessian += hessian;
        self.sums.gradient += gradient;
        self.sums.between += between;
        self.sums.bend_hessian += share * between;
        self.sums.bend_gradient += share * gradient;
    }

    /// How many rows were added until the last end of a part, and the sum of their squared residuals.
    pub fn matched(&self) -> (usize, f64) {
        (self.matched, self.weights[1])
    }

    pub fn finish(self) -> Sums {
        Sums {
            feigned_shift: self.weights[0] / POINTS_PER_INDEPENDENT_ONE,
            feigned_turn: (na::Matrix3::from_diagonal_element(self.moments.trace()) - self.moments)
                / POINTS_PER_INDEPENDENT_ONE,
            doubtful: self.doubtful.map(|sum| sum / POINTS_PER_INDEPENDENT_ONE),
            matched: self.matched,
            squares: self.weights[1],
            ..self.sums
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Lcg;

    #[test]
    fn sums_are_those_of_the_textbook() {
        let (mut lcg, mut all) = (Lcg::new(3), Accumulator::default());
        let mut hessian = na::Matrix6::<f64>::zeros();
        let mut gradient = na::Vector6::<f64>::zeros();
        for _ in 0..1000 {
            let row = [0; ROW].map(|_| lcg.symmetric(3.0));
            let weight = 1000.0 * lcg.unit();
            all.add(row, weight, 0.0);
            let jacobian = na::Vector6::from_fn(|i, _| f64::from(row[i]));
            hessian += jacobian * jacobian.transpose() * f64::from(weight) / POINTS_PER_INDEPENDENT_ONE;
            gradient += jacobian * f64::from(row[RESIDUAL] * weight) / POINTS_PER_INDEPENDENT_ONE;
        }
        all.end_part([0.5, 0.25]);
        let sums = all.finish();
        assert!((sums.hessian - hessian).norm() < 1e-5 * hessian.norm());
        assert!((sums.gradient - gradient).norm() < 1e-5 * hessian.norm());
        assert_eq!(sums.matched, 1000);
        let entry =
            |i: usize, j: usize| (sums.hessian[(i, j)], sums.between[(i, j)], sums.bend_hessian[(i, j)]);
        for ((i, j), between, bend) in [((0, 1), 0.5, 0.25), ((2, 5), 0.25, 0.125), ((4, 3), 0.25, 0.0625)] {
            let (all, by_both, by_bend) = entry(i, j);
            assert!((by_both - between * all).abs() < 1e-9 && (by_bend - bend * all).abs() < 1e-9);
        }
    }
}
