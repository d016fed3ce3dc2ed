//! Residuals of a scan against the occupied cells of a probability grid.

use nalgebra as na;
use portolan_geometry::{Point3f, Rigid2, Vector2};
use portolan_grids::ProbabilityGrid;
use portolan_solver::NormalEquations;

use super::bicubic::BicubicGrid;

/// One residual per point: the interpolated correspondence cost at the transformed point, times the scaling.
pub(crate) struct OccupiedSpace2d<'a> {
    pub grid: BicubicGrid<'a>,
    pub max: Vector2,
    pub cells_per_metre: f64,
    pub points: &'a [Point3f],
    /// Weight divided by the root of the number of points.
    pub scaling: f64,
}

impl<'a> OccupiedSpace2d<'a> {
    pub fn new(grid: &'a ProbabilityGrid, points: &'a [Point3f], weight: f64) -> Self {
        Self {
            grid: BicubicGrid::new(grid),
            max: grid.limits().max(),
            cells_per_metre: 1.0 / grid.limits().resolution(),
            points,
            scaling: weight / (points.len().max(1) as f64).sqrt(),
        }
    }

    /// Half the sum of squared residuals at `pose`; adds to the normal equations of (x, y, θ).
    pub fn evaluate(&self, pose: &Rigid2, normal: Option<&mut NormalEquations<3>>) -> f64 {
        let (sin, cos) = pose.angle.sin_cos();
        let mut unused = NormalEquations::new();
        let normal = normal.unwrap_or(&mut unused);
        let slope = -self.scaling * self.cells_per_metre;
        let mut cost = 0.0;
        for point in self.points {
            let (px, py) = (f64::from(point.x), f64::from(point.y));
            // The point rotated, then translated; the rotated one is also the lever of the rotation.
            let (tx, ty) = (cos * px - sin * py, sin * px + cos * py);
            let row = (self.max.x - (tx + pose.translation.x)) * self.cells_per_metre - 0.5;
            let column = (self.max.y - (ty + pose.translation.y)) * self.cells_per_metre - 0.5;
            let at = self.grid.evaluate(row, column);
            let residual = self.scaling * at.value;
            let (by_x, by_y) = (slope * at.by_row, slope * at.by_column);
            normal.add(residual, &na::Vector3::new(by_x, by_y, by_y * tx - by_x * ty));
            cost += residual * residual;
        }
        0.5 * cost
    }
}
