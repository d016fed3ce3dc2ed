//! A saved map of the plane as one grid, and what finds scans in it.

use portolan_geometry::{Rigid2, Vector2, project_2d};
use portolan_mapping::{GraphState, Planar, SubmapEntry};
use portolan_matching::{
    CellIndex, FastCorrelativeMatcher2d, FastCorrelativeOptions2d, Grid2d, GridError, MapLimits,
    MatcherOptionError, ProbabilityGrid,
};

use crate::likelihood::LikelihoodField;

/// Why a map cannot be localised in.
#[derive(Debug, thiserror::Error)]
pub enum KnownMapError {
    /// There is nothing in it.
    #[error("the map is empty: it has no submap")]
    Empty,
    /// Submaps without grids: somebody removed them, or the file is damaged.
    #[error("the map has {0} submaps, but not one with a grid: there is nothing to find scans in")]
    NoGrids(usize),
    /// Grids in which nothing is solid.
    #[error("nothing in the map is solid: its grids show no wall to find scans by")]
    NoWalls,
    /// A grid cannot be made.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// A matcher cannot be made.
    #[error(transparent)]
    Matcher(#[from] MatcherOptionError),
}

/// Cells of the one grid, at most: 400 m by 400 m at 5 cm. Larger maps get larger cells.
const MAX_CELLS: f64 = (1 << 26) as f64;
/// Edge of the cells in which places are proposed, metres.
const COARSE: f64 = 0.2;
/// Evidence of a cell beyond this adds nothing: a probability of 0.9.
const CERTAIN: f32 = 2.197_224_6;
/// In a distance field a surface fills cells nearer than this many cells.
const SURFACE: f32 = 0.75;
/// What a distance field says of a cell that is not a surface, as log odds.
const FREE_IN_DISTANCE_FIELD: f32 = -1.0;

/// A saved map of the plane: the evidence of all its submaps, where the pose graph puts them.
pub struct PlanarMap {
    /// How likely each cell is occupied.
    pub(crate) grid: Grid2d,
    /// How near each cell is to something solid.
    pub(crate) field: LikelihoodField,
    /// Finds places in coarse cells.
    pub(crate) places: FastCorrelativeMatcher2d,
    known_square_metres: f64,
}

impl PlanarMap {
    /// The map that a pose graph holds.
    ///
    /// # Errors
    /// If there is nothing in it that scans could be found by.
    pub fn new(state: &GraphState<Planar>) -> Result<Self, KnownMapError> {
        if state.submaps.is_empty() {
            return Err(KnownMapError::Empty);
        }
        let placed: Vec<Placed> = state
            .submaps
            .iter()
            .filter_map(|(id, entry)| Placed::new(entry, &project_2d(&state.map_from_submap(*id)?)))
            .collect();
        let limits = limits(&placed)?.ok_or(KnownMapError::NoGrids(state.submaps.len()))?;
        let grid = fuse(&placed, limits);
        let grid = grid.cropped();
        let field = LikelihoodField::new(&grid);
        if !field.has_walls() {
            return Err(KnownMapError::NoWalls);
        }
        let coarse = Grid2d::Probability(coarsened(&grid)?);
        let places = FastCorrelativeMatcher2d::new(&coarse, &FastCorrelativeOptions2d::default())?;
        let cell = grid.limits().resolution();
        let known = (0..grid.cells().len()).filter(|i| grid.cells()[*i] != 0).count();
        let known_square_metres = known as f64 * cell * cell;
        Ok(Self { grid: Grid2d::Probability(grid), field, places, known_square_metres })
    }

    /// Edge of a cell, metres.
    pub fn resolution(&self) -> f64 {
        self.grid.limits().resolution()
    }

    /// How much of the plane the map knows.
    pub fn known_square_metres(&self) -> f64 {
        self.known_square_metres
    }
}

/// A submap's evidence, and where it lies.
struct Placed {
    limits: MapLimits,
    /// Log odds; 0 where nothing is known.
    evidence: Vec<f32>,
    map_from_grid: Rigid2,
}

impl Placed {
    fn new(entry: &SubmapEntry<Planar>, map_from_submap: &Rigid2) -> Option<Self> {
        let submap = entry.submap.as_ref()?;
        submap.grid.known_cells_box()?;
        let map_from_grid = *map_from_submap * project_2d(&submap.local_from_submap).inverse();
        let grid = submap.grid.cropped();
        let limits = *grid.limits();
        let (columns, rows) = (limits.num_x_cells() as i32, limits.num_y_cells() as i32);
        let cells = (0..rows).flat_map(|y| (0..columns).map(move |x| CellIndex::new(x, y)));
        let evidence = cells.map(|cell| log_odds(&grid, cell)).collect();
        map_from_grid.is_finite().then_some(Self { limits, evidence, map_from_grid })
    }

