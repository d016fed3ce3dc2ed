//! Matches scans anywhere in a finished submap in 3D.

use portolan_geometry::{Point3f, Quaternion, Rigid3, Rigid3f, to_f32, to_f64, yaw};
use portolan_grids::value::{MAX_PROBABILITY, MIN_PROBABILITY};
use portolan_grids::{HybridGrid, MAX_VOXEL_INDEX, VoxelLattice, is_finite};
use portolan_sensor::PointCloud;

use super::MatchResult;
use super::best_first::{Best, best_first};
use super::byte_score::ByteScore;
use super::rotational::{histogram_similarity, rotate_histogram};
use super::search_window::angular_steps_3d;
use crate::MatcherOptionError;
use points::{farthest, thinned};
use pyramid::MaxPyramid3d;
use scans::{MAX_SHIFT, Scans};
use search::{Placement3d, Search3d};

mod points;
mod pyramid;
mod scans;
mod search;
mod tiles;

/// Search window of a fast correlative matcher in 3D around a guess, and its acceptance criteria.
#[derive(Clone, Debug, PartialEq)]
pub struct FastCorrelativeOptions3d {
    /// The search starts with boxes of 2^(this − 1) cells, default 8.
    pub branch_and_bound_depth: u32,
    /// Number of window sizes that are kept for every cell, coarser ones for fewer cells; default 3. Raise it
    /// for tighter bounds at the price of memory.
    pub full_resolution_depth: u32,
    /// Minimum similarity of the histograms of directions; yaws below it are not searched; default 0.77.
    pub min_rotational_score: f64,
    /// Minimum mean probability of the coarse cloud in the coarse grid, default 0.55.
    pub min_low_resolution_score: f64,
    /// Metres to either side along x and y of the submap, default 5.
    pub linear_xy_search_window: f64,
    /// Metres to either side along z of the submap, default 1.
    pub linear_z_search_window: f64,
    /// Radians of yaw to either side, default 15°.
    pub angular_search_window: f64,
}

impl Default for FastCorrelativeOptions3d {
    fn default() -> Self {
        Self {
            branch_and_bound_depth: 8,
            full_resolution_depth: 3,
            min_rotational_score: 0.77,
            min_low_resolution_score: 0.55,
            linear_xy_search_window: 5.0,
            linear_z_search_window: 1.0,
            angular_search_window: 15f64.to_radians(),
        }
    }
}

/// Largest depth: windows of 2^23 cells.
const MAX_DEPTH: u32 = 24;
/// The search never starts with boxes larger than 2^6 cells; the widest windows kept are twice as wide.
const MAX_EXPONENT: u32 = 6;
/// Maximum number of buckets of histograms that are compared.
const MAX_BUCKETS: usize = 1 << 14;

/// A node to be found in a submap.
#[derive(Clone, Copy, Debug)]
pub struct NodeToFind<'a> {
    /// Points for the fine grid, metres, in the tracking frame.
    pub high_resolution_cloud: &'a PointCloud,
    /// Points for the coarse grid, metres, in the tracking frame.
    pub low_resolution_cloud: &'a PointCloud,
    /// Directions of walls in the gravity-aligned frame of the node.
    pub rotational_histogram: &'a [f32],
    /// Rotation from tracking to gravity-aligned.
    pub gravity_alignment: Quaternion,
}

/// Parts of a submap that are used besides the fine grid.
#[derive(Clone, Copy, Debug)]
pub struct SubmapToSearch<'a> {
    /// The coarse grid.
    pub low_resolution_grid: &'a HybridGrid,
    /// Directions of walls in the frame of the submap.
    pub rotational_histogram: &'a [f32],
}

/// Search window around a guess.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchReach3d {
    /// Metres to either side along x and y of the submap.
    pub linear_xy: f64,
    /// Metres to either side along z of the submap.
    pub linear_z: f64,
    /// Radians of yaw to either side.
    pub angular: f64,
}

