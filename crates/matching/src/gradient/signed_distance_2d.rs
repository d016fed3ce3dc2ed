//! Residuals of a scan against a truncated signed distance field.

use nalgebra as na;
use portolan_geometry::{Point3f, Rigid2};
use portolan_solver::NormalEquations;

use portolan_grids::{CellIndex, Tsdf2d};

/// Distance and weight at a place, with derivatives by x and y (per metre).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct InterpolatedTsdf {
    pub distance: f64,
    pub distance_by: [f64; 2],
    pub weight: f64,
    pub weight_by: [f64; 2],
}

/// Bilinear interpolation between cell centres at (`x`, `y`), metres. Where one of the four cells is
/// not known the distance is the truncation distance, flat.
pub(crate) fn interpolate(tsdf: &Tsdf2d, x: f64, y: f64) -> InterpolatedTsdf {
    let limits = tsdf.limits();
    let per_metre = 1.0 / limits.resolution();
    // On a cell centre the neighbour beyond has no weight, not even one of the size of rounding errors.
    let snapped = |v: f64| if (v - v.round()).abs() < 1e-9 { v.round() } else { v };
    let row = snapped((limits.max().x - x) * per_metre - 0.5);
    let column = snapped((limits.max().y - y) * per_metre - 0.5);
    // Indices run against the axes: the neighbour with the smaller coordinate has the larger index.
    let (low_row, low_column) = (row.ceil(), column.ceil());
    let (u, v) = (low_row - row, low_column - column);
    let cell = |dx: i32, dy: i32| {
        CellIndex::new((low_column as i32).saturating_sub(dx), (low_row as i32).saturating_sub(dy))
    };
    let corners = [cell(0, 0), cell(1, 0), cell(0, 1), cell(1, 1)];
    let weights = corners.map(|c| f64::from(tsdf.weight(c)));
    let bilinear = |[low, up, right, both]: [f64; 4]| {
        let (left, right_side) = (low + v * (up - low), right + v * (both - right));
        let by_x = (right_side - left) * per_metre;
        let by_y = ((1.0 - u) * (up - low) + u * (both - right)) * per_metre;
        (left + u * (right_side - left), [by_x, by_y])
    };
    let (weight, weight_by) = bilinear(weights);
    let (distance, distance_by) = if weights.contains(&0.0) {
        (f64::from(tsdf.truncation_distance()), [0.0; 2])
    } else {
        bilinear(corners.map(|c| f64::from(tsdf.correspondence_cost(c))))
    };
    InterpolatedTsdf { distance, distance_by, weight, weight_by }
}

/// One residual per point: its distance to the surface times its fraction of all weights, times the scaling
/// and the number of points.
pub(crate) struct SignedDistance<'a> {
    pub tsdf: &'a Tsdf2d,
    pub points: &'a [Point3f],
    /// Weight divided by the root of the number of points.
    pub scaling: f64,
}

impl<'a> SignedDistance<'a> {
    pub fn new(tsdf: &'a Tsdf2d, points: &'a [Point3f], weight: f64) -> Self {
        Self { tsdf, points, scaling: weight / (points.len().max(1) as f64).sqrt() }
    }

