//! Free space of a robot: distance to the nearest surface on a grid, reachable cells, shortest paths.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use portolan_geometry::Vector2;

use super::shape::Shape;

/// Distance to surfaces above which distances are not distinguished, metres.
const FAR: f64 = 1.0;
/// Distance from surfaces that paths keep where there is room, metres.
const COMFORTABLE: f64 = 0.6;
/// Cost of a metre: costs are integers in tenths of a millimetre, so that sums do not depend on rounding.
const COST_PER_METRE: f64 = 10_000.0;
/// Maximum number of cells along a side; cells are larger where there would be more.
const MAX_CELLS_A_SIDE: f64 = 4000.0;
const UNREACHED: u32 = u32::MAX;
const STEPS: [(i32, i32); 8] = [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)];

/// Distance to the nearest surface, and paths that keep clear of surfaces.
#[derive(Clone, Debug)]
pub struct ClearanceGrid {
    minimum: Vector2,
    cell_size: f64,
    columns: usize,
    rows: usize,
    distances: Vec<f32>,
    needed: f32,
}

impl ClearanceGrid {
    /// Measures clearance between (0, 0) and `size` for a robot that needs `needed` metres to every
    /// surface.
    pub fn new(shapes: &[Shape], size: Vector2, cell_size: f64, needed: f64) -> Self {
        let cell_size = cell_size.max(size.x.max(size.y) / MAX_CELLS_A_SIDE);
        let columns = ((size.x / cell_size).ceil() as usize).max(1);
        let rows = ((size.y / cell_size).ceil() as usize).max(1);
        let distances = vec![FAR as f32; columns * rows];
        let mut grid =
            Self { minimum: Vector2::zeros(), cell_size, columns, rows, distances, needed: needed as f32 };
        for shape in shapes {
            grid.account_for(shape);
        }
        grid
    }

    fn account_for(&mut self, shape: &Shape) {
        let (low, high) = shape.bounds();
        let reach = Vector2::new(FAR, FAR);
        let (first_column, first_row) = self.clamped_cell(&(low - reach));
        let (last_column, last_row) = self.clamped_cell(&(high + reach));
        for row in first_row..=last_row {
            for column in first_column..=last_column {
                let centre = self.centre_of(row * self.columns + column);
                let distance = shape.distance(&centre) as f32;
                let cell = &mut self.distances[row * self.columns + column];
                *cell = cell.min(distance);
            }
        }
    }

    fn clamped_cell(&self, point: &Vector2) -> (usize, usize) {
        let cell = (point - self.minimum) / self.cell_size;
        ((cell.x as usize).min(self.columns - 1), (cell.y as usize).min(self.rows - 1))
    }

    fn cell_of(&self, point: &Vector2) -> Option<usize> {
        let cell = (point - self.minimum) / self.cell_size;
        let inside =
            cell.x >= 0.0 && cell.y >= 0.0 && cell.x < self.columns as f64 && cell.y < self.rows as f64;
        inside.then(|| cell.y as usize * self.columns + cell.x as usize)
    }

    fn centre_of(&self, index: usize) -> Vector2 {
        let (column, row) = (index % self.columns, index / self.columns);
        self.minimum + Vector2::new(column as f64 + 0.5, row as f64 + 0.5) * self.cell_size
    }

    /// Distance from the cell around `point` to the nearest surface, metres, at most about 1; negative
    /// inside circles, 0 outside the grid.
    pub fn clearance(&self, point: &Vector2) -> f64 {
        self.cell_of(point).map_or(0.0, |index| f64::from(self.distances[index]))
    }

    fn is_free(&self, index: usize) -> bool {
        self.distances[index] >= self.needed
    }

    /// Costs of the shortest paths from `start` to every cell.
    pub fn distances_from(&self, start: &Vector2) -> PathCosts {
        let mut search = PathSearch::new(self);
        if let Some(start) = self.cell_of(start) {
            search.run(start, None);
        }
        PathCosts { costs: search.costs }
    }

    /// The reachable cell within `radius` metres of `point` with the most room around it. Its distance from
    /// `point` is a penalty of up to 0.25 m of room.
    pub fn roomiest(&self, point: &Vector2, radius: f64, reachable: &PathCosts) -> Option<Vector2> {
        let reach = Vector2::new(radius, radius);
        let (first_column, first_row) = self.clamped_cell(&(point - reach));
        let (last_column, last_row) = self.clamped_cell(&(point + reach));
        let mut best: Option<(f64, Vector2)> = None;
        for row in first_row..=last_row {
            for column in first_column..=last_column {
                let index = row * self.columns + column;
                let centre = self.centre_of(index);
                let away = (centre - point).norm();
                if away > radius || reachable.costs.get(index).is_none_or(|c| *c == UNREACHED) {
                    continue;
                }
                let room = f64::from(self.distances[index]) - 0.25 * away / radius;
                if best.is_none_or(|(most, _)| room > most) {
                    best = Some((room, centre));
                }
            }
        }
        best.map(|(_, centre)| centre)
    }

