//! Distance of a point to a triangle.

use portolan_geometry::Vector3;

use super::search::Shape;

/// A triangle in space, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle(pub [[f64; 3]; 3]);

impl Triangle {
    /// The point of the triangle nearest to `point`: by the regions of its corners, edges and face (Ericson,
    /// "Real-time collision detection", section 5.1.5).
    fn nearest(&self, point: &Vector3) -> Vector3 {
        let [a, b, c] = self.0.map(Vector3::from);
        let (ab, ac, ap) = (b - a, c - a, point - a);
        let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
        if d1 <= 0.0 && d2 <= 0.0 {
            return a;
        }
        let bp = point - b;
        let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
        if d3 >= 0.0 && d4 <= d3 {
            return b;
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            return a + ab * share(d1, d1 - d3);
        }
        let cp = point - c;
        let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
        if d6 >= 0.0 && d5 <= d6 {
            return c;
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            return a + ac * share(d2, d2 - d6);
        }
        let va = d3 * d6 - d5 * d4;
        if va <= 0.0 && d4 >= d3 && d5 >= d6 {
            return b + (c - b) * share(d4 - d3, (d4 - d3) + (d5 - d6));
        }
        let sum = va + vb + vc;
        a + ab * share(vb, sum) + ac * share(vc, sum)
    }
}

/// A quotient; 0 for triangles without extent.
fn share(part: f64, whole: f64) -> f64 {
    if whole.abs() > 0.0 { part / whole } else { 0.0 }
}

impl Shape for Triangle {
    fn bounds(&self) -> [[f64; 3]; 2] {
        let fold =
            |f: fn(f64, f64) -> f64| std::array::from_fn(|k| f(f(self.0[0][k], self.0[1][k]), self.0[2][k]));
        [fold(f64::min), fold(f64::max)]
    }

    fn distance(&self, point: [f64; 3]) -> f64 {
        let point = Vector3::from(point);
        (self.nearest(&point) - point).norm()
    }

    fn numbers(&self) -> [f64; 9] {
        std::array::from_fn(|k| self.0[k / 3][k % 3])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_point_of_the_triangle_is_nearer(
            corners in [[-2.0..2.0f64, -2.0..2.0f64, -2.0..2.0f64], [-2.0..2.0f64, -2.0..2.0f64, -2.0..2.0f64],
                [-2.0..2.0f64, -2.0..2.0f64, -2.0..2.0f64]],
            point in [-4.0..4.0f64, -4.0..4.0f64, -4.0..4.0f64],
        ) {
            let triangle = Triangle(corners);
            let found = triangle.distance(point);
            let [a, b, c] = corners.map(Vector3::from);
            let mut least = f64::INFINITY;
            for i in 0..=60 {
                for k in 0..=(60 - i) {
                    let (u, v) = (f64::from(i) / 60.0, f64::from(k) / 60.0);
                    let on = a + (b - a) * u + (c - a) * v;
                    least = least.min((on - Vector3::from(point)).norm());
                }
            }
            prop_assert!(found <= least + 1e-9 && found >= least - 0.15, "{found} {least}");
        }
    }

    #[test]
    fn triangles_without_extent_are_points() {
        let found = Triangle([[1.0, 0.0, 0.0]; 3]).distance([0.0; 3]);
        assert!((found - 1.0).abs() < 1e-12);
    }
}
