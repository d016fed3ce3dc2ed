//! The 2D probability grid.

use portolan_geometry::Vector2f;

use super::value::{
    CORRESPONDENCE_COST_CODE, MAX_CORRESPONDENCE_COST, MIN_PROBABILITY, UNKNOWN_CELL, UPDATE_MARKER,
    UpdateTable, ValueCode,
};
use super::{CellBox, CellGrid, CellIndex, GridError, MapLimits};

/// Probability that each cell is occupied, stored as coded correspondence cost (one minus probability).
#[derive(Clone, Debug, PartialEq)]
pub struct ProbabilityGrid {
    pub(crate) grid: CellGrid,
}

impl ProbabilityGrid {
    /// A grid of unknown cells.
    pub fn new(limits: MapLimits) -> Self {
        Self { grid: CellGrid::new(limits, CORRESPONDENCE_COST_CODE) }
    }

    /// Position, resolution and size of the grid.
    pub fn limits(&self) -> &MapLimits {
        &self.grid.limits
    }

    /// Codes of all cells, the first index running fastest; between scans none carries the marker.
    pub fn cells(&self) -> &[u16] {
        &self.grid.cells
    }

    /// Box of all cells ever changed; none as long as there is none.
    pub fn known_cells_box(&self) -> Option<CellBox> {
        self.grid.known_box
    }

    /// Code of the costs.
    pub fn code(&self) -> &ValueCode {
        &self.grid.code
    }

    /// Whether something is known about a cell.
    pub fn is_known(&self, cell: CellIndex) -> bool {
        self.grid.is_known(cell)
    }

    /// Probability that a cell is occupied; 0.1 where nothing is known and outside the grid.
    #[inline]
    pub fn probability(&self, cell: CellIndex) -> f32 {
        match self.grid.limits.flat_index(cell).and_then(|i| self.grid.cells.get(i)) {
            Some(code) => 1.0 - self.grid.code.decode(*code, self.grid.code.upper()),
            None => MIN_PROBABILITY,
        }
    }

    /// Probability that a cell is occupied, if anything is known about it.
    #[inline]
    pub fn known_probability(&self, cell: CellIndex) -> Option<f32> {
        let code = self.grid.cell(cell) & !UPDATE_MARKER;
        (code != UNKNOWN_CELL).then(|| 1.0 - self.grid.code.decode(code, self.grid.code.upper()))
    }

    /// One minus probability; the largest cost where nothing is known, 0.9 outside the grid.
    #[inline]
    pub fn correspondence_cost(&self, cell: CellIndex) -> f32 {
        match self.grid.limits.flat_index(cell).and_then(|i| self.grid.cells.get(i)) {
            Some(code) => self.grid.code.decode(*code, self.grid.code.upper()),
            None => MAX_CORRESPONDENCE_COST,
        }
    }

    /// Sets an unknown cell; returns whether it did. Known cells and cells outside remain unchanged.
    pub fn set_probability(&mut self, cell: CellIndex, probability: f32) -> bool {
        let Some(index) = self.grid.limits.flat_index(cell) else { return false };
        let code = self.grid.code.encode(1.0 - probability);
        match self.grid.cells.get_mut(index) {
            Some(value) if *value & !UPDATE_MARKER == UNKNOWN_CELL => *value = code,
            _ => return false,
        }
        self.grid.extend_known_box(cell);
        true
    }

    /// Applies one observation to a cell unless the current scan has changed it already or it is outside;
    /// returns whether it did. Ends with [`Self::finish_update`].
    pub fn apply_update(&mut self, cell: CellIndex, table: &UpdateTable) -> bool {
        let Some(index) = self.grid.limits.flat_index(cell) else { return false };
        let changed = self.grid.apply_at(index, table);
        if changed {
            self.grid.extend_known_box(cell);
        }
        changed
    }

    /// Ends the scan: every cell may change again.
    pub fn finish_update(&mut self) {
        self.grid.finish_update();
    }

    /// Doubles the grid until all points (metres) are inside.
    ///
    /// # Errors
    /// If that needs more than `max_cells` cells; the grid remains unchanged.
    pub fn grow_to_include(&mut self, points: &[Vector2f], max_cells: usize) -> Result<(), GridError> {
        self.grid.grow_to_include(points, max_cells, &mut [])
    }

    /// A copy of the known part.
    pub fn cropped(&self) -> Self {
        Self { grid: self.grid.cropped() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::value::odds;
    use portolan_geometry::Vector2;

    #[test]
    fn an_observation_counts_once_per_scan() {
        let limits = MapLimits::new(1.0, Vector2::new(1.0, 1.0), 2, 2).unwrap();
        let mut grid = ProbabilityGrid::new(limits);
        let cell = limits.cell_index(Vector2f::new(-0.5, -0.5));
        assert!(limits.contains(cell) && !grid.is_known(cell));
        assert!(grid.set_probability(cell, 0.5) && !grid.set_probability(cell, 0.9));
        let table = |p| UpdateTable::for_correspondence_costs(odds(p));
        assert!(grid.apply_update(cell, &table(0.9)));
        grid.finish_update();
        assert!(grid.probability(cell) > 0.5);
        let unknown = limits.cell_index(Vector2f::new(0.5, 0.5));
        grid.apply_update(unknown, &table(0.42));
        assert!((grid.probability(unknown) - 0.42).abs() < 1e-4);
        assert!(!grid.apply_update(unknown, &table(0.9)), "once per scan");
        assert!((grid.probability(unknown) - 0.42).abs() < 1e-4);
        grid.finish_update();
        grid.apply_update(unknown, &table(0.9));
        assert!(grid.probability(unknown) > 0.42);
        assert!(!grid.apply_update(CellIndex::new(2, 0), &table(0.9)));
    }

    #[test]
    fn only_the_set_cell_is_known() {
        let limits = MapLimits::new(1.0, Vector2::new(1.0, 2.0), 2, 2).unwrap();
        let mut grid = ProbabilityGrid::new(limits);
        grid.set_probability(limits.cell_index(Vector2f::new(-0.5, 0.5)), 0.9);
        let known = |x, y| {
            let cell = limits.cell_index(Vector2f::new(x, y));
            assert!(limits.contains(cell));
            (grid.is_known(cell), grid.probability(cell))
        };
        assert!(known(-0.5, 0.5).0 && (known(-0.5, 0.5).1 - 0.9).abs() < 1e-6);
        for (x, y) in [(-0.5, 1.5), (0.5, 0.5), (0.5, 1.5)] {
            assert!(!known(x, y).0);
        }
    }

    #[test]
    fn cropping_keeps_the_known_part() {
        let limits = MapLimits::new(0.05, Vector2::new(10.0, 10.0), 400, 400).unwrap();
        let mut grid = ProbabilityGrid::new(limits);
        let part = CellBox { min: CellIndex::new(100, 100), max: CellIndex::new(299, 299) };
        part.cells().for_each(|c| assert!(grid.set_probability(c, 0.7)));
        assert_eq!(grid.known_cells_box(), Some(part));
        let cropped = grid.cropped();
        assert_eq!((cropped.limits().num_x_cells(), cropped.limits().num_y_cells()), (200, 200));
        assert_eq!(cropped.limits().max(), Vector2::new(5.0, 5.0));
        assert!(cropped.cells().iter().all(|c| *c == cropped.cells()[0] && *c != 0));
        let empty = ProbabilityGrid::new(limits).cropped();
        assert_eq!((empty.limits().num_cells(), empty.known_cells_box()), (1, None));
    }
}
