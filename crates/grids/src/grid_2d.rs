//! Either of the 2D grids, for code that works with both.

use super::value::ValueCode;
use super::{CellBox, CellIndex, MapLimits, ProbabilityGrid, Tsdf2d};

/// A 2D grid.
#[derive(Clone, Debug, PartialEq)]
pub enum Grid2d {
    /// Cells hold the probability of being occupied.
    Probability(ProbabilityGrid),
    /// Cells hold the distance to the nearest surface.
    Tsdf(Tsdf2d),
}

/// Value of a cell of a 2D grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CellValue {
    /// Unknown.
    Unknown,
    /// Probability that it is occupied.
    Probability(f32),
    /// Distance to the nearest surface, with its weight.
    Distance {
        /// Signed, metres.
        metres: f32,
        /// Weight.
        weight: f32,
    },
}

impl Grid2d {
    fn grid(&self) -> &super::CellGrid {
        match self {
            Self::Probability(g) => &g.grid,
            Self::Tsdf(g) => &g.grid,
        }
    }

    /// Position, resolution and size of the grid.
    pub fn limits(&self) -> &MapLimits {
        &self.grid().limits
    }

    /// Codes of all cells, the first index running fastest.
    pub fn cells(&self) -> &[u16] {
        &self.grid().cells
    }

    /// Box of all cells ever changed; none as long as there is none.
    pub fn known_cells_box(&self) -> Option<CellBox> {
        self.grid().known_box
    }

    /// Code of the cells; its bounds are the smallest and the largest correspondence cost.
    pub fn code(&self) -> &ValueCode {
        &self.grid().code
    }

    /// Whether something is known about a cell.
    pub fn is_known(&self, cell: CellIndex) -> bool {
        self.grid().is_known(cell)
    }

    /// Cost of an obstacle in a cell: one minus probability, or signed distance in metres. The largest cost
    /// where nothing is known and outside.
    pub fn correspondence_cost(&self, cell: CellIndex) -> f32 {
        match self {
            Self::Probability(g) => g.correspondence_cost(cell),
            Self::Tsdf(g) => g.correspondence_cost(cell),
        }
    }

    /// Value of a cell.
    pub fn value(&self, cell: CellIndex) -> CellValue {
        match self {
            _ if !self.is_known(cell) => CellValue::Unknown,
            Self::Probability(g) => CellValue::Probability(g.probability(cell)),
            Self::Tsdf(g) => CellValue::Distance { metres: g.signed_distance(cell), weight: g.weight(cell) },
        }
    }

    /// Gives cells new values; cells for which there is none keep theirs. Values of the other kind of grid
    /// count as unknown. Returns the number of cells that got one.
    pub fn rewrite(&mut self, new_value: impl Fn(CellIndex) -> Option<CellValue>) -> usize {
        let limits = *self.limits();
        let all = super::cells::full_box(&limits).cells();
        let values: Vec<(CellIndex, CellValue)> =
            all.filter_map(|cell| Some((cell, new_value(cell)?))).collect();
        for (cell, value) in &values {
            match self {
                Self::Probability(g) => g.grid.forget_cell(*cell),
                Self::Tsdf(g) => g.forget_cell(*cell),
            }
            match (&mut *self, value) {
                (Self::Probability(g), CellValue::Probability(probability)) => {
                    g.set_probability(*cell, *probability);
                }
                (Self::Tsdf(g), CellValue::Distance { metres, weight }) => {
                    g.set(*cell, *metres, *weight);
                    g.finish_update();
                }
                _ => {}
            }
        }
        if !values.is_empty() {
            match self {
                Self::Probability(g) => g.grid.find_known_box(),
                Self::Tsdf(g) => g.grid.find_known_box(),
            }
        }
        values.len()
    }

    /// Whether a scan is half inserted; such a grid must not be written to a file.
    pub fn has_pending_update(&self) -> bool {
        self.grid().has_pending_update()
    }

    /// A copy of the known part.
    pub fn cropped(&self) -> Self {
        match self {
            Self::Probability(g) => Self::Probability(g.cropped()),
            Self::Tsdf(g) => Self::Tsdf(g.cropped()),
        }
    }
}

impl From<ProbabilityGrid> for Grid2d {
    fn from(grid: ProbabilityGrid) -> Self {
        Self::Probability(grid)
    }
}

impl From<Tsdf2d> for Grid2d {
    fn from(grid: Tsdf2d) -> Self {
        Self::Tsdf(grid)
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::Vector2;

    use super::*;

    #[test]
    fn cells_get_other_values_or_none() {
        let limits = MapLimits::new(0.05, Vector2::new(1.0, 1.0), 20, 20).unwrap();
        let [a, b, c] = [3, 4, 9].map(|x| CellIndex::new(x, 5));
        let mut probability = ProbabilityGrid::new(limits);
        [a, b].into_iter().for_each(|cell| assert!(probability.set_probability(cell, 0.8)));
        let mut tsdf = Tsdf2d::new(limits, 0.3, 10.0).unwrap();
        [a, b].into_iter().for_each(|cell| tsdf.set(cell, 0.1, 2.0));
        tsdf.finish_update();
        let distance = CellValue::Distance { metres: -0.1, weight: 4.0 };
        let grids = [(Grid2d::from(probability), CellValue::Probability(0.3)), (tsdf.into(), distance)];
        for (mut grid, value) in grids {
            let kept = grid.value(b);
            let new_value = |cell| match cell {
                _ if cell == a => Some(CellValue::Unknown),
                _ if cell == c => Some(value),
                _ => None,
            };
            assert_eq!(grid.rewrite(new_value), 2);
            assert_eq!((grid.value(a), grid.value(b)), (CellValue::Unknown, kept));
            let near = |x: f32, y: f32| (x - y).abs() < 1e-3;
            assert!(match (grid.value(c), value) {
                (CellValue::Probability(x), CellValue::Probability(y)) => near(x, y),
                (CellValue::Distance { metres, weight }, _) => near(metres, -0.1) && near(weight, 4.0),
                _ => false,
            });
            assert_eq!(grid.known_cells_box(), Some(CellBox { min: b, max: c }));
            assert!(!grid.has_pending_update());
        }
    }
}
