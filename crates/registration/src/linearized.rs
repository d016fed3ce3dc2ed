//! Matching with planes: one Gauss–Newton step on a twist (rotation, translation) in the frame of the model.

use nalgebra::{Matrix3, Matrix6, Vector6};
use portolan_geometry::{Rigid3, Vector3, nalgebra as na, quaternion_from_angle_axis};

/// Normal equations for the twist (φ, ρ) with δx = ρ + φ × x.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TwistEquations {
    pub matrix: Matrix6<f64>,
    pub vector: Vector6<f64>,
    /// Σ w.
    pub weight: f64,
    /// Σ w r².
    pub cost: f64,
    pub count: u64,
}

impl Default for TwistEquations {
    fn default() -> Self {
        Self { matrix: Matrix6::zeros(), vector: Vector6::zeros(), weight: 0.0, cost: 0.0, count: 0 }
    }
}

impl TwistEquations {
    /// Adds the distance of a moved data point from the plane of a model point: `n · (m − x)`.
    pub fn add_plane(&mut self, model: &Vector3, normal: &Vector3, x: &Vector3, weight: f64) {
        let lever = x.cross(normal);
        let row = Vector6::new(lever.x, lever.y, lever.z, normal.x, normal.y, normal.z);
        let residual = normal.dot(&(model - x));
        self.matrix += row * row.transpose() * weight;
        self.vector += row * (weight * residual);
        self.weight += weight;
        self.cost += weight * residual * residual;
        self.count += 1;
    }

    /// Adds the difference of two points weighted by an information matrix (generalised ICP).
    pub fn add_weighted(&mut self, model: &Vector3, x: &Vector3, information: &Matrix3<f64>, weight: f64) {
        let cross = -x.cross_matrix();
        let residual = model - x;
        let (scaled, product) = (information * residual * weight, information * weight);
        let mut add = |r: usize, c: usize, block: Matrix3<f64>| {
            let mut view = self.matrix.fixed_view_mut::<3, 3>(r, c);
            view += block;
        };
        add(0, 0, cross.transpose() * product * cross);
        add(0, 3, cross.transpose() * product);
        add(3, 0, product * cross);
        add(3, 3, product);
        let turn = cross.transpose() * scaled;
        self.vector += Vector6::new(turn.x, turn.y, turn.z, scaled.x, scaled.y, scaled.z);
        self.weight += weight;
        self.cost += residual.dot(&scaled);
        self.count += 1;
    }

    /// Adds other equations.
    pub fn merge(&mut self, other: &Self) {
        self.matrix += other.matrix;
        self.vector += other.vector;
        self.weight += other.weight;
        self.cost += other.cost;
        self.count += other.count;
    }

    /// The step as a transform in the frame of the model. Directions that the pairs do not determine are left
    /// unchanged. None if the result is not finite.
    pub fn step(&self) -> Option<Rigid3> {
        let eigen = na::SymmetricEigen::new(self.matrix);
        let least = 1e-9 * eigen.eigenvalues.max().max(f64::MIN_POSITIVE);
        let mut x = Vector6::zeros();
        for k in 0..6 {
            if eigen.eigenvalues[k] > least {
                let v = eigen.eigenvectors.column(k);
                x += v * (v.dot(&self.vector) / eigen.eigenvalues[k]);
            }
        }
        let turn = quaternion_from_angle_axis(&Vector3::new(x[0], x[1], x[2]));
        let step = Rigid3::from_parts(na::Translation3::new(x[3], x[4], x[5]), turn);
        portolan_geometry::is_valid_pose(&step).then_some(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The right side is half of the falling gradient of the cost, for planes and for weighted points.
    #[test]
    fn gradients_agree_with_differences() {
        let (model, x) = (Vector3::new(1.0, -2.0, 0.5), Vector3::new(1.1, -1.8, 0.3));
        let normal = Vector3::new(0.2, -0.5, 0.9).normalize();
        let information = Matrix3::new(2.0, 0.3, 0.1, 0.3, 1.5, -0.2, 0.1, -0.2, 0.7);
        let add = |equations: &mut TwistEquations, x: &Vector3, planes: bool| match planes {
            true => equations.add_plane(&model, &normal, x, 0.7),
            false => equations.add_weighted(&model, x, &information, 0.7),
        };
        for planes in [true, false] {
            let mut equations = TwistEquations::default();
            add(&mut equations, &x, planes);
            for k in 0..6 {
                let cost = |step: f64| {
                    let mut twist = Vector6::zeros();
                    twist[k] = step;
                    let turn = quaternion_from_angle_axis(&twist.fixed_rows::<3>(0).into_owned());
                    let moved = turn * x + twist.fixed_rows::<3>(3);
                    let mut equations = TwistEquations::default();
                    add(&mut equations, &moved, planes);
                    equations.cost
                };
                let gradient = (cost(1e-6) - cost(-1e-6)) / 2e-6;
                assert!((gradient + 2.0 * equations.vector[k]).abs() < 1e-6, "{planes} {k}: {gradient}");
            }
        }
    }
}
