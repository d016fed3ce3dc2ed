//! A recording processed by the programs of Cartographer: mapped, written, compared.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use std::path::Path;

use common::{portolan_with_code, simulated, text};

/// A robot with a scanner and wheels, as its owner would describe it.
const ROBOT: &str = r#"
include "map_builder.lua"
include "trajectory_builder.lua"
MAP_BUILDER.use_trajectory_builder_2d = true
TRAJECTORY_BUILDER_2D.use_imu_data = false
TRAJECTORY_BUILDER_2D.use_online_correlative_scan_matching = true
return {
  map_builder = MAP_BUILDER, trajectory_builder = TRAJECTORY_BUILDER,
  map_frame = "map", tracking_frame = "base_link", published_frame = "base_link", odom_frame = "odom",
  provide_odom_frame = true, publish_frame_projected_to_2d = false, use_pose_extrapolator = true,
  use_odometry = true, use_nav_sat = false, use_landmarks = false,
  num_laser_scans = 1, num_multi_echo_laser_scans = 0, num_subdivisions_per_laser_scan = 1,
  num_point_clouds = 0, lookup_transform_timeout_sec = 0.2, submap_publish_period_sec = 0.3,
  pose_publish_period_sec = 5e-3, trajectory_publish_period_sec = 30e-3, rangefinder_sampling_ratio = 1.,
  odometry_sampling_ratio = 1., fixed_frame_pose_sampling_ratio = 1., imu_sampling_ratio = 1.,
  landmarks_sampling_ratio = 1.,
}
"#;

const ASSETS: &str = r#"
include "transform.lua"
return {
  tracking_frame = "base_link",
  pipeline = {
    { action = "min_max_range_filter", min_range = 0.2, max_range = 30. },
    { action = "voxel_filter_and_remove_moving_objects", voxel_size = 0.1 },
    { action = "dump_num_points" },
    { action = "color_points", frame_id = "laser", color = { 255., 0., 0. } },
    { action = "write_ply", filename = "points.ply" },
    { action = "write_xray_image", voxel_size = 0.05, filename = "xray", transform = XY_TRANSFORM },
    { action = "write_ros_map", filestem = "map", resolution = 0.05,
      range_data_inserter = { insert_free_space = true, hit_probability = 0.55, miss_probability = 0.49 } },
  },
}
"#;

#[test]
fn a_recording_is_processed_by_the_programs_of_the_reference() {
    let folder = tempfile::tempdir().unwrap();
    let bag = simulated(folder.path(), "walk.bag", &[]);
    let at = |name: &str| text(&folder.path().join(name));
    std::fs::write(folder.path().join("robot.lua"), ROBOT).unwrap();
    std::fs::write(folder.path().join("assets.lua"), ASSETS).unwrap();
    let directory = text(folder.path());
    let configuration = ["-configuration_directory", &directory];

    let node = ["compat", "cartographer_offline_node", "-configuration_basenames", "robot.lua"];
    portolan_with_code(0, &[&node[..], &configuration, &["-bag_filenames", &bag]].concat());
    let map = format!("{bag}.pbstream");

    let writer = ["compat", "cartographer_assets_writer", "-configuration_basename", "assets.lua"];
    let inputs = ["-bag_filenames", &bag, "-pose_graph_filename", &map];
    let run = portolan_with_code(0, &[&writer[..], &configuration, &inputs].concat());
    assert!(
        run.stderr.contains("Counting rays...") && run.stderr.contains("and finishing."),
        "{}",
        run.stderr
    );
    for (name, smallest) in [("points.ply", 20_000), ("xray.png", 100), ("map.pgm", 5_000), ("map.yaml", 50)]
    {
        let size = std::fs::metadata(format!("{bag}_{name}")).unwrap().len();
        assert!(size > smallest, "{name}: {size} bytes");
    }
    // Two recordings do not belong to a map of one trajectory.
    let both = format!("{bag},{bag}");
    let inputs = ["-bag_filenames", &both, "-pose_graph_filename", &map];
    let run = portolan_with_code(1, &[&writer[..], &configuration, &inputs].concat());
    assert!(run.stderr.contains("1 trajectories but 2 bags"), "{}", run.stderr);

    let poses = at("poses.bag");
    let to_bag = ["compat", "cartographer_dev_pbstream_trajectories_to_rosbag"];
    portolan_with_code(0, &[&to_bag[..], &["-input", &map, "-output", &poses]].concat());
    let compare = ["compat", "cartographer_dev_trajectory_comparison", "-tf_child_frame", "trajectory_0"];
    let run = portolan_with_code(
        0,
        &[&compare[..], &["-bag_filename", &poses, "-pbstream_filename", &map]].concat(),
    );
    assert!(run.stdout.contains("smaller than 0.01 m: 1\n"), "{}", run.stdout);
}

#[test]
fn bags_become_trajectories_after_those_of_the_state() {
    let folder = tempfile::tempdir().unwrap();
    let bag = simulated(folder.path(), "walk.bag", &[]);
    std::fs::write(folder.path().join("robot.lua"), ROBOT).unwrap();
    let at = |name: &str| text(&folder.path().join(name));
    let (state, all, directory) = (at("state.pbstream"), at("all.pbstream"), text(folder.path()));
    let node = ["compat", "cartographer_offline_node", "-configuration_directory", &directory];
    let node = [&node[..], &["-configuration_basenames", "robot.lua"]].concat();
    portolan_with_code(0, &[&node[..], &["-bag_filenames", &bag, "-save_state_filename", &state]].concat());
    let bags = format!("{bag},{bag}");
    let more = ["-bag_filenames", &bags, "-load_state_filename", &state, "-save_state_filename", &all];
    portolan_with_code(0, &[&node[..], &more].concat());

    let info = |map: &str| -> serde_json::Value {
        let run = portolan_with_code(0, &["info", "--json", map]);
        serde_json::from_str::<serde_json::Value>(&run.stdout).unwrap()[0]["trajectories"].take()
    };
    let (before, after) = (info(&state), info(&all));
    assert_eq!(after.as_array().unwrap().len(), 3);
    assert_eq!(before[0]["nodes"], after[1]["nodes"]);
    // Frozen: not a bit of the first trajectory moves. All three saw the same.
    let poses = |map: &str, trajectory: &str| {
        let tum = at("poses.tum");
        portolan_with_code(0, &["convert", map, "-o", &tum, "--trajectory", trajectory]);
        std::fs::read_to_string(tum).unwrap()
    };
    assert_eq!(poses(&state, "0"), poses(&all, "0"));
    let run = portolan_with_code(2, &[&node[..], &["-load_state_filename", "state.bag"]].concat());
    assert!(run.stderr.contains("no .pbstream"), "{}", run.stderr);
}

#[test]
fn times_of_messages_are_dumped_into_the_working_folder() {
    let folder = tempfile::tempdir().unwrap();
    let bag = simulated(folder.path(), "walk.bag", &[]);
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_portolan"))
        .args(["compat", "cartographer_rosbag_validate", "-bag_filename", &bag, "-dump_timing"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(output.status.code().is_some_and(|code| code <= 1));
    let table = std::fs::read_to_string(Path::new(folder.path()).join("timing_laser.csv")).unwrap();
    assert!(table.starts_with('#') && table.lines().count() > 100, "{table}");
    assert!(table.lines().nth(1).unwrap().starts_with("1\t17000000"), "{table}");
}