    /// Half the sum of squared residuals at `pose`; adds to the normal equations of (x, y, θ). None if
    /// no point meets a known place.
    ///
    /// With `a = C W` of a point, `b = ∂a` and `S = Σ W`, a residual is `k a / S` and its row
    /// `k (b − a ∂S/S) / S`; the sums over the points of `a²`, `a b`, `b bᵀ` and `∂W` are all it takes.
    pub fn evaluate(&self, pose: &Rigid2, normal: Option<&mut NormalEquations<3>>) -> Option<f64> {
        let (sin, cos) = pose.angle.sin_cos();
        let mut sums = NormalEquations::<3>::new();
        let (mut squares, mut weight, mut weight_by) = (0.0, 0.0, na::Vector3::zeros());
        for point in self.points {
            let (px, py) = (f64::from(point.x), f64::from(point.y));
            let (tx, ty) = (cos * px - sin * py, sin * px + cos * py);
            let at = interpolate(self.tsdf, tx + pose.translation.x, ty + pose.translation.y);
            let by_pose = |[x, y]: [f64; 2]| na::Vector3::new(x, y, y * tx - x * ty);
            let (distance_by, point_weight_by) = (by_pose(at.distance_by), by_pose(at.weight_by));
            let a = at.distance * at.weight;
            sums.add(a, &(distance_by * at.weight + point_weight_by * at.distance));
            squares += a * a;
            weight += at.weight;
            weight_by += point_weight_by;
        }
        if weight == 0.0 {
            return None;
        }
        let factor = (self.points.len() as f64 * self.scaling / weight).powi(2);
        if let Some(normal) = normal {
            let relative = weight_by / weight;
            let hessian = sums.symmetric_hessian()
                - sums.gradient * relative.transpose()
                - relative * sums.gradient.transpose()
                + squares * relative * relative.transpose();
            normal.hessian += hessian * factor;
            normal.gradient += (sums.gradient - squares * relative) * factor;
        }
        Some(0.5 * squares * factor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Vector2;
    use portolan_grids::{MapLimits, TsdfInserter, TsdfInserterOptions};
    use portolan_sensor::{PointCloud, RangeData};

    fn field(cells: &[(i32, i32, f32, f32)]) -> Tsdf2d {
        let limits = MapLimits::new(1.0, Vector2::new(5.5, 5.5), 10, 10).unwrap();
        let mut tsdf = Tsdf2d::new(limits, 1.0, 10.0).unwrap();
        cells.iter().for_each(|(x, y, d, w)| tsdf.set(CellIndex::new(*x, *y), *d, *w));
        tsdf.finish_update();
        tsdf
    }

    #[test]
    fn interpolation_is_bilinear_between_known_cells() {
        // Cell (x, y) has its centre at (5 − y, 5 − x).
        let tsdf = field(&[(3, 4, 0.1, 1.0), (2, 4, 0.2, 2.0), (3, 3, 0.3, 3.0), (2, 3, 0.4, 4.0)]);
        let (x0, y0) = (1.0, 2.0);
        for (u, v) in [(0.0, 0.0), (0.25, 0.5), (0.9, 0.1), (0.999, 0.999)] {
            let at = interpolate(&tsdf, x0 + u, y0 + v);
            if (u, v) != (0.0, 0.0) {
                assert!((at.distance - (0.1 + 0.2 * u + 0.1 * v)).abs() < 1e-3, "{u} {v}");
            }
            assert!((at.weight - (1.0 + 2.0 * u + v)).abs() < 1e-3, "{u} {v}");
            assert!((at.weight_by[0] - 2.0).abs() < 1e-2 && (at.weight_by[1] - 1.0).abs() < 1e-2);
        }
        assert_eq!(interpolate(&tsdf, x0 + 1.5, y0 + 0.5).distance, 1.0);
        assert_eq!(interpolate(&tsdf, 1e30, -1e30).weight, 0.0);
    }

    fn wall() -> Tsdf2d {
        let limits = MapLimits::new(0.1, Vector2::new(2.05, 2.05), 40, 40).unwrap();
        let mut tsdf = Tsdf2d::new(limits, 0.3, 1.0).unwrap();
        let points = (-5..=5).map(|i| Point3f::new(0.1 * i as f32, 1.0, 0.0)).collect();
        let data = RangeData {
            origin: Point3f::new(-0.5, -0.5, 0.0),
            returns: PointCloud::new(points),
            misses: PointCloud::default(),
        };
        let inserter = TsdfInserter::new(&TsdfInserterOptions {
            maximum_weight: 1.0,
            update_weight_angle_scan_normal_to_ray_kernel_bandwidth: 0.0,
            update_weight_distance_cell_to_hit_kernel_bandwidth: 0.0,
            ..Default::default()
        });
        inserter.unwrap().insert(&data, &mut tsdf).unwrap();
        tsdf
    }

    #[test]
    fn the_residual_is_the_distance_to_the_wall() {
        let (tsdf, points) = (wall(), [Point3f::new(0.0, 1.0, 0.0)]);
        let problem = SignedDistance::new(&tsdf, &points, 1.0);
        for (y, residual) in [(0.0, 0.0), (0.1, -0.1), (-0.1, 0.1f64)] {
            let mut normal = NormalEquations::new();
            let cost = problem.evaluate(&Rigid2::new(0.0, y, 0.0), Some(&mut normal)).unwrap();
            assert!((cost - 0.5 * residual * residual).abs() < 1e-3);
            assert!((normal.hessian[(1, 1)] - 1.0).abs() < 1e-3, "{normal:?}");
            assert!((normal.gradient[1] + residual).abs() < 1e-3, "{normal:?}");
            assert!(normal.hessian[(0, 0)].abs() < 1e-3 && normal.hessian[(2, 2)].abs() < 1e-3);
        }
        for y in [0.4, -0.4] {
            assert_eq!(problem.evaluate(&Rigid2::new(0.0, y, 0.0), None), None);
        }
        let empty = field(&[]);
        assert_eq!(SignedDistance::new(&empty, &points, 1.0).evaluate(&Rigid2::identity(), None), None);
    }

    #[test]
    fn derivatives_are_those_of_the_cost() {
        let mut cells = Vec::new();
        for x in 0..10 {
            for y in 0..10 {
                let s = (x * 7 + y * 3) % 11;
                cells.push((x, y, s as f32 / 11.0 - 0.4, 1.0 + ((x * 5 + y) % 7) as f32));
            }
        }
        let tsdf = field(&cells);
        let points = [(0.3, 0.4), (1.7, -2.1), (-2.4, 0.9), (0.1, 3.3)].map(|(x, y)| Point3f::new(x, y, 0.0));
        let problem = SignedDistance::new(&tsdf, &points, 2.0);
        let pose = Rigid2::new(0.13, -0.21, 0.17);
        let mut normal = NormalEquations::new();
        problem.evaluate(&pose, Some(&mut normal)).unwrap();
        for i in 0..3 {
            let h = 1e-6;
            let moved = |s: f64| {
                let d = [0, 1, 2].map(|k| if k == i { s } else { 0.0 });
                let pose =
                    Rigid2::new(pose.translation.x + d[0], pose.translation.y + d[1], pose.angle + d[2]);
                problem.evaluate(&pose, None).unwrap()
            };
            let numeric = (moved(h) - moved(-h)) / (2.0 * h);
            assert!((numeric - normal.gradient[i]).abs() < 1e-6, "{i} {numeric} {normal:?}");
        }
    }
}
