//! Converts 2D grids to and from the parts that files hold.

use super::value::{UNKNOWN_CELL, UPDATE_MARKER, ValueCode};
use super::{CellBox, CellGrid, CellIndex, Grid2d, GridError, MapLimits, ProbabilityGrid, Tsdf2d};

/// Everything a 2D grid consists of.
#[derive(Clone, Debug, PartialEq)]
pub struct GridParts {
    /// Position, resolution and size of the grid.
    pub limits: MapLimits,
    /// Codes, the first index running fastest; as many as the limits contain.
    pub cells: Vec<u16>,
    /// Box of all known cells.
    pub known_cells_box: Option<CellBox>,
    /// Value of code 1.
    pub min_correspondence_cost: f32,
    /// Value of code 32767.
    pub max_correspondence_cost: f32,
    /// Present in truncated signed distance fields.
    pub tsdf: Option<TsdfParts>,
}

/// Parts of a truncated signed distance field beyond those of a probability grid.
#[derive(Clone, Debug, PartialEq)]
pub struct TsdfParts {
    /// Metres.
    pub truncation_distance: f32,
    /// The largest weight.
    pub max_weight: f32,
    /// Codes of the weights, in the order of the cells.
    pub weight_cells: Vec<u16>,
}

/// Repairs made while a grid was assembled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GridRepairs {
    /// Cells and weights that carried the update marker of an unfinished scan, now removed.
    pub markers_removed: usize,
    /// The known box was inverted, outside the grid or missed known cells, and was computed again.
    pub known_box_recomputed: bool,
    /// The cost bounds of a distance field were not its truncation distance; the latter was taken.
    pub cost_bounds_replaced: bool,
}

impl GridRepairs {
    /// Whether anything was repaired.
    pub fn any(&self) -> bool {
        *self != Self::default()
    }
}

impl Grid2d {
    /// Assembles a grid and reports what had to be repaired.
    ///
    /// # Errors
    /// If the lists have the wrong length or bounds of values are not a range.
    pub fn from_parts(parts: GridParts) -> Result<(Self, GridRepairs), GridError> {
        let mut repairs = GridRepairs::default();
        let GridParts { limits, cells, known_cells_box, tsdf, .. } = parts;
        check_count("cells", &limits, &cells)?;
        let (lower, upper) = match &tsdf {
            None => (parts.min_correspondence_cost, parts.max_correspondence_cost),
            Some(t) => (-t.truncation_distance, t.truncation_distance),
        };
        check_bounds("correspondence costs", lower, upper)?;
        repairs.cost_bounds_replaced =
            (lower, upper) != (parts.min_correspondence_cost, parts.max_correspondence_cost);
        let cells = without_markers(cells, &mut repairs);
        let known_box = checked_box(known_cells_box, &limits, &cells, &mut repairs);
        let grid = CellGrid::from_cells(limits, ValueCode::new(lower, upper), cells, known_box);
        let Some(tsdf) = tsdf else { return Ok((Self::Probability(ProbabilityGrid { grid }), repairs)) };
        check_count("weights", &limits, &tsdf.weight_cells)?;
        check_bounds("weights", 0.0, tsdf.max_weight)?;
        let weight_code = ValueCode::new(0.0, tsdf.max_weight);
        let weights = without_markers(tsdf.weight_cells, &mut repairs);
        Ok((Self::Tsdf(Tsdf2d { grid, weight_code, weights }), repairs))
    }

    /// The parts of a copy of the grid; pending updates are ended.
    pub fn to_parts(&self) -> GridParts {
        let tsdf = match self {
            Self::Probability(_) => None,
            Self::Tsdf(t) => Some(TsdfParts {
                truncation_distance: t.truncation_distance(),
                max_weight: t.max_weight(),
                weight_cells: t.weights.clone(),
            }),
        };
        GridParts {
            limits: *self.limits(),
            cells: self.cells().iter().map(|c| c & !UPDATE_MARKER).collect(),
            known_cells_box: self.known_cells_box(),
            min_correspondence_cost: self.code().lower(),
            max_correspondence_cost: self.code().upper(),
            tsdf,
        }
    }
}

fn check_count(what: &'static str, limits: &MapLimits, list: &[u16]) -> Result<(), GridError> {
    let expected = u64::from(limits.num_x_cells()) * u64::from(limits.num_y_cells());
    if list.len() as u64 == expected {
        return Ok(());
    }
    Err(GridError::CellCount { what, expected, found: list.len() })
}

fn check_bounds(what: &'static str, lower: f32, upper: f32) -> Result<(), GridError> {
    if lower.is_finite() && (upper - lower).is_finite() && lower < upper {
        return Ok(());
    }
    Err(GridError::InvalidBounds { what, lower, upper })
}

fn without_markers(mut cells: Vec<u16>, repairs: &mut GridRepairs) -> Vec<u16> {
    for cell in &mut cells {
        if *cell & UPDATE_MARKER != 0 {
            *cell &= !UPDATE_MARKER;
            repairs.markers_removed += 1;
        }
    }
    cells
}