    /// The cell nearest to `point` where the robot fits, within `radius` metres.
    pub fn nearest_free(&self, point: &Vector2, radius: f64) -> Option<Vector2> {
        let reach = Vector2::new(radius, radius);
        let (first_column, first_row) = self.clamped_cell(&(point - reach));
        let (last_column, last_row) = self.clamped_cell(&(point + reach));
        let cells = (first_row..=last_row)
            .flat_map(|row| (first_column..=last_column).map(move |column| row * self.columns + column));
        cells
            .filter(|index| self.is_free(*index))
            .map(|index| self.centre_of(index))
            .min_by(|a, b| (a - point).norm_squared().total_cmp(&(b - point).norm_squared()))
    }

    /// Estimated cost to the goal, never more than the true cost; 0 without a goal.
    fn estimate(&self, index: usize, goal: Option<usize>) -> u32 {
        let Some(goal) = goal else { return 0 };
        let dx = (index % self.columns).abs_diff(goal % self.columns) as f64;
        let dy = (index / self.columns).abs_diff(goal / self.columns) as f64;
        let straight = dx.max(dy) + (std::f64::consts::SQRT_2 - 1.0) * dx.min(dy);
        (straight * self.cell_size * COST_PER_METRE * 0.999) as u32
    }

    /// Free cells around a cell, with the cost of the step: its length, up to four times as much near
    /// surfaces.
    fn neighbours(&self, index: usize) -> impl Iterator<Item = (usize, u32)> + '_ {
        let (column, row) = ((index % self.columns) as i32, (index / self.columns) as i32);
        STEPS.iter().filter_map(move |(dx, dy)| {
            let (x, y) = (column + dx, row + dy);
            if x < 0 || y < 0 || x >= self.columns as i32 || y >= self.rows as i32 {
                return None;
            }
            let next = y as usize * self.columns + x as usize;
            if !self.is_free(next) {
                return None;
            }
            let length = if dx * dy == 0 { 1.0 } else { std::f64::consts::SQRT_2 };
            let tightness = (1.0 - f64::from(self.distances[next]) / FAR).max(0.0);
            let cost = length * self.cell_size * COST_PER_METRE * (1.0 + 3.0 * tightness * tightness);
            Some((next, cost as u32))
        })
    }

    /// Leaves out corners where the straight line keeps a comfortable distance from surfaces, or at least
    /// that of the path that it replaces.
    fn straighten(&self, points: &[Vector2]) -> Vec<Vector2> {
        let mut kept = vec![points[0]];
        let mut anchor = 0;
        while anchor + 1 < points.len() {
            let mut reached = anchor + 1;
            let mut tightest = COMFORTABLE;
            for (next, point) in points.iter().enumerate().skip(anchor + 1) {
                tightest = tightest.min(self.clearance(point));
                if self.tightest_between(&points[anchor], point) >= tightest {
                    reached = next;
                }
            }
            kept.push(points[reached]);
            anchor = reached;
        }
        kept
    }

    /// Minimum clearance along a straight line, metres.
    fn tightest_between(&self, from: &Vector2, to: &Vector2) -> f64 {
        let steps = ((to - from).norm() / (0.5 * self.cell_size)).ceil().max(1.0) as usize;
        (0..=steps)
            .map(|i| self.clearance(&(from + (to - from) * (i as f64 / steps as f64))))
            .fold(f64::INFINITY, f64::min)
    }
}

/// Finds paths on a clearance grid, one after the other, in the same memory.
#[derive(Clone, Debug)]
pub struct PathSearch<'a> {
    grid: &'a ClearanceGrid,
    costs: Vec<u32>,
    previous: Vec<u32>,
    /// Cells to be reset before the next search.
    touched: Vec<u32>,
}

impl<'a> PathSearch<'a> {
    /// Searches on this grid.
    pub fn new(grid: &'a ClearanceGrid) -> Self {
        let cells = grid.distances.len();
        Self { grid, costs: vec![UNREACHED; cells], previous: vec![UNREACHED; cells], touched: Vec::new() }
    }

