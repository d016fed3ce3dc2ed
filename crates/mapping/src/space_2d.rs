//! Implements [`Space`] in 2D for the pose graph and the mapper.

use portolan_config::{ConstraintBuilderOptions, OptimizationProblemOptions, Options};
use portolan_geometry::{
    Dimension, Quaternion, Rigid2, Rigid3, Vector2, Vector3, embed_3d, project_2d, to_f32,
};
use portolan_grids::{CellBox, Grid2d, ScanAgreement, match_spread, mean_of_solid_cells, scan_agreement};
use portolan_local_slam::{AT_WRONG_PLACES, LocalSlam2d, LocalSlamExtras, Space2d};
use portolan_matching::{FastCorrelativeMatcher2d, GradientMatcher2d};
use portolan_optimization::{OptimizationData, OptimizationSummary, optimize_2d};
use portolan_sensor::{PointCloud, SensorId};
use portolan_submaps::{SearchWindow, Submap2d, fast_matcher_options, gradient_matcher};

use crate::mapper::MapperWork;
use crate::place_finder_2d::PlaceFinder2d;
use crate::{
    Constraint, MapperError, MatchAcceptance, MatchedPose, NodeData, OpenShift, PlaceFinder, SearchRegion,
    Space, SubmapInMap,
};

/// Matcher of nodes in one finished submap.
pub struct SubmapMatcher2d {
    search: FastCorrelativeMatcher2d,
    /// Mean probability of its occupied cells: the score of a scan that fits, independent of how often the
    /// cells were seen.
    solidity: f32,
    refinement: GradientMatcher2d,
}

/// Maximum spread of a match along a direction that it still constrains, metres: of matches that spread less,
/// one in a hundred is wrong, of those that spread more, two in five
/// (docs/experiments/2026-11-corridor-loops.md).
const MOST_SPREAD: f64 = 0.25;

/// Distance along a corridor within which a scan is compared with the submap that it was inserted into,
/// metres: past several doors.
const OWN_REACH: f64 = 6.0;

/// Score of all unexplained beams together, as a fraction of the probability of occupied cells: they end in
/// cells that are not quite free.
const SCORE_OF_OTHERS: f32 = 0.03;

impl SubmapMatcher2d {
    /// Minimum score: a scan below it explains less than wanted, or than scans at wrong places do.
    fn least_score(&self, acceptance: MatchAcceptance) -> f32 {
        (acceptance.min_explained.max(AT_WRONG_PLACES.explained) + SCORE_OF_OTHERS) * self.solidity
    }
}

/// The direction along which a match does not constrain the pose of a node within `reach` metres of `guess`.
fn open_shift(
    grid: &Grid2d,
    grid_from_node: &Rigid2,
    points: &PointCloud,
    (guess, reach): (&Vector2, f64),
) -> Option<OpenShift> {
    let spread = match_spread(grid, grid_from_node, points, (guess, reach))?;
    let is_open = spread.sigma > MOST_SPREAD;
    is_open.then(|| OpenShift { direction: Vector3::new(spread.direction.x, spread.direction.y, 0.0) })
}

static MAPPER_WORK: MapperWork<Space2d> = MapperWork::compiled();

impl Space for Space2d {
    type Matcher = SubmapMatcher2d;
    type LocalSlam = LocalSlam2d;

    const DIMENSION: Dimension = Dimension::TwoD;
    const STRETCH_METRES: f64 = 4.0;

