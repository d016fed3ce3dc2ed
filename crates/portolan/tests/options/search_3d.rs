//! The search for constraints in 3D.

use std::sync::OnceLock;

use portolan::config::Options;
use portolan::geometry::{Rigid3, Vector3, rotation_angle, rotation_from_roll_pitch_yaw};
use portolan::mapping::{MatchedPose, NodeData, SearchRegion, Space, Space3d};
use portolan::submaps::Submap3d;

use crate::effect::{Effect, check, effects};
use crate::local_3d::{base, first_submap, leaning, scans};
use crate::world::{dense_scan, pose};

/// A finished submap of a scan at rest and the node of that scan.
fn submap_and_node() -> &'static (Submap3d, NodeData) {
    static MADE: OnceLock<(Submap3d, NodeData)> = OnceLock::new();
    MADE.get_or_init(|| {
        let mut options = base();
        let local = &mut options.trajectory_builder.trajectory_builder_3d;
        local.submaps.range_data_inserter.hit_probability = 0.9;
        local.submaps.high_resolution = 0.2;
        local.voxel_filter_size = 0.1;
        let run = scans(&options, vec![dense_scan(&pose(0.0, 0.0, 0.0), 0.0)]);
        let node = run.map.graph.state().nodes.values().next().unwrap();
        (first_submap(&run).clone(), NodeData::clone(&node.data))
    })
}

/// Searches for the node at its predicted pose, at this distance from the true one.
fn find(options: &Options, offset: Rigid3) -> Option<MatchedPose> {
    let search = &options.map_builder.pose_graph.constraint_builder;
    let (submap, node) = submap_and_node();
    let matcher = Space3d::build_matcher(submap, search).unwrap();
    let guess = submap.local_from_submap.inverse() * node.local_from_tracking * offset;
    Space3d::find_node(
        &matcher,
        submap,
        node,
        &guess,
        SearchRegion::Window { travelled: f64::INFINITY, window: None, acceptance: Default::default() },
        search,
    )
}

fn is_found(options: &Options, offset: Rigid3) -> f64 {
    f64::from(u8::from(find(options, offset).is_some()))
}

/// A guess that is no whole number of cells off.
fn guess() -> Rigid3 {
    Rigid3::from_parts(
        Vector3::new(0.237, -0.161, 0.043).into(),
        rotation_from_roll_pitch_yaw(0.0, 0.0, 0.013),
    )
}

/// Where a node is found, as seen from where it is.
fn found(options: &Options, offset: Rigid3) -> Rigid3 {
    let (submap, node) = submap_and_node();
    let truth = submap.local_from_submap.inverse() * node.local_from_tracking;
    truth.inverse() * find(options, offset).unwrap().submap_from_node
}

/// Where the search finds the node before the match is refined.
fn unrefined(options: &Options) -> Rigid3 {
    let mut options = options.clone();
    for weight in ["translation_weight", "rotation_weight"] {
        options.set(&format!("ceres_scan_matcher_3d.{weight}=1e9")).unwrap();
    }
    found(&options, guess())
}

/// How far the refinement moves the node, metres.
fn refined_by(options: &Options) -> f64 {
    (unrefined(options).inverse() * found(options, guess())).translation.vector.norm()
}

/// How far the refinement turns the node, radians.
fn turned_by(options: &Options) -> f64 {
    rotation_angle(&(unrefined(options).inverse() * found(options, guess())))
}

fn memory(options: &Options) -> f64 {
    let search = &options.map_builder.pose_graph.constraint_builder;
    Space3d::matcher_bytes(&Space3d::build_matcher(&submap_and_node().0, search).unwrap()) as f64
}

pub fn table() -> Vec<Effect> {
    effects! {
        "fast_correlative_scan_matcher_3d.branch_and_bound_depth", "2" => "7", Rises, memory;
        "fast_correlative_scan_matcher_3d.full_resolution_depth", "1" => "6", Rises, memory;
        "min_rotational_score", "0.5" => "1", Falls, |o| is_found(o, guess());
        "min_low_resolution_score", "0.2" => "0.99", Falls, |o| is_found(o, guess());
        "linear_xy_search_window", "0.2" => "2", Rises, |o| is_found(o, Rigid3::translation(1.0, 0.5, 0.0));
        "linear_z_search_window", "0.2" => "1.5", Rises, |o| is_found(o, Rigid3::translation(0.0, 0.0, 1.0));
        "fast_correlative_scan_matcher_3d.angular_search_window", "0.05" => "0.4", Rises, |o| is_found(o, pose(0.0, 0.0, 0.3));
        "ceres_scan_matcher_3d.occupied_space_weight_0", "0.001" => "5", Rises, refined_by,
            ["ceres_scan_matcher_3d.occupied_space_weight_1=0.001"];
        "ceres_scan_matcher_3d.occupied_space_weight_1", "0.001" => "30", Rises, refined_by,
            ["ceres_scan_matcher_3d.occupied_space_weight_0=0.001"];
        "ceres_scan_matcher_3d.translation_weight", "1" => "100000", Falls, refined_by;
        "ceres_scan_matcher_3d.rotation_weight", "1" => "100000", Falls, turned_by;
        "ceres_scan_matcher_3d.only_optimize_yaw", "false" => "true", Rises,
            |o| rotation_angle(&found(o, leaning())), ["constraint_builder.min_score=0.2", "min_low_resolution_score=0.2"];
        "ceres_scan_matcher_3d.ceres_solver_options.max_num_iterations", "1" => "10", Changes, refined_by;
        "ceres_scan_matcher_3d.ceres_solver_options.use_nonmonotonic_steps", "false" => "true", Changes,
            |o| (0..6).map(|i| 0.013 * f64::from(i)).map(|d| found(o, Rigid3::from_parts(Vector3::new(d, 0.7, 0.3 * d).into(), rotation_from_roll_pitch_yaw(2.0 * d, -d, d))).translation.x).sum(),
            ["constraint_builder.min_score=0.1", "min_low_resolution_score=0.1", "ceres_scan_matcher_3d.translation_weight=0.01", "ceres_scan_matcher_3d.rotation_weight=0.01",
             "ceres_scan_matcher_3d.ceres_solver_options.max_num_iterations=50"];
    }
}

#[test]
fn options_of_the_search_for_constraints_in_3d_have_their_effects() {
    check(&base(), &table());
}
