//! Position and size of a 2D grid, and conversion of points to cells.

use portolan_geometry::{Vector2, Vector2f};

use super::GridError;

/// Indices of a cell of a 2D grid. They may be outside the grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CellIndex {
    /// Along −y of the map.
    pub x: i32,
    /// Along −x of the map.
    pub y: i32,
}

impl CellIndex {
    /// The cell with these indices.
    pub const fn new(x: i32, y: i32) -> Self {
        Self { x, y }
    }
}

/// A rectangle of cells, both ends included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellBox {
    /// Smallest indices.
    pub min: CellIndex,
    /// Largest indices.
    pub max: CellIndex,
}

impl CellBox {
    /// The box of one cell.
    pub const fn of(cell: CellIndex) -> Self {
        Self { min: cell, max: cell }
    }

    /// The smallest box that also holds `cell`.
    #[must_use]
    pub fn extended(self, cell: CellIndex) -> Self {
        Self {
            min: CellIndex::new(self.min.x.min(cell.x), self.min.y.min(cell.y)),
            max: CellIndex::new(self.max.x.max(cell.x), self.max.y.max(cell.y)),
        }
    }

    /// The box moved by (`x`, `y`) cells.
    #[must_use]
    pub fn shifted(self, x: i32, y: i32) -> Self {
        Self {
            min: CellIndex::new(self.min.x + x, self.min.y + y),
            max: CellIndex::new(self.max.x + x, self.max.y + y),
        }
    }

    /// Number of cells along the first index; at least one unless the box is inverted.
    pub fn num_x_cells(&self) -> u32 {
        u32::try_from(i64::from(self.max.x) - i64::from(self.min.x) + 1).unwrap_or(0)
    }

    /// Number of cells along the second index.
    pub fn num_y_cells(&self) -> u32 {
        u32::try_from(i64::from(self.max.y) - i64::from(self.min.y) + 1).unwrap_or(0)
    }

    /// All its cells, the first index running fastest.
    pub fn cells(self) -> impl Iterator<Item = CellIndex> {
        (self.min.y..=self.max.y)
            .flat_map(move |y| (self.min.x..=self.max.x).map(move |x| CellIndex::new(x, y)))
    }
}

/// The nearest integer, halves away from zero, saturating; 0 for not-a-number. The same as C's
/// `lround`, without a call.
#[inline]
pub fn lround(value: f64) -> i64 {
    let truncated = value as i64;
    let fraction = value - truncated as f64;
    truncated.saturating_add(i64::from(fraction >= 0.5) - i64::from(fraction <= -0.5))
}

/// Resolution, corner and size of a 2D grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapLimits {
    resolution: f64,
    max: Vector2,
    num_x_cells: u32,
    num_y_cells: u32,
}

impl MapLimits {
    /// The most cells a side may have.
    pub const MAX_SIDE: u32 = 1 << 24;

    /// A grid of `num_x_cells` (along −y) by `num_y_cells` (along −x) cells of edge `resolution`
    /// metres, whose corner with the largest coordinates is `max`, metres.
    ///
    /// # Errors
    /// If a size is zero or absurd or a number is not finite.
    pub fn new(resolution: f64, max: Vector2, num_x_cells: u32, num_y_cells: u32) -> Result<Self, GridError> {
        let sides = 1..=Self::MAX_SIDE;
        let finite = max.x.is_finite() && max.y.is_finite() && resolution.is_finite() && resolution > 0.0;
        if !finite || !sides.contains(&num_x_cells) || !sides.contains(&num_y_cells) {
            return Err(GridError::InvalidLimits {
                resolution,
                max_x: max.x,
                max_y: max.y,
                num_x_cells: num_x_cells.into(),
                num_y_cells: num_y_cells.into(),
            });
        }
        Ok(Self { resolution, max, num_x_cells, num_y_cells })
    }