/// A node found in a submap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FastMatch3d {
    /// Pose of the node (tracking frame) in the submap, and the mean probability of the fine cells met, to
    /// 8 bits.
    pub found: MatchResult<Rigid3>,
    /// Similarity of the directions of walls, 0 to 1.
    pub rotational_score: f32,
    /// Mean probability of the coarse cells met.
    pub low_resolution_score: f32,
}

/// Finds the best placement of a node in a submap by branch and bound over yaw and translation, near a guess
/// or anywhere (`slam3d.md` §6). Roll and pitch are taken from the node: gravity determines them.
///
/// It does not refer to the grid it was made from. Only cells within ±7900 of the origin are searched, and
/// only points within 8192 cells of the node count.
#[derive(Clone, Debug)]
pub struct FastCorrelativeMatcher3d {
    options: FastCorrelativeOptions3d,
    lattice: VoxelLattice,
    extent: u32,
    score: ByteScore,
    pyramid: MaxPyramid3d,
}

/// One yaw that is searched.
struct Turn {
    pose: Rigid3f,
    rotational_score: f32,
}

impl FastCorrelativeMatcher3d {
    /// Prepares the fine grid of a submap for searching.
    ///
    /// # Errors
    /// If a window is negative or a depth out of bounds, or the grid has more voxels than a scanner can see.
    pub fn new(
        high_resolution_grid: &HybridGrid,
        options: &FastCorrelativeOptions3d,
    ) -> Result<Self, MatcherOptionError> {
        MatcherOptionError::check_not_negative(&[
            ("linear_xy_search_window", options.linear_xy_search_window),
            ("linear_z_search_window", options.linear_z_search_window),
            ("angular_search_window", options.angular_search_window),
        ])?;
        for (name, value) in [
            ("branch_and_bound_depth", options.branch_and_bound_depth),
            ("full_resolution_depth", options.full_resolution_depth),
        ] {
            if !(1..=MAX_DEPTH).contains(&value) {
                return Err(MatcherOptionError::Depth { name, value, max: MAX_DEPTH });
            }
        }
        let score = ByteScore::new(MIN_PROBABILITY, MAX_PROBABILITY);
        let depth = options.full_resolution_depth;
        let max_exponent = max_exponent(options);
        let pyramid = MaxPyramid3d::new(high_resolution_grid, &score, max_exponent + 1, depth)
            .ok_or(MatcherOptionError::TooManyVoxels)?;
        Ok(Self {
            options: options.clone(),
            lattice: high_resolution_grid.lattice(),
            extent: high_resolution_grid.extent(),
            score,
            pyramid,
        })
    }

