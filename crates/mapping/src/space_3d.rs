//! Implements [`Space`] in 3D for the pose graph and the mapper.

use portolan_config::{ConstraintBuilderOptions, OptimizationProblemOptions, Options};
use portolan_geometry::{Dimension, Point3f, Quaternion, Rigid3, Vector2, is_valid_pose};
use portolan_grids::{SOLID_VOXEL, ScanAgreement};
use portolan_local_slam::{LocalSlam3d, LocalSlam3dSettings, Space3d};
use portolan_matching::{
    FastCorrelativeMatcher3d, GradientMatcher3d, NodeToFind, SubmapToSearch, judge_placement_3d,
};
use portolan_optimization::{OptimizationData, OptimizationSummary, optimize_3d};
use portolan_sensor::SensorId;
use portolan_submaps::{Submap3d, clouds_in_grids, fast_matcher_options_3d, gradient_matcher_3d};

use crate::made_planes::{as_on_made_planes, as_on_planes_of_sweeps, planes_of_loaded};
use crate::mapper::MapperWork;
use crate::place_finder_3d::PlaceFinder3d;
use crate::plane_search::{drift_over, explained_at, find_nearby, refined_by_planes};
use crate::{
    Constraint, MapperError, MatchAcceptance, MatchedPose, Nearby, NodeData, PlaceFinder, SearchRegion,
    Space, SubmapInMap,
};

/// Matcher of nodes in one finished submap.
pub struct SubmapMatcher3d {
    search: FastCorrelativeMatcher3d,
    refinement: GradientMatcher3d,
}

static MAPPER_WORK: MapperWork<Space3d> = MapperWork::compiled();

impl Space for Space3d {
    type Matcher = SubmapMatcher3d;
    type LocalSlam = LocalSlam3d;

    const DIMENSION: Dimension = Dimension::ThreeD;
    /// For a car, which makes a node each metre or two, this gives as many scans as for a walker.
    const STRETCH_METRES: f64 = 12.0;
    /// Building one takes 70 ms, keeping one 10 MB (submap of a hall of 30 m by 20 m).
    const MATCHER_CACHE_BYTES: usize = 160 << 20;

    fn mapper_work() -> &'static MapperWork<Self> {
        &MAPPER_WORK
    }

    fn new_local_slam(options: &Options, range_sensors: &[SensorId]) -> Result<LocalSlam3d, MapperError> {
        let settings = LocalSlam3dSettings {
            use_all_odometry: options.portolan.use_all_odometry,
            min_scan_duration: options.portolan.min_scan_duration,
            plane_voxel_size: plane_voxel_size(options),
        };
        Ok(LocalSlam3d::new(&options.trajectory_builder.trajectory_builder_3d, range_sensors, settings)?)
    }

    fn local_from_submap(submap: &Submap3d) -> Rigid3 {
        submap.local_from_submap
    }

    fn graph_pose(pose: &Rigid3, _gravity_alignment: &Quaternion) -> Rigid3 {
        *pose
    }

    fn tracking_pose(graph_pose: &Rigid3, _gravity_alignment: &Quaternion) -> Rigid3 {
        *graph_pose
    }

    fn build_matcher(submap: &Submap3d, options: &ConstraintBuilderOptions) -> Option<SubmapMatcher3d> {
        let settings = fast_matcher_options_3d(&options.fast_correlative_scan_matcher_3d);
        Some(SubmapMatcher3d {
            search: FastCorrelativeMatcher3d::new(&submap.high_resolution_grid, &settings).ok()?,
            refinement: gradient_matcher_3d(&options.ceres_scan_matcher_3d, false).ok()?,
        })
    }

    fn matcher_bytes(matcher: &SubmapMatcher3d) -> usize {
        matcher.search.memory_bytes()
    }

    fn complete_loaded(submap: &mut Submap3d, nodes: &mut dyn Iterator<Item = &NodeData>, options: &Options) {
        if submap.planes.is_none()
            && let Some(size) = plane_voxel_size(options)
        {
            submap.made_planes = Some(planes_of_loaded(submap, nodes, size as f32));
        }
    }

    fn find_nearby(
        submap: &Submap3d,
        node: &NodeData,
        guess_submap_from_node: &Rigid3,
        region: &SearchRegion,
        options: &ConstraintBuilderOptions,
    ) -> Nearby {
        let Some(planes) = submap.planes_to_match() else { return Nearby::Unknown };
        let wanted = to_find(node);
        let error = match region {
            SearchRegion::Window { travelled, .. } => drift_over(*travelled),
            SearchRegion::WholeSubmap { around_guess: Some(around), .. } => *around,
            SearchRegion::WholeSubmap { .. } => return Nearby::Unknown,
        };
        let found =
            find_nearby(planes, &wanted, guess_submap_from_node, error, least_explained(submap, region));
        match found {
            Nearby::Found(found)
                if matches!(region, SearchRegion::WholeSubmap { .. })
                    && !meets_solid_cells(submap, &wanted, &found.submap_from_node, options) =>
            {
                Nearby::Absent
            }
            found => found,
        }
    }

    fn place_finder(submaps: &[SubmapInMap<'_, Submap3d>]) -> Option<Box<dyn PlaceFinder>> {
        Some(Box::new(PlaceFinder3d::new(submaps)?))
    }

    /// Planes explain points even where other sweeps did not measure the same cells; those of a car seldom
    /// do.
    fn wanted_acceptance(_: MatchAcceptance, options: &ConstraintBuilderOptions) -> MatchAcceptance {
        MatchAcceptance { min_explained: options.min_score as f32, ..MatchAcceptance::default() }
    }

    fn own_agreement(submap: &Submap3d, node: &NodeData, submap_from_node: &Rigid3) -> Option<ScanAgreement> {
        let explained = explained_at(submap.planes_to_match()?, &to_find(node), submap_from_node);
        let explained = as_on_planes_of_sweeps(submap, explained);
        Some(ScanAgreement { explained, in_free_space: 0.0, through_solid: 0.0 })
    }

    fn find_node(
        matcher: &SubmapMatcher3d,
        submap: &Submap3d,
        node: &NodeData,
        guess_submap_from_node: &Rigid3,
        region: SearchRegion,
        options: &ConstraintBuilderOptions,
    ) -> Option<MatchedPose> {
        let wanted = to_find(node);
        let clouds = [wanted.high_resolution_cloud, wanted.low_resolution_cloud];
        let target = SubmapToSearch {
            low_resolution_grid: &submap.low_resolution_grid,
            rotational_histogram: &submap.rotational_histogram,
        };
        // Yaw is searched about the z axis of the local map, which points up as that of the global one.
        let local_from_submap = submap.local_from_submap;
        let found = match region {
            SearchRegion::Window { .. } => {
                let local_from_node = local_from_submap * guess_submap_from_node;
                let min_score = options.min_score as f32;
                matcher.search.match_local(&local_from_node, &local_from_submap, &wanted, &target, min_score)
            }
            SearchRegion::WholeSubmap { .. } => {
                // Of a node far away only gravity is known.
                let (node_rotation, submap_rotation) = (node.gravity_alignment, level(submap));
                let min_score = options.global_localization_min_score as f32;
                matcher.search.match_full(&node_rotation, &submap_rotation, &wanted, &target, min_score)
            }
        }?;
        let initial = found.found.pose;
        if let Some(planes) = submap.planes_to_match() {
            return refined_by_planes(planes, &wanted, &initial, least_explained(submap, &region));
        }
        let grids = clouds_in_grids(clouds, submap);
        let refined = matcher.refinement.match_scan(initial.translation.vector, &initial, &grids).pose;
        let submap_from_node = if is_valid_pose(&refined) { refined } else { initial };
        Some(MatchedPose { submap_from_node, open: None, score: found.found.score })
    }

    fn optimize(
        data: &mut OptimizationData,
        constraints: &[Constraint],
        options: &OptimizationProblemOptions,
    ) -> OptimizationSummary {
        optimize_3d(data, constraints, options)
    }

    fn known_cell_centers(_submap: &Submap3d) -> Option<Vec<Vector2>> {
        None
    }

    fn solid_cell_centers(submap: &Submap3d) -> Option<Vec<Point3f>> {
        Some(solid_cells(submap))
    }

    fn cell_size(submap: &Submap3d) -> f64 {
        f64::from(submap.high_resolution_grid.resolution())
    }
}

