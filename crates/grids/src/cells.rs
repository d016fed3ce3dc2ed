//! The cells of a 2D grid: the common base of probability grids and truncated signed distance fields.

use portolan_geometry::Vector2f;

use super::value::{UNKNOWN_CELL, UPDATE_MARKER, UpdateTable, ValueCode};
use super::{CellBox, CellIndex, GridError, MapLimits};

/// Coded cells in a rectangle, which of them are known, and which the current scan has changed.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CellGrid {
    pub limits: MapLimits,
    pub code: ValueCode,
    /// The first index runs fastest.
    pub cells: Vec<u16>,
    /// Smallest box that holds all cells ever changed.
    pub known_box: Option<CellBox>,
    /// Positions of the cells that carry the update marker.
    marked: Vec<u32>,
}

impl CellGrid {
    pub fn new(limits: MapLimits, code: ValueCode) -> Self {
        Self {
            limits,
            code,
            cells: vec![UNKNOWN_CELL; limits.num_cells()],
            known_box: None,
            marked: Vec::new(),
        }
    }

    /// `cells` must have as many elements as `limits` contain.
    pub fn from_cells(
        limits: MapLimits,
        code: ValueCode,
        cells: Vec<u16>,
        known_box: Option<CellBox>,
    ) -> Self {
        debug_assert_eq!(cells.len(), limits.num_cells());
        Self { limits, code, cells, known_box, marked: Vec::new() }
    }

    /// The code of a cell; unknown outside the grid.
    #[inline]
    pub fn cell(&self, cell: CellIndex) -> u16 {
        match self.limits.flat_index(cell) {
            Some(index) => self.cells.get(index).copied().unwrap_or(UNKNOWN_CELL),
            None => UNKNOWN_CELL,
        }
    }

    /// Whether the grid has this cell and something is known about it.
    pub fn is_known(&self, cell: CellIndex) -> bool {
        self.cell(cell) & !UPDATE_MARKER != UNKNOWN_CELL
    }

    /// Whether a scan is half inserted.
    pub fn has_pending_update(&self) -> bool {
        !self.marked.is_empty()
    }

    /// Extends the known box. The cell must be inside the grid.
    pub fn extend_known_box(&mut self, cell: CellIndex) {
        self.known_box = Some(self.known_box.map_or(CellBox::of(cell), |b| b.extended(cell)));
    }

    /// Applies a table to the cell at a flat index unless this scan has changed the cell already. The
    /// known box is left to the caller. Whether the cell changed.
    #[inline]
    pub fn apply_at(&mut self, index: usize, table: &UpdateTable) -> bool {
        let Some(cell) = self.cells.get_mut(index) else { return false };
        if *cell & UPDATE_MARKER != 0 {
            return false;
        }
        *cell = table.updated(*cell);
        self.marked.push(index as u32);
        true
    }

    /// Sets the code of the cell at a flat index and marks it as changed by this scan.
    #[inline]
    pub fn set_marked_at(&mut self, index: usize, code: u16) {
        if let Some(cell) = self.cells.get_mut(index) {
            if *cell & UPDATE_MARKER == 0 {
                self.marked.push(index as u32);
            }
            *cell = code | UPDATE_MARKER;
        }
    }

    /// Makes a cell unknown; the known box is left to the caller.
    pub fn forget_cell(&mut self, cell: CellIndex) {
        let cell = self.limits.flat_index(cell).and_then(|index| self.cells.get_mut(index));
        cell.into_iter().for_each(|cell| *cell = UNKNOWN_CELL);
    }

    /// Makes the known box the smallest one.
    pub fn find_known_box(&mut self) {
        let known = full_box(&self.limits).cells().filter(|cell| self.is_known(*cell));
        self.known_box = known.fold(None, |known: Option<CellBox>, cell| {
            Some(known.map_or(CellBox::of(cell), |b| b.extended(cell)))
        });
    }

    /// Ends the scan: the next one may change every cell again.
    pub fn finish_update(&mut self) {
        for index in self.marked.drain(..) {
            if let Some(cell) = self.cells.get_mut(index as usize) {
                *cell &= !UPDATE_MARKER;
            }
        }
    }

    /// Doubles the grid until all `points` (metres) are inside. `companions` are further lists of cells
    /// of the same shape, which move along. Nothing changes when that would need too many cells.
    ///
    /// # Errors
    /// If that would need more than `max_cells` cells.
    pub fn grow_to_include(
        &mut self,
        points: &[Vector2f],
        max_cells: usize,
        companions: &mut [&mut Vec<u16>],
    ) -> Result<(), GridError> {
        let (mut limits, mut shift) = (self.limits, CellIndex::default());
        for point in points {
            let (grown, moved) = limits.grown(*point, max_cells)?;
            limits = grown;
            shift = CellIndex::new(shift.x + moved.x, shift.y + moved.y);
        }
        if limits == self.limits {
            return Ok(());
        }
        self.finish_update();
        let part = full_box(&self.limits);
        self.cells = moved_cells(&self.cells, &self.limits, part, &limits, shift);
        for companion in companions {
            **companion = moved_cells(companion, &self.limits, part, &limits, shift);
        }
        self.known_box = self.known_box.map(|b| b.shifted(shift.x, shift.y));
        self.limits = limits;
        Ok(())
    }

    /// A copy of the known part, without spare memory. A grid about which nothing is known shrinks to
    /// its first cell.
    pub fn cropped(&self) -> Self {
        let part = self.crop_box();
        let limits = self.limits.cropped(part);
        let known_box = self.known_box.map(|b| b.shifted(-part.min.x, -part.min.y));
        Self { limits, code: self.code, cells: self.cropped_list(&self.cells), known_box, marked: Vec::new() }
    }

    /// The part of `list`, shaped as the cells of this grid, that a cropped copy keeps.
    pub fn cropped_list(&self, list: &[u16]) -> Vec<u16> {
        let part = self.crop_box();
        let limits = self.limits.cropped(part);
        let shift = CellIndex::new(-part.min.x, -part.min.y);
        let mut cells = moved_cells(list, &self.limits, part, &limits, shift);
        cells.iter_mut().for_each(|c| *c &= !UPDATE_MARKER);
        cells
    }

    /// The known box, or the first cell if nothing is known.
    pub fn crop_box(&self) -> CellBox {
        self.known_box.unwrap_or(CellBox::of(CellIndex::default()))
    }
}

/// All cells of a grid.
pub(crate) fn full_box(limits: &MapLimits) -> CellBox {
    let max = CellIndex::new(limits.num_x_cells() as i32 - 1, limits.num_y_cells() as i32 - 1);
    CellBox { min: CellIndex::default(), max }
}

/// `part` of the cells of a grid copied into an otherwise unknown grid with limits `to`, indices moved
/// by `shift`.
fn moved_cells(cells: &[u16], from: &MapLimits, part: CellBox, to: &MapLimits, shift: CellIndex) -> Vec<u16> {
    let mut moved = vec![UNKNOWN_CELL; to.num_cells()];
    let width = part.num_x_cells() as usize;
    for y in part.min.y..=part.max.y {
        let source = from.flat_index(CellIndex::new(part.min.x, y));
        let target = to.flat_index(CellIndex::new(part.min.x + shift.x, y + shift.y));
        let (Some(source), Some(target)) = (source, target) else { continue };
        if let (Some(row), Some(place)) =
            (cells.get(source..source + width), moved.get_mut(target..target + width))
        {
            place.copy_from_slice(row);
        }
    }
    moved
}
