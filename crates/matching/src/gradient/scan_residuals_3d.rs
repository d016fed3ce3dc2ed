//! Residuals of a scan against a grid in 3D.

use nalgebra as na;
use portolan_geometry::{Point3f, Rigid3, Vector3};
use portolan_grids::{Average, HybridGrid, IntensityGrid, is_finite};
use portolan_sensor::PointCloud;
use portolan_solver::{Loss, NormalEquations};

use super::smooth_grid_3d::{SmoothGrid3d, wide};

/// One residual per point: `scaling · (1 − P)` with the interpolated probability P at the transformed point.
pub(crate) struct OccupiedSpace3d<'a> {
    grid: SmoothGrid3d<'a, u16>,
    points: &'a [Point3f],
    /// Weight divided by the root of the number of points.
    scaling: f64,
}

impl<'a> OccupiedSpace3d<'a> {
    pub fn new(grid: &'a HybridGrid, points: &'a [Point3f], weight: f64) -> Self {
        Self { grid: grid.into(), points, scaling: scaling(weight, points.len()) }
    }

    /// Half the sum of squared residuals at `pose`; adds to the normal equations.
    pub fn evaluate<const N: usize>(&self, pose: &Rigid3, normal: &mut NormalEquations<N>) -> f64 {
        let rotation = pose.rotation.to_rotation_matrix();
        let mut cost = 0.0;
        for point in self.points.iter().filter(|p| is_finite(p)) {
            let turned = rotation * wide(point);
            let (value, gradient) = self.grid.evaluate(&(turned + pose.translation.vector));
            let residual = self.scaling * (1.0 - value);
            normal.add(residual, &row(&(gradient * -self.scaling), &turned));
            cost += residual * residual;
        }
        0.5 * cost
    }
}

/// One residual per point: `scaling · (I − intensity)` with the interpolated intensity I at the transformed
/// point; nothing for points brighter than the threshold. All of them share one Huber loss.
pub(crate) struct IntensityResiduals<'a> {
    grid: SmoothGrid3d<'a, Average>,
    cloud: &'a PointCloud,
    scaling: f64,
    threshold: f32,
    loss: Loss,
}

impl<'a> IntensityResiduals<'a> {
    pub fn new(
        grid: &'a IntensityGrid,
        cloud: &'a PointCloud,
        weight: f64,
        threshold: f32,
        huber_scale: f64,
    ) -> Self {
        let scaling = scaling(weight, cloud.len());
        Self { grid: grid.into(), cloud, scaling, threshold, loss: Loss::Huber(huber_scale) }
    }

    /// Half the loss of the sum of squared residuals at `pose`; adds to the normal equations.
    pub fn evaluate<const N: usize>(&self, pose: &Rigid3, normal: &mut NormalEquations<N>) -> f64 {
        let mut own = NormalEquations::new();
        let mut squares = 0.0;
        self.for_each_residual(pose, |residual, row| {
            own.add(residual, row);
            squares += residual * residual;
        });
        // A Huber loss only scales the Gauss-Newton terms: its second derivative is never positive.
        let loss = self.loss.evaluate(squares);
        normal.hessian += own.hessian * loss.first;
        normal.gradient += own.gradient * loss.first;
        0.5 * loss.value
    }

    fn for_each_residual<const N: usize>(
        &self,
        pose: &Rigid3,
        mut visit: impl FnMut(f64, &na::SVector<f64, N>),
    ) {
        let rotation = pose.rotation.to_rotation_matrix();
        for (point, intensity) in self.cloud.points.iter().zip(&self.cloud.intensities) {
            if intensity.is_nan() || *intensity > self.threshold || !is_finite(point) {
                continue;
            }
            let turned = rotation * wide(point);
            let (value, gradient) = self.grid.evaluate(&(turned + pose.translation.vector));
            let residual = self.scaling * (value - f64::from(*intensity));
            visit(residual, &row(&(gradient * self.scaling), &turned));
        }
    }
}

fn scaling(weight: f64, num_points: usize) -> f64 {
    weight / (num_points.max(1) as f64).sqrt()
}

/// The row of the Jacobian for a residual whose derivative by the position of the point is `by_place`: the
/// translation first, then the half-angle vector of a rotation applied after the pose's own, of which only
/// the part about z counts when there are four columns.
#[inline]
fn row<const N: usize>(by_place: &Vector3, turned: &Vector3) -> na::SVector<f64, N> {
    let by_half_angle = turned.cross(by_place) * 2.0;
    na::SVector::from_fn(|i, _| match i {
        0..3 => by_place[i],
        _ if N == 4 => by_half_angle.z,
        _ => by_half_angle[i - 3],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intensity_residuals_are_grid_minus_point() {
        let mut grid = IntensityGrid::new(0.3).unwrap();
        grid.add_intensity([0, 0, 0], 50.0);
        let cloud = PointCloud {
            points: [0.0, 1.0, 2.0].map(|v| Point3f::new(v, v, v)).to_vec(),
            intensities: vec![50.0, 100.0, 150.0],
        };
        // The weight undoes the division by the root of three points.
        let residuals = IntensityResiduals::new(&grid, &cloud, 3f64.sqrt(), 100.0, 1e9);
        let mut found = Vec::new();
        residuals.for_each_residual::<6>(&Rigid3::identity(), |r, _| found.push(r));
        assert_eq!(found.len(), 2, "the third is too bright");
        assert!(found[0].abs() < 1e-9 && (found[1] + 100.0).abs() < 1e-9, "{found:?}");
    }
}
