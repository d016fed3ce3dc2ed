//! Coarse alignment of two sweeps when nothing is known of the motion: nearest points, coarse to fine.
//!
//! A car that is already driving has moved more than a metre between its first two sweeps. Points are paired with their
//! nearest neighbours and the pairs are brought together as in Vizzo et al., "KISS-ICP: In Defense of Point-to-Point ICP",
//! 2023 (equations 5 to 7), with cells that begin as large as the motion may be.

use nalgebra as na;
use portolan_geometry::{Point3f, Quaternion, Rigid3, Vector3, quaternion_from_angle_axis, to_f32};
use portolan_spatial::VoxelHash;

use crate::settings::CoarseAlignmentSettings;

/// What scans are aligned to.
pub(crate) struct CoarseReference {
    /// The same points in cells of each size.
    sizes: [Cells; 3],
}

impl CoarseReference {
    /// Of points in metres. Points on level ground should be left out: the rings in which beams meet it move with the
    /// scanner.
    pub fn new(points: &[Point3f], settings: &CoarseAlignmentSettings) -> Self {
        Self { sizes: settings.cells.map(|edge| Cells::new(points, edge, settings.points_per_cell)) }
    }

    /// The pose near `initial` at which the points of a scan lie nearest to these, in their frame. None if they hardly
    /// overlap. Points on level ground should be left out there, too.
    pub fn align(
        &self,
        scan: &[Point3f],
        initial: &Rigid3,
        settings: &CoarseAlignmentSettings,
    ) -> Option<Rigid3> {
        let stride = scan.len().div_ceil(settings.max_points.max(1)).max(1);
        let scan: Vec<Point3f> = scan.iter().copied().step_by(stride).collect();
        let mut pose = *initial;
        for cells in &self.sizes {
            for _ in 0..settings.iterations {
                let step = step(cells, &scan, &pose, settings.min_pairs)?;
                let turn = quaternion_from_angle_axis(&step.fixed_rows::<3>(3).into_owned());
                let translation: Vector3 = step.fixed_rows::<3>(0).into();
                pose = Rigid3::from_parts(
                    (pose.translation.vector + translation).into(),
                    Quaternion::new_normalize((turn * pose.rotation).into_inner()),
                );
                if step.norm() < settings.converged {
                    break;
                }
            }
        }
        Some(pose)
    }
}

struct Cells {
    edge: f32,
    points: VoxelHash<Vec<Point3f>>,
}

/// A cell and its neighbours, those first that are likely to be near.
const AROUND: [[i32; 3]; 27] = {
    let mut around = [[0; 3]; 27];
    let (mut filled, mut sides) = (0, 0);
    while sides <= 3 {
        let mut i = 0;
        while i < 27 {
            let cell = [i / 9 - 1, i / 3 % 3 - 1, i % 3 - 1];
            if cell[0] * cell[0] + cell[1] * cell[1] + cell[2] * cell[2] == sides {
                around[filled] = cell;
                filled += 1;
            }
            i += 1;
        }
        sides += 1;
    }
    around
};

impl Cells {
    fn new(reference: &[Point3f], edge: f32, points_per_cell: usize) -> Self {
        let mut cells = Self { edge, points: VoxelHash::default() };
        for point in reference.iter().filter(|p| p.coords.iter().all(|v| v.abs() < 1e6)) {
            let cell = cells.points.or_default(cells.cell(point));
            if cell.len() < points_per_cell {
                cell.push(*point);
            }
        }
        cells
    }

    fn cell(&self, point: &Point3f) -> [i32; 3] {
        [point.x, point.y, point.z].map(|v| (v / self.edge).floor() as i32)
    }

    /// The nearest point in the cell around a place and in its neighbours. Cells that are farther than the nearest point so
    /// far are passed by.
    fn nearest(&self, place: &Point3f) -> Option<Point3f> {
        let cell = self.cell(place);
        // Squared distances from the cells before, at and after the place along each axis.
        let mut off = [[0.0; 3]; 3];
        for axis in 0..3 {
            let inside = place[axis] - cell[axis] as f32 * self.edge;
            off[axis] = [inside * inside, 0.0, (self.edge - inside) * (self.edge - inside)];
        }
        let (mut nearest, mut least) = (None, f32::INFINITY);
        for side in AROUND {
            let [x, y, z] = [0, 1, 2].map(|axis| off[axis][(side[axis] + 1) as usize]);
            if x + y + z > least {
                continue;
            }
            let key = [0, 1, 2].map(|axis| cell[axis].saturating_add(side[axis]));
            for point in self.points.get(&key).into_iter().flatten() {
                let squared = (point - place).norm_squared();
                if squared < least {
                    (nearest, least) = (Some(*point), squared);
                }
            }
        }
        nearest
    }
}

fn step(cells: &Cells, scan: &[Point3f], pose: &Rigid3, min_pairs: usize) -> Option<na::Vector6<f64>> {
    let single = to_f32(pose);
    let scale = f64::from(cells.edge * cells.edge) / 9.0;
    let mut hessian = na::Matrix6::<f64>::identity() * 1e-3;
    let mut gradient = na::Vector6::<f64>::zeros();
    let mut pairs = 0;
    for point in scan {
        let place = single * point;
        let Some(nearest) = cells.nearest(&place) else { continue };
        let residual = (place - nearest).cast::<f64>();
        let weight = (scale / (scale + residual.norm_squared())).powi(2);
        let arm = (single.rotation * point.coords).cast::<f64>();
        let mut jacobian = na::Matrix3x6::<f64>::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-arm.cross_matrix());
        hessian += jacobian.transpose() * jacobian * weight;
        gradient += jacobian.transpose() * residual * weight;
        pairs += 1;
    }
    let step = (pairs >= min_pairs).then(|| hessian.cholesky())??.solve(&-gradient);
    step.iter().all(|v| v.is_finite()).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn posts_and_walls_show_how_far_a_car_went() {
        let mut street = Vec::new();
        for i in 0..12 {
            let x = 5.3 * i as f32 + (i * i % 5) as f32;
            for k in 0..20 {
                let z = 0.2 * k as f32;
                street.push(Point3f::new(x, 6.0 + (i % 3) as f32, z));
                street.push(Point3f::new(x + 1.7, -5.0 - (i % 2) as f32, z));
            }
        }
        let expected = Rigid3::new(Vector3::new(1.6, 0.1, 0.0), Vector3::z() * 0.03);
        let scan: Vec<Point3f> = street.iter().map(|p| to_f32(&expected.inverse()) * p).collect();
        let align = |reference: &[Point3f], scan: &[Point3f]| {
            let settings = CoarseAlignmentSettings::default();
            CoarseReference::new(reference, &settings).align(scan, &Rigid3::identity(), &settings)
        };
        let found = align(&street, &scan).unwrap();
        assert!((found.inverse() * expected).translation.vector.norm() < 0.02, "{found}");
        assert!(align(&street, &scan[..5]).is_none());
        assert!(align(&[], &scan).is_none());
    }
}