    fn mapper_work() -> &'static MapperWork<Self> {
        &MAPPER_WORK
    }

    fn new_local_slam(options: &Options, range_sensors: &[SensorId]) -> Result<LocalSlam2d, MapperError> {
        let extras = LocalSlamExtras {
            use_all_odometry: options.portolan.use_all_odometry,
            search_penalty_limit: options.portolan.search_penalty_limit,
            wide_search_after_gap: options.portolan.wide_search_after_gap,
            adaptive_search: options.portolan.adaptive_search,
            submap_length: options.portolan.submap_length,
            keep_scans: options.portolan.redraw_submaps,
            join_surfaces: options.portolan.join_surfaces,
        };
        Ok(LocalSlam2d::new(&options.trajectory_builder.trajectory_builder_2d, range_sensors, extras)?)
    }

    fn local_from_submap(submap: &Submap2d) -> Rigid3 {
        submap.local_from_submap
    }

    fn graph_pose(pose: &Rigid3, gravity_alignment: &Quaternion) -> Rigid3 {
        embed_3d(&project_2d(&(pose * gravity_alignment.inverse())))
    }

    fn tracking_pose(graph_pose: &Rigid3, gravity_alignment: &Quaternion) -> Rigid3 {
        graph_pose * gravity_alignment
    }

    fn build_matcher(submap: &Submap2d, options: &ConstraintBuilderOptions) -> Option<SubmapMatcher2d> {
        let settings = fast_matcher_options(&options.fast_correlative_scan_matcher);
        Some(SubmapMatcher2d {
            solidity: mean_of_solid_cells(&submap.grid),
            search: FastCorrelativeMatcher2d::new(&submap.grid, &settings).ok()?,
            refinement: gradient_matcher(&options.ceres_scan_matcher).ok()?,
        })
    }

    fn matcher_bytes(matcher: &SubmapMatcher2d) -> usize {
        matcher.search.memory_bytes()
    }

    fn redrawn(submap: &Submap2d, nodes: &mut dyn Iterator<Item = (&NodeData, Rigid3)>) -> Option<Submap2d> {
        Self::drawn_from(submap, nodes).filter(|redrawn| redrawn.num_range_data == submap.num_range_data)
    }

    fn drawn_from(
        submap: &Submap2d,
        nodes: &mut dyn Iterator<Item = (&NodeData, Rigid3)>,
    ) -> Option<Submap2d> {
        let scan = |(node, submap_from_node): (&NodeData, Rigid3)| {
            let local_from_node = submap.local_from_submap * submap_from_node;
            let scan = node.scan.as_ref()?;
            Some((scan.range_data(&to_f32(&local_from_node)), scan.beam_spacing()))
        };
        submap.drawn_from(nodes.map(scan).collect::<Option<Vec<_>>>()?)
    }

    fn agreement(submap: &Submap2d, node: &NodeData, submap_from_node: &Rigid3) -> Option<ScanAgreement> {
        let local_from_node = project_2d(&(submap.local_from_submap * submap_from_node));
        let cell = submap.grid.limits().cell_index(local_from_node.translation.cast::<f32>());
        if !submap.grid.is_known(cell) {
            return None;
        }
        scan_agreement(&submap.grid, &local_from_node, &node.filtered_gravity_aligned_point_cloud)
    }

    fn leaves_open(submap: &Submap2d, node: &NodeData, submap_from_node: &Rigid3) -> bool {
        let pose = project_2d(&(submap.local_from_submap * submap_from_node));
        let cloud = &node.filtered_gravity_aligned_point_cloud;
        open_shift(&submap.grid, &pose, cloud, (&pose.translation, OWN_REACH)).is_some()
    }

    fn find_node(
        matcher: &SubmapMatcher2d,
        submap: &Submap2d,
        node: &NodeData,
        guess_submap_from_node: &Rigid3,
        region: SearchRegion,
        options: &ConstraintBuilderOptions,
    ) -> Option<MatchedPose> {
        let local_from_submap = project_2d(&submap.local_from_submap);
        let cloud = &node.filtered_gravity_aligned_point_cloud;
        let found = match region {
            SearchRegion::Window { window, acceptance, .. } => {
                let guess = local_from_submap * project_2d(guess_submap_from_node);
                let min_score = options.min_score as f32;
                match window {
                    Some(SearchWindow { linear, angular }) => {
                        let min_score = min_score.min(matcher.least_score(acceptance));
                        matcher.search.match_within(&guess, cloud, min_score, linear, angular)
                    }
                    None => matcher.search.match_local(&guess, cloud, min_score),
                }
            }
            SearchRegion::WholeSubmap { acceptance, around_guess } => {
                let mut min_score = options.global_localization_min_score as f32;
                if acceptance != MatchAcceptance::default() {
                    min_score = min_score.min(matcher.least_score(acceptance));
                }
                match around_guess {
                    Some(SearchWindow { linear, angular }) => {
                        let guess = local_from_submap * project_2d(guess_submap_from_node);
                        matcher.search.match_within(&guess, cloud, min_score, linear, angular)
                    }
                    None => matcher.search.match_full(cloud, min_score),
                }
            }
        }?;
        let refined =
            matcher.refinement.match_scan(found.pose.translation, &found.pose, cloud, &submap.grid).pose;
        let pose = if refined.is_finite() { refined } else { found.pose };
        if let SearchRegion::Window { acceptance, .. } | SearchRegion::WholeSubmap { acceptance, .. } = region
            && !acceptance.accepts(scan_agreement(&submap.grid, &pose, cloud))
        {
            return None;
        }
        let submap_from_node = embed_3d(&(local_from_submap.inverse() * pose));
        // With the search windows of the options, matches count as full constraints, as in Cartographer.
        let open = if let SearchRegion::Window { window: Some(window), .. } = region {
            let guess = local_from_submap * project_2d(guess_submap_from_node);
            open_shift(&submap.grid, &pose, cloud, (&guess.translation, window.linear))
        } else {
            None
        };
        Some(MatchedPose { submap_from_node, open, score: found.score })
    }

    fn place_finder(submaps: &[SubmapInMap<'_, Submap2d>]) -> Option<Box<dyn PlaceFinder>> {
        PlaceFinder2d::new(submaps).map(|places| Box::new(places) as Box<dyn PlaceFinder>)
    }

    fn optimize(
        data: &mut OptimizationData,
        constraints: &[Constraint],
        options: &OptimizationProblemOptions,
    ) -> OptimizationSummary {
        optimize_2d(data, constraints, options)
    }

    fn known_cell_centers(submap: &Submap2d) -> Option<Vec<Vector2>> {
        let submap_from_local = project_2d(&submap.local_from_submap).inverse();
        let cells = submap.grid.known_cells_box().map(CellBox::cells).into_iter().flatten();
        Some(
            cells
                .filter(|cell| submap.grid.is_known(*cell))
                .map(|cell| submap_from_local.transform_point(&submap.grid.limits().cell_center(cell)))
                .collect(),
        )
    }

    fn cell_size(submap: &Submap2d) -> f64 {
        submap.grid.limits().resolution()
    }
}
