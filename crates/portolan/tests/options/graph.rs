//! The pose graph: searching for constraints, trimming, several trajectories, ordering of sensors.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use portolan::RequestedOptions;
use portolan::config::Options;
use portolan::geometry::{Rigid3, Vector3, rotation_angle};
use portolan::mapping::{
    Constraint, ConstraintTag, InitialTrajectoryPose, Map, Mapper, MapperSettings, MatchedPose, NodeData,
    NodeId, PoseGraph, PoseGraphPolicy, SearchCounts, SearchRegion, Space, Space2d, SubmapId, TrajectoryId,
};
use portolan::sensor::{Measurement, PointCloud, SensorKind};
use portolan::submaps::Submap2d;

use crate::effect::{Effect, check, effects};
use crate::run::{Run, mapper, run, sensor, trajectory};
use crate::world::{at, distance, odometry, on_circle, pose, scan_2d};

pub fn base() -> Options {
    let mut options = Options::for_2d();
    let local = &mut options.trajectory_builder.trajectory_builder_2d;
    local.use_imu_data = false;
    local.submaps.num_range_data = 4;
    local.submaps.grid_options_2d.resolution = 0.1;
    let search = &mut options.map_builder.pose_graph.constraint_builder;
    search.fast_correlative_scan_matcher.linear_search_window = 1.0;
    search.sampling_ratio = 0.5;
    options.map_builder.pose_graph.optimize_every_n_nodes = 0;
    options
}

/// What a robot measures that drives round a circle for so many steps of 0.6 s. Odometry drifts.
pub fn laps(steps: u32) -> Vec<Measurement> {
    let mut measurements = Vec::new();
    for step in 0..steps {
        let seconds = 0.6 * f64::from(step);
        let truth = on_circle(seconds);
        let drift = Rigid3::translation(0.002 * seconds, 0.0, 0.0);
        measurements.push(Measurement::Odometry(odometry(drift * truth, seconds)));
        measurements.push(Measurement::Range(scan_2d(&truth, seconds)));
    }
    measurements
}

fn lap(options: &Options) -> Run<Space2d> {
    run(options, laps(30))
}

fn searches(options: &Options) -> SearchCounts {
    lap(options).map.graph.search_counts()
}

/// The same lap twice, as two trajectories; the start of the second may be given.
fn two_laps(options: &Options, is_start_given: bool) -> Map<Space2d> {
    let mut mapper = mapper::<Space2d>(options);
    let sensors = [SensorKind::Range, SensorKind::Odometry].map(sensor).into_iter().collect();
    for lap in 0..2 {
        let start = (lap == 1 && is_start_given).then(|| InitialTrajectoryPose {
            to_trajectory_id: TrajectoryId(0),
            relative_pose: Rigid3::identity(),
            time: at(0.0),
        });
        let id = mapper.add_trajectory(&sensors, start).unwrap();
        for measurement in laps(14) {
            mapper.add(id, &sensor(measurement.kind()), measurement).unwrap();
        }
        mapper.finish_trajectory(id).unwrap();
    }
    mapper.finish().unwrap().0
}

fn searches_of_two(options: &Options) -> SearchCounts {
    two_laps(options, false).graph.search_counts()
}

/// Searches in whole submaps although it is known where the second lap started.
fn whole_searches_from_given_start(options: &Options) -> f64 {
    two_laps(options, true).graph.search_counts().whole_submap_searched as f64
}

/// Constraints that tie the two laps together.
fn ties(options: &Options) -> f64 {
    let map = two_laps(options, false);
    let constraints = &map.graph.state().constraints;
    let ties = constraints.iter().filter(|c| c.node_id.trajectory_id != c.submap_id.trajectory_id);
    ties.count() as f64
}

fn weights_of(run: &Run<Space2d>, tag: ConstraintTag) -> [f64; 2] {
    let constraints = &run.map.graph.state().constraints;
    let found = constraints.iter().find(|c| c.tag == tag).unwrap();
    [found.translation_weight, found.rotation_weight]
}

