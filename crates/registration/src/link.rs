//! Information of the pairs of two scans on their poses (specification section 2.2, equations 7 to 9).

use nalgebra::{Matrix6, Vector6};
use portolan_geometry::Vector3;

/// Minimum number of pairs of a link.
const MIN_PAIRS: u64 = 3;
/// Minimum variance of a link: with less scatter the pairs are identical points, which carry no information.
const LEAST_VARIANCE: f64 = 1e-12;

/// Sums over the pairs (p of scan a, q of scan b, world) of a link: with midpoints m and differences z = p −
/// q the normal equations of `z ≈ M (X_a − X_b)`, `M = [I | −[m]×]`, in the order translation, rotation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkStatistics {
    /// Number of pairs.
    pub count: u64,
    /// Weight of the scalar residuals: three for a pair of points, up to one for a point and a plane.
    pub rows: f64,
    /// Σ MᵀM.
    pub matrix: Matrix6<f64>,
    /// Σ Mᵀz.
    pub vector: Vector6<f64>,
    /// Σ |z|².
    pub squares: f64,
}

impl LinkStatistics {
    /// Adds a pair.
    pub fn add(&mut self, p: &Vector3, q: &Vector3) {
        let (m, z) = ((p + q) * 0.5, p - q);
        let cross = m.cross_matrix();
        self.count += 1;
        self.rows += 3.0;
        for k in 0..3 {
            self.matrix[(k, k)] += 1.0;
        }
        let mut add = |r: usize, c: usize, block: nalgebra::Matrix3<f64>| {
            let mut view = self.matrix.fixed_view_mut::<3, 3>(r, c);
            view += block;
        };
        add(0, 3, -cross);
        add(3, 0, cross);
        add(3, 3, -cross * cross);
        let moment = m.cross(&z);
        self.vector += Vector6::new(z.x, z.y, z.z, moment.x, moment.y, moment.z);
        self.squares += z.norm_squared();
    }

    /// Adds a pair of which only the distance along a unit normal is used: `n · z ≈ nᵀ M (X_a − X_b)`.
    pub fn add_plane(&mut self, p: &Vector3, q: &Vector3, normal: &Vector3, weight: f64) {
        let (m, distance) = ((p + q) * 0.5, normal.dot(&(p - q)));
        let lever = m.cross(normal);
        let row = Vector6::new(normal.x, normal.y, normal.z, lever.x, lever.y, lever.z);
        self.count += 1;
        self.rows += weight;
        self.matrix += row * row.transpose() * weight;
        self.vector += row * (weight * distance);
        self.squares += weight * distance * distance;
    }

    /// Adds other pairs of the same link.
    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.rows += other.rows;
        self.matrix += other.matrix;
        self.vector += other.vector;
        self.squares += other.squares;
    }

    /// The difference of the poses' errors D = (MᵀM)⁻¹MᵀZ (equation 7) and the unbiased variance of a coordinate s²
    /// (equation 9 with 3m − 6, for planes m − 6). None for too few pairs, or identical points.
    pub fn difference(&self) -> Option<(Vector6<f64>, f64)> {
        if self.count < MIN_PAIRS {
            return None;
        }
        // Planes may leave directions undetermined; these get no difference.
        let slack = Matrix6::identity() * (1e-9 * self.matrix.trace());
        let difference = (self.matrix + slack).cholesky()?.solve(&self.vector);
        let rest = self.squares - self.vector.dot(&difference);
        let variance = rest / (self.rows - 6.0).max(1.0);
        (variance > LEAST_VARIANCE && difference.iter().all(|v| v.is_finite()))
            .then_some((difference, variance))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Rigid3, nalgebra as na};

    #[test]
    fn the_jacobian_agrees_with_differences() {
        let p = Vector3::new(1.0, -2.0, 3.0);
        let mut link = LinkStatistics::default();
        link.add(&p, &p);
        // Columns of M from the matrix MᵀM's first three rows: its upper half is M itself.
        for k in 0..6 {
            let mut twist = Vector6::zeros();
            twist[k] = 1e-6;
            let motion =
                Rigid3::new(twist.fixed_rows::<3>(0).into_owned(), twist.fixed_rows::<3>(3).into_owned());
            let numeric = ((motion * na::Point3::from(p)).coords - p) / 1e-6;
            let column = link.matrix.fixed_view::<3, 1>(0, k).into_owned();
            assert!((numeric - column).norm() < 1e-5, "{k}");
        }
    }

    #[test]
    fn a_known_difference_is_found() {
        let twist = Vector6::new(0.01, -0.02, 0.005, 0.001, 0.002, -0.001);
        let motion =
            Rigid3::new(twist.fixed_rows::<3>(0).into_owned(), twist.fixed_rows::<3>(3).into_owned());
        let mut link = LinkStatistics::default();
        for i in 0..50 {
            let i = f64::from(i);
            let q = Vector3::new((i * 0.7).sin() * 5.0, (i * 1.1).cos() * 4.0, (i * 0.3).sin() * 2.0);
            let noise = Vector3::new((i * 12.9).sin(), (i * 78.2).sin(), (i * 37.7).sin()) * 1e-4;
            link.add(&((motion * na::Point3::from(q)).coords + noise), &q);
        }
        let (difference, variance) = link.difference().unwrap();
        assert!((difference - twist).norm() < 1e-3 && variance < 1e-6);
        assert!(LinkStatistics::default().difference().is_none());
    }
}
