//! The cells of a scan rotated by every angle of a search window; computed when needed.

use portolan_geometry::{Point3f, Rigid2, Vector2f};
use portolan_grids::MapLimits;

use super::search_window::SearchWindow;
use crate::Transform2d;

/// Cells are clamped to this so that sums with shifts cannot overflow.
const FAR: i64 = 1 << 24;

/// Cells of the points of a scan, rotated by each angle of a window and put at the initial translation.
/// Points are sorted by range, the nearest first.
pub(crate) struct RotatedScans {
    window: SearchWindow,
    limits: MapLimits,
    /// Subtracted from cell indices: the first cell of the part of the grid that is searched.
    first_cell: [i32; 2],
    translation: Vector2f,
    /// Rotated by the initial angle.
    points: Vec<Point3f>,
    /// Horizontal range of each point, metres.
    ranges: Vec<f32>,
    /// Position of each point of the given scan in the sorted one.
    positions: Vec<u32>,
    /// Where the cells of a scan start in `cells`; none if not computed yet.
    starts: Vec<Option<u32>>,
    cells: Vec<[i32; 2]>,
    /// Cells of one scan in the order of the given scan.
    ordered: Vec<[i32; 2]>,
}

impl RotatedScans {
    pub fn new(
        points: &[Point3f],
        initial: &Rigid2,
        window: SearchWindow,
        limits: MapLimits,
        first_cell: [i32; 2],
    ) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let range = |i: &u32| points[*i as usize].coords.xy().norm();
        order.sort_by(|a, b| range(a).total_cmp(&range(b)).then(a.cmp(b)));
        let mut positions = vec![0; points.len()];
        for (position, i) in order.iter().enumerate() {
            positions[*i as usize] = position as u32;
        }
        let turn = Transform2d::rotation(initial.angle as f32);
        Self {
            window,
            limits,
            first_cell,
            translation: initial.translation.cast::<f32>(),
            points: order.iter().map(|i| turn.apply(&points[*i as usize])).collect(),
            ranges: order.iter().map(range).collect(),
            positions,
            starts: vec![None; window.num_scans() as usize],
            cells: Vec::new(),
            ordered: Vec::new(),
        }
    }

    /// Number of points of a scan.
    pub fn num_points(&self) -> usize {
        self.points.len()
    }

    /// Cells to either side of the window.
    pub fn num_linear(&self) -> i32 {
        self.window.num_linear
    }

    /// Horizontal ranges of the points, ascending, metres.
    pub fn ranges(&self) -> &[f32] {
        &self.ranges
    }

    /// The cells of all points in scan `k`, in the order of the given scan.
    pub fn cells_in_given_order(&mut self, k: i32) -> &[[i32; 2]] {
        let mut ordered = std::mem::take(&mut self.ordered);
        ordered.resize(self.points.len(), [0; 2]);
        let positions = std::mem::take(&mut self.positions);
        let cells = self.cells(k);
        for (cell, position) in ordered.iter_mut().zip(&positions) {
            *cell = cells[*position as usize];
        }
        (self.ordered, self.positions) = (ordered, positions);
        &self.ordered
    }

    /// Maximum difference in cells, due to rounding, between two computations of the same position.
    pub fn rounding_error(&self) -> f64 {
        let reach = self.window.max_range + f64::from(self.translation.norm());
        1e-6 * reach / self.window.resolution
    }

    /// The cells of all points in scan `k`, nearest first.
    pub fn cells(&mut self, k: i32) -> &[[i32; 2]] {
        let start = match self.starts[k as usize] {
            Some(start) => start as usize,
            None => self.compute(k),
        };
        &self.cells[start..start + self.points.len()]
    }

    fn compute(&mut self, k: i32) -> usize {
        let start = self.cells.len();
        let turn = Transform2d::rotation(self.window.angle(k) as f32);
        let (limits, translation, first) = (self.limits, self.translation, self.first_cell);
        self.cells.extend(self.points.iter().map(|p| {
            let place = turn.apply(p).coords.xy() + translation;
            let [x, y] = limits.scaled_index(place, limits.resolution());
            [(x.clamp(-FAR, FAR) as i32) - first[0], (y.clamp(-FAR, FAR) as i32) - first[1]]
        }));
        self.starts[k as usize] = Some(start as u32);
        start
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Vector2;

    #[test]
    fn points_land_in_their_cells() {
        let limits = MapLimits::new(0.05, Vector2::new(0.05, 0.25), 6, 6).unwrap();
        let points = [
            (0.025, 0.175),
            (-0.025, 0.175),
            (-0.075, 0.175),
            (-0.125, 0.175),
            (-0.125, 0.125),
            (-0.125, 0.075),
            (-0.125, 0.025),
        ];
        let points: Vec<_> = points.iter().map(|p| Point3f::new(p.0, p.1, 0.0)).collect();
        let window = SearchWindow::new(&points, 0.05, 0.0, 0.0);
        let mut scans = RotatedScans::new(&points, &Rigid2::identity(), window, limits, [0, 0]);
        let cells = scans.cells_in_given_order(0);
        assert_eq!(cells, [[1, 0], [1, 1], [1, 2], [1, 3], [2, 3], [3, 3], [4, 3]]);
    }

    #[test]
    fn angles_run_from_negative_to_positive() {
        let limits = MapLimits::new(1.0, Vector2::new(3.5, 3.5), 7, 7).unwrap();
        let window = SearchWindow {
            resolution: 1.0,
            angular_step: std::f64::consts::FRAC_PI_2,
            num_angular: 1,
            num_linear: 0,
            max_range: 3.0,
        };
        let point = [Point3f::new(-1.0, 1.0, 0.0)];
        let mut scans = RotatedScans::new(&point, &Rigid2::identity(), window, limits, [0, 0]);
        // Cell (x, y) has its centre at (3 − y, 3 − x).
        let places = [0, 1, 2].map(|k| scans.cells(k)[0]).map(|c| (3 - c[1], 3 - c[0]));
        assert_eq!(places, [(1, 1), (-1, 1), (-1, -1)]);
    }
}