    /// The limits of a new submap: 100×100 cells around `origin` (metres).
    ///
    /// # Errors
    /// If a number is not finite or the resolution not positive.
    pub fn around(resolution: f64, origin: Vector2) -> Result<Self, GridError> {
        Self::new(resolution, origin + Vector2::repeat(50.0 * resolution), 100, 100)
    }

    /// Limits that contain all points (metres), a cell from the edge or more. Cells have an edge of `finest`
    /// metres, doubled until there are at most about `max_cells`. None without a point.
    ///
    /// # Errors
    /// If a number is not finite.
    pub fn of_points(
        mut points: impl Iterator<Item = Vector2>,
        finest: f64,
        max_cells: f64,
    ) -> Result<Option<Self>, GridError> {
        let Some(first) = points.next() else { return Ok(None) };
        let (low, high) = points.fold((first, first), |(low, high), p| (low.inf(&p), high.sup(&p)));
        let mut resolution = finest;
        let cells = |resolution: f64| (high - low).map(|length| (length / resolution).ceil() + 2.0);
        while cells(resolution).product() > max_cells {
            resolution *= 2.0;
        }
        let max = high.map(|v| ((v / resolution).ceil() + 1.0) * resolution);
        let count = cells(resolution).map(|c| (c + 1.0).min(f64::from(Self::MAX_SIDE)) as u32);
        Self::new(resolution, max, count.y, count.x).map(Some)
    }

    /// Edge of a cell, metres.
    pub fn resolution(&self) -> f64 {
        self.resolution
    }

    /// Corner with the largest coordinates, metres.
    pub fn max(&self) -> Vector2 {
        self.max
    }

    /// Cells along the first index (−y).
    pub fn num_x_cells(&self) -> u32 {
        self.num_x_cells
    }

    /// Cells along the second index (−x).
    pub fn num_y_cells(&self) -> u32 {
        self.num_y_cells
    }

    /// Number of cells.
    pub fn num_cells(&self) -> usize {
        self.num_x_cells as usize * self.num_y_cells as usize
    }

    /// The cell that holds a point (metres). Far points saturate, outside the grid.
    #[inline]
    pub fn cell_index(&self, point: Vector2f) -> CellIndex {
        let [x, y] = self.scaled_index(point, self.resolution);
        let clamped = |v: i64| v.clamp(i32::MIN.into(), i32::MAX.into()) as i32;
        CellIndex::new(clamped(x), clamped(y))
    }

    /// As [`Self::cell_index`] for cells of another edge `resolution` at the same corner.
    #[inline]
    pub fn scaled_index(&self, point: Vector2f, resolution: f64) -> [i64; 2] {
        [
            lround((self.max.y - f64::from(point.y)) / resolution - 0.5),
            lround((self.max.x - f64::from(point.x)) / resolution - 0.5),
        ]
    }

    /// The centre of a cell, metres.
    pub fn cell_center(&self, cell: CellIndex) -> Vector2 {
        Vector2::new(
            self.max.x - self.resolution * (f64::from(cell.y) + 0.5),
            self.max.y - self.resolution * (f64::from(cell.x) + 0.5),
        )
    }

    /// Whether the grid has this cell.
    #[inline]
    pub fn contains(&self, cell: CellIndex) -> bool {
        (cell.x as u32) < self.num_x_cells && (cell.y as u32) < self.num_y_cells
    }

    /// Position of a cell in the list of cells, if the grid has it.
    #[inline]
    pub fn flat_index(&self, cell: CellIndex) -> Option<usize> {
        self.contains(cell).then(|| self.num_x_cells as usize * cell.y as usize + cell.x as usize)
    }

    /// The limits of the part of the grid in `part`.
    pub(crate) fn cropped(&self, part: CellBox) -> Self {
        let offset = Vector2::new(f64::from(part.min.y), f64::from(part.min.x));
        Self {
            resolution: self.resolution,
            max: self.max - self.resolution * offset,
            num_x_cells: part.num_x_cells().max(1),
            num_y_cells: part.num_y_cells().max(1),
        }
    }

