//! Place index: finds places in a whole map at once, without a guess.
//!
//! The cost of searching submap by submap grows with their number, and a result in one saves nothing in the
//! next. Here all submaps are one grid of large cells, and one branch and bound goes through it, best first,
//! until the best places are known; boxes with smaller bounds are never looked at. Two things make the bounds
//! tight enough for that. A point that ends in free space counts against a place, so that windows without
//! walls have negative bounds. And a scanner stands where the map knows free space, so that boxes without any
//! are not looked at.
//!
//! A greedy search goes first. Where the bounds separate good places from others, it finds them all, at a
//! cost that hardly depends on the map; how many it finds depends on its width. The complete search proves
//! that nothing is missed, at a cost that grows with the map.

use portolan_geometry::{Point3f, Rigid2, Vector2, normalize_angle};
use portolan_grids::{CellIndex, Grid2d, GridError, MapLimits, is_finite};
use portolan_sensor::PointCloud;

use super::MatchResult;
use super::best_first::{Node, Taker};
use super::byte_score::ByteScore;
use super::joint_search::{Best, JointSearch, Objective, Placement, Region, SearchOptions, ShiftBounds};
use super::max_pyramid::MaxPyramid;
use super::place_grid::{Known, PlaceGrid};
use super::rotated_scans::RotatedScans;
use super::search_window::{MAX_LINEAR_STEPS, SearchWindow};

/// Value of a point that ends in an occupied cell.
const SOLID: f32 = 1.0;
/// Value of a point that ends beside an occupied cell.
const BESIDE_SOLID: f32 = 0.5;
/// Value of a point that ends in an unknown cell.
const NOTHING: f32 = 0.0;
/// Value of a point that ends in a free cell.
const FREE: f32 = -0.5;
/// The search starts with boxes of 2^5 cells and as many angles. Windows of points in them are up to twice as wide and a
/// little more: of 2^7 cells.
const MAX_EXPONENT: u32 = 5;

/// Criteria for places, and limits of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WantedPlaces {
    /// Minimum score.
    pub min_score: f32,
    /// Minimum score as a fraction of the best score.
    pub share_of_best: f32,
    /// Separation below which two places count as one, metres and radians.
    pub separation: (f64, f64),
    /// Maximum number of places.
    pub most: usize,
    /// Number of points to which a cloud is thinned.
    pub most_points: usize,
    /// Number of boxes of each size that the first, greedy search splits: its result bounds the best score
    /// from below. It costs the same in any map, except for boxes of the first size.
    pub beam: usize,
    /// Maximum number of look-ups of cells of the complete search after it, which then ends with the results
    /// of both; 0 omits it. A thousand million take about a second.
    pub lookups: u64,
}

/// Places where a cloud fits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FoundPlaces2d {
    /// Poses of the cloud in the map, the best first. The score is the mean over the points: 1 in an occupied
    /// cell, ½ beside it, 0 in an unknown cell, −½ in a free one.
    pub places: Vec<MatchResult<Rigid2>>,
    /// Whether these are the best ones of all; false if the look-ups were too few to know.
    pub is_complete: bool,
    /// Number of cells looked up by the complete search: its cost, independent of the machine.
    pub lookups: u64,
}

/// Finds clouds of points anywhere in a 2D map.
///
/// It takes some 25 bytes for each cell of the box around the map, and does not refer to the grids any more.
#[derive(Clone, Debug)]
pub struct PlaceIndex2d {
    limits: MapLimits,
    score: ByteScore,
    pyramid: MaxPyramid,
    /// 1 where a cell is partly known to be free, or a scanner may stand.
    free: MaxPyramid,
}

