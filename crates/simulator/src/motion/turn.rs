//! A turn: the heading changes by α over the length L as α·S(s/L), so that curvature and its
//! derivative vanish at both ends and the turn joins straight lines smoothly.

use portolan_geometry::Vector2;

use super::smooth;

/// Number of pieces over which positions are tabulated.
const KNOTS: usize = 32;
/// Gauss-Legendre nodes and weights of order 3 on [−1, 1]; over 1/32 of a turn the error is below
/// 1e-13 of its length.
const NODES: [(f64, f64); 3] =
    [(-0.774_596_669_241_483_4, 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 5.0 / 9.0)];

/// A turn of unit length that starts at the origin along x.
#[derive(Clone, Debug)]
pub(crate) struct UnitTurn {
    angle: f64,
    knots: Vec<Vector2>,
}

impl UnitTurn {
    /// A turn by `angle` radians, to the left for positive angles.
    pub fn new(angle: f64) -> Self {
        let mut turn = Self { angle, knots: Vec::with_capacity(KNOTS + 1) };
        let mut at = Vector2::zeros();
        turn.knots.push(at);
        for knot in 0..KNOTS {
            at += turn.advance(knot as f64 / KNOTS as f64, (knot + 1) as f64 / KNOTS as f64);
            turn.knots.push(at);
        }
        turn
    }

    /// ∫ (cos, sin)(α S(u)) du between two nearby points.
    fn advance(&self, from: f64, to: f64) -> Vector2 {
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        let mut sum = Vector2::zeros();
        for (node, weight) in NODES {
            let (sine, cosine) = libm::sincos(self.angle * smooth::step(middle + half * node));
            sum += Vector2::new(cosine, sine) * weight;
        }
        sum * half
    }

    /// Position at the fraction `u` of the turn, in [0, 1].
    pub fn position(&self, u: f64) -> Vector2 {
        let knot = ((u * KNOTS as f64) as usize).min(KNOTS - 1);
        self.knots[knot] + self.advance(knot as f64 / KNOTS as f64, u)
    }

    /// Heading at the fraction `u` of the turn, and its first and second derivative by `u`.
    pub fn heading(&self, u: f64) -> (f64, f64, f64) {
        (self.angle * smooth::step(u), self.angle * smooth::slope(u), self.angle * smooth::bend(u))
    }

    /// Length of a turn that leaves its lines `tangent` metres from their corner. By symmetry the end
    /// (X, Y) of the unit turn satisfies X = d (1 + cos α) for tangents of length d.
    pub fn length_for_tangent(&self, tangent: f64) -> f64 {
        let end = self.knots[KNOTS];
        tangent * (1.0 + libm::cos(self.angle)) / end.x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_fit_the_corner() {
        for angle in [-2.2, -1.0, -0.1, 0.01, 0.7, 1.57, 2.2] {
            let turn = UnitTurn::new(angle);
            let length = turn.length_for_tangent(1.3);
            let end = turn.position(1.0) * length;
            let expected = Vector2::new(1.3 + 1.3 * libm::cos(angle), 1.3 * libm::sin(angle));
            assert!((end - expected).norm() < 1e-11, "{angle}: {end} {expected}");
        }
    }

    #[test]
    fn positions_are_the_integral_of_headings() {
        let turn = UnitTurn::new(2.2);
        let h = 1e-6;
        for i in 1..200 {
            let u = f64::from(i) / 200.0;
            let numeric = (turn.position(u + h) - turn.position(u - h)) / (2.0 * h);
            let (sine, cosine) = libm::sincos(turn.heading(u).0);
            assert!((numeric - Vector2::new(cosine, sine)).norm() < 1e-8);
        }
        // Against a fine sum: the table is exact to rounding.
        let n = 200_000;
        let mut sum = Vector2::zeros();
        for i in 0..n {
            let (sine, cosine) = libm::sincos(turn.heading((f64::from(i) + 0.5) / f64::from(n)).0);
            sum += Vector2::new(cosine, sine) / f64::from(n);
        }
        assert!((turn.position(1.0) - sum).norm() < 1e-10);
    }
}