/// Submaps while the trajectory is still being mapped.
fn submaps_meanwhile(options: &Options) -> f64 {
    let mut mapper = mapper::<Space2d>(options);
    let id = trajectory(&mut mapper, &[SensorKind::Range, SensorKind::Odometry]);
    for measurement in laps(30) {
        mapper.add(id, &sensor(measurement.kind()), measurement).unwrap();
    }
    let count = |graph: &mut PoseGraph<Space2d>| {
        graph.optimize();
        graph.state().submaps.len()
    };
    mapper.with_pose_graph(count).unwrap() as f64
}

/// Scans that are mapped although a sensor of this kind, of this or of another trajectory, is silent.
fn mapped_meanwhile(options: &Options, silent: SensorKind, of_other: bool) -> f64 {
    let mut mapper = mapper::<Space2d>(options);
    let own = if of_other { vec![SensorKind::Range] } else { vec![SensorKind::Range, silent] };
    let id = trajectory(&mut mapper, &own);
    if of_other {
        trajectory(&mut mapper, &[silent]);
    }
    let mut mapped = 0;
    for measurement in laps(6) {
        if measurement.kind() == SensorKind::Range {
            mapped += mapper.add(id, &sensor(SensorKind::Range), measurement).unwrap().len();
        }
    }
    mapped as f64
}

/// A finished submap of two scans at rest and the cloud of one of them.
fn submap_and_node() -> &'static (Submap2d, NodeData) {
    static MADE: OnceLock<(Submap2d, NodeData)> = OnceLock::new();
    MADE.get_or_init(|| submap_with_misses(0.49))
}

fn submap_with_misses(miss_probability: f64) -> (Submap2d, NodeData) {
    let mut options = base();
    let local = &mut options.trajectory_builder.trajectory_builder_2d;
    let inserter = &mut local.submaps.range_data_inserter.probability_grid_range_data_inserter;
    (inserter.hit_probability, inserter.miss_probability) = (0.9, miss_probability);
    let rest = pose(0.0, 0.0, 0.0);
    let scans = vec![Measurement::Range(scan_2d(&rest, 0.0))];
    let run = run::<Space2d>(&options, scans);
    let state = run.map.graph.state();
    let submap = state.submaps.values().next().unwrap().submap.as_ref().unwrap();
    let node = state.nodes.values().next().unwrap();
    (Submap2d::clone(submap), NodeData::clone(&node.data))
}

/// Searches for a node, which is at the origin, at its predicted pose.
fn find(options: &Options, guess: [f64; 3], node: &NodeData) -> Option<MatchedPose> {
    let search = &options.map_builder.pose_graph.constraint_builder;
    let submap = &submap_and_node().0;
    let matcher = Space2d::build_matcher(submap, search).unwrap();
    let guess = pose(guess[0], guess[1], guess[2]);
    Space2d::find_node(
        &matcher,
        submap,
        node,
        &guess,
        SearchRegion::Window { travelled: f64::INFINITY, window: None, acceptance: Default::default() },
        search,
    )
}

/// Whether it is found (1) or not (0).
fn is_found(options: &Options, guess: [f64; 3]) -> f64 {
    f64::from(u8::from(find(options, guess, &submap_and_node().1).is_some()))
}

/// A guess that is no whole number of cells off.
const GUESS: [f64; 3] = [0.237, -0.161, 0.013];

/// Whether a node is found of which two points lie in the middle of the room.
fn contradicted_found(options: &Options) -> f64 {
    let mut options = options.clone();
    options.set("constraint_builder.min_score=0.2").unwrap();
    let (submap, mut node) = submap_with_misses(0.2);
    let inside: [portolan::geometry::Point3f; 2] = [[1.0, 0.3, 0.0].into(), [0.8, -0.4, 0.0].into()];
    node.filtered_gravity_aligned_point_cloud.points.extend(inside);
    let acceptance = PoseGraphPolicy::new(&options.portolan).loops.acceptance;
    let region = SearchRegion::Window { travelled: f64::INFINITY, window: None, acceptance };
    let search = &options.map_builder.pose_graph.constraint_builder;
    let matcher = Space2d::build_matcher(&submap, search).unwrap();
    let found = Space2d::find_node(&matcher, &submap, &node, &Rigid3::identity(), region, search);
    f64::from(u8::from(found.is_some()))
}