impl PlaceIndex2d {
    /// From grids and their poses in the map (`map_from_grid`), in cells of this edge, metres, or larger ones
    /// if the map is very wide. None where nothing is known.
    ///
    /// # Errors
    /// If the map is absurdly wide.
    pub fn new(grids: &[(&Grid2d, Rigid2)], cell: f64) -> Result<Option<Self>, GridError> {
        let Some(PlaceGrid { limits, cells, has_free }) = PlaceGrid::new(grids, cell)? else {
            return Ok(None);
        };
        let score = ByteScore::new(FREE, SOLID);
        let value = |known: &Known| match known {
            Known::Nothing => NOTHING,
            Known::Free => FREE,
            Known::BesideSolid => BESIDE_SOLID,
            Known::Solid => SOLID,
        };
        let bytes: Vec<u8> = cells.iter().map(|known| score.byte(value(known))).collect();
        let free: Vec<u8> = has_free.iter().map(|free| u8::from(*free)).collect();
        Ok(Some(Self::of_bytes(limits, score, &bytes, &free)))
    }

    /// From cells with the value of a point that ends there, from 0 to 1; others have the value 0. A scanner
    /// may stand in the cells that are open, in the order of [`MapLimits::flat_index`].
    pub fn of_cells(limits: MapLimits, counts: &[(CellIndex, f32)], is_open: &[bool]) -> Self {
        let score = ByteScore::new(FREE, SOLID);
        let mut bytes = vec![score.byte(NOTHING); limits.num_cells()];
        for (cell, count) in counts {
            if let Some(byte) = limits.flat_index(*cell).and_then(|index| bytes.get_mut(index)) {
                *byte = score.byte(count.clamp(NOTHING, SOLID));
            }
        }
        let mut open: Vec<u8> = is_open.iter().map(|open| u8::from(*open)).collect();
        open.resize(bytes.len(), 0);
        Self::of_bytes(limits, score, &bytes, &open)
    }

    fn of_bytes(limits: MapLimits, score: ByteScore, bytes: &[u8], free: &[u8]) -> Self {
        let (num_x, num_y) = (limits.num_x_cells() as usize, limits.num_y_cells() as usize);
        Self {
            limits,
            score,
            pyramid: MaxPyramid::new(bytes, num_x, num_y, MAX_EXPONENT + 2, score.byte(NOTHING)),
            free: MaxPyramid::new(free, num_x, num_y, MAX_EXPONENT, 0),
        }
    }

    /// Memory that it takes, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.pyramid.memory_bytes() + self.free.memory_bytes()
    }

    /// Edge of a cell, metres.
    pub fn resolution(&self) -> f64 {
        self.limits.resolution()
    }

    /// The best places of `points`, metres in the level frame of a scanner at the origin. Points that are not
    /// finite are left out.
    pub fn find(&self, points: &PointCloud, wanted: &WantedPlaces) -> FoundPlaces2d {
        let everywhere = f64::from(MAX_LINEAR_STEPS) * self.limits.resolution();
        self.find_within(points, wanted, &self.limits.max(), everywhere)
    }

    /// As [`Self::find`], for a scanner within `metres` of a place in the map along each axis.
    pub fn find_within(
        &self,
        points: &PointCloud,
        wanted: &WantedPlaces,
        place: &Vector2,
        metres: f64,
    ) -> FoundPlaces2d {
        let points: Vec<Point3f> = points.points.iter().copied().filter(is_finite).collect();
        let stride = points.len().div_ceil(wanted.most_points.max(1)).max(1);
        let points: Vec<Point3f> = points.into_iter().step_by(stride).collect();
        if points.is_empty() || wanted.most == 0 {
            return FoundPlaces2d { is_complete: true, ..FoundPlaces2d::default() };
        }
        let centre = Rigid2 { translation: *place, angle: 0.0 };
        let window = SearchWindow::new(&points, self.limits.resolution(), metres, std::f64::consts::PI);
        let mut search = self.search(&points, &centre, window);
        let min_score = wanted.min_score.max(NOTHING);
        let mut good = search.run_beam(min_score, wanted.beam);
        let best = good.iter().map(|node| node.bound).fold(0.0, f32::max);
        let floor = min_score.max(wanted.share_of_best * best);
        good.retain(|node| node.bound > floor);
        let mut taken = Taken { wanted, window, centre, places: Vec::new() };
        let left = search.run_in_order(floor, wanted.lookups, good, &mut taken);
        let places = taken.places.into_iter().map(|(score, pose)| MatchResult { score, pose }).collect();
        FoundPlaces2d { places, is_complete: left > 0, lookups: wanted.lookups - left }
    }

    fn search<'a>(
        &'a self,
        points: &[Point3f],
        centre: &Rigid2,
        window: SearchWindow,
    ) -> JointSearch<'a, PlaceScore<'a>> {
        let scans = RotatedScans::new(points, centre, window, self.limits, [0, 0]);
        let size = [self.limits.num_x_cells() as i32, self.limits.num_y_cells() as i32];
        let origin = self.limits.cell_index(centre.translation.cast::<f32>());
        let origin = [origin.x, origin.y];
        let shifts = ShiftBounds::OriginInside { size, origin };
        let objective = PlaceScore { score: self.score, num_points: points.len(), free: &self.free, origin };
        let options = SearchOptions { max_exponent: MAX_EXPONENT, leaf_exponent: 0 };
        JointSearch::new(&self.pyramid, scans, window, shifts, objective, options)
    }
}

