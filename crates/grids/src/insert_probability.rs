//! Inserts range data into a probability grid.

use portolan_geometry::{Point3f, Vector2f};
use portolan_sensor::RangeData;

use super::joined_surfaces::between_neighbours;
use super::value::{UpdateTable, odds};
use super::{CellIndex, GridError, InserterOptionError, ProbabilityGrid, for_each_cell_on_ray};

/// Subpixels per cell between which rays are cast.
pub(crate) const SUBPIXELS: i64 = 1000;
/// Default maximum number of cells of a grid: 8192×8192 cells, 128 MB.
pub const DEFAULT_MAX_CELLS: usize = 1 << 26;

/// Options of inserting scans into a probability grid: how strongly a scan changes cells, and limits of the
/// grid.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbabilityInserterOptions {
    /// Probability that a cell in which a ray ended is occupied; above 0.5, default 0.55.
    pub hit_probability: f64,
    /// Probability that a cell through which a ray passed is occupied; below 0.5, default 0.49.
    pub miss_probability: f64,
    /// Whether rays clear the cells they pass, default true.
    pub insert_free_space: bool,
    /// Maximum number of cells of the grid, default 2²⁶.
    pub max_cells: usize,
    /// Whether the space between neighbouring returns of one surface is hit, too, default false.
    pub join_surfaces: bool,
}

impl Default for ProbabilityInserterOptions {
    fn default() -> Self {
        Self {
            hit_probability: 0.55,
            miss_probability: 0.49,
            insert_free_space: true,
            max_cells: DEFAULT_MAX_CELLS,
            join_surfaces: false,
        }
    }
}

/// Statistics of the points of a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InsertReport {
    /// Returns inserted.
    pub hits: usize,
    /// Points left out because they are not finite.
    pub not_finite: usize,
    /// Points left out because they are beyond the reach of a grid in 3D.
    pub outside: usize,
}

/// Inserts range data into probability grids.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbabilityInserter {
    hit_table: UpdateTable,
    miss_table: UpdateTable,
    insert_free_space: bool,
    max_cells: usize,
    join_surfaces: bool,
}

impl ProbabilityInserter {
    /// Computes the tables of an inserter, which may then serve any number of grids.
    ///
    /// # Errors
    /// If a probability is out of its bounds.
    pub fn new(options: &ProbabilityInserterOptions) -> Result<Self, InserterOptionError> {
        let (hit, miss) = (options.hit_probability, options.miss_probability);
        InserterOptionError::check_probabilities(hit, miss)?;
        Ok(Self {
            hit_table: UpdateTable::for_correspondence_costs(odds(hit as f32)),
            miss_table: UpdateTable::for_correspondence_costs(odds(miss as f32)),
            insert_free_space: options.insert_free_space,
            max_cells: options.max_cells,
            join_surfaces: options.join_surfaces,
        })
    }

    /// Inserts one scan (metres, in the frame of the grid): cells in which rays end become more likely
    /// occupied, cells that they pass from the origin on less. A cell changes at most once, and being hit
    /// wins over being passed. The grid grows as needed.
    ///
    /// # Errors
    /// If the origin is not finite or the grid would grow too large; the grid remains unchanged.
    pub fn insert(
        &self,
        range_data: &RangeData,
        grid: &mut ProbabilityGrid,
    ) -> Result<InsertReport, GridError> {
        let free = self.insert_free_space.then_some(|_| &self.miss_table);
        let cell = grid.limits().resolution() as f32;
        let joined = if self.join_surfaces { between_neighbours(range_data, cell) } else { Vec::new() };
        draw((range_data, &joined), grid, self.max_cells, |_| &self.hit_table, free)
    }
}

/// Offset of a cell from the cell of the origin: columns and rows.
pub(super) type Offset = [i64; 2];

