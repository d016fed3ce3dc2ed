//! A saved 2D map as one grid, with the structures that match scans to it.

use portolan_geometry::{Rigid2, Vector2, project_2d};
use portolan_grids::{CellBox, CellIndex, Grid2d, GridError, MapLimits, ProbabilityGrid, SURFACE_CELLS};
use portolan_mapping::{GraphState, Space2d, SubmapEntry};
use portolan_matching::PlaceIndex2d;

use crate::known_cells::KnownCells;
use crate::known_map::KnownMapError;
use crate::likelihood::LikelihoodField;
use crate::matcher_2d::Matcher2d;
use crate::settings::maps::{COARSE_CELL, DISTANCE_FIELD_FREE_LOG_ODDS, MOST_GRID_CELLS, MOST_LOG_ODDS};

/// A saved 2D map: the fused evidence of all its submaps at their poses in the pose graph.
pub struct KnownMap2d {
    /// Probability of each cell that it is occupied.
    pub(crate) grid: Grid2d,
    /// Likelihood field: distance of each cell to something solid.
    pub(crate) field: LikelihoodField,
    /// Proposes places in coarse cells.
    pub(crate) places: PlaceIndex2d,
    /// Matches scans near a guess.
    pub(crate) matcher: Matcher2d,
    /// Cells that scans may contradict.
    pub(crate) cells: KnownCells,
    known_square_metres: f64,
}

impl KnownMap2d {
    /// The map that a pose graph holds.
    ///
    /// # Errors
    /// If it has no submaps, no grids or no solid cells, is too far from the origin, or grids cannot be
    /// made.
    pub fn new(state: &GraphState<Space2d>) -> Result<Self, KnownMapError> {
        if state.submaps.is_empty() {
            return Err(KnownMapError::Empty);
        }
        KnownMapError::require_near_origin(state)?;
        let placed: Vec<Placed> = state
            .submaps
            .iter()
            .filter_map(|(id, entry)| Placed::new(entry, &project_2d(&state.map_from_submap(*id)?)))
            .collect();
        let limits = limits(&placed)?.ok_or(KnownMapError::NoGrids(state.submaps.len()))?;
        let grids: Vec<(&Grid2d, Rigid2)> = placed.iter().map(|p| (p.grid, p.map_from_grid)).collect();
        let fused = || {
            let grid = fuse(&placed, limits).cropped();
            let field = LikelihoodField::new(&grid);
            (grid, field)
        };
        let ((grid, field), places) = rayon::join(fused, || PlaceIndex2d::new(&grids, COARSE_CELL));
        if !field.has_walls() {
            return Err(KnownMapError::NoWalls);
        }
        let places = places?.ok_or(KnownMapError::NoWalls)?;
        let cell = grid.limits().resolution();
        let known = grid.cells().iter().filter(|cell| **cell != 0).count();
        let known_square_metres = known as f64 * cell * cell;
        let cells = KnownCells::new(&grid, &field, state)?;
        Ok(Self {
            grid: Grid2d::Probability(grid),
            field,
            cells,
            places,
            matcher: Matcher2d::new()?,
            known_square_metres,
        })
    }

    /// Edge of a cell, metres.
    pub fn resolution(&self) -> f64 {
        self.grid.limits().resolution()
    }

    /// Whether the cell at a point is known.
    pub(crate) fn knows(&self, point: &Vector2) -> bool {
        self.grid.is_known(self.grid.limits().cell_index(point.cast::<f32>()))
    }

    /// Known area, square metres.
    pub fn known_square_metres(&self) -> f64 {
        self.known_square_metres
    }
}

/// A submap and its pose.
struct Placed<'a> {
    grid: &'a Grid2d,
    map_from_grid: Rigid2,
}

impl<'a> Placed<'a> {
    fn new(entry: &'a SubmapEntry<Space2d>, map_from_submap: &Rigid2) -> Option<Self> {
        let submap = entry.submap.as_ref()?;
        submap.grid.known_cells_box()?;
        let map_from_grid = *map_from_submap * project_2d(&submap.local_from_submap).inverse();
        map_from_grid.is_finite().then_some(Self { grid: &submap.grid, map_from_grid })
    }

