//! Likelihood field of a 2D map (distance to the nearest solid cell), and correlative search of scans in it.
//!
//! It is the likelihood field of Thrun, Burgard and Fox ("Probabilistic Robotics", §6.4). It is smooth where
//! grids are not, so that a search may take steps of several cells.

use portolan_geometry::{Rigid2, Vector2};
use portolan_grids::{CellIndex, MapLimits, ProbabilityGrid, SOLID_CELL};

use crate::known_map::Window;
use crate::settings::matching::{GUESS_PREFERENCE, MOST_PLACEMENTS, RETURN_SIGMA, SEARCH_STEP, SEARCH_TURN};

/// Distance beyond which a byte is 0, in standard deviations.
const FARTHEST: f64 = 4.0;

/// Likelihoods as bytes: 255 at something solid, 0 far from everything.
pub(crate) struct LikelihoodField {
    limits: MapLimits,
    bytes: Vec<u8>,
}

impl LikelihoodField {
    pub fn new(grid: &ProbabilityGrid) -> Self {
        let limits = *grid.limits();
        let distances = squared_distances(grid);
        let cells = RETURN_SIGMA / limits.resolution();
        let byte = |squared: f32| match f64::from(squared) / (cells * cells) {
            far if far > FARTHEST * FARTHEST => 0,
            near => (255.0 * (-0.5 * near).exp()).round() as u8,
        };
        Self { limits, bytes: distances.into_iter().map(byte).collect() }
    }

    /// Whether any cell is solid.
    pub fn has_walls(&self) -> bool {
        self.bytes.contains(&255)
    }

    /// Value of [`LikelihoodField::at`] at a distance from something solid, metres.
    pub fn at_distance(metres: f64) -> f64 {
        (-0.5 * (metres / RETURN_SIGMA).powi(2)).exp()
    }

    /// 1 at something solid, 0 far from everything.
    pub fn at(&self, point: &Vector2) -> f64 {
        f64::from(self.byte(point)) / 255.0
    }

    #[inline]
    fn byte(&self, point: &Vector2) -> u8 {
        let index = self.limits.flat_index(self.limits.cell_index(point.cast::<f32>()));
        index.and_then(|i| self.bytes.get(i)).copied().unwrap_or(0)
    }

    /// For each point moved by `at`, two numbers whose sum is the index of its cell in the list: the start
    /// of the row of the grid, which depends on x alone, and the position in that row, which depends on y
    /// alone. Outside of the grid the sum is beyond the list.
    fn positions(&self, points: &[Vector2], at: &Vector2) -> (Vec<usize>, Vec<usize>) {
        let [columns, rows] = [self.limits.num_x_cells(), self.limits.num_y_cells()].map(|n| n as usize);
        let within = |i: i32, count: usize| usize::try_from(i).ok().filter(|i| *i < count);
        let cells = points.iter().map(|p| self.limits.cell_index((p + at).cast::<f32>()));
        let position = |cell: CellIndex| {
            let row = within(cell.y, rows).map_or(self.bytes.len(), |row| row * columns);
            (row, within(cell.x, columns).unwrap_or(self.bytes.len()))
        };
        cells.map(position).unzip()
    }

    /// The pose of a scan in a window around a guess with the highest mean likelihood.
    pub fn search(&self, points: &[Vector2], guess: &Rigid2, window: Window) -> Rigid2 {
        let count = |width: f64, step: f64| (width / step - 1e-6).ceil().max(0.0);
        let (mut shifts, mut turns) = (count(window.metres, SEARCH_STEP), count(window.radians, SEARCH_TURN));
        while (2.0 * shifts + 1.0).powi(2) * (2.0 * turns + 1.0) > MOST_PLACEMENTS {
            (shifts, turns) = ((0.8 * shifts).floor(), (0.8 * turns).floor());
        }
        let step = |width: f64, count: f64| if count > 0.0 { width / count } else { 0.0 };
        let (metres, radians) = (step(window.metres, shifts), step(window.radians, turns));
        let (shifts, turns) = (shifts as i32, turns as i32);
        let mut best = (f64::NEG_INFINITY, *guess);
        for turn in -turns..=turns {
            let angle = guess.angle + f64::from(turn) * radians;
            let matrix = Rigid2::new(0.0, 0.0, angle).rotation_matrix();
            let turned: Vec<Vector2> = points.iter().map(|p| matrix * p).collect();
            let shift = |x: i32, y: i32| metres * Vector2::new(f64::from(x), f64::from(y));
            // A shift along x moves points to other rows, and one along y within their rows.
            let (of_rows, in_rows): (Vec<_>, Vec<_>) = (-shifts..=shifts)
                .map(|i| self.positions(&turned, &(guess.translation + shift(i, i))))
                .unzip();
            let pairs =
                (-shifts..).zip(&of_rows).flat_map(|x| (-shifts..).zip(&in_rows).map(move |y| (x, y)));
            for ((x, of_row), (y, in_row)) in pairs {
                let bytes = of_row.iter().zip(in_row).filter_map(|(row, place)| self.bytes.get(row + place));
                let sum: u64 = bytes.map(|byte| u64::from(*byte)).sum();
                let mean = sum as f64 / (255.0 * points.len().max(1) as f64);
                let part = |i: i32, most: i32| f64::from(i) / f64::from(most.max(1));
                let off = part(x, shifts).powi(2) + part(y, shifts).powi(2) + part(turn, turns).powi(2);
                let score = mean - GUESS_PREFERENCE * off;
                if score > best.0 {
                    best = (score, Rigid2 { translation: guess.translation + shift(x, y), angle });
                }
            }
        }
        best.1
    }
}

