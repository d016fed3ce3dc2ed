//! State of a 2D map in the cells in which contradictions are counted.

use portolan_grids::{CellIndex, FREE_CELL, GridError, MapLimits, ProbabilityGrid, SOLID_CELL};
use portolan_mapping::{GraphState, Space2d};

use crate::known_map::KnownMap;
use crate::known_map_2d::KnownMap2d;
use crate::likelihood::LikelihoodField;
use crate::placed_scan::PlacedScan;
use crate::settings::changes::{CHANGE_CELL_2D, CHANGING_FRACTION, CLEARANCE};

/// State of a cell of the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Known {
    Solid,
    /// Free, with nothing solid near.
    Free,
    /// Unknown, too near to something solid, or see-through.
    Nothing,
}

/// A map in larger cells.
#[derive(Clone, Debug)]
pub(crate) struct KnownCells {
    pub limits: MapLimits,
    pub known: Vec<Known>,
}

impl KnownCells {
    /// From the grid of a map, the distance of its cells to something solid, and the scans that the map
    /// keeps.
    ///
    /// # Errors
    /// If the grid cannot be made.
    pub(crate) fn new(
        grid: &ProbabilityGrid,
        field: &LikelihoodField,
        state: &GraphState<Space2d>,
    ) -> Result<Self, GridError> {
        let fine = grid.limits();
        let factor = (CHANGE_CELL_2D / fine.resolution()).round().max(1.0);
        let resolution = fine.resolution() * factor;
        let count = |cells: u32| cells.div_ceil(factor as u32);
        let limits =
            MapLimits::new(resolution, fine.max(), count(fine.num_x_cells()), count(fine.num_y_cells()))?;
        let mut cells = Self { limits, known: known(grid, field, &limits, factor as i32) };
        cells.leave_out_see_through(state);
        Ok(cells)
    }

    /// State of a cell; nothing for cells outside of the map.
    pub(crate) fn at(&self, cell: usize) -> Known {
        self.known.get(cell).copied().unwrap_or(Known::Nothing)
    }

    /// Marks free cells as see-through if too many scans of the map itself end in them: glass and railings,
    /// which the grid holds as free because most beams pass. The lidar is assumed at the origin of the
    /// tracking frame.
    fn leave_out_see_through(&mut self, state: &GraphState<Space2d>) {
        let (mut hits, mut passes) = (Counts::new(self.known.len()), Counts::new(self.known.len()));
        let (mut ends, mut passed) = (MarkedCells::new(self.known.len()), MarkedCells::new(self.known.len()));
        for_each_scan(state, |scan| {
            ends.clear();
            for cell in scan.around_ends(&self.limits) {
                if ends.insert(cell) && self.at(cell) == Known::Free {
                    hits.count(cell);
                }
            }
        });
        for_each_scan(state, |scan| {
            ends.clear();
            passed.clear();
            scan.around_ends(&self.limits).for_each(|cell| _ = ends.insert(cell));
            for cell in scan.passed(&self.limits).filter(|cell| hits.of(*cell) > 0) {
                if !ends.contains(cell) && passed.insert(cell) {
                    passes.count(cell);
                }
            }
        });
        for (cell, known) in self.known.iter_mut().enumerate() {
            let (hits, passes) = (f64::from(hits.of(cell)), f64::from(passes.of(cell)));
            if hits > (1.0 - CHANGING_FRACTION) * (hits + passes) {
                *known = Known::Nothing;
            }
        }
    }
}

/// Number of observations of each cell; it saturates at the largest number.
#[derive(Clone, Debug)]
pub(crate) struct Counts(Vec<u32>);

impl Counts {
    /// Zero counts for this number of cells.
    pub(crate) fn new(cells: usize) -> Self {
        Self(vec![0; cells])
    }

    /// Counts one more observation of a cell.
    pub(crate) fn count(&mut self, cell: usize) {
        if let Some(count) = self.0.get_mut(cell) {
            *count = count.saturating_add(1);
        }
    }

    /// Number of observations of a cell.
    pub(crate) fn of(&self, cell: usize) -> u32 {
        self.0.get(cell).copied().unwrap_or_default()
    }
}

/// A set of cells that is cleared in constant time.
struct MarkedCells {
    /// The round in which each cell was inserted last.
    rounds: Vec<u32>,
    round: u32,
}

impl MarkedCells {
    /// An empty set of this number of cells.
    fn new(cells: usize) -> Self {
        Self { rounds: vec![0; cells], round: 1 }
    }

    fn clear(&mut self) {
        self.round += 1;
    }

    /// Inserts a cell; returns whether it was new.
    fn insert(&mut self, cell: usize) -> bool {
        let round = self.rounds.get_mut(cell);
        round.is_some_and(|round| std::mem::replace(round, self.round) != self.round)
    }

    fn contains(&self, cell: usize) -> bool {
        self.rounds.get(cell) == Some(&self.round)
    }
}

/// Visits the scans that the nodes of a map keep.
fn for_each_scan(state: &GraphState<Space2d>, mut visit: impl FnMut(&PlacedScan)) {
    for (_, node) in state.nodes.iter() {
        let map_from_tracking = node.map_from_tracking;
        visit(&PlacedScan {
            time: node.data.time,
            origin: map_from_tracking.translation.vector,
            map_from_local: map_from_tracking,
            returns: &KnownMap2d::points_in_tracking(&node.data).points,
        });
    }
}

/// States of larger cells from the grid.
fn known(grid: &ProbabilityGrid, field: &LikelihoodField, limits: &MapLimits, factor: i32) -> Vec<Known> {
    let nearest = LikelihoodField::at_distance(CLEARANCE);
    // The cells of the grid within a larger one; the part beyond the grid is unknown.
    let within = |cell: i32, count: u32| {
        let first = factor.saturating_mul(cell);
        (first, first.saturating_add(factor).min(count as i32))
    };
    let cell_state = |cell: CellIndex| {
        let (left, right) = within(cell.x, grid.limits().num_x_cells());
        let (top, bottom) = within(cell.y, grid.limits().num_y_cells());
        let (mut unknown, mut near_solid) = (right - left < factor || bottom - top < factor, false);
        for (x, y) in (top..bottom).flat_map(|y| (left..right).map(move |x| (x, y))) {
            let cell = CellIndex::new(x, y);
            if !grid.is_known(cell) {
                unknown = true;
                continue;
            }
            let probability = grid.probability(cell);
            if probability > SOLID_CELL {
                return Known::Solid;
            }
            near_solid |= probability >= FREE_CELL || field.at(&grid.limits().cell_center(cell)) >= nearest;
        }
        if unknown || near_solid { Known::Nothing } else { Known::Free }
    };
    let (columns, rows) = (limits.num_x_cells() as i32, limits.num_y_cells() as i32);
    (0..rows).flat_map(|y| (0..columns).map(move |x| CellIndex::new(x, y))).map(cell_state).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use portolan_geometry::Vector2;

    use super::*;

    #[test]
    fn a_map_of_tiny_cells_is_looked_through_once() {
        for resolution in [1e-9, 1e-300] {
            let limits = MapLimits::new(resolution, Vector2::zeros(), 100, 100).unwrap();
            let mut grid = ProbabilityGrid::new(limits);
            grid.set_probability(CellIndex::new(50, 50), 0.9);
            let field = LikelihoodField::new(&grid);
            let cells = KnownCells::new(&grid, &field, &GraphState::default()).unwrap();
            assert_eq!(cells.known, [Known::Solid]);
        }
    }
}