    /// Memory that it takes, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.pyramid.memory_bytes()
    }

    /// The placement of a node near its guess with the largest score above `min_score`. Both poses are in one
    /// frame with z pointing up, about which yaw is searched.
    pub fn match_local(
        &self,
        map_from_node: &Rigid3,
        map_from_submap: &Rigid3,
        node: &NodeToFind<'_>,
        submap: &SubmapToSearch<'_>,
        min_score: f32,
    ) -> Option<FastMatch3d> {
        let reach = SearchReach3d {
            linear_xy: self.options.linear_xy_search_window,
            linear_z: self.options.linear_z_search_window,
            angular: self.options.angular_search_window,
        };
        let window = self.window(&reach, map_from_node, map_from_submap, node);
        self.search(map_from_node, map_from_submap, node, submap, window, reach.angular, min_score)
    }

    /// Cells along z, y, x.
    fn window(
        &self,
        reach: &SearchReach3d,
        map_from_node: &Rigid3,
        map_from_submap: &Rigid3,
        node: &NodeToFind<'_>,
    ) -> [i32; 3] {
        let cells = |metres: f64| (metres / f64::from(self.lattice.resolution)).round() as i32;
        let xy = cells(reach.linear_xy);
        let offset = (map_from_submap.inverse() * map_from_node).translation.vector;
        let extent = self.reach(node);
        // Beyond no shift puts a point on the grid.
        let useful = |axis: usize| extent.saturating_add(cells(offset[axis].abs())).saturating_add(1);
        [cells(reach.linear_z).min(useful(2)), xy.min(useful(1)), xy.min(useful(0))]
    }

    /// As [`Self::match_local`], anywhere in the submap at any yaw; only the directions of gravity of the two
    /// rotations count.
    pub fn match_full(
        &self,
        map_from_node: &Quaternion,
        map_from_submap: &Quaternion,
        node: &NodeToFind<'_>,
        submap: &SubmapToSearch<'_>,
        min_score: f32,
    ) -> Option<FastMatch3d> {
        let reach = self.reach(node);
        let [node_rotation, submap_rotation] =
            [map_from_node, map_from_submap].map(|r| Rigid3::from_parts(Default::default(), *r));
        let window = [reach; 3];
        let angular = std::f64::consts::PI;
        self.search(&node_rotation, &submap_rotation, node, submap, window, angular, min_score)
    }

    /// Cells by which a node at the origin may be shifted and still meet the grid.
    fn reach(&self, node: &NodeToFind<'_>) -> i32 {
        let range = farthest(&self.usable(node.high_resolution_cloud)) / self.lattice.resolution;
        self.extent.div_ceil(2) as i32 + (range + 0.5).round().min(MAX_SHIFT as f32) as i32
    }

    #[allow(clippy::too_many_arguments)] // several entry points, one search
    fn search(
        &self,
        map_from_node: &Rigid3,
        map_from_submap: &Rigid3,
        node: &NodeToFind<'_>,
        submap: &SubmapToSearch<'_>,
        window: [i32; 3],
        angular: f64,
        min_score: f32,
    ) -> Option<FastMatch3d> {
        let points = self.usable(node.high_resolution_cloud);
        let coarse: Vec<Point3f> =
            node.low_resolution_cloud.points.iter().copied().filter(is_finite).collect();
        let turns = self.turns(map_from_node, map_from_submap, node, submap, angular);
        if points.is_empty() || turns.iter().all(Option::is_none) || min_score.is_nan() {
            return None;
        }
        let points = thinned(points, turns.iter().flatten().count());
        let poses = turns.iter().map(|turn| turn.as_ref().map(|t| t.pose));
        let scans = Scans::new(&points, poses, self.lattice, &self.pyramid, max_exponent(&self.options));
        let coarse_score = |p: Placement3d| {
            let pose = self.pose(&turns, p)?;
            Some(mean_probability(&coarse, &pose, submap.low_resolution_grid))
        };
        let mut search = Search3d {
            pyramid: &self.pyramid,
            scans: &scans,
            score: self.score,
            window: window.map(|n| n.min(MAX_SHIFT)),
            num_coarse: coarse.len(),
            fits: |p| coarse_score(p).is_some_and(|s| f64::from(s) >= self.options.min_low_resolution_score),
        };
        let best = Best::single_above(min_score);
        let (score, placements) = best_first(&mut search, best);
        let placement = *placements.first()?;
        Some(FastMatch3d {
            found: MatchResult { score, pose: to_f64(&self.pose(&turns, placement)?) },
            rotational_score: turns.get(placement.scan as usize)?.as_ref()?.rotational_score,
            low_resolution_score: coarse_score(placement)?,
        })
    }

    /// The yaws of a search window, with a pose for those at which walls have the right directions.
    fn turns(
        &self,
        map_from_node: &Rigid3,
        map_from_submap: &Rigid3,
        node: &NodeToFind<'_>,
        submap: &SubmapToSearch<'_>,
        angular: f64,
    ) -> Vec<Option<Turn>> {
        let submap_from_node = map_from_submap.inverse() * map_from_node;
        if !submap_from_node.translation.vector.iter().all(|v| v.is_finite()) {
            return Vec::new();
        }
        let submap_from_gravity_aligned = submap_from_node.rotation * node.gravity_alignment.inverse();
        let initial_yaw = yaw(&submap_from_gravity_aligned) as f32;
        let [from_map, from_node] =
            [map_from_submap.inverse(), *map_from_node].map(|pose| to_f32(&pose).rotation);
        let translation = to_f32(&submap_from_node).translation;
        let (step, count) = angular_steps_3d(
            farthest(&self.usable(node.high_resolution_cloud)),
            self.lattice.resolution,
            1e-2,
            angular,
        );
        let [in_node, in_submap] = [node.rotational_histogram, submap.rotational_histogram]
            .map(|histogram| if histogram.len() > MAX_BUCKETS { &[] } else { histogram });
        let turn = |k: i32| {
            let angle = k as f32 * step;
            let rotated = rotate_histogram(in_node, initial_yaw + angle);
            let rotational_score = histogram_similarity(in_submap, &rotated);
            let about_z = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), angle);
            let pose = Rigid3f::from_parts(translation, from_map * about_z * from_node);
            let is_alike = f64::from(rotational_score) >= self.options.min_rotational_score;
            is_alike.then_some(Turn { pose, rotational_score })
        };
        (-count..=count).map(turn).collect()
    }

    /// Points that can be in a grid at all: those no farther from the node than a grid reaches.
    fn usable(&self, cloud: &PointCloud) -> Vec<Point3f> {
        let reach = MAX_VOXEL_INDEX as f32 * self.lattice.resolution;
        cloud.points.iter().copied().filter(|p| p.coords.norm() <= reach).collect()
    }

    fn pose(&self, turns: &[Option<Turn>], placement: Placement3d) -> Option<Rigid3f> {
        let turn = turns.get(placement.scan as usize)?.as_ref()?;
        let [z, y, x] = placement.shift.map(|i| i as f32 * self.lattice.resolution);
        Some(nalgebra::Translation3::new(x, y, z) * turn.pose)
    }
}

