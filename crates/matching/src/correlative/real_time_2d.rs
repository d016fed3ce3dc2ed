//! Matches scans near a guess in a grid that is still being filled.

use portolan_geometry::{Point3f, Rigid2};
use portolan_grids::{CellBox, CellIndex, Grid2d, MapLimits, is_finite};
use portolan_sensor::PointCloud;

use super::MatchResult;
use super::joint_search::{Best, JointSearch, Objective, Placement, Region, SearchOptions, ShiftBounds};
use super::max_pyramid::MaxPyramid;
use super::rotated_scans::RotatedScans;
use super::search_window::SearchWindow;
use crate::MatcherOptionError;

mod exhaustive;
mod probability;
mod signed_distance;
mod tile;

/// Search window of a real-time correlative matcher, and its preference for the initial pose.
#[derive(Clone, Debug, PartialEq)]
pub struct RealTimeCorrelativeOptions {
    /// Metres to either side along each axis, default 0.1.
    pub linear_search_window: f64,
    /// Radians to either side, default 20°.
    pub angular_search_window: f64,
    /// Weight by which scores fall with the distance from the initial pose, 1/m, default 0.1.
    pub translation_delta_cost_weight: f64,
    /// Weight by which scores fall with the angle from the initial pose, 1/rad, default 0.1.
    pub rotation_delta_cost_weight: f64,
}

impl Default for RealTimeCorrelativeOptions {
    fn default() -> Self {
        Self {
            linear_search_window: 0.1,
            angular_search_window: 20f64.to_radians(),
            translation_delta_cost_weight: 0.1,
            rotation_delta_cost_weight: 0.1,
        }
    }
}

impl RealTimeCorrelativeOptions {
    pub(crate) fn check(&self) -> Result<(), MatcherOptionError> {
        MatcherOptionError::check_not_negative(&[
            ("linear_search_window", self.linear_search_window),
            ("angular_search_window", self.angular_search_window),
            ("translation_delta_cost_weight", self.translation_delta_cost_weight),
            ("rotation_delta_cost_weight", self.rotation_delta_cost_weight),
        ])
    }
}

/// Finds the best placement of a scan on a 2D grid within a small window, as if every placement had
/// been scored.
#[derive(Clone, Debug, PartialEq)]
pub struct RealTimeCorrelativeMatcher2d {
    options: RealTimeCorrelativeOptions,
    largest_penalty: f64,
}

impl RealTimeCorrelativeMatcher2d {
    /// # Errors
    /// If an option is negative.
    pub fn new(options: &RealTimeCorrelativeOptions) -> Result<Self, MatcherOptionError> {
        options.check()?;
        Ok(Self { options: options.clone(), largest_penalty: 1.0 })
    }

    /// Limits the fraction, 0 to 1, by which the offset from the initial pose may lower a score: the factor
    /// becomes `1 − largest (1 − exp(−(‖translation‖ w_t + |angle| w_r)²))`. With large weights and a small
    /// limit the result is kept at the initial pose where the grid does not constrain it, as along a corridor,
    /// and leaves it at any distance where the grid does.
    #[must_use]
    pub fn with_largest_penalty(self, largest: f64) -> Self {
        Self { largest_penalty: largest.clamp(0.0, 1.0), ..self }
    }

    /// The placement of `points` (metres, in the gravity-aligned tracking frame) with the largest score
    /// around `initial`; among equals the one with the smallest angle, then the smallest cell indices.
    /// Points that are not finite are left out; without points there is no result.
    ///
    /// On a probability grid a placement scores the mean probability of the cells the points meet, on a
    /// distance field the weighted mean of how near the surface they are; both times
    /// `exp(−(‖translation‖ w_t + |angle| w_r)²)` of the offset from `initial`.
    pub fn match_scan(
        &self,
        initial: &Rigid2,
        points: &PointCloud,
        grid: &Grid2d,
    ) -> Option<MatchResult<Rigid2>> {
        let points: Vec<Point3f> = points.points.iter().copied().filter(is_finite).collect();
        if points.is_empty() || !initial.is_finite() {
            return None;
        }
        let window = self.window(initial, &points, grid);
        let tile = searched_part(grid, initial, &points, &window);
        let first_cell = [tile.min.x, tile.min.y];
        let scans = RotatedScans::new(&points, initial, window, *grid.limits(), first_cell);
        let penalty = Penalty::new(&self.options, self.largest_penalty, window);
        let (score, placement) = match grid {
            Grid2d::Probability(g) => probability::best(g, tile, scans, window, penalty),
            Grid2d::Tsdf(g) => signed_distance::best(g, tile, scans, window, penalty),
        }?;
        Some(MatchResult { score, pose: window.pose(initial, &placement) })
    }