fn found(options: &Options) -> Rigid3 {
    let mut options = options.clone();
    options.set("constraint_builder.min_score=0.2").unwrap();
    find(&options, GUESS, &submap_and_node().1).unwrap().submap_from_node
}

fn error(options: &Options) -> f64 {
    distance(&found(options), &Rigid3::identity())
}

fn turn_error(options: &Options) -> f64 {
    rotation_angle(&found(options))
}

/// Where a scan of a single point near a pillar is found, which fits all along two of its sides.
fn place_of_point(options: &Options) -> f64 {
    let mut node = submap_and_node().1.clone();
    node.filtered_gravity_aligned_point_cloud = PointCloud::new(vec![[2.72, 1.25, 0.0].into()]);
    let place = find(options, [0.0; 3], &node).unwrap().submap_from_node.translation.vector;
    place.x + 17.0 * place.y
}

/// A graph with six loop closures of which one is 3 m off; how many are left.
fn loops_after_final_optimization(options: &Options) -> f64 {
    let id = TrajectoryId(0);
    let mut graph = PoseGraph::<Space2d>::new(options.map_builder.pose_graph.clone());
    graph.load_trajectory(id, None);
    let (submap, data) = submap_and_node();
    graph.load_submap(SubmapId::new(id, 0), Arc::new(submap.clone()), true, Rigid3::identity());
    for index in 0..8 {
        let node_id = NodeId::new(id, index);
        let place = Rigid3::translation(0.3 * f64::from(index), 0.0, 0.0);
        let mut data = data.clone();
        data.local_from_tracking = place;
        data.time = at(f64::from(index));
        graph.load_node(node_id, Arc::new(data), place);
        let wrong = if index == 5 { Vector3::new(3.0, 0.0, 0.0) } else { Vector3::zeros() };
        let constraint = |tag, score, offset: Vector3| Constraint {
            submap_id: SubmapId::new(id, 0),
            node_id,
            submap_from_node: Rigid3::from(offset) * place,
            translation_weight: 100.0,
            rotation_weight: 100.0,
            tag,
            open: None,
            score,
        };
        graph.load_constraint(constraint(ConstraintTag::IntraSubmap, None, Vector3::zeros()));
        graph.load_constraint(constraint(ConstraintTag::InterSubmap, Some(0.8), wrong));
    }
    let settings = MapperSettings { threads: 1, ..MapperSettings::default() };
    let mapper = Mapper::with_graph(options, settings, graph, BTreeMap::new()).unwrap();
    let map = mapper.finish().unwrap().0;
    map.graph.state().constraints.iter().filter(|c| c.is_loop_closure()).count() as f64
}

fn background_threads(options: &Options) -> f64 {
    let requested = RequestedOptions { configuration: Some(options.clone()), settings: Vec::new() };
    requested.background_threads().unwrap() as f64
}

pub fn table() -> Vec<Effect> {
    let mut table = pose_graph();
    table.extend(search());
    table.extend(match_of_loop_closures());
    table.extend(trajectories());
    table
}