/// The largest boxes of a search.
fn max_exponent(options: &FastCorrelativeOptions3d) -> u32 {
    (options.branch_and_bound_depth - 1).min(MAX_EXPONENT)
}

/// Scores of a node in a submap at a pose, the same as those of the search.
pub fn judge_placement_3d(
    submap_from_node: &Rigid3,
    node: &NodeToFind<'_>,
    submap: &SubmapToSearch<'_>,
    high_resolution_grid: &HybridGrid,
) -> FastMatch3d {
    let pose = to_f32(submap_from_node);
    let turn = yaw(&(submap_from_node.rotation * node.gravity_alignment.inverse())) as f32;
    let rotated = rotate_histogram(node.rotational_histogram, turn);
    let mean = |cloud: &PointCloud, grid: &HybridGrid| mean_probability(&cloud.points, &pose, grid);
    FastMatch3d {
        found: MatchResult {
            score: mean(node.high_resolution_cloud, high_resolution_grid),
            pose: *submap_from_node,
        },
        rotational_score: histogram_similarity(submap.rotational_histogram, &rotated),
        low_resolution_score: mean(node.low_resolution_cloud, submap.low_resolution_grid),
    }
}

/// The mean probability of the cells at the points; 0.1 without points.
pub(crate) fn mean_probability(points: &[Point3f], pose: &Rigid3f, grid: &HybridGrid) -> f32 {
    let probability = |p: &Point3f| {
        let cell = grid.cell_index(&(pose * p));
        cell.map_or(MIN_PROBABILITY, |cell| grid.probability(cell))
    };
    let sum: f32 = points.iter().map(probability).sum();
    if points.is_empty() { MIN_PROBABILITY } else { sum / points.len() as f32 }
}

#[cfg(test)]
mod tests;
