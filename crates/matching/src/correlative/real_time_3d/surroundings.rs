//! Copies the part of a grid around each point that any placement of a window can put it in.

use portolan_geometry::{Point3f, Rigid3f};
use portolan_grids::{HybridGrid, VoxelIndex, value::PROBABILITY_CODE};

use super::UNKNOWN;

/// More cells than this are not copied: 128 MB.
const MAX_COPIED_CELLS: usize = 1 << 25;

/// Probabilities around every point, copied from the grid so that reading one is a matter of
/// multiplication, not of search.
pub(super) struct Surroundings<'a> {
    grid: &'a HybridGrid,
    boxes: Vec<CopiedBox>,
    probabilities: Vec<f32>,
}

/// A box of cells and where its copy starts.
#[derive(Clone, Copy)]
struct CopiedBox {
    first: VoxelIndex,
    size: [i32; 3],
    start: usize,
}

/// The cells around one point.
pub(super) struct Around<'a> {
    grid: &'a HybridGrid,
    first: VoxelIndex,
    size: [i32; 3],
    probabilities: &'a [f32],
}

impl<'a> Surroundings<'a> {
    /// For `points` at `initial`, rotated by up to `max_angle` and moved by up to `max_shift`.
    pub fn new(
        grid: &'a HybridGrid,
        points: &[Point3f],
        initial: &Rigid3f,
        max_angle: f32,
        max_shift: f32,
    ) -> Self {
        let mut surroundings =
            Self { grid, boxes: Vec::with_capacity(points.len()), probabilities: Vec::new() };
        for point in points {
            // A chord of a circle is shorter than the arc and than the diameter.
            let reach = point.coords.norm() * max_angle.min(2.0) + max_shift + grid.resolution();
            let center = initial * point;
            let corner = |sign: f32| {
                let place = center.coords.add_scalar(sign * reach);
                grid.lattice().unchecked_cell(place.into())
            };
            surroundings.copy(corner(-1.0), corner(1.0));
        }
        surroundings
    }

    fn copy(&mut self, first: VoxelIndex, last: VoxelIndex) {
        let size = [0, 1, 2].map(|a| last[a] - first[a] + 1);
        let start = self.probabilities.len();
        let count = size.iter().map(|n| *n as usize).product::<usize>();
        if start + count > MAX_COPIED_CELLS {
            self.boxes.push(CopiedBox { first, size: [0; 3], start });
            return;
        }
        self.probabilities.resize(start + count, UNKNOWN);
        let copy = &mut self.probabilities[start..];
        self.grid.cells().for_each_in_box(first, last, |cell, code| {
            let [x, y, z] = [0, 1, 2].map(|a| (cell[a] - first[a]) as usize);
            let at = (z * size[1] as usize + y) * size[0] as usize + x;
            copy[at] = PROBABILITY_CODE.decode(code, UNKNOWN);
        });
        self.boxes.push(CopiedBox { first, size, start });
    }

    /// The cells around the point with a number.
    pub fn of_point(&self, number: usize) -> Around<'_> {
        let CopiedBox { first, size, start } = self.boxes[number];
        let count = size.iter().map(|n| *n as usize).product::<usize>();
        Around { grid: self.grid, first, size, probabilities: &self.probabilities[start..start + count] }
    }
}

impl Around<'_> {
    /// The probability of a cell.
    #[inline]
    pub fn probability(&self, cell: VoxelIndex) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|a| (cell[a] - self.first[a]) as u32);
        let [nx, ny, nz] = self.size.map(|n| n as u32);
        if x < nx && y < ny && z < nz {
            return self.probabilities[((z * ny + y) * nx + x) as usize];
        }
        self.grid.probability(cell)
    }
}
