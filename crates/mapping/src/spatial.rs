//! Space itself as a space to map in.

use portolan_config::{ConstraintBuilderOptions, OptimizationProblemOptions, Options};
use portolan_geometry::{Point3f, Quaternion, Rigid3, Vector2, is_valid_pose};
use portolan_matching::{
    FastCorrelativeMatcher3d, GradientMatcher3d, NodeToFind, PosePrior, SubmapToSearch, SurfaceMap,
    SurfaceMatcher, SurfaceMatcherOptions,
};
use portolan_sensor::{PointCloud, SensorId};

use crate::local_slam::three_d::LocalSlam3d;
use crate::local_slam::two_d::LocalSlamExtras;
use crate::optimization::{OptimizationData, OptimizationSummary, optimize_3d};
use crate::scan_matching_3d::{clouds_in_grids, fast_matcher_options_3d, gradient_matcher_3d};
use crate::submap_3d::Submap3d;
use crate::{Constraint, MapperError, MatchedPose, NodeData, SearchRegion, Space};

/// 3D mapping: poses in space, hybrid grids.
#[derive(Clone, Copy, Debug)]
pub struct Spatial;

/// What finds nodes in one finished submap.
pub struct SpatialMatcher {
    search: FastCorrelativeMatcher3d,
    refinement: GradientMatcher3d,
}

impl Space for Spatial {
    type Submap = Submap3d;
    type Matcher = SpatialMatcher;
    type LocalSlam = LocalSlam3d;

    const OPTIMIZES_WITH_IMU: bool = true;
    /// Building one takes 70 ms, keeping one 10 MB (submap of a hall of 30 m by 20 m).
    const MATCHER_CACHE_BYTES: usize = 160 << 20;

    fn new_local_slam(options: &Options, range_sensors: &[SensorId]) -> Result<LocalSlam3d, MapperError> {
        let extras = LocalSlamExtras {
            search_penalty_limit: options.portolan.search_penalty_limit,
            use_all_odometry: options.portolan.use_all_odometry,
            wide_search_after_gap: options.portolan.wide_search_after_gap,
            min_scan_duration: options.portolan.min_scan_duration,
            surface_voxel_size: surface_voxel_size(options),
        };
        LocalSlam3d::new(&options.trajectory_builder.trajectory_builder_3d, range_sensors, extras)
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

    fn build_matcher(submap: &Submap3d, options: &ConstraintBuilderOptions) -> Option<SpatialMatcher> {
        let settings = fast_matcher_options_3d(&options.fast_correlative_scan_matcher_3d);
        Some(SpatialMatcher {
            search: FastCorrelativeMatcher3d::new(&submap.high_resolution_grid, &settings).ok()?,
            refinement: gradient_matcher_3d(&options.ceres_scan_matcher_3d, false).ok()?,
        })
    }

    fn matcher_bytes(matcher: &SpatialMatcher) -> usize {
        matcher.search.memory_bytes()
    }

    fn find_node(
        matcher: &SpatialMatcher,
        submap: &Submap3d,
        node: &NodeData,
        guess_submap_from_node: &Rigid3,
        region: SearchRegion,
        options: &ConstraintBuilderOptions,
    ) -> Option<MatchedPose> {
        let clouds = [&node.high_resolution_point_cloud, &node.low_resolution_point_cloud];
        let wanted = NodeToFind {
            high_resolution_cloud: clouds[0],
            low_resolution_cloud: clouds[1],
            rotational_histogram: &node.rotational_scan_matcher_histogram,
            gravity_alignment: node.gravity_alignment,
        };
        let target = SubmapToSearch {
            low_resolution_grid: &submap.low_resolution_grid,
            rotational_histogram: &submap.rotational_histogram,
        };
        // Yaw is searched about the z axis of the local map, which points up as that of the global one.
        let local_from_submap = submap.local_from_submap;
        let found = match region {
            SearchRegion::Window => {
                let local_from_node = local_from_submap * guess_submap_from_node;
                let min_score = options.min_score as f32;
                matcher.search.match_local(&local_from_node, &local_from_submap, &wanted, &target, min_score)
            }
            SearchRegion::WholeSubmap => {
                // Of a node far away only gravity is known.
                let (node_rotation, submap_rotation) = (node.gravity_alignment, level(submap));
                let min_score = options.global_localization_min_score as f32;
                matcher.search.match_full(&node_rotation, &submap_rotation, &wanted, &target, min_score)
            }
        }?;
        let initial = found.found.pose;
        if let Some(surfaces) = &submap.surfaces {
            let submap_from_node = refined_by_surfaces(surfaces, clouds, &initial)?;
            return Some(MatchedPose { submap_from_node, score: found.found.score });
        }
        let grids = clouds_in_grids(clouds, submap);
        let refined = matcher.refinement.match_scan(initial.translation.vector, &initial, &grids).pose;
        let submap_from_node = if is_valid_pose(&refined) { refined } else { initial };
        Some(MatchedPose { submap_from_node, score: found.found.score })
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

    fn cell_size(submap: &Submap3d) -> f64 {
        f64::from(submap.high_resolution_grid.resolution())
    }
}

/// A found pose may be off by this: metres and radians.
const SEARCH_SIGMA: (f64, f64) = (0.2, 0.05);
/// Points may be off by this at the beginning of the refinement, metres.
const REFINEMENT_SCALE: f64 = 0.4;
/// A loop closure needs so large a share of its points on surfaces.
const MIN_MATCHED_SHARE: f64 = 0.5;

/// The pose near `initial` that puts a node on the surfaces of a submap. None if it does not fit them, or if
/// they leave a direction open: what the search found along a bare corridor is no measurement.
fn refined_by_surfaces(surfaces: &SurfaceMap, clouds: [&PointCloud; 2], initial: &Rigid3) -> Option<Rigid3> {
    let points: Vec<Point3f> = clouds.iter().flat_map(|cloud| cloud.points.iter().copied()).collect();
    let (translation_sigma, rotation_sigma) = SEARCH_SIGMA;
    let prior = PosePrior { pose: *initial, translation_sigma, rotation_sigma };
    let final_scale = 0.1 * f64::from(surfaces.edge());
    let matcher =
        SurfaceMatcher::new(SurfaceMatcherOptions { final_scale, ..SurfaceMatcherOptions::default() });
    let found = matcher.match_scan(surfaces, &points, initial, &prior, REFINEMENT_SCALE)?;
    let fits = found.matched_share >= MIN_MATCHED_SHARE && found.weak.is_empty();
    (fits && is_valid_pose(&found.pose)).then_some(found.pose)
}

/// The size of voxels if scans are matched to surfaces.
fn surface_voxel_size(options: &Options) -> Option<f64> {
    options.portolan.match_surfaces.then_some(options.portolan.surface_voxel_size)
}

/// The rotation from a submap to a frame that is level: that of its pose in the local map.
fn level(submap: &Submap3d) -> Quaternion {
    submap.local_from_submap.rotation
}
