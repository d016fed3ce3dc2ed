//! The configuration files that are part of the program.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::path::Path;

use portolan_config::lua::{Evaluation, Limits, built_in_names, dump, evaluate_file, evaluate_text};
use portolan_config::{LoadedConfig, Loader, MapBuilderServerOptions, Options, Value};
use portolan_geometry::Dimension;

const ROBOTS: [&str; 9] = [
    "backpack_2d",
    "backpack_2d_localization",
    "backpack_2d_localization_evaluation",
    "backpack_3d",
    "backpack_3d_localization",
    "pr2",
    "revo_lds",
    "taurob_tracker",
    "visualize_pbstream",
];

fn load(name: &str) -> LoadedConfig {
    Options::from_lua_file(Path::new(&format!("{name}.lua")), &[]).unwrap()
}

fn evaluate(name: &str) -> Evaluation {
    evaluate_file(Path::new(name), &[], Limits::default()).unwrap()
}

/// The part of a configuration under test, with Cartographer's own defaults.
fn part(includes: &[&str], returned: &str) -> Value {
    let includes: String = includes.iter().map(|name| format!("include \"{name}\"\n")).collect();
    let text = format!("{includes}return {returned}");
    Value::Table(evaluate_text("test", &text, &[], Limits::default()).unwrap().table)
}

#[test]
fn every_robot_loads_without_warnings() {
    for name in ROBOTS {
        let config = load(name);
        assert_eq!(config.warnings, [], "{name}");
        assert_eq!(config.files[0], format!("built-in:{name}.lua"));
        assert_eq!(config.options.validate(), Ok(()), "{name}");
    }
}

#[test]
fn the_files_and_the_defaults_agree() {
    let names = ["map_builder.lua", "trajectory_builder.lua"];
    let defaults = Options::default();
    let map_builder = portolan_config::node::section_to_value(&defaults.map_builder);
    assert_eq!(part(&names, "MAP_BUILDER"), map_builder);
    let trajectory_builder = portolan_config::node::section_to_value(&defaults.trajectory_builder);
    assert_eq!(part(&names, "TRAJECTORY_BUILDER"), trajectory_builder);
    let server = portolan_config::node::section_to_value(&MapBuilderServerOptions::default());
    assert_eq!(part(&["map_builder_server.lua"], "MAP_BUILDER_SERVER"), server);
}

#[test]
fn the_configuration_of_the_reference_tests_is_complete() {
    let text = r#"
        include "map_builder.lua"
        include "trajectory_builder.lua"
        MAP_BUILDER.use_trajectory_builder_2d = true
        TRAJECTORY_BUILDER.trajectory_builder_2d.use_imu_data = false
        return { map_builder = MAP_BUILDER, trajectory_builder = TRAJECTORY_BUILDER, num_laser_scans = 1 }
    "#;
    let config = Options::from_lua("test.lua", text).unwrap();
    assert_eq!(config.options.map_builder.dimension(), Ok(Dimension::TwoD));
    assert!(!config.options.trajectory_builder.trajectory_builder_2d.use_imu_data);
    let about_builders = |warning: &&_| {
        let text = format!("{warning}");
        text.contains("`map_builder") || text.contains("`trajectory_builder")
    };
    assert_eq!(config.warnings.iter().filter(about_builders).count(), 0);
}

#[test]
fn backpack_2d_and_its_relatives() {
    let options = load("backpack_2d").options;
    assert_eq!(options.map_builder.dimension(), Ok(Dimension::TwoD));
    assert_eq!(options.trajectory_builder.trajectory_builder_2d.num_accumulated_range_data, 10);
    assert_eq!((options.bridge.num_multi_echo_laser_scans, options.bridge.num_laser_scans), (1, 0));
    assert_eq!(options.bridge.num_subdivisions_per_laser_scan, 10);
    assert_eq!(options.trajectory_builder.pure_localization_trimmer, None);

    let options = load("backpack_2d_localization").options;
    assert_eq!(options.trajectory_builder.pure_localization_trimmer.unwrap().max_submaps_to_keep, 3);
    assert_eq!(options.map_builder.pose_graph.optimize_every_n_nodes, 20);

    let options = load("backpack_2d_localization_evaluation").options;
    let graph = &options.map_builder.pose_graph;
    assert!(!options.bridge.provide_odom_frame && graph.optimization_problem.log_solver_summary);
    assert_eq!(options.map_builder.num_background_threads, 12);
    assert_eq!(graph.constraint_builder.sampling_ratio, 0.15);
    assert!((graph.global_sampling_ratio - 0.0003).abs() < 1e-15);
    assert_eq!(graph.max_num_final_iterations, 1);

    let options = load("visualize_pbstream").options;
    let graph = &options.map_builder.pose_graph;
    assert_eq!((graph.constraint_builder.sampling_ratio, graph.global_sampling_ratio), (0.0, 0.0));
    assert_eq!(graph.optimize_every_n_nodes, 0);
}

