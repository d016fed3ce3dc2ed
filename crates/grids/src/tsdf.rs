//! The 2D truncated signed distance field.

use portolan_geometry::Vector2f;

use super::value::{UNKNOWN_CELL, UPDATE_MARKER, ValueCode};
use super::{CellBox, CellGrid, CellIndex, GridError, MapLimits};

/// Signed distance to the nearest surface, positive in front of it and clamped to the truncation distance,
/// with a weight.
#[derive(Clone, Debug, PartialEq)]
pub struct Tsdf2d {
    /// Coded distances.
    pub(crate) grid: CellGrid,
    pub(crate) weight_code: ValueCode,
    pub(crate) weights: Vec<u16>,
}

impl Tsdf2d {
    /// A field of unknown cells.
    ///
    /// # Errors
    /// If truncation distance (metres) or maximum weight is not positive and finite.
    pub fn new(limits: MapLimits, truncation_distance: f32, max_weight: f32) -> Result<Self, GridError> {
        for (what, value) in [("truncation distance", truncation_distance), ("maximum weight", max_weight)] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(GridError::InvalidBounds { what, lower: 0.0, upper: value });
            }
        }
        let grid = CellGrid::new(limits, ValueCode::new(-truncation_distance, truncation_distance));
        let weights = vec![UNKNOWN_CELL; limits.num_cells()];
        Ok(Self { grid, weight_code: ValueCode::new(0.0, max_weight), weights })
    }

    /// Position, resolution and size of the field.
    pub fn limits(&self) -> &MapLimits {
        &self.grid.limits
    }

    /// Codes of all distances, the first index running fastest.
    pub fn cells(&self) -> &[u16] {
        &self.grid.cells
    }

    /// Codes of all weights, in the order of the distances.
    pub fn weight_cells(&self) -> &[u16] {
        &self.weights
    }

    /// Box of all cells ever changed; none as long as there is none.
    pub fn known_cells_box(&self) -> Option<CellBox> {
        self.grid.known_box
    }

    /// Code of the distances.
    pub fn code(&self) -> &ValueCode {
        &self.grid.code
    }

    /// Metres.
    pub fn truncation_distance(&self) -> f32 {
        self.grid.code.upper()
    }

    /// The largest weight of a cell.
    pub fn max_weight(&self) -> f32 {
        self.weight_code.upper()
    }

    /// Whether something is known about a cell.
    pub fn is_known(&self, cell: CellIndex) -> bool {
        self.grid.is_known(cell)
    }

    /// Signed distance, metres; minus the truncation distance where nothing is known and outside.
    pub fn signed_distance(&self, cell: CellIndex) -> f32 {
        self.grid.code.decode(self.grid.cell(cell), self.grid.code.lower())
    }

    /// As [`Self::signed_distance`], but plus the truncation distance where nothing is known.
    #[inline]
    pub fn correspondence_cost(&self, cell: CellIndex) -> f32 {
        self.grid.code.decode(self.grid.cell(cell), self.grid.code.upper())
    }

    /// Weight of a cell; 0 where nothing is known and outside.
    #[inline]
    pub fn weight(&self, cell: CellIndex) -> f32 {
        match self.grid.limits.flat_index(cell).and_then(|i| self.weights.get(i)) {
            Some(code) => self.weight_code.decode(*code, 0.0),
            None => 0.0,
        }
    }

    /// Makes a cell unknown; the known box is left to the caller.
    pub(crate) fn forget_cell(&mut self, cell: CellIndex) {
        self.grid.forget_cell(cell);
        let weight = self.grid.limits.flat_index(cell).and_then(|index| self.weights.get_mut(index));
        weight.into_iter().for_each(|weight| *weight = 0);
    }

    /// Whether the current scan has changed the cell.
    pub fn is_updated(&self, cell: CellIndex) -> bool {
        self.grid.cell(cell) & UPDATE_MARKER != 0
    }

    /// Sets distance (metres) and weight of a cell for the current scan; both are clamped to their
    /// bounds. A cell outside remains unknown. Ends with [`Self::finish_update`].
    pub fn set(&mut self, cell: CellIndex, signed_distance: f32, weight: f32) {
        if let Some(index) = self.grid.limits.flat_index(cell) {
            self.grid.set_marked_at(index, self.grid.code.encode(signed_distance));
            if let Some(place) = self.weights.get_mut(index) {
                *place = self.weight_code.encode(weight);
            }
            self.grid.extend_known_box(cell);
        }
    }

    /// Ends the scan: every cell may change again.
    pub fn finish_update(&mut self) {
        self.grid.finish_update();
    }

    /// Doubles the field until all points (metres) are inside.
    ///
    /// # Errors
    /// If that needs more than `max_cells` cells; the field remains unchanged.
    pub fn grow_to_include(&mut self, points: &[Vector2f], max_cells: usize) -> Result<(), GridError> {
        self.grid.grow_to_include(points, max_cells, &mut [&mut self.weights])
    }

    /// A copy of the known part.
    pub fn cropped(&self) -> Self {
        Self {
            grid: self.grid.cropped(),
            weight_code: self.weight_code,
            weights: self.grid.cropped_list(&self.weights),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Vector2;

    #[test]
    fn distance_and_weight_are_kept_to_half_a_code() {
        let limits = MapLimits::new(1.0, Vector2::new(1.0, 2.0), 2, 2).unwrap();
        let mut tsdf = Tsdf2d::new(limits, 1.0, 2.0).unwrap();
        let cell = limits.cell_index(Vector2f::new(-0.5, 0.5));
        tsdf.set(cell, 0.42, 1.5);
        assert!(tsdf.is_updated(cell));
        tsdf.finish_update();
        assert!(!tsdf.is_updated(cell));
        assert!((tsdf.signed_distance(cell) - 0.42).abs() < 2.0 / 32768.0);
        assert!((tsdf.weight(cell) - 1.5).abs() < 2.0 / 32768.0);
        let unknown = limits.cell_index(Vector2f::new(0.5, 0.5));
        assert_eq!((tsdf.signed_distance(unknown), tsdf.weight(unknown)), (-1.0, 0.0));
        assert_eq!(tsdf.correspondence_cost(unknown), 1.0);
        assert!(Tsdf2d::new(limits, 0.0, 1.0).is_err() && Tsdf2d::new(limits, 1.0, f32::NAN).is_err());
    }

    #[test]
    fn growing_and_cropping_carry_the_weights() {
        let limits = MapLimits::new(0.05, Vector2::new(10.0, 10.0), 400, 400).unwrap();
        let mut tsdf = Tsdf2d::new(limits, 0.3, 10.0).unwrap();
        let part = CellBox { min: CellIndex::new(100, 100), max: CellIndex::new(299, 299) };
        part.cells().for_each(|c| tsdf.set(c, 0.1, 5.0));
        tsdf.finish_update();
        tsdf.grow_to_include(&[Vector2f::new(11.0, 0.0)], 1 << 26).unwrap();
        assert_eq!(tsdf.weight_cells().len(), 800 * 800);
        let cropped = tsdf.cropped();
        assert_eq!(cropped.limits().num_cells(), 200 * 200);
        assert!(cropped.cells().iter().chain(cropped.weight_cells()).all(|c| *c != 0));
        assert!((cropped.limits().max() - Vector2::new(5.0, 5.0)).norm() < 1e-12);
    }
}