    /// The limits doubled on all sides until `point` is inside, and by how many cells the old indices
    /// move.
    ///
    /// # Errors
    /// If that needs more than `max_cells` cells.
    pub(crate) fn grown(&self, point: Vector2f, max_cells: usize) -> Result<(Self, CellIndex), GridError> {
        let (mut limits, mut shift) = (*self, CellIndex::default());
        while !limits.contains(limits.cell_index(point)) {
            let (half_x, half_y) = (limits.num_x_cells / 2, limits.num_y_cells / 2);
            let too_large = GridError::TooLarge { x: point.x, y: point.y, max_cells };
            let grown = Self::new(
                limits.resolution,
                limits.max + limits.resolution * Vector2::new(f64::from(half_y), f64::from(half_x)),
                limits.num_x_cells * 2,
                limits.num_y_cells * 2,
            )
            .map_err(|_| too_large.clone())?;
            if grown.num_cells() > max_cells {
                return Err(too_large);
            }
            limits = grown;
            shift = CellIndex::new(shift.x + half_x as i32, shift.y + half_y as i32);
        }
        Ok((limits, shift))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_become_cells() {
        let limits = MapLimits::new(2.0, Vector2::new(8.0, 14.0), 14, 8).unwrap();
        for (x, y, expected) in [
            (7.0, 13.0, (0, 0)),
            (7.0, -13.0, (13, 0)),
            (-7.0, 13.0, (0, 7)),
            (-7.0, -13.0, (13, 7)),
            (0.5, 0.5, (6, 3)),
            (1.5, 1.5, (6, 3)),
            (0.5, -0.5, (7, 3)),
            (-0.5, 0.5, (6, 4)),
            (-0.5, -0.5, (7, 4)),
        ] {
            let cell = limits.cell_index(Vector2f::new(x, y));
            assert_eq!((cell.x, cell.y), expected, "{x} {y}");
        }
        assert_eq!(limits.cell_center(CellIndex::new(0, 0)), Vector2::new(7.0, 13.0));
        assert!(!limits.contains(limits.cell_index(Vector2f::new(f32::INFINITY, -1e30))));
    }

    #[test]
    fn a_box_runs_through_its_cells_with_x_first() {
        let part = CellBox { min: CellIndex::new(1, 2), max: CellIndex::new(3, 4) };
        let cells: Vec<_> = part.cells().map(|c| (c.x, c.y)).collect();
        assert_eq!(cells.len(), 9);
        assert_eq!(cells[..4], [(1, 2), (2, 2), (3, 2), (1, 3)]);
    }

    #[test]
    fn rounding_is_that_of_c() {
        for (value, expected) in
            [(0.5, 1), (-0.5, -1), (0.499_999_999_999_999_94, 0), (2.4, 2), (-1.5, -2), (f64::NAN, 0)]
        {
            assert_eq!(lround(value), expected, "{value}");
        }
        assert_eq!(lround(1e300), i64::MAX);
        assert_eq!(lround(-1e300), i64::MIN);
    }

    #[test]
    fn growing_stops_at_the_limit() {
        let limits = MapLimits::around(0.05, Vector2::zeros()).unwrap();
        let far = limits.grown(Vector2f::new(1e9, 0.0), 1 << 26);
        assert!(matches!(far, Err(GridError::TooLarge { .. })));
        let (grown, shift) = limits.grown(Vector2f::new(4.0, 0.0), 1 << 26).unwrap();
        assert_eq!((grown.num_x_cells(), shift), (200, CellIndex::new(50, 50)));
        let single = MapLimits::new(1.0, Vector2::zeros(), 1, 1).unwrap();
        assert!(single.grown(Vector2f::new(3.0, 3.0), 1 << 20).is_ok());
        assert!(MapLimits::new(f64::NAN, Vector2::zeros(), 1, 1).is_err());
        assert!(MapLimits::new(1.0, Vector2::zeros(), 0, 1).is_err());
    }
}