/// Squares of the distances to the nearest solid cell, in cells, exact (Felzenszwalb and Huttenlocher 2012, "Distance
/// transforms of sampled functions").
fn squared_distances(grid: &ProbabilityGrid) -> Vec<f32> {
    let limits = grid.limits();
    let (columns, rows) = (limits.num_x_cells() as usize, limits.num_y_cells() as usize);
    let mut distances = vec![f32::INFINITY; columns * rows];
    for (i, distance) in distances.iter_mut().enumerate() {
        let cell = CellIndex::new((i % columns) as i32, (i / columns) as i32);
        if grid.is_known(cell) && grid.probability(cell) > SOLID_CELL {
            *distance = 0.0;
        }
    }
    let mut transform = Transform::default();
    for row in distances.chunks_mut(columns) {
        let line = transform.run(row.iter().copied()).to_vec();
        row.copy_from_slice(&line);
    }
    for column in 0..columns {
        let values = distances.iter().skip(column).step_by(columns).copied();
        let line = transform.run(values).to_vec();
        for (distance, value) in distances.iter_mut().skip(column).step_by(columns).zip(line) {
            *distance = value;
        }
    }
    distances
}

/// Lower envelope of parabolas over one line.
#[derive(Default)]
struct Transform {
    values: Vec<f32>,
    /// Position and height of the parabolas of the envelope, and the position from which each is the lowest.
    envelope: Vec<(f32, f32, f32)>,
    result: Vec<f32>,
}

impl Transform {
    fn run(&mut self, values: impl Iterator<Item = f32>) -> &[f32] {
        self.values.clear();
        self.values.extend(values);
        self.envelope.clear();
        for (i, value) in self.values.iter().enumerate().filter(|(_, v)| v.is_finite()) {
            let mut from = f32::NEG_INFINITY;
            while let Some((b, height, start)) = self.envelope.last() {
                let a = i as f32;
                from = ((value + a * a) - (height + b * b)) / (2.0 * (a - b));
                if from > *start {
                    break;
                }
                self.envelope.pop();
                from = f32::NEG_INFINITY;
            }
            self.envelope.push((i as f32, *value, from));
        }
        self.result.clear();
        let mut k = 0;
        for i in 0..self.values.len() {
            while self.envelope.get(k + 1).is_some_and(|(.., from)| *from < i as f32) {
                k += 1;
            }
            let distance = |(at, height, _): &(f32, f32, f32)| (i as f32 - at).powi(2) + height;
            self.result.push(self.envelope.get(k).map_or(f32::INFINITY, distance));
        }
        &self.result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(solid: &[(i32, i32)]) -> ProbabilityGrid {
        let limits = MapLimits::new(0.05, Vector2::new(2.0, 3.0), 60, 40).unwrap();
        let mut grid = ProbabilityGrid::new(limits);
        for (x, y) in solid {
            grid.set_probability(CellIndex::new(*x, *y), 0.9);
        }
        grid
    }

    #[test]
    fn distances_are_those_to_the_nearest_cell() {
        let solid = [(3, 7), (50, 30), (51, 30), (20, 0)];
        let distances = squared_distances(&grid(&solid));
        for (i, distance) in distances.iter().enumerate() {
            let (x, y) = ((i % 60) as i32, (i / 60) as i32);
            let nearest = solid.iter().map(|(a, b)| (x - a).pow(2) + (y - b).pow(2)).min();
            assert_eq!(Some(*distance as i32), nearest, "{x} {y}");
        }
        assert!(squared_distances(&grid(&[])).iter().all(|d| d.is_infinite()));
    }

    #[test]
    fn a_corner_is_found_within_a_step() {
        let walls: Vec<(i32, i32)> = (5..50).map(|i| (i, 10)).chain((10..38).map(|i| (50, i))).collect();
        let grid = grid(&walls);
        let field = LikelihoodField::new(&grid);
        let points: Vec<Vector2> =
            walls.iter().map(|(x, y)| grid.limits().cell_center(CellIndex::new(*x, *y))).collect();
        let guess = Rigid2::new(0.2, -0.1, 0.05);
        let found = field.search(&points, &guess, Window { metres: 0.3, radians: 0.1 });
        assert!(found.translation.norm() < 0.08 && found.angle.abs() < 0.03, "{found:?}");
    }
}
