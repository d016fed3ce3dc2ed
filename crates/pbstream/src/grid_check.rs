//! Checks whether grids are valid, and repairs them.

use crate::codes::without_marker;
use crate::proto::mapping::grid2_d::{CellBox, Grid};
use crate::proto::mapping::{Grid2D, HybridGrid};

/// Bound of the absolute value of voxel indices.
const MAX_VOXEL_INDEX: i32 = 8192;

/// Problems of a grid.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GridReport {
    /// Why the grid cannot be used; none if it can.
    pub broken: Option<String>,
    /// Cells whose value is not 0 to 32767, or whose index is out of range.
    pub bad_cells: usize,
    /// The box of known cells is not inside the grid.
    pub bad_box: bool,
}

impl GridReport {
    fn broken(text: String) -> Self {
        Self { broken: Some(text), ..Self::default() }
    }

    /// Whether there are no problems.
    pub fn is_good(&self) -> bool {
        *self == Self::default()
    }
}

fn is_bad(cell: i32) -> bool {
    without_marker(cell).and_then(|c| i32::try_from(c).ok()) != Some(cell)
}

/// Checks sizes, bounds and cells of a 2D grid.
pub fn check_grid_2d(grid: &Grid2D) -> GridReport {
    let limits = grid.limits.unwrap_or_default();
    let max = limits.max.unwrap_or_default();
    if !(limits.resolution.is_finite() && limits.resolution > 0.0) {
        return GridReport::broken(format!("the resolution is {}", limits.resolution));
    }
    if !(max.x.is_finite() && max.y.is_finite()) {
        return GridReport::broken("the corner of the grid is not finite".to_owned());
    }
    let size = limits.cell_limits.unwrap_or_default();
    let stated = i64::from(size.num_x_cells).saturating_mul(i64::from(size.num_y_cells));
    let found = grid.cells.len();
    if size.num_x_cells < 0 || size.num_y_cells < 0 || usize::try_from(stated) != Ok(found) {
        let (x, y) = (size.num_x_cells, size.num_y_cells);
        return GridReport::broken(format!("the grid states {x} x {y} cells but has {found}"));
    }
    let mut bad_cells = grid.cells.iter().filter(|c| is_bad(**c)).count();
    match &grid.grid {
        None => return GridReport::broken("the type of the grid is not known".to_owned()),
        Some(Grid::ProbabilityGrid2d(_)) => {
            let (low, high) = (grid.min_correspondence_cost, grid.max_correspondence_cost);
            if !(low.is_finite() && high.is_finite() && (low < high || (low == 0.0 && high == 0.0))) {
                return GridReport::broken(format!("the bounds of the cells are {low} and {high}"));
            }
        }
        Some(Grid::Tsdf2d(tsdf)) => {
            let positive = |v: f32| v.is_finite() && v > 0.0;
            if !positive(tsdf.truncation_distance) || !positive(tsdf.max_weight) {
                return GridReport::broken(format!(
                    "truncation distance {} or maximum weight {} is not positive",
                    tsdf.truncation_distance, tsdf.max_weight
                ));
            }
            let weights = tsdf.weight_cells.len();
            if weights != found {
                return GridReport::broken(format!("the grid has {found} cells but {weights} weights"));
            }
            bad_cells += tsdf.weight_cells.iter().filter(|c| is_bad(**c)).count();
        }
    }
    let bad_box = grid.known_cells_box.as_ref().is_some_and(|b| !fits(b, size.num_x_cells, size.num_y_cells));
    GridReport { broken: None, bad_cells, bad_box }
}

/// Whether the box of known cells is inside the grid. An inverted box is the encoding of an empty one.
fn fits(known: &CellBox, columns: i32, rows: i32) -> bool {
    let inverted = known.min_x > known.max_x || known.min_y > known.max_y;
    inverted || (known.min_x >= 0 && known.min_y >= 0 && known.max_x < columns && known.max_y < rows)
}

/// Checks sizes and cells of a 3D grid.
pub fn check_hybrid_grid(grid: &HybridGrid) -> GridReport {
    if !(grid.resolution.is_finite() && grid.resolution > 0.0) {
        return GridReport::broken(format!("the resolution is {}", grid.resolution));
    }
    let axes = [&grid.x_indices, &grid.y_indices, &grid.z_indices];
    if axes.iter().any(|a| a.len() != grid.values.len()) {
        let [x, y, z] = axes.map(Vec::len);
        return GridReport::broken(format!(
            "the grid has {x}, {y} and {z} indices but {} values",
            grid.values.len()
        ));
    }
    let bad_cells = (0..grid.values.len()).filter(|i| is_bad_voxel(grid, *i)).count();
    GridReport { broken: None, bad_cells, bad_box: false }
}

fn is_bad_voxel(grid: &HybridGrid, i: usize) -> bool {
    let inside = |axis: &[i32]| axis.get(i).is_some_and(|v| (-MAX_VOXEL_INDEX..MAX_VOXEL_INDEX).contains(v));
    let inside = inside(&grid.x_indices) && inside(&grid.y_indices) && inside(&grid.z_indices);
    !inside || grid.values.get(i).is_none_or(|v| is_bad(*v))
}

/// Removes update markers, sets invalid cells to unknown and computes the box of known cells again. The sizes
/// must be valid.
pub fn mend_grid_2d(grid: &mut Grid2D) {
    let mend = |cells: &mut Vec<i32>| {
        cells
            .iter_mut()
            .for_each(|c| *c = without_marker(*c).and_then(|c| i32::try_from(c).ok()).unwrap_or(0));
    };
    mend(&mut grid.cells);
    if let Some(Grid::Tsdf2d(tsdf)) = &mut grid.grid {
        mend(&mut tsdf.weight_cells);
    }
    let columns = grid.limits.and_then(|l| l.cell_limits).map_or(0, |l| l.num_x_cells);
    let mut known: Option<CellBox> = None;
    let width = usize::try_from(columns).unwrap_or(0).max(1);
    for (row, cells) in (0..).zip(grid.cells.chunks(width)) {
        let mut columns = (0..).zip(cells).filter(|(_, c)| **c != 0).map(|(i, _)| i);
        let Some(first) = columns.next() else { continue };
        let last = columns.last().unwrap_or(first);
        let b = known.get_or_insert(CellBox { min_x: first, max_x: last, min_y: row, max_y: row });
        b.min_x = b.min_x.min(first);
        b.max_x = b.max_x.max(last);
        b.max_y = row;
    }
    grid.known_cells_box = known;
}

/// Removes invalid voxels. The sizes must be valid.
pub fn mend_hybrid_grid(grid: &mut HybridGrid) {
    let keep: Vec<bool> = (0..grid.values.len()).map(|i| !is_bad_voxel(grid, i)).collect();
    for values in [&mut grid.x_indices, &mut grid.y_indices, &mut grid.z_indices, &mut grid.values] {
        let mut keep = keep.iter();
        values.retain(|_| keep.next().copied().unwrap_or(false));
    }
}