fn pose_graph() -> Vec<Effect> {
    effects! {
        "optimize_every_n_nodes", "0" => "5", Rises, |o| lap(o).map.graph.optimizations().0 as f64;
        "matcher_translation_weight", "100" => "1000", Rises, |o| weights_of(&lap(o), ConstraintTag::IntraSubmap)[0];
        "matcher_rotation_weight", "100" => "1000", Rises, |o| weights_of(&lap(o), ConstraintTag::IntraSubmap)[1];
        "max_num_final_iterations", "1" => "200", Rises, |o| f64::from(lap(o).map.graph.optimizations().1.iterations),
            ["optimization_problem.ceres_solver_options.max_num_iterations=1", "portolan.drop_contradicted_loop_closures=false"];
        "overlapping_submaps_trimmer_2d.fresh_submaps_count", "1" => "10", Rises, |o| lap(o).submaps(),
            ["overlapping_submaps_trimmer_2d.min_added_submaps_count=0"];
        "overlapping_submaps_trimmer_2d.min_covered_area", "0.01" => "1000", Falls, |o| lap(o).submaps(),
            ["overlapping_submaps_trimmer_2d.min_added_submaps_count=0"];
        "overlapping_submaps_trimmer_2d.min_added_submaps_count", "0" => "100", Rises, |o| lap(o).submaps(),
            ["overlapping_submaps_trimmer_2d.min_covered_area=1000"];
        "portolan.submaps_per_place", "1" => "0", Rises, |o| lap(o).submaps();
        "portolan.drop_contradicted_loop_closures", "false" => "true", Falls, loops_after_final_optimization;
        "map_builder.num_background_threads", "1" => "3", Rises, background_threads;
        "collate_by_trajectory", "false" => "true", Rises, |o| mapped_meanwhile(o, SensorKind::Odometry, true);
    }
}

fn search() -> Vec<Effect> {
    effects! {
        "constraint_builder.sampling_ratio", "0.1" => "1", Rises, |o| searches(o).window_searched as f64;
        "constraint_builder.max_constraint_distance", "0.5" => "15", Rises, |o| searches(o).window_searched as f64;
        "constraint_builder.min_score", "0.1" => "0.99", Falls, |o| searches(o).window_found as f64;
        "constraint_builder.global_localization_min_score", "0.1" => "0.99", Falls, |o| searches_of_two(o).whole_submap_found as f64,
            ["pose_graph.global_sampling_ratio=0.2", "pose_graph.global_constraint_search_after_n_seconds=0"];
        "pose_graph.global_sampling_ratio", "0" => "0.3", Rises, |o| searches_of_two(o).whole_submap_searched as f64,
            ["pose_graph.global_constraint_search_after_n_seconds=0"];
        "pose_graph.global_constraint_search_after_n_seconds", "0" => "100000", Falls, whole_searches_from_given_start,
            ["pose_graph.global_sampling_ratio=0.2"];
        "portolan.global_localization_min_matches", "1" => "1000", Falls, ties,
            ["pose_graph.global_sampling_ratio=0.3", "constraint_builder.global_localization_min_score=0.1"];
        "portolan.loop_search_drift", "0" => "1", Rises, |o| searches(o).window_searched as f64,
            ["constraint_builder.max_constraint_distance=0.5"];
        "portolan.loop_search_spacing", "0.2" => "5", Falls, |o| searches(o).window_searched as f64;
        "portolan.loop_min_explained", "0" => "1", Falls, |o| searches(o).window_found as f64,
            ["constraint_builder.min_score=0.1"];
        "portolan.loop_max_contradiction", "1" => "0", Falls, contradicted_found;
        "portolan.min_loop_closure_searches", "0" => "200", Rises, |o| searches(o).window_searched as f64,
            ["constraint_builder.sampling_ratio=0.05"];
        "loop_closure_translation_weight", "100" => "1000", Rises, |o| weights_of(&lap(o), ConstraintTag::InterSubmap)[0],
            ["constraint_builder.min_score=0.1"];
        "loop_closure_rotation_weight", "100" => "1000", Rises, |o| weights_of(&lap(o), ConstraintTag::InterSubmap)[1],
            ["constraint_builder.min_score=0.1"];
        "fast_correlative_scan_matcher.linear_search_window", "0.2" => "2", Rises, |o| is_found(o, [1.0, -0.5, 0.0]);
        "fast_correlative_scan_matcher.angular_search_window", "0.05" => "0.6", Rises, |o| is_found(o, [0.0, 0.0, 0.5]),
            ["constraint_builder.min_score=0.45"];
        "fast_correlative_scan_matcher.branch_and_bound_depth", "1" => "7", Changes, place_of_point,
            ["fast_correlative_scan_matcher.angular_search_window=0", "fast_correlative_scan_matcher.linear_search_window=0.8",
             "constraint_builder.ceres_scan_matcher.translation_weight=100000"];
    }
}

