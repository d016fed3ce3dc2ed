//! A grid in 3D as a smooth function of position: between the centres of cells values blend by `3u² − 2u³`
//! along each axis, flat at the centres.

use portolan_geometry::{Point3f, Vector3};

use portolan_grids::value::{MIN_PROBABILITY, PROBABILITY_CODE, UNKNOWN_CELL};
use portolan_grids::{Average, HybridGrid, IntensityGrid, MAX_VOXEL_INDEX, VoxelLattice, VoxelMap};

/// Meaning of the cells of a grid in 3D.
pub(crate) trait CellValue: Copy + Default {
    /// The value of a cell; none is an unknown cell.
    fn value(cell: Option<Self>) -> f64;
}

/// Codes of probabilities.
impl CellValue for u16 {
    #[inline]
    fn value(cell: Option<u16>) -> f64 {
        f64::from(PROBABILITY_CODE.decode(cell.unwrap_or(UNKNOWN_CELL), MIN_PROBABILITY))
    }
}

/// Mean intensities.
impl CellValue for Average {
    #[inline]
    fn value(cell: Option<Average>) -> f64 {
        f64::from(cell.unwrap_or_default().mean())
    }
}

/// A grid to be read between its cells.
#[derive(Clone, Copy)]
pub(crate) struct SmoothGrid3d<'a, T> {
    lattice: VoxelLattice,
    cells: &'a VoxelMap<T>,
}

impl<'a> From<&'a HybridGrid> for SmoothGrid3d<'a, u16> {
    fn from(grid: &'a HybridGrid) -> Self {
        Self { lattice: grid.lattice(), cells: grid.cells() }
    }
}

impl<'a> From<&'a IntensityGrid> for SmoothGrid3d<'a, Average> {
    fn from(grid: &'a IntensityGrid) -> Self {
        Self { lattice: grid.lattice(), cells: grid.cells() }
    }
}

impl<T: CellValue> SmoothGrid3d<'_, T> {
    /// The value at a place (metres) and its gradient (per metre).
    #[inline]
    pub fn evaluate(&self, place: &Vector3) -> (f64, Vector3) {
        let resolution = f64::from(self.lattice.resolution);
        let nearest = self.lattice.unchecked_cell([place.x as f32, place.y as f32, place.z as f32]);
        let reach = -MAX_VOXEL_INDEX..MAX_VOXEL_INDEX;
        if nearest.iter().any(|i| !reach.contains(i)) {
            return (T::value(None), Vector3::zeros());
        }
        // Centres of cells are computed in single precision, as in Cartographer.
        let center = |index: i32| f64::from(index as f32 * self.lattice.resolution);
        let mut low = nearest;
        let (mut blend, mut slope) = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            let mut start = center(nearest[axis]);
            if start > place[axis] {
                low[axis] -= 1;
                start -= resolution;
            }
            let u = (place[axis] - start) / resolution;
            blend[axis] = u * u * (3.0 - 2.0 * u);
            slope[axis] = 6.0 * u * (1.0 - u) / resolution;
        }
        let v = self.cells.corners(low).map(T::value);
        // Along z for the four columns, then along y, then along x.
        let along_z = [0, 1, 2, 3].map(|c| v[c] + (v[c + 4] - v[c]) * blend[2]);
        let by_z = [0, 1, 2, 3].map(|c| (v[c + 4] - v[c]) * slope[2]);
        let along_y = [0, 1].map(|c| along_z[c] + (along_z[c + 2] - along_z[c]) * blend[1]);
        let by_y = [0, 1].map(|c| (along_z[c + 2] - along_z[c]) * slope[1]);
        let by_z = [0, 1].map(|c| by_z[c] + (by_z[c + 2] - by_z[c]) * blend[1]);
        let mix = |pair: [f64; 2]| pair[0] + (pair[1] - pair[0]) * blend[0];
        let gradient = Vector3::new((along_y[1] - along_y[0]) * slope[0], mix(by_y), mix(by_z));
        (mix(along_y), gradient)
    }
}

/// A point in double precision.
#[inline]
pub(crate) fn wide(point: &Point3f) -> Vector3 {
    Vector3::new(f64::from(point.x), f64::from(point.y), f64::from(point.z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Lcg;

    fn seven_cells() -> HybridGrid {
        let mut grid = HybridGrid::new(0.1).unwrap();
        for (x, y, z) in [
            (-3.0, 2.0, 0.5),
            (-2.0, 2.0, 0.5),
            (-1.0, 2.0, 0.5),
            (-3.0, 1.9, 0.6),
            (-2.1, 1.9, 0.6),
            (0.1, -0.4, 0.0),
            (0.2, -0.4, 0.1),
        ] {
            let cell = grid.cell_index(&Point3f::new(x, y, z)).unwrap();
            grid.set_probability(cell, 0.8);
        }
        grid
    }

    #[test]
    fn cell_centres_keep_their_value() {
        let grid = seven_cells();
        let smooth = SmoothGrid3d::from(&grid);
        for z in -20..20 {
            for y in -20..25 {
                for x in -35..25 {
                    let center = wide(&grid.cell_center([x, y, z]));
                    let expected = f64::from(grid.probability([x, y, z]));
                    assert!((smooth.evaluate(&center).0 - expected).abs() < 1e-6);
                }
            }
        }
    }

    #[test]
    fn values_rise_steadily_between_centres() {
        let grid = seven_cells();
        let smooth = SmoothGrid3d::from(&grid);
        let at = |x: f64| smooth.evaluate(&Vector3::new(x, 2.0, 0.5)).0;
        let samples: Vec<f64> = (0..=50).map(|i| at(-3.1 + 0.1 * f64::from(i) / 50.0)).collect();
        assert!(samples.is_sorted() && samples[0] < 0.1001 && samples[50] > 0.7999);
    }

    #[test]
    fn slopes_are_derivatives() {
        let (mut grid, mut lcg) = (HybridGrid::new(0.45).unwrap(), Lcg::new(3));
        for _ in 0..3000 {
            let cell = [0; 3].map(|_| lcg.symmetric(9.0).round() as i32);
            grid.set_probability(cell, 0.5 + lcg.symmetric(0.4));
        }
        let smooth = SmoothGrid3d::from(&grid);
        for _ in 0..500 {
            let place = Vector3::from([0; 3].map(|_| f64::from(lcg.symmetric(4.5))));
            let gradient = smooth.evaluate(&place).1;
            for axis in 0..3 {
                let step = Vector3::ith(axis, 1e-6);
                let difference = smooth.evaluate(&(place + step)).0 - smooth.evaluate(&(place - step)).0;
                assert!((gradient[axis] - difference / 2e-6).abs() < 1e-6, "{place} {axis}");
            }
        }
        for far in [1e5, -1e5, f64::NAN, f64::INFINITY] {
            let (value, slope) = smooth.evaluate(&Vector3::new(0.0, far, 0.0));
            assert!((value - 0.1).abs() < 1e-7 && slope == Vector3::zeros());
        }
    }
}
