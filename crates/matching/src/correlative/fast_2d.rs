//! Matches scans anywhere in a finished submap.

use portolan_geometry::{Point3f, Rigid2, Vector2, normalize_angle};
use portolan_grids::{Grid2d, MapLimits, is_finite, value::CODE_COUNT};
use portolan_sensor::PointCloud;

use super::MatchResult;
use super::byte_score::ByteScore;
use super::joint_search::{Best, JointSearch, Objective, Region, SearchOptions, ShiftBounds};
use super::max_pyramid::MaxPyramid;
use super::rotated_scans::RotatedScans;
use super::search_window::{MAX_LINEAR_STEPS, SearchWindow};
use crate::MatcherOptionError;

mod order;

/// Search window of a fast correlative matcher around a guess.
#[derive(Clone, Debug, PartialEq)]
pub struct FastCorrelativeOptions2d {
    /// Metres to either side along each axis, default 7.
    pub linear_search_window: f64,
    /// Radians to either side, default 30°.
    pub angular_search_window: f64,
    /// Number of levels of the search in Cartographer, default 7. Here it only decides between placements
    /// with exactly the same score.
    pub branch_and_bound_depth: u32,
}

impl Default for FastCorrelativeOptions2d {
    fn default() -> Self {
        Self {
            linear_search_window: 7.0,
            angular_search_window: 30f64.to_radians(),
            branch_and_bound_depth: 7,
        }
    }
}

/// Criteria for several places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeveralPlaces {
    /// Minimum score.
    pub min_score: f32,
    /// Minimum score as a fraction of the best score.
    pub share_of_best: f32,
    /// Separation below which two places count as one, metres and radians.
    pub separation: (f64, f64),
    /// Maximum number of places.
    pub most: usize,
    /// Maximum number of look-ups of cells; the search then ends with what it has. A thousand million take
    /// about a second.
    pub lookups: u64,
}

/// Largest depth: windows of 2^23 cells.
const MAX_DEPTH: u32 = 24;
/// The search starts with boxes of 2^6 cells; the widest windows kept are twice as wide.
const MAX_EXPONENT: u32 = 6;

/// Finds the best placement of a scan on a 2D grid by branch and bound, near a guess or anywhere.
///
/// Making one costs about as much as copying the grid 14 times and takes that much memory in bytes;
/// it does not refer to the grid any more.
#[derive(Clone, Debug, PartialEq)]
pub struct FastCorrelativeMatcher2d {
    options: FastCorrelativeOptions2d,
    limits: MapLimits,
    pyramid: MaxPyramid,
    score: ByteScore,
}

impl FastCorrelativeMatcher2d {
    /// Prepares a grid for searching.
    ///
    /// # Errors
    /// If a window is negative or the depth out of bounds.
    pub fn new(grid: &Grid2d, options: &FastCorrelativeOptions2d) -> Result<Self, MatcherOptionError> {
        MatcherOptionError::check_not_negative(&[
            ("linear_search_window", options.linear_search_window),
            ("angular_search_window", options.angular_search_window),
        ])?;
        let depth = options.branch_and_bound_depth;
        if !(1..=MAX_DEPTH).contains(&depth) {
            let name = "branch_and_bound_depth";
            return Err(MatcherOptionError::Depth { name, value: depth, max: MAX_DEPTH });
        }
        let (lowest, highest) = (1.0 - grid.code().upper(), 1.0 - grid.code().lower());
        let score = ByteScore::new(lowest, highest);
        let table: Vec<u8> = (0..CODE_COUNT as u16)
            .map(|code| {
                let cost = grid.code().decode(code, grid.code().upper()).abs();
                score.byte(1.0 - cost)
            })
            .collect();
        let bytes: Vec<u8> = grid.cells().iter().map(|c| table[usize::from(*c) % CODE_COUNT]).collect();
        let limits = *grid.limits();
        let (num_x, num_y) = (limits.num_x_cells() as usize, limits.num_y_cells() as usize);
        Ok(Self {
            options: options.clone(),
            limits,
            pyramid: MaxPyramid::new(&bytes, num_x, num_y, MAX_EXPONENT + 1, 0),
            score,
        })
    }