fn match_of_loop_closures() -> Vec<Effect> {
    effects! {
        "constraint_builder.ceres_scan_matcher.occupied_space_weight", "0.001" => "20", Falls, error;
        "constraint_builder.ceres_scan_matcher.translation_weight", "1" => "100000", Rises, error;
        "constraint_builder.ceres_scan_matcher.rotation_weight", "1" => "100000", Rises, turn_error;
        "constraint_builder.ceres_scan_matcher.ceres_solver_options.max_num_iterations", "1" => "20", Falls, error;
        "constraint_builder.ceres_scan_matcher.ceres_solver_options.use_nonmonotonic_steps", "false" => "true", Changes,
            |o| (0..16).map(|i| 0.06 * f64::from(i)).filter_map(|d| find(o, [0.0; 3], &scattered(d))).map(|m| m.submap_from_node.translation.x).sum(),
            ["constraint_builder.min_score=0.05", "constraint_builder.ceres_scan_matcher.translation_weight=0.01",
             "constraint_builder.ceres_scan_matcher.rotation_weight=0.01", "constraint_builder.ceres_scan_matcher.ceres_solver_options.max_num_iterations=50"];
    }
}

/// The node seen by a scanner with `spread` metres of noise.
fn scattered(spread: f64) -> NodeData {
    let mut node = submap_and_node().1.clone();
    let points = &mut node.filtered_gravity_aligned_point_cloud.points;
    for (i, point) in points.iter_mut().enumerate() {
        let i = i as f32;
        point.x += spread as f32 * (1.7 * i).sin();
        point.y += spread as f32 * (2.3 * i).cos();
    }
    node
}

fn trajectories() -> Vec<Effect> {
    effects! {
        "collate_landmarks", "false" => "true", Falls, |o| mapped_meanwhile(o, SensorKind::Landmark, false);
        "collate_fixed_frame", "false" => "true", Falls, |o| mapped_meanwhile(o, SensorKind::FixedFramePose, false);
        "pure_localization_trimmer.max_submaps_to_keep", "2" => "4", Rises, submaps_meanwhile;
        "pose_graph_odometry_motion_filter.max_time_seconds", "0.1" => "1000", Falls, |o| lap(o).kept_odometry(),
            ["pose_graph_odometry_motion_filter.max_distance_meters=100", "pose_graph_odometry_motion_filter.max_angle_radians=10"];
        "pose_graph_odometry_motion_filter.max_distance_meters", "0.1" => "100", Falls, |o| lap(o).kept_odometry(),
            ["pose_graph_odometry_motion_filter.max_time_seconds=1000", "pose_graph_odometry_motion_filter.max_angle_radians=10"];
        "pose_graph_odometry_motion_filter.max_angle_radians", "0.1" => "10", Falls, |o| lap(o).kept_odometry(),
            ["pose_graph_odometry_motion_filter.max_time_seconds=1000", "pose_graph_odometry_motion_filter.max_distance_meters=100"];
    }
}

#[test]
fn options_of_the_pose_graph_have_their_effects() {
    check(&base(), &pose_graph());
}

#[test]
fn options_of_the_search_for_constraints_have_their_effects() {
    check(&base(), &search());
    check(&base(), &match_of_loop_closures());
}

#[test]
fn options_of_trajectories_have_their_effects() {
    check(&base(), &trajectories());
}

#[test]
fn a_lap_has_loop_closures_and_trimming_is_off_unless_asked_for() {
    let plain = lap(&base());
    assert!(plain.loops() >= 1.0, "{:?}", plain.map.graph.search_counts());
    let mut options = base();
    options.set("overlapping_submaps_trimmer_2d=default").unwrap();
    assert!(lap(&options).submaps() < plain.submaps());
}
