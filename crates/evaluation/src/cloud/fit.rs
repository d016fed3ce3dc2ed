//! Registration of a cloud to true surfaces.

use nalgebra::{Matrix6, Vector6};
use portolan_geometry::{Rigid3, Vector3, nalgebra as na, quaternion_from_angle_axis};

use super::{TrueSurfaces, spread_sample};

/// Maximum number of points used for the fit.
const POINTS: usize = 8000;
const MAX_STEPS: usize = 40;
/// Step of the finite differences for the gradient of the distance, metres.
const DIFFERENCE: f64 = 1e-3;
/// Scale of the Cauchy weight, in medians of the distance; larger distances lose weight.
const MEDIANS: f64 = 2.0;
/// Step size below which the iteration stops, metres and radians.
const REST: f64 = 1e-7;

impl TrueSurfaces {
    /// The rigid motion that moves points (metres) closest to the surfaces, starting from their present
    /// positions: Gauss–Newton on the distances, with the gradient from finite differences. Distant points
    /// have less weight. Degenerate directions stay unchanged.
    pub fn fit(&self, points: &[[f64; 3]]) -> Rigid3 {
        let chosen: Vec<[f64; 3]> = spread_sample(points.len(), POINTS)
            .into_iter()
            .map(|i| points[i as usize])
            .filter(|p| p.iter().all(|v| v.is_finite()))
            .collect();
        let mut pose = Rigid3::identity();
        let Some(first) = chosen.first() else { return pose };
        // Rotations are about a centre among the points: about a distant origin they would also be large
        // translations.
        let centre =
            chosen.iter().fold(Vector3::zeros(), |sum, p| sum + Vector3::from(*p)) / chosen.len() as f64;
        let centre = if centre.iter().all(|v| v.is_finite()) { centre } else { Vector3::from(*first) };
        for _ in 0..MAX_STEPS {
            let moved: Vec<[f64; 3]> =
                chosen.iter().map(|p| (pose * na::Point3::from(*p)).coords.into()).collect();
            let Some(step) = self.fit_step(&moved, &centre) else { break };
            let turn = quaternion_from_angle_axis(&step.fixed_rows::<3>(0).into_owned());
            let shift = step.fixed_rows::<3>(3).into_owned();
            let about = centre - turn * centre + shift;
            pose = Rigid3::from_parts(na::Translation3::from(about), turn) * pose;
            pose.rotation.renormalize();
            if step.norm() < REST {
                break;
            }
        }
        pose
    }

    /// Rotation and translation of one step, about a centre.
    fn fit_step(&self, points: &[[f64; 3]], centre: &Vector3) -> Option<Vector6<f64>> {
        let distances = self.distances(points);
        let sides: Vec<[Vec<f64>; 2]> = (0..3)
            .map(|k| {
                [DIFFERENCE, -DIFFERENCE].map(|d| {
                    let beside = |p: &[f64; 3]| std::array::from_fn(|i| p[i] + if i == k { d } else { 0.0 });
                    self.distances(&points.iter().map(beside).collect::<Vec<_>>())
                })
            })
            .collect();
        let mut sorted: Vec<f64> = distances.iter().copied().filter(|d| d.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let scale = MEDIANS * sorted.get(sorted.len() / 2)?.max(1e-6);
        let (mut matrix, mut right) = (Matrix6::zeros(), Vector6::zeros());
        for (i, (point, distance)) in points.iter().zip(&distances).enumerate() {
            let gradient = Vector3::from_fn(|k, _| (sides[k][0][i] - sides[k][1][i]) / (2.0 * DIFFERENCE));
            // On a surface, and midway between two surfaces, the distance has no gradient.
            let Some(gradient) = gradient.try_normalize(0.5).filter(|g| g.iter().all(|v| v.is_finite()))
            else {
                continue;
            };
            let lever = (Vector3::from(*point) - centre).cross(&gradient);
            let row = Vector6::new(lever.x, lever.y, lever.z, gradient.x, gradient.y, gradient.z);
            let weight = 1.0 / (1.0 + (distance / scale).powi(2));
            matrix += row * row.transpose() * weight;
            right -= row * (weight * distance);
        }
        let slack = Matrix6::identity() * (1e-9 * matrix.trace());
        (matrix + slack).cholesky().map(|factor| factor.solve(&right))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::{SolidBox, SurfaceErrors};

    #[test]
    fn a_moved_cloud_is_aligned() {
        let solid = |low, high| SolidBox { low, high };
        let surfaces = TrueSurfaces::boxes(vec![
            solid([-0.2, 0.0, 0.0], [0.0, 8.0, 3.0]),
            solid([0.0, -0.2, 0.0], [10.0, 0.0, 3.0]),
            solid([0.0, 0.0, -0.2], [10.0, 8.0, 0.0]),
        ])
        .unwrap();
        let expected = Rigid3::new(Vector3::new(0.06, -0.04, 0.05), Vector3::new(0.004, -0.006, 0.01));
        let points: Vec<[f64; 3]> = (0..6000)
            .map(|i| {
                let random = |k: f64| (f64::from(i) * k).fract();
                let (u, v) = (7.0 * random(0.754_877_666) + 0.5, 2.0 * random(0.569_840_291) + 0.5);
                let noise = 0.02 * (random(0.381_966_011) - 0.5);
                let p = match i % 3 {
                    0 => [noise, u, v],
                    1 => [u, noise, v],
                    _ => [u, v, noise],
                };
                (expected.inverse() * na::Point3::from(p)).coords.into()
            })
            .collect();
        let pose = surfaces.fit(&points);
        let error = pose.to_homogeneous() - expected.to_homogeneous();
        assert!(error.norm() < 0.004, "{error}");
        let moved: Vec<[f64; 3]> =
            points.iter().map(|p| (pose * na::Point3::from(*p)).coords.into()).collect();
        let errors = SurfaceErrors::of(surfaces.distances(&moved), f64::INFINITY).unwrap();
        assert!(errors.mean < 0.006, "{errors}");
        assert_eq!(surfaces.fit(&[]), Rigid3::identity());
    }
}