    /// Corners in the map.
    fn corners(&self) -> [Vector2; 4] {
        let limits = self.grid.limits();
        let cells = [limits.num_y_cells(), limits.num_x_cells()].map(f64::from);
        let (max, size) = (limits.max(), limits.resolution() * Vector2::from(cells));
        [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
            .map(|[x, y]| self.map_from_grid.transform_point(&(max - Vector2::new(x * size.x, y * size.y))))
    }
}

/// Evidence of a submap about its cells.
struct Evidence {
    limits: MapLimits,
    /// The cells that are known, and one more to each side.
    cells: CellBox,
    /// Log odds of these; 0 where unknown.
    log_odds: Vec<f32>,
}

impl Evidence {
    fn of(grid: &Grid2d) -> Option<Self> {
        let CellBox { min, max } = grid.known_cells_box()?;
        let cells = CellBox { min, max: CellIndex::new(max.x + 1, max.y + 1) }
            .extended(CellIndex::new(min.x - 1, min.y - 1));
        Some(Self {
            limits: *grid.limits(),
            cells,
            log_odds: cells.cells().map(|cell| log_odds(grid, cell)).collect(),
        })
    }

    /// A point of the submap as columns and rows of these cells, from the centre of the first.
    fn place(&self, point: &Vector2) -> Vector2 {
        let off = self.limits.cell_center(self.cells.min) - point;
        Vector2::new(off.y, off.x) / self.limits.resolution()
    }

    /// Interpolated between the four cells around a place.
    #[inline]
    fn at(&self, place: &Vector2) -> f32 {
        if !(place.x >= 0.0 && place.y >= 0.0) {
            return 0.0;
        }
        let (column, row, columns) = (place.x as usize, place.y as usize, self.cells.num_x_cells() as usize);
        let (u, v) = ((place.x - column as f64) as f32, (place.y - row as f64) as f32);
        let first = row.saturating_mul(columns).saturating_add(column);
        let rows =
            self.log_odds.get(first..).and_then(|of| Some((of.get(..2)?, of.get(columns..columns + 2)?)));
        match rows {
            Some(([a, b], [c, d])) if column + 1 < columns => {
                (1.0 - v) * ((1.0 - u) * a + u * b) + v * ((1.0 - u) * c + u * d)
            }
            _ => 0.0,
        }
    }