    /// A path from `start` to `goal` that keeps clear of surfaces and has few corners, both ends included;
    /// none if there is no path.
    pub fn path(&mut self, start: &Vector2, goal: &Vector2) -> Option<Vec<Vector2>> {
        let (from, to) = (self.grid.cell_of(start)?, self.grid.cell_of(goal)?);
        self.run(from, Some(to));
        if self.costs[to] == UNREACHED {
            return None;
        }
        let mut cells = vec![to];
        let mut at = to;
        while at != from {
            at = self.previous[at] as usize;
            cells.push(at);
        }
        let mut points: Vec<Vector2> = cells.iter().rev().map(|index| self.grid.centre_of(*index)).collect();
        if let Some(last) = points.last_mut() {
            *last = *goal;
        }
        if points.len() < 2 {
            return Some(vec![*start, *goal]);
        }
        points[0] = *start;
        Some(self.grid.straighten(&points))
    }

    /// Dijkstra without a goal, A* with one.
    fn run(&mut self, start: usize, goal: Option<usize>) {
        for index in self.touched.drain(..) {
            self.costs[index as usize] = UNREACHED;
        }
        if !self.grid.is_free(start) {
            return;
        }
        let mut open = BinaryHeap::new();
        self.costs[start] = 0;
        self.touched.push(start as u32);
        open.push(Reverse((0_u32, start as u32)));
        while let Some(Reverse((estimate, index))) = open.pop() {
            let index = index as usize;
            if Some(index) == goal {
                return;
            }
            let reached = self.costs[index];
            if estimate > reached.saturating_add(self.grid.estimate(index, goal)) {
                continue;
            }
            for (next, step) in self.grid.neighbours(index) {
                let cost = reached.saturating_add(step);
                if cost < self.costs[next] {
                    if self.costs[next] == UNREACHED {
                        self.touched.push(next as u32);
                    }
                    self.costs[next] = cost;
                    self.previous[next] = index as u32;
                    open.push(Reverse((cost.saturating_add(self.grid.estimate(next, goal)), next as u32)));
                }
            }
        }
    }
}

/// Costs of the shortest paths from one start to every cell.
#[derive(Clone, Debug)]
pub struct PathCosts {
    costs: Vec<u32>,
}

impl PathCosts {
    /// Length of the path to the cell around `point`, metres, in which narrow places count more; none if
    /// the cell cannot be reached.
    pub fn metres_to(&self, grid: &ClearanceGrid, point: &Vector2) -> Option<f64> {
        let cost = *self.costs.get(grid.cell_of(point)?)?;
        (cost != UNREACHED).then(|| f64::from(cost) / COST_PER_METRE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::two_d::{Draft, Material, Opening};

    /// Two rooms with a door between them.
    fn two_rooms() -> ClearanceGrid {
        let mut draft = Draft::new();
        draft.aligned_box(Vector2::zeros(), Vector2::new(10.0, 6.0), Material::Wall);
        let door = [Opening { from: 4.0, to: 5.0 }];
        draft.wall(Vector2::new(5.0, 0.0), Vector2::new(5.0, 6.0), 0.2, &door);
        ClearanceGrid::new(&draft.into_shapes(), Vector2::new(10.0, 6.0), 0.1, 0.3)
    }

    #[test]
    fn paths_lead_through_doors_and_keep_clear() {
        let grid = two_rooms();
        let (start, goal) = (Vector2::new(1.05, 1.05), Vector2::new(8.95, 1.05));
        let path = PathSearch::new(&grid).path(&start, &goal).unwrap();
        assert!(path.len() >= 3 && path.len() < 10, "{path:?}");
        assert_eq!((path[0], path[path.len() - 1]), (start, goal));
        for pair in path.windows(2) {
            assert!(grid.tightest_between(&pair[0], &pair[1]) >= 0.3);
        }
        let metres = grid.distances_from(&start).metres_to(&grid, &goal).unwrap();
        let length: f64 = path.windows(2).map(|p| (p[1] - p[0]).norm()).sum();
        assert!(length <= metres && metres < 2.0 * length);
    }

    #[test]
    fn walled_in_places_cannot_be_reached() {
        let mut draft = Draft::new();
        draft.wall(Vector2::new(5.0, 0.0), Vector2::new(5.0, 6.0), 0.2, &[]);
        let grid = ClearanceGrid::new(&draft.into_shapes(), Vector2::new(10.0, 6.0), 0.1, 0.3);
        let start = Vector2::new(1.0, 1.0);
        assert!(PathSearch::new(&grid).path(&start, &Vector2::new(9.0, 1.0)).is_none());
        let costs = grid.distances_from(&start);
        assert!(costs.metres_to(&grid, &Vector2::new(9.0, 1.0)).is_none());
        assert!(grid.roomiest(&Vector2::new(9.0, 1.0), 1.0, &costs).is_none());
        assert!((grid.clearance(&Vector2::new(4.55, 3.05)) - 0.35).abs() < 0.06);
    }
}