    /// Memory that it takes, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.pyramid.memory_bytes()
    }

    /// The placement of `points` (metres, in the gravity-aligned tracking frame) around `initial` (in
    /// the frame of the grid) with the largest score, if that is above `min_score`. The score is the
    /// mean probability of the cells met, to 8 bits. Points that are not finite are left out.
    pub fn match_local(
        &self,
        initial: &Rigid2,
        points: &PointCloud,
        min_score: f32,
    ) -> Option<MatchResult<Rigid2>> {
        let (linear, angular) = (self.options.linear_search_window, self.options.angular_search_window);
        self.match_within(initial, points, min_score, linear, angular)
    }

    /// As [`Self::match_local`], in a window of these metres and radians to either side instead of that of the
    /// options.
    pub fn match_within(
        &self,
        initial: &Rigid2,
        points: &PointCloud,
        min_score: f32,
        linear: f64,
        angular: f64,
    ) -> Option<MatchResult<Rigid2>> {
        self.search(initial, points, min_score, linear, angular.min(std::f64::consts::PI))
    }

    /// As [`Self::match_local`], anywhere on the grid and at any angle.
    pub fn match_full(&self, points: &PointCloud, min_score: f32) -> Option<MatchResult<Rigid2>> {
        let (centre, everywhere) = self.everywhere();
        self.search(&centre, points, min_score, everywhere, std::f64::consts::PI)
    }

    /// All places on the grid, at any angle, where `points` (metres, in the gravity-aligned tracking frame) fit about as
    /// well as where they fit best; the best first.
    pub fn match_several(&self, points: &PointCloud, wanted: &SeveralPlaces) -> Vec<MatchResult<Rigid2>> {
        let (centre, everywhere) = self.everywhere();
        self.match_several_within(points, wanted, &centre.translation, everywhere)
    }

    /// As [`Self::match_several`], with the origin of the points within `metres` of a place on the grid along
    /// each axis.
    pub fn match_several_within(
        &self,
        points: &PointCloud,
        wanted: &SeveralPlaces,
        place: &Vector2,
        metres: f64,
    ) -> Vec<MatchResult<Rigid2>> {
        let points: Vec<Point3f> = points.points.iter().copied().filter(is_finite).collect();
        let centre = Rigid2 { translation: *place, angle: 0.0 };
        let min_inside = self.min_points_inside(points.len(), wanted.min_score);
        let (Some(min_inside), false) = (min_inside, points.is_empty()) else { return Vec::new() };
        let window = SearchWindow::new(&points, self.limits.resolution(), metres, std::f64::consts::PI);
        let mut search = self.joint_search(&points, &centre, window, min_inside);
        let found = search.run_several(wanted.min_score, wanted.share_of_best, wanted.lookups);
        let mut places: Vec<MatchResult<Rigid2>> = Vec::new();
        for (score, placement) in found {
            let pose = window.pose(&centre, &placement);
            if places.len() < wanted.most && !places.iter().any(|p| is_near(&p.pose, &pose, wanted)) {
                places.push(MatchResult { score, pose });
            }
        }
        places
    }

    /// The middle of the grid, and a distance around it that covers everything, metres.
    fn everywhere(&self) -> (Rigid2, f64) {
        let half_size = 0.5
            * self.limits.resolution()
            * nalgebra::Vector2::new(
                f64::from(self.limits.num_y_cells()),
                f64::from(self.limits.num_x_cells()),
            );
        let centre = Rigid2 { translation: self.limits.max() - half_size, angle: 0.0 };
        (centre, f64::from(MAX_LINEAR_STEPS) * self.limits.resolution())
    }

    fn joint_search(
        &self,
        points: &[Point3f],
        initial: &Rigid2,
        window: SearchWindow,
        min_inside: usize,
    ) -> JointSearch<'_, MeanByte> {
        let scans = RotatedScans::new(points, initial, window, self.limits, [0, 0]);
        let size = [self.limits.num_x_cells() as i32, self.limits.num_y_cells() as i32];
        let shifts = ShiftBounds::Overlap { size, min_inside };
        let objective = MeanByte { score: self.score, num_points: points.len() };
        let options = SearchOptions { max_exponent: MAX_EXPONENT, leaf_exponent: 0 };
        JointSearch::new(&self.pyramid, scans, window, shifts, objective, options)
    }

    fn search(
        &self,
        initial: &Rigid2,
        points: &PointCloud,
        min_score: f32,
        linear: f64,
        angular: f64,
    ) -> Option<MatchResult<Rigid2>> {
        let points: Vec<Point3f> = points.points.iter().copied().filter(is_finite).collect();
        if points.is_empty() || !initial.is_finite() || min_score.is_nan() {
            return None;
        }
        let window = SearchWindow::new(&points, self.limits.resolution(), linear, angular);
        let min_inside = self.min_points_inside(points.len(), min_score)?;
        let mut search = self.joint_search(&points, initial, window, min_inside);
        let (score, placements) = search.run(min_score);
        let placement = order::first_of(&placements, self, &mut search.scans)?;
        Some(MatchResult { score, pose: window.pose(initial, &placement) })
    }

    /// Minimum number of points inside the grid for a score above `min_score`; none if all are too few.
    fn min_points_inside(&self, num_points: usize, min_score: f32) -> Option<usize> {
        let enough = |inside: usize| self.score.of(255 * inside as u32, num_points) > min_score;
        let (mut low, mut high) = (0, num_points);
        while low < high {
            let middle = low.midpoint(high);
            if enough(middle) { high = middle } else { low = middle + 1 }
        }
        enough(low).then_some(low)
    }
}

fn is_near(a: &Rigid2, b: &Rigid2, wanted: &SeveralPlaces) -> bool {
    let (metres, radians) = wanted.separation;
    (a.translation - b.translation).norm() < metres && normalize_angle(a.angle - b.angle).abs() < radians
}

/// The mean of the bytes at the points, as a score.
struct MeanByte {
    score: ByteScore,
    num_points: usize,
}

impl Objective for MeanByte {
    fn bound(&self, byte_sum: u32, _region: &Region) -> f32 {
        self.score.of(byte_sum, self.num_points)
    }

    fn score(&self, region: &Region, byte_sum: u32, _scans: &mut RotatedScans, best: &mut Best) {
        best.offer(region.first, self.score.of(byte_sum, self.num_points));
    }
}

#[cfg(test)]
mod tests;