    /// The cells of a grid of the map that this submap may reach.
    fn reached(&self, map_from_grid: &Rigid2, limits: &MapLimits) -> CellBox {
        let CellBox { min, max } = self.cells;
        let to_map = map_from_grid.point_transform();
        let corners = [(min.x, min.y), (min.x, max.y), (max.x, min.y), (max.x, max.y)].map(|(x, y)| {
            limits.cell_index(to_map(&self.limits.cell_center(CellIndex::new(x, y))).cast::<f32>())
        });
        let range = |value: fn(&CellIndex) -> i32, count: u32| {
            let (low, high) =
                corners.iter().map(value).fold((i32::MAX, i32::MIN), |(l, h), v| (l.min(v), h.max(v)));
            let last = count as i32 - 1;
            (low.saturating_sub(1).clamp(0, last), high.saturating_add(1).clamp(0, last))
        };
        let (x, y) = (range(|c| c.x, limits.num_x_cells()), range(|c| c.y, limits.num_y_cells()));
        CellBox { min: CellIndex::new(x.0, y.0), max: CellIndex::new(x.1, y.1) }
    }
}

/// All cells of a grid, in the order in which they are stored.
fn all_cells(limits: &MapLimits) -> impl Iterator<Item = CellIndex> + use<> {
    let (columns, rows) = (limits.num_x_cells() as i32, limits.num_y_cells() as i32);
    (0..rows).flat_map(move |y| (0..columns).map(move |x| CellIndex::new(x, y)))
}

fn log_odds(grid: &Grid2d, cell: CellIndex) -> f32 {
    if !grid.is_known(cell) {
        return 0.0;
    }
    let cost = grid.correspondence_cost(cell);
    match grid {
        Grid2d::Probability(_) => ((1.0 - cost) / cost.max(1e-3)).max(1e-3).ln(),
        Grid2d::Tsdf(_) if cost.abs() < SURFACE_CELLS * grid.limits().resolution() as f32 => MOST_LOG_ODDS,
        Grid2d::Tsdf(_) => DISTANCE_FIELD_FREE_LOG_ODDS,
    }
}

/// Limits of a grid that contains all submaps; none without any.
fn limits(placed: &[Placed]) -> Result<Option<MapLimits>, GridError> {
    let finest = placed.iter().map(|p| p.grid.limits().resolution()).fold(f64::INFINITY, f64::min);
    MapLimits::of_points(placed.iter().flat_map(Placed::corners), finest, MOST_GRID_CELLS)
}

/// Sums the evidence of all submaps in each cell.
fn fuse(placed: &[Placed], limits: MapLimits) -> ProbabilityGrid {
    let mut evidence = vec![0.0_f32; limits.num_cells()];
    for submap in placed {
        let Some(evidence_of_submap) = Evidence::of(submap.grid) else { continue };
        if limits.resolution() > 1.5 * evidence_of_submap.limits.resolution() {
            add_most_in_larger_cells(&mut evidence, submap, &evidence_of_submap, &limits);
            continue;
        }
        add_between_cells(&mut evidence, submap, &evidence_of_submap, &limits);
    }
    let mut grid = ProbabilityGrid::new(limits);
    for (cell, sum) in all_cells(&limits).zip(evidence).filter(|(_, sum)| *sum != 0.0) {
        grid.set_probability(cell, 1.0 / (1.0 + (-sum.clamp(-MOST_LOG_ODDS, MOST_LOG_ODDS)).exp()));
    }
    grid
}

/// Adds the evidence of a submap at the centres of cells.
fn add_between_cells(
    evidence: &mut [f32],
    submap: &Placed,
    evidence_of_submap: &Evidence,
    limits: &MapLimits,
) {
    let to_grid = submap.map_from_grid.inverse().point_transform();
    let place = |x, y| evidence_of_submap.place(&to_grid(&limits.cell_center(CellIndex::new(x, y))));
    let first = place(0, 0);
    let (by_column, by_row) = (place(1, 0) - first, place(0, 1) - first);
    let CellBox { min, max } = evidence_of_submap.reached(&submap.map_from_grid, limits);
    for y in min.y..=max.y {
        let row = first + f64::from(y) * by_row;
        let start = y as usize * limits.num_x_cells() as usize;
        let cells = evidence.get_mut(start + min.x as usize..=start + max.x as usize);
        for (sum, x) in cells.into_iter().flatten().zip(min.x..) {
            *sum += evidence_of_submap.at(&(row + f64::from(x) * by_column));
        }
    }
}

/// Adds the strongest evidence of a submap in each of some larger cells, so that walls between their centres
/// are kept.
fn add_most_in_larger_cells(
    evidence: &mut [f32],
    submap: &Placed,
    evidence_of_submap: &Evidence,
    limits: &MapLimits,
) {
    let reached = evidence_of_submap.reached(&submap.map_from_grid, limits);
    let (columns, rows) = (reached.num_x_cells() as usize, reached.num_y_cells() as usize);
    let mut most = vec![f32::NEG_INFINITY; columns * rows];
    let to_map = submap.map_from_grid.point_transform();
    for (cell, value) in
        evidence_of_submap.cells.cells().zip(&evidence_of_submap.log_odds).filter(|(_, value)| **value != 0.0)
    {
        let at = limits.cell_index(to_map(&evidence_of_submap.limits.cell_center(cell)).cast::<f32>());
        let (column, row) = (at.x.wrapping_sub(reached.min.x), at.y.wrapping_sub(reached.min.y));
        let (column, row) = (column as u32 as usize, row as u32 as usize);
        if let Some(most) = most.get_mut(row.saturating_mul(columns) + column).filter(|_| column < columns) {
            *most = most.max(*value);
        }
    }
    for (cell, value) in reached.cells().zip(most).filter(|(_, value)| value.is_finite()) {
        if let Some(sum) = limits.flat_index(cell).and_then(|index| evidence.get_mut(index)) {
            *sum += value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Rigid3;
    use portolan_mapping::{SubmapId, TrajectoryId};
    use portolan_submaps::Submap2d;
    use std::sync::Arc;

    /// A submap with a wall of 2 m along y at x = 1 m in its own frame, free on one side.
    fn state(map_from_submap: &[Rigid3]) -> GraphState<Space2d> {
        let mut state = GraphState::default();
        for (index, pose) in map_from_submap.iter().enumerate() {
            let mut grid =
                ProbabilityGrid::new(MapLimits::new(0.05, Vector2::new(3.0, 3.0), 120, 120).unwrap());
            for y in -20..20 {
                let point = |x: f64| Vector2::new(x, 0.05 * f64::from(y) + 0.025).cast::<f32>();
                grid.set_probability(grid.limits().cell_index(point(1.025)), 0.8);
                (0..20).for_each(|i| {
                    let free = grid.limits().cell_index(point(0.05 * f64::from(i) + 0.025));
                    grid.set_probability(free, 0.3);
                });
            }
            let submap = Submap2d::from_parts(Rigid3::identity(), 10, true, Grid2d::Probability(grid));
            let id = SubmapId::new(TrajectoryId(0), index as u32);
            state.submaps.insert(
                id,
                SubmapEntry {
                    submap: Some(Arc::new(submap)),
                    local_from_submap: Rigid3::identity(),
                    searchable: true,
                    insertion_finished: true,
                    node_ids: Default::default(),
                },
            );
            state.optimized_submaps.insert(id, *pose);
        }
        state
    }

    fn probability(map: &KnownMap2d, x: f64, y: f64) -> f32 {
        let Grid2d::Probability(grid) = &map.grid else { panic!() };
        grid.probability(grid.limits().cell_index(Vector2::new(x, y).cast::<f32>()))
    }

    #[test]
    fn a_submap_beyond_the_earth_takes_no_memory() {
        let far = |x: f64| Rigid3::translation(x, x, 0.0);
        for places in [[far(1e300), far(1e300)], [far(0.0), far(1e300)], [far(-1e308), far(1e308)]] {
            // In cells so large nothing is left of the walls, or everything.
            let cells = KnownMap2d::new(&state(&places)).map_or(0, |map| map.cells.limits.num_cells());
            assert!(cells <= 1 << 26, "{cells}");
        }
    }

    #[test]
    fn submaps_are_placed_by_the_pose_graph_and_summed() {
        let turned = Rigid3::new(
            portolan_geometry::Vector3::new(5.0, 0.0, 0.0),
            portolan_geometry::Vector3::z() * std::f64::consts::FRAC_PI_2,
        );
        let map = KnownMap2d::new(&state(&[Rigid3::identity(), Rigid3::identity(), turned])).unwrap();
        assert!(probability(&map, 1.02, 0.33) > 0.85, "two submaps say more than one");
        assert!(probability(&map, 0.52, 0.33) < 0.2);
        assert!(probability(&map, 5.3, 1.03) > 0.6, "the wall of the turned one lies along x");
        assert!(
            map.field.at(&Vector2::new(1.02, 0.0)) > 0.95 && map.field.at(&Vector2::new(0.3, 0.0)) < 0.01
        );
    }

    #[test]
    fn maps_without_grids_are_refused() {
        assert!(matches!(KnownMap2d::new(&GraphState::default()), Err(KnownMapError::Empty)));
        let mut without_grids = state(&[Rigid3::identity()]);
        without_grids.submaps.values_mut().for_each(|entry| entry.submap = None);
        assert!(matches!(KnownMap2d::new(&without_grids), Err(KnownMapError::NoGrids(1))));
    }

    #[test]
    fn submaps_far_apart_get_larger_cells() {
        let map = KnownMap2d::new(&state(&[Rigid3::identity(), Rigid3::translation(3000.0, 3000.0, 0.0)]));
        let map = map.unwrap();
        assert!(map.resolution() > 0.3 && map.known_square_metres() > 0.0, "{}", map.resolution());
    }
}
