//! Measurements at single times as terms of the optimisation: tilt and position.

use portolan_geometry::Vector3;

use super::Knots;

/// Three residuals at one time, which depend on the knots around it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct UnaryTerm {
    pub knot: usize,
    /// Position between the knot and the next, 0 to 1.
    pub fraction: f64,
    /// Jacobian with respect to the increment (translation, rotation) at this time, and residual.
    pub rows: [([f64; 6], f64); 3],
    pub weight: f64,
}

impl UnaryTerm {
    /// A vector in the world that rotates with the tracking frame and has the error `residual`.
    pub fn tilt(
        knots: &Knots,
        seconds: f64,
        vector: &Vector3,
        residual: &Vector3,
        deviation: f64,
        robust: f64,
    ) -> Self {
        let [x, y, z] = [vector.x, vector.y, vector.z];
        // φ × v.
        let cross = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]];
        let row = |k: usize| ([0.0, 0.0, 0.0, cross[k][0], cross[k][1], cross[k][2]], residual[k]);
        Self::new(knots, seconds, [row(0), row(1), row(2)], residual, deviation, robust)
    }

    /// A position with the error `residual`.
    pub fn place(knots: &Knots, seconds: f64, residual: &Vector3, deviation: f64, robust: f64) -> Self {
        let row = |k: usize| {
            let mut jacobian = [0.0; 6];
            jacobian[k] = 1.0;
            (jacobian, residual[k])
        };
        Self::new(knots, seconds, [row(0), row(1), row(2)], residual, deviation, robust)
    }

    fn new(
        knots: &Knots,
        seconds: f64,
        rows: [([f64; 6], f64); 3],
        residual: &Vector3,
        deviation: f64,
        robust: f64,
    ) -> Self {
        let (knot, fraction) = knots.place(seconds);
        let variance = deviation * deviation;
        let squares = residual.norm_squared() / variance;
        Self { knot, fraction, rows, weight: 1.0 / (variance * (1.0 + squares / (3.0 * robust * robust))) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::quaternion_from_angle_axis;

    #[test]
    fn tilts_turn_the_vector() {
        let knots = Knots::new(10.0, 1.0);
        let vector = Vector3::new(0.3, -0.4, 9.7);
        let term = UnaryTerm::tilt(&knots, 2.25, &vector, &Vector3::new(0.1, 0.0, 0.0), 0.1, 2.0);
        assert_eq!((term.knot, term.fraction), (2, 0.25));
        let step = Vector3::new(1e-6, -2e-6, 0.5e-6);
        let moved = quaternion_from_angle_axis(&step) * vector - vector;
        for (k, (jacobian, _)) in term.rows.iter().enumerate() {
            let linear: f64 = (0..3).map(|i| jacobian[3 + i] * step[i]).sum();
            assert!((linear - moved[k]).abs() < 1e-10);
        }
    }
}
