//! Merges all submaps of a map into one grid of large cells.

use portolan_geometry::{Rigid2, Vector2};

use portolan_grids::{
    CellBox, CellIndex, FREE_CELL, Grid2d, GridError, MapLimits, SOLID_CELL, SURFACE_CELLS,
};

/// Maximum number of cells: 800 m by 800 m in cells of 20 cm; the pyramids over them take some 400 MB. Larger
/// maps get larger cells.
const MAX_CELLS: f64 = (1 << 24) as f64;

/// Knowledge of a cell. A cell that is occupied in one grid is occupied.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Known {
    Nothing,
    Free,
    /// Beside an occupied cell: a scan that is placed to within a cell may end there.
    BesideSolid,
    Solid,
}

/// All grids of a map, merged.
pub(super) struct PlaceGrid {
    pub limits: MapLimits,
    /// In the order of [`MapLimits::flat_index`].
    pub cells: Vec<Known>,
    /// Whether something of the cell is known to be free.
    pub has_free: Vec<bool>,
}

impl PlaceGrid {
    /// In cells of this edge, metres, or larger ones. None where nothing is known.
    ///
    /// # Errors
    /// If the map is absurdly wide.
    pub fn new(grids: &[(&Grid2d, Rigid2)], cell: f64) -> Result<Option<Self>, GridError> {
        let corners = grids.iter().flat_map(|(grid, map_from_grid)| corners(grid, map_from_grid));
        let Some(limits) = MapLimits::of_points(corners, cell, MAX_CELLS)? else { return Ok(None) };
        let count = limits.num_cells();
        let mut place_grid =
            Self { limits, cells: vec![Known::Nothing; count], has_free: vec![false; count] };
        grids.iter().for_each(|(grid, map_from_grid)| place_grid.add(grid, map_from_grid));
        place_grid.mark_beside_solid();
        Ok(Some(place_grid))
    }

    fn add(&mut self, grid: &Grid2d, map_from_grid: &Rigid2) {
        let to_map = map_from_grid.point_transform();
        for cell in grid.known_cells_box().map(CellBox::cells).into_iter().flatten() {
            let known = known(grid, cell);
            if known == Known::Nothing {
                continue;
            }
            let point = to_map(&grid.limits().cell_center(cell));
            let index = self.limits.flat_index(self.limits.cell_index(point.cast::<f32>()));
            let Some(index) = index else { continue };
            self.cells[index] = self.cells[index].max(known);
            self.has_free[index] |= known == Known::Free;
        }
    }

    fn mark_beside_solid(&mut self) {
        let (columns, rows) = (self.limits.num_x_cells() as usize, self.limits.num_y_cells() as usize);
        let solid: Vec<usize> = (0..self.cells.len()).filter(|i| self.cells[*i] == Known::Solid).collect();
        for index in solid {
            let (x, y) = (index % columns, index / columns);
            for row in y.saturating_sub(1)..(y + 2).min(rows) {
                for column in x.saturating_sub(1)..(x + 2).min(columns) {
                    let beside = &mut self.cells[row * columns + column];
                    *beside = (*beside).max(Known::BesideSolid);
                }
            }
        }
    }
}

fn known(grid: &Grid2d, cell: CellIndex) -> Known {
    if !grid.is_known(cell) {
        return Known::Nothing;
    }
    let cost = grid.correspondence_cost(cell);
    match grid {
        Grid2d::Probability(_) if 1.0 - cost > SOLID_CELL => Known::Solid,
        Grid2d::Probability(_) if 1.0 - cost < FREE_CELL => Known::Free,
        Grid2d::Probability(_) => Known::Nothing,
        Grid2d::Tsdf(_) if cost.abs() < SURFACE_CELLS * grid.limits().resolution() as f32 => Known::Solid,
        Grid2d::Tsdf(_) => Known::Free,
    }
}

/// Corners of the known part of a grid, in the map.
fn corners(grid: &Grid2d, map_from_grid: &Rigid2) -> impl Iterator<Item = Vector2> + use<> {
    let map_from_grid = *map_from_grid;
    let known = grid.known_cells_box().filter(|_| map_from_grid.is_finite());
    let limits = *grid.limits();
    known.into_iter().flat_map(move |known| {
        let CellBox { min, max } = known;
        let ends = [(min.x, min.y), (min.x, max.y), (max.x, min.y), (max.x, max.y)];
        ends.map(|(x, y)| map_from_grid.transform_point(&limits.cell_center(CellIndex::new(x, y))))
    })
}