    /// [`Self::match_scan`] around each of several initial poses. Where the window is small, the grid is read once for all.
    pub fn match_scan_around(
        &self,
        initials: &[Rigid2],
        points: &PointCloud,
        grid: &Grid2d,
    ) -> Vec<Option<MatchResult<Rigid2>>> {
        let finite: Vec<Point3f> = points.points.iter().copied().filter(is_finite).collect();
        let are_usual = !finite.is_empty() && initials.iter().all(Rigid2::is_finite);
        let windows: Vec<SearchWindow> = match are_usual {
            true => initials.iter().map(|initial| self.window(initial, &finite, grid)).collect(),
            false => Vec::new(),
        };
        let parts =
            initials.iter().zip(&windows).map(|(at, window)| searched_part(grid, at, &finite, window));
        let all = parts.reduce(|a, b| a.extended(b.min).extended(b.max));
        let (Grid2d::Probability(probabilities), Some(all)) = (grid, all) else {
            return initials.iter().map(|initial| self.match_scan(initial, points, grid)).collect();
        };
        if windows.iter().any(|window| window.num_linear > SMALL_WINDOW) {
            return initials.iter().map(|initial| self.match_scan(initial, points, grid)).collect();
        }
        let tile = probability::tile(probabilities, all);
        let found = initials.iter().zip(windows).map(|(initial, window)| {
            let first_cell = [all.min.x, all.min.y];
            let scans = RotatedScans::new(&finite, initial, window, *grid.limits(), first_cell);
            let penalty = Penalty::new(&self.options, self.largest_penalty, window);
            let (score, placement) = probability::best_on(&tile, scans, window, penalty)?;
            Some(MatchResult { score, pose: window.pose(initial, &placement) })
        });
        found.collect()
    }

    fn window(&self, initial: &Rigid2, points: &[Point3f], grid: &Grid2d) -> SearchWindow {
        let mut window = SearchWindow::new(
            points,
            grid.limits().resolution(),
            self.options.linear_search_window,
            self.options.angular_search_window,
        );
        window.num_linear = window.num_linear.min(largest_useful_shift(grid, initial, &window));
        window
    }
}

/// Penalty of the offset from the initial pose.
#[derive(Clone, Copy, Debug)]
struct Penalty {
    translation_weight: f64,
    rotation_weight: f64,
    largest: f64,
    window: SearchWindow,
}

impl Penalty {
    fn new(options: &RealTimeCorrelativeOptions, largest: f64, window: SearchWindow) -> Self {
        Self {
            translation_weight: options.translation_delta_cost_weight,
            rotation_weight: options.rotation_delta_cost_weight,
            largest,
            window,
        }
    }

    /// The factor of a placement.
    fn factor(&self, placement: &Placement) -> f64 {
        let [x, y] = self.window.shift(placement.x, placement.y);
        let angle = self.window.angle(placement.scan);
        let near =
            (-(x.hypot(y) * self.translation_weight + angle.abs() * self.rotation_weight).powi(2)).exp();
        // The plain case apart, so that it remains exact.
        if self.largest < 1.0 { 1.0 - self.largest * (1.0 - near) } else { near }
    }

    /// The largest factor of all placements of a region: that of the one nearest to the initial pose.
    fn largest_factor(&self, region: &Region) -> f64 {
        let nearest = |first: i32, last: i32, centre: i32| centre.clamp(first, last);
        let (first, last) = (region.first, region.last);
        self.factor(&Placement {
            scan: nearest(first.scan, last.scan, self.window.num_angular),
            x: nearest(first.x, last.x, 0),
            y: nearest(first.y, last.y, 0),
        })
    }
}

/// At most this many cells to either side are searched.
const MAX_SHIFT: f64 = 2048.0;

/// Cells beyond which a shift takes all points off the grid, where no placement is better than another.
fn largest_useful_shift(grid: &Grid2d, initial: &Rigid2, window: &SearchWindow) -> i32 {
    let limits = grid.limits();
    let offset = (limits.max() - initial.translation).abs().max();
    let across = f64::from(limits.num_x_cells().max(limits.num_y_cells()));
    let cells = across + (offset + window.max_range) / limits.resolution();
    cells.ceil().min(MAX_SHIFT) as i32
}

/// The cells of the grid that any placement can meet.
fn searched_part(grid: &Grid2d, initial: &Rigid2, points: &[Point3f], window: &SearchWindow) -> CellBox {
    let limits: &MapLimits = grid.limits();
    let turn = window.angle(window.num_scans() - 1);
    let margin = f64::from(window.num_linear) + 2.0;
    let [mut low, mut high] = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    let (sin, cos) = initial.angle.sin_cos();
    for point in points {
        let (px, py) = (f64::from(point.x), f64::from(point.y));
        // No point leaves its place by more than twice its range or by more than the arc.
        let reach = px.hypot(py) * turn.min(2.0) / limits.resolution() + margin;
        let x = initial.translation.x + cos * px - sin * py;
        let y = initial.translation.y + sin * px + cos * py;
        let cell = [limits.max().y - y, limits.max().x - x].map(|d| d / limits.resolution() - 0.5);
        for axis in 0..2 {
            low[axis] = low[axis].min(cell[axis] - reach);
            high[axis] = high[axis].max(cell[axis] + reach);
        }
    }
    // Casts saturate; a part without any cell shrinks to one.
    let last = [limits.num_x_cells(), limits.num_y_cells()].map(|n| n as i32 - 1);
    let [min, max] = [low.map(f64::floor), high.map(f64::ceil)]
        .map(|v| CellIndex::new((v[0] as i32).clamp(0, last[0]), (v[1] as i32).clamp(0, last[1])));
    CellBox { min, max }
}

/// Up to this many cells to either side all placements are scored: bounds would cost as much.
const SMALL_WINDOW: i32 = 3;
/// Boxes of 8 by 8 shifts of one scan are scored as a whole.
const LEAF_EXPONENT: u32 = 3;

/// Boxes that hold the whole window unless that is large.
fn max_exponent(window: &SearchWindow) -> u32 {
    (2 * window.num_linear as u32 + 1).next_power_of_two().trailing_zeros().clamp(LEAF_EXPONENT, 5)
}

#[cfg(test)]
mod tests;