    /// Corners in the map.
    fn corners(&self) -> [Vector2; 4] {
        let (max, size) = (self.limits.max(), self.size());
        [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
            .map(|[x, y]| self.map_from_grid.transform_point(&(max - Vector2::new(x * size.x, y * size.y))))
    }

    fn size(&self) -> Vector2 {
        let cells = [self.limits.num_y_cells(), self.limits.num_x_cells()].map(f64::from);
        self.limits.resolution() * Vector2::from(cells)
    }

    /// Interpolated between the four cells around a point of the map.
    fn evidence_at(&self, point: &Vector2) -> f32 {
        let cell = 1.0 / self.limits.resolution();
        let (x, y) =
            ((self.limits.max().y - point.y) * cell - 0.5, (self.limits.max().x - point.x) * cell - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let (u, v) = ((x - left) as f32, (y - top) as f32);
        let at = |dx: i32, dy: i32| {
            let index = CellIndex::new(left as i32 + dx, top as i32 + dy);
            self.limits.flat_index(index).and_then(|i| self.evidence.get(i)).copied().unwrap_or(0.0)
        };
        (1.0 - v) * ((1.0 - u) * at(0, 0) + u * at(1, 0)) + v * ((1.0 - u) * at(0, 1) + u * at(1, 1))
    }
}

fn log_odds(grid: &Grid2d, cell: CellIndex) -> f32 {
    if !grid.is_known(cell) {
        return 0.0;
    }
    let cost = grid.correspondence_cost(cell);
    match grid {
        Grid2d::Probability(_) => ((1.0 - cost) / cost.max(1e-3)).max(1e-3).ln(),
        Grid2d::Tsdf(_) if cost.abs() < SURFACE * grid.limits().resolution() as f32 => CERTAIN,
        Grid2d::Tsdf(_) => FREE_IN_DISTANCE_FIELD,
    }
}

/// A grid in which all submaps lie; none without any.
fn limits(placed: &[Placed]) -> Result<Option<MapLimits>, GridError> {
    let corners = || placed.iter().flat_map(Placed::corners);
    let Some(first) = corners().next() else { return Ok(None) };
    let (low, high) = corners().fold((first, first), |(low, high), p| (low.inf(&p), high.sup(&p)));
    let finest = placed.iter().map(|p| p.limits.resolution()).fold(f64::INFINITY, f64::min);
    let mut resolution = finest;
    let cells = |resolution: f64| (high - low).map(|length| (length / resolution).ceil() + 2.0);
    while cells(resolution).product() > MAX_CELLS && resolution < 1e6 {
        resolution *= 2.0;
    }
    // Where cells begin does not depend on which submaps there are.
    let max = high.map(|v| ((v / resolution).ceil() + 1.0) * resolution);
    let count = cells(resolution).map(|c| (c + 1.0).min(f64::from(MapLimits::MAX_SIDE)) as u32);
    MapLimits::new(resolution, max, count.y, count.x).map(Some)
}

/// Adds up what all submaps say of each cell.
fn fuse(placed: &[Placed], limits: MapLimits) -> ProbabilityGrid {
    let mut evidence = vec![0.0_f32; limits.num_cells()];
    for submap in placed {
        let grid_from_map = submap.map_from_grid.inverse();
        for cell in cells_around(submap, &limits) {
            let Some(index) = limits.flat_index(cell) else { continue };
            let point = grid_from_map.transform_point(&limits.cell_center(cell));
            evidence[index] += submap.evidence_at(&point);
        }
    }
    let mut grid = ProbabilityGrid::new(limits);
    let (columns, rows) = (limits.num_x_cells() as i32, limits.num_y_cells() as i32);
    for cell in (0..rows).flat_map(|y| (0..columns).map(move |x| CellIndex::new(x, y))) {
        match limits.flat_index(cell).map(|i| evidence[i]) {
            Some(sum) if sum != 0.0 => {
                grid.set_probability(cell, 1.0 / (1.0 + (-sum.clamp(-CERTAIN, CERTAIN)).exp()));
            }
            _ => {}
        }
    }
    grid
}

/// The cells of a grid that a submap may reach.
fn cells_around(submap: &Placed, limits: &MapLimits) -> impl Iterator<Item = CellIndex> + use<> {
    let corners = submap.corners().map(|p| limits.cell_index(p.cast::<f32>()));
    let range = |value: fn(&CellIndex) -> i32, count: u32| {
        let (low, high) =
            corners.iter().map(value).fold((i32::MAX, i32::MIN), |(l, h), v| (l.min(v), h.max(v)));
        low.saturating_sub(1).max(0)..high.saturating_add(2).min(count as i32)
    };
    let (x, y) = (range(|c| c.x, limits.num_x_cells()), range(|c| c.y, limits.num_y_cells()));
    y.flat_map(move |y| x.clone().map(move |x| CellIndex::new(x, y)))
}

/// The most that any cell says, in larger cells.
fn coarsened(grid: &ProbabilityGrid) -> Result<ProbabilityGrid, GridError> {
    let fine = grid.limits();
    let factor = ((COARSE / fine.resolution()).round() as u32).max(1);
    let count = |cells: u32| cells.div_ceil(factor);
    let resolution = fine.resolution() * f64::from(factor);
    let limits =
        MapLimits::new(resolution, fine.max(), count(fine.num_x_cells()), count(fine.num_y_cells()))?;
    let mut largest = vec![0.0_f32; limits.num_cells()];
    let (columns, rows) = (fine.num_x_cells() as i32, fine.num_y_cells() as i32);
    let coarse_cell = |cell: CellIndex| CellIndex::new(cell.x / factor as i32, cell.y / factor as i32);
    for cell in (0..rows).flat_map(|y| (0..columns).map(move |x| CellIndex::new(x, y))) {
        if let (true, Some(index)) = (grid.is_known(cell), limits.flat_index(coarse_cell(cell))) {
            largest[index] = largest[index].max(grid.probability(cell));
        }
    }
    let mut coarse = ProbabilityGrid::new(limits);
    let (columns, rows) = (limits.num_x_cells() as i32, limits.num_y_cells() as i32);
    for cell in (0..rows).flat_map(|y| (0..columns).map(move |x| CellIndex::new(x, y))) {
        match limits.flat_index(cell).map(|i| largest[i]) {
            Some(probability) if probability > 0.0 => {
                coarse.set_probability(cell, probability);
            }
            _ => {}
        }
    }
    Ok(coarse)
}