/// Inserts one scan, as [`ProbabilityInserter::insert`]. `hit` and `free` give the update of a cell at an
/// offset from the origin; without `free` rays clear nothing. Points of surfaces `between` neighbouring
/// returns are hit, but no rays are cast to them.
pub(super) fn draw<'a>(
    (range_data, between): (&RangeData, &[Vector2f]),
    grid: &mut ProbabilityGrid,
    max_cells: usize,
    hit: impl Fn(Offset) -> &'a UpdateTable,
    free: Option<impl Fn(Offset) -> &'a UpdateTable>,
) -> Result<InsertReport, GridError> {
    let bounds = Bounds::of(range_data)?;
    grid.grow_to_include(&bounds.padded(), max_cells)?;
    let pixels = SubpixelIndex::new(grid);
    let finite = |points: &[Point3f]| points.iter().filter(|p| is_finite(p)).count();
    let (hits, misses) = (&range_data.returns.points, &range_data.misses.points);
    let (num_hits, num_misses) = (finite(hits), finite(misses));
    let mut ends = Vec::with_capacity(num_hits + num_misses);
    ends.extend(hits.iter().chain(misses).filter(|p| is_finite(p)).map(|p| pixels.of(p.xy().coords)));

    let num_x_cells = i64::from(grid.limits().num_x_cells());
    let index = |x: i64, y: i64| (num_x_cells * y + x) as usize;
    let cell = |end: &[i64; 2]| [end[0] / SUBPIXELS, end[1] / SUBPIXELS];
    let begin = pixels.of(range_data.origin.xy().coords);
    let origin = cell(&begin);
    let cells = &mut grid.grid;
    let between = between.iter().map(|point| pixels.of(*point));
    for end in ends[..num_hits].iter().copied().chain(between) {
        let [x, y] = cell(&end);
        cells.apply_at(index(x, y), hit([x - origin[0], y - origin[1]]));
        cells.extend_known_box(CellIndex::new(x as i32, y as i32));
    }
    if let Some(free) = free.filter(|_| !ends.is_empty()) {
        for end in &ends {
            for_each_cell_on_ray(begin, *end, SUBPIXELS, |x, y| {
                cells.apply_at(index(x, y), free([x - origin[0], y - origin[1]]));
            });
        }
        // Every cell of a ray is known by now and is in the box of its two ends.
        for end in ends[num_hits..].iter().chain([&begin]) {
            let [x, y] = cell(end);
            cells.extend_known_box(CellIndex::new(x as i32, y as i32));
        }
    }
    grid.finish_update();
    let not_finite = hits.len() + misses.len() - num_hits - num_misses;
    Ok(InsertReport { hits: num_hits, not_finite, outside: 0 })
}

/// Whether all coordinates are finite.
#[inline]
pub fn is_finite(point: &Point3f) -> bool {
    point.coords.iter().all(|v| v.is_finite())
}

/// Bounding box in 2D.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    min: Vector2f,
    max: Vector2f,
}

impl Bounds {
    /// The box of the origin alone.
    ///
    /// # Errors
    /// If the origin is not finite.
    pub fn of_origin(origin: Point3f) -> Result<Self, GridError> {
        if !is_finite(&origin) {
            return Err(GridError::InvalidOrigin { x: origin.x, y: origin.y, z: origin.z });
        }
        Ok(Self { min: origin.xy().coords, max: origin.xy().coords })
    }

    /// The box of origin, returns and misses.
    fn of(range_data: &RangeData) -> Result<Self, GridError> {
        let mut bounds = Self::of_origin(range_data.origin)?;
        for point in range_data.returns.points.iter().chain(&range_data.misses.points) {
            if is_finite(point) {
                bounds.extend(point.xy().coords);
            }
        }
        Ok(bounds)
    }

    pub fn extend(&mut self, point: Vector2f) {
        self.min = self.min.inf(&point);
        self.max = self.max.sup(&point);
    }

    /// Both corners, moved outwards by 1 µm so that no point is on the edge of the grid.
    pub fn padded(&self) -> [Vector2f; 2] {
        let padding = Vector2f::repeat(1e-6);
        [self.min - padding, self.max + padding]
    }
}

/// Converts points to subpixels of a grid.
pub(crate) struct SubpixelIndex {
    limits: super::MapLimits,
    resolution: f64,
    last: [i64; 2],
}

impl SubpixelIndex {
    fn new(grid: &ProbabilityGrid) -> Self {
        Self::for_limits(grid.limits())
    }

    pub fn for_limits(limits: &super::MapLimits) -> Self {
        let last = [limits.num_x_cells(), limits.num_y_cells()].map(|n| i64::from(n) * SUBPIXELS - 1);
        Self { limits: *limits, resolution: limits.resolution() / SUBPIXELS as f64, last }
    }