/// Centres of the solid fine cells of a submap, in its own frame, metres.
pub(crate) fn solid_cells(submap: &Submap3d) -> Vec<Point3f> {
    let grid = &submap.high_resolution_grid;
    let mut centers = Vec::new();
    grid.for_each_cell(|cell, _| {
        if grid.probability(cell) > SOLID_VOXEL {
            centers.push(grid.cell_center(cell));
        }
    });
    centers
}

/// Whether the scan of a node that may be anywhere also hits occupied cells of a submap at the pose that its
/// planes give. Points also fit planes of other buildings, but then the distant ones do not hit the coarse
/// occupied cells.
fn meets_solid_cells(
    submap: &Submap3d,
    node: &NodeToFind<'_>,
    submap_from_node: &Rigid3,
    options: &ConstraintBuilderOptions,
) -> bool {
    let target = SubmapToSearch {
        low_resolution_grid: &submap.low_resolution_grid,
        rotational_histogram: &submap.rotational_histogram,
    };
    let judged = judge_placement_3d(submap_from_node, node, &target, &submap.high_resolution_grid);
    f64::from(judged.found.score) >= options.global_localization_min_score
        && f64::from(judged.low_resolution_score)
            >= options.fast_correlative_scan_matcher_3d.min_low_resolution_score
}

/// Minimum fraction of points on the planes of a submap.
fn least_explained(submap: &Submap3d, region: &SearchRegion) -> f32 {
    as_on_made_planes(submap, region.acceptance().min_explained)
}

pub(crate) fn to_find(node: &NodeData) -> NodeToFind<'_> {
    NodeToFind {
        high_resolution_cloud: &node.high_resolution_point_cloud,
        low_resolution_cloud: &node.low_resolution_point_cloud,
        rotational_histogram: &node.rotational_scan_matcher_histogram,
        gravity_alignment: node.gravity_alignment,
    }
}

/// The size of voxels if sweeps are registered to planes.
fn plane_voxel_size(options: &Options) -> Option<f64> {
    options.portolan.match_surfaces.then_some(options.portolan.surface_voxel_size)
}

/// The rotation from a submap to a frame that is level: that of its pose in the local map.
fn level(submap: &Submap3d) -> Quaternion {
    submap.local_from_submap.rotation
}