#[test]
fn backpack_3d_and_taurob_tracker() {
    let options = load("backpack_3d").options;
    assert_eq!(options.map_builder.dimension(), Ok(Dimension::ThreeD));
    assert_eq!(options.trajectory_builder.trajectory_builder_3d.num_accumulated_range_data, 160);
    let graph = &options.map_builder.pose_graph;
    assert_eq!((graph.optimize_every_n_nodes, graph.optimization_problem.huber_scale), (320, 5e2));
    assert_eq!(graph.constraint_builder.min_score, 0.62);
    assert_eq!(graph.constraint_builder.global_localization_min_score, 0.66);
    assert_eq!(graph.optimization_problem.ceres_solver_options.max_num_iterations, 10);
    assert_eq!(load("backpack_3d_localization").options.map_builder.pose_graph.optimize_every_n_nodes, 100);

    let options = load("taurob_tracker").options;
    let builder = &options.trajectory_builder.trajectory_builder_3d;
    assert_eq!((builder.min_range, builder.max_range, builder.submaps.num_range_data), (0.5, 20.0, 40));
    assert_eq!((options.bridge.published_frame.as_str(), options.bridge.use_odometry), ("odom", true));
}

#[test]
fn pr2_and_revo_lds() {
    let options = load("pr2").options;
    let builder = &options.trajectory_builder.trajectory_builder_2d;
    assert!(!builder.use_imu_data && builder.use_online_correlative_scan_matching);
    assert_eq!(builder.real_time_correlative_scan_matcher.angular_search_window, 35.0_f64.to_radians());

    let options = load("revo_lds").options;
    let builder = &options.trajectory_builder.trajectory_builder_2d;
    assert_eq!((builder.min_range, builder.max_range, builder.missing_data_ray_length), (0.3, 8.0, 1.0));
    assert_eq!(builder.real_time_correlative_scan_matcher.translation_delta_cost_weight, 10.0);
    assert_eq!(options.bridge.tracking_frame, "horizontal_laser_link");
}

#[test]
fn the_server_loads() {
    let config = Loader::default().load_server(Path::new("backpack_2d_server.lua")).unwrap();
    assert_eq!(config.warnings, []);
    assert!(config.options.map_builder.collate_by_trajectory);
    assert_eq!(config.options.map_builder.dimension(), Ok(Dimension::TwoD));
    assert_eq!(config.options.server_address, "0.0.0.0:50051");
    assert_eq!(config.options.validate(), Ok(()));
}

#[test]
fn pipelines_have_their_stages() {
    for (name, stages) in [
        ("assets_writer_backpack_2d.lua", 15),
        ("assets_writer_backpack_2d_ci.lua", 5),
        ("assets_writer_backpack_3d.lua", 10),
        ("assets_writer_ros_map.lua", 2),
    ] {
        let table = evaluate(name).table;
        assert_eq!(table.entries["tracking_frame"], Value::Text("base_link".into()));
        assert_eq!(table.entries["pipeline"].as_table().unwrap().array.len(), stages, "{name}");
    }
    let transforms = part(&["transform.lua"], "XY_TRANSFORM");
    let rotation = transforms.as_table().unwrap().entries["rotation"].as_table().unwrap().array.clone();
    assert_eq!(rotation[1], Value::Number(-std::f64::consts::FRAC_PI_2));
}

#[test]
fn the_dump_of_every_file_parses_back() {
    // Six decimals: the dump of what was read from a dump is the same dump.
    let returning = |name: &&&str| {
        ROBOTS.iter().any(|robot| **name == format!("{robot}.lua"))
            || name.starts_with("assets_writer")
            || **name == "backpack_2d_server.lua"
    };
    let mut seen = 0;
    for name in built_in_names().iter().filter(returning) {
        let text = dump(&evaluate(name).table);
        let again = evaluate_text("dump", &format!("return {text}"), &[], Limits::default()).unwrap();
        assert_eq!(dump(&again.table), text, "{name}");
        seen += 1;
    }
    assert_eq!(seen, 14);
}
