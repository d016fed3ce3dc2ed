//! Computes the information about the pose of a scan in a map of planes, with the scale of its errors
//! estimated from its own residuals.

use std::collections::BTreeMap;

use nalgebra as na;
use portolan_geometry::{Point3f, Rigid3, Vector3, to_f32};
use portolan_lidar_odometry::{Plane, PlaneMap};

use crate::belief::{Matrix6, Vector6};
use crate::information::{along_surface, distance_information, positive};
use crate::settings::matching::{ERROR_PATCH, NORMAL_VARIANCE, RANGE_NOISE, ROBUST_REACH, ROBUST_SCALE};

/// Contribution of points with a common error.
#[derive(Clone, Copy, Debug)]
struct Patch {
    /// Derivative of half the sum of squares by the pose.
    score: Vector6,
    curvature: Matrix6,
}

impl Default for Patch {
    fn default() -> Self {
        Self { score: Vector6::zeros(), curvature: Matrix6::zeros() }
    }
}

/// The points of a scan that are on planes, at a pose to which they were registered.
#[derive(Clone, Debug, Default)]
pub(crate) struct Residuals {
    patches: BTreeMap<[i32; 3], Patch>,
    curvature: Matrix6,
    /// Part of the curvature that is spurious because of errors of normals.
    spurious: Matrix6,
    /// Scatter of the scores from range noise alone.
    noise: Matrix6,
}

impl Residuals {
    /// From points in the frame of the scan, metres.
    pub fn new(planes: &PlaneMap, points: &[Point3f], pose: &Rigid3) -> Self {
        let (map_from_scan, origin) = (to_f32(pose), pose.translation.vector.cast::<f32>());
        let mut all = Self::default();
        for point in points {
            let place = map_from_scan * point;
            if let Some(plane) = planes.plane_near(&place) {
                all.add(&place, &(place.coords - origin), &plane);
            }
        }
        all
    }

    /// Adds a point in the map at a plane; `lever` is its position from the scanner.
    fn add(&mut self, place: &Point3f, lever: &na::Vector3<f32>, plane: &Plane) {
        let off = place.coords - plane.point;
        let residual = plane.normal.dot(&off);
        if residual.abs() > ROBUST_REACH {
            return;
        }
        let robust = 1.0 / (1.0 + (residual / ROBUST_SCALE).powi(2));
        let variance = RANGE_NOISE.powi(2) + plane.variance + plane.normal_variance * off.norm_squared();
        let weight = f64::from(robust * robust / variance);
        let (lever, normal): (Vector3, Vector3) = (lever.cast(), plane.normal.cast());
        let (row, along_normal) = distance_information(&lever, &normal);
        let patch = [place.x, place.y, place.z].map(|v| (v / ERROR_PATCH).floor() as i32);
        let sum = self.patches.entry(patch).or_default();
        sum.score += weight * f64::from(residual) * row;
        sum.curvature += weight * along_normal;
        self.curvature += weight * along_normal;
        self.spurious += weight * NORMAL_VARIANCE * along_surface(&lever, &along_normal);
        self.noise += (weight * f64::from(RANGE_NOISE)).powi(2) * along_normal;
    }

    /// Inverse of the covariance of the pose: H M⁻¹ H, where H is the curvature without its spurious part,
    /// and M the scatter of the scores of patches (White 1980, by clusters: Liang and Zeger 1986).
    pub fn information(&self) -> Matrix6 {
        let held = positive(&(self.curvature - self.spurious));
        let Some(covariance) = inverse_of(&self.curvature) else { return Matrix6::zeros() };
        let scatter = scatter(self.patches.values(), &covariance) + self.noise;
        let Some(inverse) = inverse_of(&scatter) else { return Matrix6::zeros() };
        let information = held * inverse * held;
        0.5 * (information + information.transpose())
    }
}

/// Sum of the squares of scores. A patch that constrains the pose nearly alone has pulled the pose to
/// itself; its score is therefore taken as if the pose had been found without it (Bell and McCaffrey 2002).
fn scatter<'a>(patches: impl Iterator<Item = &'a Patch>, covariance: &Matrix6) -> Matrix6 {
    let without_itself = |patch: &Patch| {
        let others = Matrix6::identity() - patch.curvature * covariance;
        others.try_inverse().map_or(patch.score, |inverse| inverse * patch.score)
    };
    patches.map(without_itself).map(|score| score * score.transpose()).sum()
}

fn inverse_of(matrix: &Matrix6) -> Option<Matrix6> {
    // So small that it has no effect, but singular matrices can be inverted.
    let tiny = matrix.diagonal().map(|v| 1e-9 * v + 1e-12);
    (matrix + Matrix6::from_diagonal(&tiny)).try_inverse()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Patches of 0.5 m in the middle of cubes, on the floor and on two walls, moved off their planes by `off`.
    fn scan(mut off: impl FnMut() -> f32) -> Vec<Point3f> {
        let mut points = Vec::new();
        for (i, j) in (-5..5).flat_map(|i| (-5..5).map(move |j| (i as f32 + 0.5, j as f32 + 0.5))) {
            let by = [off(), off(), off()];
            for (a, b) in (0..4).flat_map(|a| (0..4).map(move |b| (i + 0.1 * a as f32, j + 0.1 * b as f32))) {
                points.push(Point3f::new(a, b, by[0] - 5.5));
                points.push(Point3f::new(by[1] - 5.5, a, b));
                points.push(Point3f::new(a, by[2] - 5.5, b));
            }
        }
        points
    }

    /// The mean square of the errors of 100 poses that such offsets of patches cause, each by its own covariance.
    fn normalised_error(sigma: f32) -> f64 {
        let mut planes = PlaneMap::new(1.0);
        let clean = scan(|| 0.0).into_iter().chain(scan(|| 0.002)).chain(scan(|| -0.002));
        planes.insert_all(clean, &Point3f::origin());
        let mut seed = 7_u32;
        let mut uniform = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) as f32 / (1 << 24) as f32 - 0.5
        };
        let mut offset = || sigma * (0..12).map(|_| uniform()).sum::<f32>();
        let trial = |_| {
            let residuals = Residuals::new(&planes, &scan(&mut offset), &Rigid3::identity());
            let pull = residuals.patches.values().map(|patch| patch.score).sum::<Vector6>();
            let error = inverse_of(&residuals.curvature).unwrap() * pull;
            error.dot(&(residuals.information() * error))
        };
        (0..100).map(trial).sum::<f64>() / 100.0
    }

    #[test]
    fn covariances_follow_the_errors_of_patches() {
        for sigma in [0.01, 0.02, 0.05] {
            let mean = normalised_error(sigma);
            assert!((3.5..8.0).contains(&mean), "{sigma} m: {mean} in place of 6");
        }
    }
}