    /// The subpixel of a point inside the grid. Rounding may put a point on the very edge just outside;
    /// it is put back.
    #[inline]
    pub fn of(&self, point: Vector2f) -> [i64; 2] {
        let [x, y] = self.limits.scaled_index(point, self.resolution);
        [x.clamp(0, self.last[0]), y.clamp(0, self.last[1])]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MapLimits;
    use crate::testing::{crc_u16, default_inserter, grid_g, room_limits, room1, room2};
    use portolan_geometry::Vector2;
    use portolan_sensor::PointCloud;

    fn small_scan() -> (ProbabilityGrid, ProbabilityInserter, RangeData) {
        let limits = MapLimits::new(1.0, Vector2::new(1.0, 5.0), 5, 5).unwrap();
        let inserter = ProbabilityInserter::new(&ProbabilityInserterOptions {
            hit_probability: 0.7,
            miss_probability: 0.4,
            ..Default::default()
        })
        .unwrap();
        let points = [(-3.5, 0.5), (-2.5, 1.5), (-1.5, 2.5), (-0.5, 3.5)];
        let returns = PointCloud::new(points.iter().map(|p| Point3f::new(p.0, p.1, 0.0)).collect());
        let data = RangeData { origin: Point3f::new(-0.5, 0.5, 0.0), returns, misses: PointCloud::default() };
        (ProbabilityGrid::new(limits), inserter, data)
    }

    #[test]
    fn hits_and_misses_are_in_their_cells() {
        let (mut grid, inserter, data) = small_scan();
        let report = inserter.insert(&data, &mut grid).unwrap();
        assert_eq!(report, InsertReport { hits: 4, ..Default::default() });
        assert_eq!((grid.limits().num_x_cells(), grid.limits().num_y_cells()), (5, 5));
        for (y, row) in ["?????", "?HMMM", "??HMM", "???HM", "????H"].iter().enumerate() {
            for (x, state) in row.chars().enumerate() {
                let cell = CellIndex::new(x as i32, y as i32);
                let expected = match state {
                    'H' => 0.7,
                    'M' => 0.4,
                    _ => 0.1,
                };
                assert_eq!(grid.is_known(cell), state != '?', "{cell:?}");
                assert!((grid.probability(cell) - expected).abs() < 1e-4, "{cell:?}");
            }
        }
        for _ in 0..1000 {
            inserter.insert(&data, &mut grid).unwrap();
        }
        assert!((grid.probability(CellIndex::new(1, 1)) - 0.9).abs() < 1e-3);
        assert!((grid.probability(CellIndex::new(2, 1)) - 0.1).abs() < 1e-3);
    }

    #[test]
    fn drawn_rooms_equal_the_golden_grids() {
        let mut grid = ProbabilityGrid::new(room_limits());
        let inserter = default_inserter();
        let check = |grid: &ProbabilityGrid, non_zero: usize, crc: u32| {
            assert_eq!((grid.limits().num_x_cells(), grid.limits().num_y_cells()), (400, 400));
            let known = grid.known_cells_box().unwrap();
            assert_eq!((known.min, known.max), (CellIndex::new(96, 86), CellIndex::new(255, 285)));
            assert_eq!(grid.limits().max(), Vector2::new(10.300000160932541, 9.80000014603138));
            assert_eq!(grid.cells().iter().filter(|c| **c != 0).count(), non_zero);
            assert_eq!(crc_u16(grid.cells()), crc);
        };
        inserter.insert(&room1(), &mut grid).unwrap();
        check(&grid, 25392, 0x9348_9134);
        (0..4).for_each(|_| assert!(inserter.insert(&room1(), &mut grid).is_ok()));
        check(&grid, 25392, 0x157c_abb1);
        inserter.insert(&room2(), &mut grid).unwrap();
        check(&grid, 29464, 0x69de_c47a);
        let cropped = grid_g();
        assert_eq!((cropped.limits().num_x_cells(), cropped.limits().num_y_cells()), (160, 200));
        assert_eq!(cropped.limits().max(), Vector2::new(6.000000096857548, 5.000000074505806));
        assert_eq!(crc_u16(cropped.cells()), 0x0e4d_8c2e);
    }

    #[test]
    fn absurd_points_are_handled() {
        let (mut grid, inserter, mut data) = small_scan();
        data.returns.points.push(Point3f::new(f32::NAN, 0.0, 0.0));
        data.misses.points.push(Point3f::new(0.0, f32::INFINITY, 0.0));
        assert_eq!(inserter.insert(&data, &mut grid).unwrap().not_finite, 2);
        let before = grid.clone();
        data.returns.points.push(Point3f::new(1e9, 0.0, 0.0));
        assert!(matches!(inserter.insert(&data, &mut grid), Err(GridError::TooLarge { .. })));
        data.origin.x = f32::NAN;
        assert!(matches!(inserter.insert(&data, &mut grid), Err(GridError::InvalidOrigin { .. })));
        assert_eq!(grid, before);
        let options = ProbabilityInserterOptions { hit_probability: 0.4, ..Default::default() };
        assert!(ProbabilityInserter::new(&options).is_err());
    }

    #[test]
    fn points_on_cell_borders_and_corners_stay_inside() {
        let (mut grid, inserter, mut data) = small_scan();
        data.returns.points = [(1.0, 5.0), (-4.0, 0.0), (1.0, 0.0), (-4.0, 5.0), (-2.0, 2.0)]
            .map(|(x, y)| Point3f::new(x, y, 0.0))
            .to_vec();
        assert_eq!(inserter.insert(&data, &mut grid).unwrap().hits, 5);
        assert!(grid.limits().num_cells() > 25);
    }
}
