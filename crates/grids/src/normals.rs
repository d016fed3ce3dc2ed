//! Estimates the normals of a planar scan.

use portolan_geometry::{Point3f, Vector2f};

use super::InserterOptionError;

/// Which neighbours along the scan determine a normal.
#[derive(Clone, Debug, PartialEq)]
pub struct NormalEstimationOptions {
    /// Maximum number of neighbours, default 4.
    pub num_normal_samples: usize,
    /// Maximum distance from the point, metres, default 0.5.
    pub sample_radius: f64,
}

impl Default for NormalEstimationOptions {
    fn default() -> Self {
        Self { num_normal_samples: 4, sample_radius: 0.5 }
    }
}

impl NormalEstimationOptions {
    /// # Errors
    /// If a number is not positive.
    pub fn check(&self) -> Result<(), InserterOptionError> {
        let samples = ("num_normal_samples", self.num_normal_samples as f64);
        for (name, value) in [samples, ("sample_radius", self.sample_radius)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(InserterOptionError::NotPositive { name, value });
            }
        }
        Ok(())
    }
}

/// Sorts returns by their direction from the origin, from −π on.
pub fn sort_by_direction(returns: &mut [Point3f], origin: &Point3f) {
    let direction = |p: &Point3f| (p.xy() - origin.xy()).normalize();
    returns.sort_by(|a, b| {
        let (a, b) = (direction(a), direction(b));
        let upper = |d: &Vector2f| d.y >= 0.0;
        // In the lower half plane x ascends with the angle, in the upper one it descends.
        let along = if upper(&a) { b.x.total_cmp(&a.x) } else { a.x.total_cmp(&b.x) };
        upper(&a).cmp(&upper(&b)).then(along)
    });
}

/// The direction (radians) of the surface normal at each return, facing the origin, estimated from
/// neighbours in a scan sorted by [`sort_by_direction`].
pub fn estimate_normals(
    sorted_returns: &[Point3f],
    origin: &Point3f,
    options: &NormalEstimationOptions,
) -> Vec<f32> {
    let radius = options.sample_radius as f32;
    let half = options.num_normal_samples / 2;
    let ahead = options.num_normal_samples.div_ceil(2).saturating_add(1);
    let near = |p: &Point3f, q: &Point3f| (p - q).norm() < radius;
    let normal = |(i, point): (usize, &Point3f)| {
        let before = sorted_returns[..i].iter().rev().take(half).take_while(|q| near(point, q)).count();
        let after = sorted_returns[i..].iter().take(ahead).take_while(|q| near(point, q)).count();
        normal_from_window(sorted_returns, i, i - before..i + after, origin)
    };
    sorted_returns.iter().enumerate().map(normal).collect()
}

/// The normal at point `i` from its neighbours in `window`; the direction to the origin if there are
/// none.
fn normal_from_window(points: &[Point3f], i: usize, window: std::ops::Range<usize>, origin: &Point3f) -> f32 {
    let point = &points[i];
    let to_origin = (origin - point).xy();
    if window.len() < 2 {
        return to_origin.y.atan2(to_origin.x);
    }
    let mut sum = Vector2f::zeros();
    for sample in window.filter(|s| *s != i) {
        let tangent = (point - points[sample]).xy();
        let candidate = Vector2f::new(-tangent.y, tangent.x);
        let length = candidate.norm();
        if length < 1e-6 {
            continue;
        }
        let facing = if candidate.dot(&to_origin) < 0.0 { -candidate } else { candidate };
        sum += facing / length;
    }
    sum.y.atan2(sum.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::normalize_angle;
    use std::f32::consts::PI;

    fn normals(mut points: Vec<Point3f>, num_normal_samples: usize) -> Vec<f32> {
        let origin = Point3f::origin();
        sort_by_direction(&mut points, &origin);
        let options = NormalEstimationOptions { num_normal_samples, sample_radius: 10.0 };
        estimate_normals(&points, &origin, &options)
    }

    fn difference(a: f32, b: f32) -> f64 {
        normalize_angle(f64::from(a - b)).abs()
    }

    #[test]
    fn a_lone_point_looks_at_the_origin() {
        for i in 0..100 {
            let a = 2.0 * PI * i as f32 / 100.0;
            let normal = normals(vec![Point3f::new(a.cos(), a.sin(), 0.0)], 2)[0];
            assert!(difference(normal, a - PI) < 1e-4, "{a}");
        }
    }

    #[test]
    fn walls_look_at_the_origin() {
        for (wall, expected) in [(0.0, PI), (90.0, -PI / 2.0), (180.0, 0.0), (270.0, PI / 2.0f32)] {
            let turn = nalgebra::Rotation2::new(f32::to_radians(wall));
            let points = [-1.0, 0.0, 1.0].map(|s| turn * nalgebra::Point2::new(1.0, s));
            let found = normals(points.map(|p| Point3f::new(p.x, p.y, 0.0)).to_vec(), 4);
            assert!(found.iter().all(|n| difference(*n, expected) < 1e-4), "{wall}");
        }
    }

    #[test]
    fn normals_of_a_circle_point_inwards() {
        let step = 2.0 * PI / 100.0;
        for samples in [1, 2, 4, 5, 8] {
            let points = (0..100).map(|i| {
                let a = step * i as f32 + PI;
                Point3f::new(a.cos(), a.sin(), 0.0)
            });
            let tolerance = f64::from(step) * samples as f64 / 2.0 + 1e-4;
            let found = normals(points.collect(), samples);
            // The scan starts at −π or at π, as rounding has it.
            for (i, normal) in found.iter().enumerate().skip(1) {
                assert!(difference(*normal, step * i as f32) < tolerance, "{samples} {i} {normal}");
            }
        }
    }
}