/// The mean value of the points, for a scanner in free space.
struct PlaceScore<'a> {
    score: ByteScore,
    num_points: usize,
    free: &'a MaxPyramid,
    /// Cell of the scanner in the unmoved scan.
    origin: [i32; 2],
}

impl Objective for PlaceScore<'_> {
    fn bound(&self, byte_sum: u32, _region: &Region) -> f32 {
        self.score.of(byte_sum, self.num_points)
    }

    fn is_open(&self, region: &Region) -> bool {
        let Region { first, last } = region;
        let width = 1 + (last.x - first.x).max(last.y - first.y).max(0);
        let level = self.free.level(MaxPyramid::level_for(width as u32));
        level.at(self.origin[0] + first.x, self.origin[1] + first.y) > 0
    }

    fn score(&self, region: &Region, byte_sum: u32, _scans: &mut RotatedScans, best: &mut Best) {
        best.offer(region.first, self.score.of(byte_sum, self.num_points));
    }
}

/// Places that were taken, the best first.
struct Taken<'a> {
    wanted: &'a WantedPlaces,
    window: SearchWindow,
    centre: Rigid2,
    places: Vec<(f32, Rigid2)>,
}

impl Taker<Placement> for Taken<'_> {
    /// If the whole box is within the separation from one place.
    fn is_needless(&self, node: &Node<Placement>) -> bool {
        let width = (1 << node.exponent) - 1;
        let Placement { scan, x, y } = node.first;
        let corner = |scan, x, y| self.window.pose(&self.centre, &Placement { scan, x, y });
        let corners = [(x, y), (x + width, y), (x, y + width), (x + width, y + width)]
            .map(|(x, y)| corner(scan, x, y).translation);
        let angles = [scan, scan + width].map(|scan| corner(scan, x, y).angle);
        let (metres, radians) = self.wanted.separation;
        // Otherwise a box might reach around the other side.
        let is_narrow = angles[1] - angles[0] < radians;
        is_narrow
            && self.places.iter().any(|(_, place)| {
                angles.iter().all(|angle| normalize_angle(angle - place.angle).abs() < radians)
                    && corners.iter().all(|corner| (corner - place.translation).norm() < metres)
            })
    }

    fn take(&mut self, score: f32, placement: Placement) -> Option<f32> {
        self.places.push((score, self.window.pose(&self.centre, &placement)));
        let best = self.places.first().map_or(score, |(best, _)| *best);
        (self.places.len() < self.wanted.most).then_some(self.wanted.share_of_best * best)
    }
}

#[cfg(test)]
mod tests;
