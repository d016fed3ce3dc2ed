//! Count, sum and sum of outer products of points: sufficient to fit a plane.

use nalgebra::{Matrix3, SymmetricEigen};
use portolan_geometry::Vector3;

/// Moments of a set of points up to the second order. The moments of a union are the sums of the moments. Use
/// coordinates relative to a nearby position: squares of large coordinates lose digits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    /// Number of points.
    pub count: f64,
    /// Sum of the points, metres.
    pub sum: [f64; 3],
    /// Sums of xx, xy, xz, yy, yz, zz.
    pub products: [f64; 6],
}

/// The least-squares plane of a set of points, with the eigenvalues of the covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneFit {
    /// Mean of the points.
    pub mean: Vector3,
    /// Unit normal; its sign is arbitrary.
    pub normal: Vector3,
    /// Eigenvalues of the covariance, ascending, square metres: the first is the variance across the plane.
    pub variances: [f64; 3],
}

impl Moments {
    /// Adds a point.
    pub fn add(&mut self, p: &Vector3) {
        self.count += 1.0;
        self.sum[0] += p.x;
        self.sum[1] += p.y;
        self.sum[2] += p.z;
        self.products[0] += p.x * p.x;
        self.products[1] += p.x * p.y;
        self.products[2] += p.x * p.z;
        self.products[3] += p.y * p.y;
        self.products[4] += p.y * p.z;
        self.products[5] += p.z * p.z;
    }

    /// Adds the points of another set.
    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        for (a, b) in self.sum.iter_mut().zip(&other.sum) {
            *a += b;
        }
        for (a, b) in self.products.iter_mut().zip(&other.products) {
            *a += b;
        }
    }

    /// The mean (zero without points).
    pub fn mean(&self) -> Vector3 {
        Vector3::from(self.sum) / self.count.max(1.0)
    }

    /// The covariance about the mean, divided by the count.
    pub fn covariance(&self) -> Matrix3<f64> {
        let m = self.mean();
        let [xx, xy, xz, yy, yz, zz] = self.products.map(|v| v / self.count.max(1.0));
        Matrix3::new(
            xx - m.x * m.x,
            xy - m.x * m.y,
            xz - m.x * m.z,
            xy - m.x * m.y,
            yy - m.y * m.y,
            yz - m.y * m.z,
            xz - m.x * m.z,
            yz - m.y * m.z,
            zz - m.z * m.z,
        )
    }

    /// The best plane; `None` for fewer than three points or values that are not finite.
    pub fn plane(&self) -> Option<PlaneFit> {
        let covariance = self.covariance();
        if self.count < 3.0 || !covariance.iter().all(|v| v.is_finite()) {
            return None;
        }
        let eigen = SymmetricEigen::new(covariance);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let normal = eigen.eigenvectors.column(order[0]).into_owned();
        Some(PlaneFit {
            mean: self.mean(),
            normal: normal.try_normalize(1e-12)?,
            variances: order.map(|k| eigen.eigenvalues[k].max(0.0)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilted_plane_is_found_and_sets_add_up() {
        let normal = Vector3::new(1.0, 2.0, 3.0).normalize();
        let (u, v) = (Vector3::new(2.0, -1.0, 0.0).normalize(), normal.cross(&Vector3::new(2.0, -1.0, 0.0)));
        let (mut first, mut second) = (Moments::default(), Moments::default());
        for i in 0..20 {
            for k in 0..20 {
                let p = Vector3::new(3.0, 1.0, 2.0) + u * f64::from(i) * 0.1 + v * f64::from(k) * 0.05;
                if i < 10 { first.add(&p) } else { second.add(&p) }
            }
        }
        first.merge(&second);
        let plane = first.plane().unwrap();
        assert!((plane.normal.dot(&normal).abs() - 1.0).abs() < 1e-9);
        assert!(plane.variances[0] < 1e-9 && plane.variances[1] > 0.01);
        assert!(Moments::default().plane().is_none());
    }
}