/// The given box if it is inside the grid and holds all known cells, else the smallest that does.
fn checked_box(
    given: Option<CellBox>,
    limits: &MapLimits,
    cells: &[u16],
    repairs: &mut GridRepairs,
) -> Option<CellBox> {
    let needed = box_of_known(limits, cells);
    let inside = |b: &CellBox| {
        limits.contains(b.min) && limits.contains(b.max) && b.min.x <= b.max.x && b.min.y <= b.max.y
    };
    let holds = |b: &CellBox, n: CellBox| b.extended(n.min).extended(n.max) == *b;
    let valid = match (given, needed) {
        (None, needed) => needed.is_none(),
        (Some(b), None) => inside(&b),
        (Some(b), Some(n)) => inside(&b) && holds(&b, n),
    };
    repairs.known_box_recomputed = !valid;
    if valid { given } else { needed }
}

fn box_of_known(limits: &MapLimits, cells: &[u16]) -> Option<CellBox> {
    let mut known: Option<CellBox> = None;
    for (y, row) in cells.chunks(limits.num_x_cells() as usize).enumerate() {
        let first = row.iter().position(|c| *c != UNKNOWN_CELL);
        let last = row.iter().rposition(|c| *c != UNKNOWN_CELL);
        for x in first.into_iter().chain(last) {
            let cell = CellIndex::new(x as i32, y as i32);
            known = Some(known.map_or(CellBox::of(cell), |b| b.extended(cell)));
        }
    }
    known
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Vector2;
    use proptest::prelude::*;

    fn parts(cells: Vec<u16>, known_cells_box: Option<CellBox>) -> GridParts {
        GridParts {
            limits: MapLimits::new(1.0, Vector2::new(2.0, 3.0), 4, 5).unwrap(),
            cells,
            known_cells_box,
            min_correspondence_cost: 0.1,
            max_correspondence_cost: 0.9,
            tsdf: None,
        }
    }

    #[test]
    fn an_inverted_box_is_repaired() {
        let inverted = CellBox { min: CellIndex::new(21, 22), max: CellIndex::new(19, 20) };
        let (grid, repairs) = Grid2d::from_parts(parts(vec![0; 20], Some(inverted))).unwrap();
        assert!(repairs.known_box_recomputed && grid.known_cells_box().is_none());
        assert_eq!(grid.limits().num_y_cells(), 5);
        assert!(matches!(grid, Grid2d::Probability(_)));
        let (again, repairs) = Grid2d::from_parts(grid.to_parts()).unwrap();
        assert!(again == grid && !repairs.any());
    }

    #[test]
    fn damaged_parts_are_refused() {
        let wrong_count = Grid2d::from_parts(parts(vec![0; 6], None));
        assert_eq!(wrong_count, Err(GridError::CellCount { what: "cells", expected: 20, found: 6 }));
        let bounds = GridParts { max_correspondence_cost: f32::NAN, ..parts(vec![0; 20], None) };
        assert!(matches!(Grid2d::from_parts(bounds), Err(GridError::InvalidBounds { .. })));
        let tsdf = TsdfParts { truncation_distance: 0.1, max_weight: 0.0, weight_cells: vec![0; 20] };
        let tsdf = GridParts { tsdf: Some(tsdf), ..parts(vec![0; 20], None) };
        assert!(matches!(Grid2d::from_parts(tsdf), Err(GridError::InvalidBounds { .. })));
    }

    #[test]
    fn a_distance_field_comes_back() {
        let tsdf = TsdfParts { truncation_distance: 0.25, max_weight: 10.0, weight_cells: vec![7; 20] };
        let parts = GridParts {
            tsdf: Some(tsdf),
            min_correspondence_cost: -0.25,
            max_correspondence_cost: 0.25,
            ..parts(vec![5; 20], None)
        };
        let (grid, repairs) = Grid2d::from_parts(parts).unwrap();
        assert_eq!(repairs, GridRepairs { known_box_recomputed: true, ..Default::default() });
        assert_eq!(Grid2d::from_parts(grid.to_parts()).unwrap(), (grid, GridRepairs::default()));
    }

    proptest! {
        #[test]
        fn any_cells_make_a_grid(cells in prop::collection::vec(any::<u16>(), 20), x in -2..6i32, y in -2..6i32, z in -2..6i32, w in -2..6i32) {
            let given = CellBox { min: CellIndex::new(x, y), max: CellIndex::new(z, w) };
            let (grid, _) = Grid2d::from_parts(parts(cells, Some(given))).unwrap();
            let known = grid.known_cells_box().unwrap();
            for cell in super::super::cells::full_box(grid.limits()).cells() {
                prop_assert!(!grid.is_known(cell) || known.extended(cell) == known);
            }
            let _ = grid.cropped().to_parts();
            let (again, repairs) = Grid2d::from_parts(grid.to_parts()).unwrap();
            prop_assert!(again == grid && !repairs.any());
        }
    }
}
