//! Matching of scans in 3D.

use portolan::config::Options;
use portolan::geometry::{Rigid3, Vector3, rotation_angle, rotation_from_roll_pitch_yaw};

use crate::effect::{Effect, check, effects};
use crate::local_3d::{base, circle, leaning, roll, scans};
use crate::world::{dense_scan, distance, pose, scan_3d};

/// Two scans at rest, then one elsewhere that nothing foretells.
fn pushed(options: &Options, to: &Rigid3) -> Rigid3 {
    let mut options = options.clone();
    options.set("trajectory_builder_3d.submaps.range_data_inserter.hit_probability=0.9").unwrap();
    options.set("trajectory_builder_3d.voxel_filter_size=0.05").unwrap();
    options.set("trajectory_builder_3d.motion_filter.max_time_seconds=1").unwrap();
    let rest = pose(0.0, 0.0, 0.0);
    let clouds = vec![dense_scan(&rest, 0.0), scan_3d(&rest, 0.2), scan_3d(to, 0.4)];
    scans(&options, clouds).last_pose()
}

fn near() -> Rigid3 {
    Rigid3::from_parts(Vector3::new(0.06, 0.05, 0.02).into(), rotation_from_roll_pitch_yaw(0.01, 0.0, 0.03))
}

fn far() -> Rigid3 {
    Rigid3::from_parts(Vector3::new(0.35, 0.2, 0.0).into(), rotation_from_roll_pitch_yaw(0.0, 0.0, 0.06))
}

fn moved(options: &Options, to: Rigid3) -> f64 {
    pushed(options, &to).translation.vector.norm()
}

fn turn(options: &Options, to: Rigid3) -> f64 {
    rotation_angle(&pushed(options, &to))
}

fn error(options: &Options, to: Rigid3) -> f64 {
    distance(&pushed(options, &to), &to)
}

fn turn_error(options: &Options, to: Rigid3) -> f64 {
    rotation_angle(&(pushed(options, &to).inverse() * to))
}

pub fn table() -> Vec<Effect> {
    effects! {
        "trajectory_builder_3d.use_online_correlative_scan_matching", "false" => "true", Falls, |o| error(o, far()),
            ["trajectory_builder_3d.submaps.high_resolution=0.2", "trajectory_builder_3d.real_time_correlative_scan_matcher.linear_search_window=0.4",
             "trajectory_builder_3d.ceres_scan_matcher.translation_weight=0.1"];
        "trajectory_builder_3d.real_time_correlative_scan_matcher.linear_search_window", "0.1" => "0.4", Falls, |o| error(o, far()),
            ["trajectory_builder_3d.submaps.high_resolution=0.2", "trajectory_builder_3d.use_online_correlative_scan_matching=true",
             "trajectory_builder_3d.ceres_scan_matcher.translation_weight=0.1"];
        "trajectory_builder_3d.real_time_correlative_scan_matcher.angular_search_window", "0" => "0.08", Falls, |o| turn_error(o, far()),
            ["trajectory_builder_3d.submaps.high_resolution=0.2", "trajectory_builder_3d.use_online_correlative_scan_matching=true",
             "trajectory_builder_3d.real_time_correlative_scan_matcher.linear_search_window=0.4"];
        "trajectory_builder_3d.real_time_correlative_scan_matcher.translation_delta_cost_weight", "0.1" => "100", Falls, |o| moved(o, far()),
            ["trajectory_builder_3d.submaps.high_resolution=0.2", "trajectory_builder_3d.use_online_correlative_scan_matching=true",
             "trajectory_builder_3d.real_time_correlative_scan_matcher.linear_search_window=0.4"];
        "trajectory_builder_3d.real_time_correlative_scan_matcher.rotation_delta_cost_weight", "0.1" => "1000", Falls, |o| turn(o, far()),
            ["trajectory_builder_3d.submaps.high_resolution=0.2", "trajectory_builder_3d.use_online_correlative_scan_matching=true",
             "trajectory_builder_3d.real_time_correlative_scan_matcher.linear_search_window=0.4",
             "trajectory_builder_3d.real_time_correlative_scan_matcher.angular_search_window=0.08"];
        "trajectory_builder_3d.ceres_scan_matcher.occupied_space_weight_0", "0.1" => "20", Falls, |o| error(o, near());
        "trajectory_builder_3d.ceres_scan_matcher.occupied_space_weight_1", "0.1" => "20", Rises, |o| moved(o, near());
        "trajectory_builder_3d.ceres_scan_matcher.translation_weight", "0.1" => "1000", Falls, |o| moved(o, near());
        "trajectory_builder_3d.ceres_scan_matcher.rotation_weight", "1" => "100000", Falls, |o| turn(o, near());
        "trajectory_builder_3d.ceres_scan_matcher.only_optimize_yaw", "false" => "true", Falls,
            |o| roll(&pushed(o, &leaning()).rotation), ["trajectory_builder_3d.ceres_scan_matcher.rotation_weight=1"];
        "trajectory_builder_3d.ceres_scan_matcher.ceres_solver_options.max_num_iterations", "1" => "12", Falls, |o| error(o, near()),
            ["trajectory_builder_3d.ceres_scan_matcher.translation_weight=0.1", "trajectory_builder_3d.ceres_scan_matcher.rotation_weight=1"];
        "trajectory_builder_3d.ceres_scan_matcher.ceres_solver_options.use_nonmonotonic_steps", "false" => "true", Changes,
            |o| (1..5).map(|i| 0.09 * f64::from(i)).map(|d| moved(o, pose(d, -0.6 * d, 0.2 * d))).sum(),
            ["trajectory_builder_3d.ceres_scan_matcher.translation_weight=0.1", "trajectory_builder_3d.ceres_scan_matcher.rotation_weight=1",
             "trajectory_builder_3d.ceres_scan_matcher.occupied_space_weight_0=30"];
        "trajectory_builder_3d.ceres_scan_matcher.intensity_cost_function_options_0.weight", "0.01" => "5", Changes, |o| moved(o, near()),
            ["use_intensities=true"];
        "trajectory_builder_3d.ceres_scan_matcher.intensity_cost_function_options_0.huber_scale", "0.01" => "100", Changes, |o| moved(o, near()),
            ["use_intensities=true"];
        "trajectory_builder_3d.ceres_scan_matcher.intensity_cost_function_options_0.intensity_threshold", "15" => "40", Changes, |o| moved(o, near()),
            ["use_intensities=true"];
        "use_intensities", "false" => "true", Changes, |o| moved(o, near());
        "portolan.match_surfaces", "false" => "true", Changes, |o| circle(o).last_pose().translation.x;
        "portolan.surface_voxel_size", "0.5" => "2", Changes, |o| circle(o).last_pose().translation.x,
            ["portolan.match_surfaces=true"];
        "portolan.min_scan_duration", "0" => "1.2", Falls, |o| circle(o).results.len() as f64;
    }
}

#[test]
fn options_of_matching_in_3d_have_their_effects() {
    check(&base(), &table());
}
