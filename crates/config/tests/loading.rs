//! Strictness, messages and merging when a robot's file is loaded.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use portolan_config::{ConfigError, ConfigWarning, Loader, Options, Strictness};

/// A robot's file with lines added before the end.
fn robot(lines: &str) -> String {
    format!("include \"backpack_2d.lua\"\n{lines}\nreturn options\n")
}

fn error(lines: &str) -> String {
    Options::from_lua("robot.lua", &robot(lines)).unwrap_err().to_string()
}

fn warnings(lines: &str) -> Vec<String> {
    let config = Options::from_lua("robot.lua", &robot(lines)).unwrap();
    config.warnings.iter().map(ToString::to_string).collect()
}

#[test]
fn a_misspelt_key_names_the_nearest_one_and_the_line() {
    let text = error("POSE_GRAPH.constraint_builder.min_scroe = 0.6");
    assert_eq!(
        text,
        "robot.lua:2: unknown option `map_builder.pose_graph.constraint_builder.min_scroe`; did you mean \
         `map_builder.pose_graph.constraint_builder.min_score`?"
    );
    let text = error("options.use_odometri = true");
    assert!(
        text.starts_with("robot.lua:2: unknown option `use_odometri`; did you mean `use_odometry`?"),
        "{text}"
    );
    let text = error("POSE_GRAPH.min_score = 0.6");
    assert!(text.contains("did you mean `map_builder.pose_graph.constraint_builder.min_score`?"), "{text}");
    let text = error("options.portolan = { use_all_odometri = true }");
    assert!(text.contains("did you mean `portolan.use_all_odometry`?"), "{text}");
}

#[test]
fn all_errors_of_a_file_are_reported_at_once() {
    let lines = "MAP_BUILDER.speed = 1\noptions.use_odometry = 1\nTRAJECTORY_BUILDER_2D.submaps = 5";
    let ConfigError::Several { errors } = Options::from_lua("robot.lua", &robot(lines)).unwrap_err() else {
        panic!("several errors expected")
    };
    let text: Vec<_> = errors.iter().map(ToString::to_string).collect();
    assert_eq!(text.len(), 3, "{text:?}");
    assert!(text[0].starts_with("robot.lua:2: unknown option `map_builder.speed`"), "{text:?}");
    assert!(text[1].contains("submaps` must be a table, but is number 5"), "{text:?}");
    assert_eq!(text[2], "robot.lua:3: `use_odometry` must be boolean, but is number 1");
}

#[test]
fn unknown_keys_can_be_warnings() {
    let loader = Loader { strictness: Strictness::Warn, ..Loader::default() };
    let config = loader.load_text("robot.lua", &robot("options.colour = 'red'")).unwrap();
    assert_eq!(config.warnings.len(), 1);
    assert!(config.warnings[0].to_string().starts_with("ignored: robot.lua:2: unknown option `colour`"));
}

#[test]
fn missing_keys_take_their_default_with_a_warning() {
    let text = warnings("TRAJECTORY_BUILDER_2D.min_z = nil\nTRAJECTORY_BUILDER_3D.pose_extrapolator = nil");
    assert_eq!(
        text,
        [
            "robot.lua: `trajectory_builder.trajectory_builder_2d.min_z` is missing, its default is used: -0.8",
            "robot.lua: `trajectory_builder.trajectory_builder_3d.pose_extrapolator` is missing, its default is \
             used: the defaults of the whole table"
        ]
    );
    let optional = "options.publish_to_tf = nil\noptions.use_pose_extrapolator = nil\nTRAJECTORY_BUILDER_2D.submaps\
                    .range_data_inserter.probability_grid_range_data_inserter.insert_free_space = nil";
    assert!(warnings(optional).is_empty());
}

#[test]
fn bounds_are_checked_with_place_and_bound() {
    let text = error("POSE_GRAPH.global_sampling_ratio = 3");
    assert_eq!(
        text,
        "robot.lua:2: `map_builder.pose_graph.global_sampling_ratio` = 3 is out of bounds, it must be 0 to 1"
    );
    let inserter = "TRAJECTORY_BUILDER_2D.submaps.range_data_inserter.probability_grid_range_data_inserter";
    assert!(
        error(&format!("{inserter}.hit_probability = 0.5")).contains("between 0.5 and 1 (both excluded)")
    );
    assert!(
        error("TRAJECTORY_BUILDER.pure_localization_trimmer = { max_submaps_to_keep = 1 }").contains(">= 2")
    );
    assert!(error("MAP_BUILDER.num_background_threads = -1").contains("1 to 1024"));
    assert!(error("TRAJECTORY_BUILDER_2D.voxel_filter_size = 0 / 0").contains("is out of bounds"));
    assert!(error("TRAJECTORY_BUILDER_2D.submaps.num_range_data = 1e30").contains("is out of bounds"));
    let text = warnings("TRAJECTORY_BUILDER_3D.ceres_scan_matcher.rotation_weight = 0");
    assert!(text.len() == 1 && text[0].starts_with("ignored: robot.lua:2: "), "{text:?}");
}

#[test]
fn options_must_fit_each_other() {
    assert!(error("MAP_BUILDER.use_trajectory_builder_3d = true").contains("both are"));
    assert!(error("MAP_BUILDER.use_trajectory_builder_2d = false").contains("none are"));
    assert!(
        error("TRAJECTORY_BUILDER_2D.pose_extrapolator.use_imu_based = true").contains("must be false in 2D")
    );
    let grid = "TRAJECTORY_BUILDER_2D.submaps.grid_options_2d.grid_type";
    assert!(error(&format!("{grid} = 'TSDF'")).contains("does not fit"));
    assert!(error(&format!("{grid} = 'GRID'")).contains("one of \"PROBABILITY_GRID\", \"TSDF\""));
    let both = format!(
        "{grid} = 'TSDF'\nTRAJECTORY_BUILDER_2D.submaps.range_data_inserter.range_data_inserter_type = \
         'TSDF_INSERTER_2D'"
    );
    assert!(warnings(&both).is_empty());
    assert!(error("options.num_multi_echo_laser_scans = 0").contains("at least one of num_laser_scans"));
}

#[test]
fn numbers_are_read_as_in_the_reference() {
    let config = Options::from_lua(
        "robot.lua",
        &robot("TRAJECTORY_BUILDER_2D.submaps.num_range_data = '40'\noptions.map_frame = 7"),
    );
    let config = config.unwrap();
    assert_eq!(config.options.trajectory_builder.trajectory_builder_2d.submaps.num_range_data, 40);
    assert_eq!(config.options.bridge.map_frame, "7");
    assert_eq!(
        warnings("TRAJECTORY_BUILDER_2D.submaps.num_range_data = 40.7"),
        [
            "robot.lua:2: `trajectory_builder.trajectory_builder_2d.submaps.num_range_data` = 40.7 is read as 40"
        ]
    );
    assert!(warnings("TRAJECTORY_BUILDER_2D.max_range = math.huge").is_empty());
}

#[test]
fn optional_tables_are_there_when_given() {
    let lines = "POSE_GRAPH.overlapping_submaps_trimmer_2d = { fresh_submaps_count = 2, min_covered_area = 3, \
                 min_added_submaps_count = 4 }\nTRAJECTORY_BUILDER_3D.ceres_scan_matcher.intensity_cost_function_options_0 = nil";
    let options = Options::from_lua("robot.lua", &robot(lines)).unwrap().options;
    assert_eq!(options.map_builder.pose_graph.overlapping_submaps_trimmer_2d.unwrap().fresh_submaps_count, 2);
    let matcher = &options.trajectory_builder.trajectory_builder_3d.ceres_scan_matcher;
    assert_eq!(matcher.intensity_cost_functions().count(), 0);
    assert_eq!(matcher.occupied_space_weights(), [1.0, 6.0]);
}

#[test]
fn keys_of_other_versions_are_understood() {
    let lines = "TRAJECTORY_BUILDER_2D.scans_per_accumulation = 3\nTRAJECTORY_BUILDER_2D.num_accumulated_range_data = nil\n\
                 TRAJECTORY_BUILDER_2D.submaps.resolution = 0.1\n\
                 TRAJECTORY_BUILDER_2D.submaps.grid_options_2d.resolution = nil\n\
                 POSE_GRAPH.optimize_every_n_scans = 5\nPOSE_GRAPH.constraint_builder.max_covariance_trace = 1\n\
                 TRAJECTORY_BUILDER.pure_localization = false\noptions.use_laser_scan = true\noptions.num_laser_scans = nil";
    let config = Options::from_lua("robot.lua", &robot(lines)).unwrap();
    let builder = &config.options.trajectory_builder.trajectory_builder_2d;
    assert_eq!((builder.num_accumulated_range_data, builder.submaps.grid_options_2d.resolution), (3, 0.1));
    // Given under both names: the new one wins.
    assert_eq!(config.options.map_builder.pose_graph.optimize_every_n_nodes, 90);
    assert_eq!(config.options.bridge.num_laser_scans, 1);
    assert_eq!(config.options.trajectory_builder.pure_localization_trimmer, None);
    assert_eq!(config.warnings.len(), 6, "{:?}", config.warnings);
    assert!(config.warnings.iter().all(|warning| matches!(warning, ConfigWarning::OtherVersion { .. })));
    let text: Vec<_> = config.warnings.iter().map(ToString::to_string).collect();
    assert!(text.contains(
        &"robot.lua:2: `trajectory_builder.trajectory_builder_2d.scans_per_accumulation` is from another version: \
          read as `num_accumulated_range_data` = 3"
            .to_owned()
    ));
}

#[test]
fn other_kinds_of_files_are_recognised() {
    let load = |text: &str| Options::from_lua("x.lua", text).unwrap_err().to_string();
    assert!(load("include 'map_builder.lua' return MAP_BUILDER").contains("this is only a part"));
    assert!(
        load("include 'map_builder_server.lua' return MAP_BUILDER_SERVER").contains("map builder server")
    );
    assert!(load("return { pipeline = {} }").contains("pipeline of the assets writer"));
    assert!(load("return {}").contains("Key 'map_builder' not in dictionary"));
}

#[test]
fn settings_win_over_the_file_and_the_file_over_defaults() {
    let settings =
        ["optimize_every_n_nodes=7", "portolan.use_all_odometry=false"].map(str::to_owned).to_vec();
    let loader = Loader { settings, ..Loader::default() };
    let config = loader.load_text("robot.lua", &robot("POSE_GRAPH.optimize_every_n_nodes = 5")).unwrap();
    assert_eq!(config.options.map_builder.pose_graph.optimize_every_n_nodes, 7);
    assert_eq!(config.options.trajectory_builder.trajectory_builder_2d.num_accumulated_range_data, 10);
    assert!(!config.options.portolan.use_all_odometry);
    let config = loader.load_options(Options::for_3d()).unwrap();
    assert_eq!(config.options.map_builder.pose_graph.optimize_every_n_nodes, 7);

    // A setting may repair what the file lacks.
    let settings = vec!["num_laser_scans=1".to_owned()];
    let loader = Loader { settings, ..Loader::default() };
    assert!(loader.load_text("robot.lua", &robot("options.num_multi_echo_laser_scans = 0")).is_ok());
}

/// Lines that give an option a value, creating the tables as needed.
fn assignment(path: &str, value: &str) -> String {
    let mut lines = String::new();
    let mut table = "options".to_owned();
    for segment in path.split('.') {
        if table != "options" {
            lines.push_str(&format!("{table} = {table} or {{}}\n"));
        }
        table.push_str(&format!(".{segment}"));
    }
    format!("{lines}{table} = {value}\n")
}

#[test]
fn absurd_values_in_a_file_are_refused_or_within_bounds() {
    let (mut refused, mut loaded) = (0, 0);
    for doc in portolan_config::catalogue().iter().filter(|doc| !doc.is_table) {
        for value in ["0/0", "math.huge", "-1e300", "0", "true", "{}", "'text'"] {
            match Options::from_lua("robot.lua", &robot(&assignment(&doc.path, value))) {
                Ok(config) => {
                    assert_eq!(config.options.validate(), Ok(()), "{} = {value}", doc.path);
                    loaded += 1;
                }
                Err(error) => {
                    let text = error.to_string();
                    let key = doc.path.rsplit('.').next().unwrap();
                    assert!(text.contains(key), "{} = {value}: {text}", doc.path);
                    refused += 1;
                }
            }
        }
    }
    assert!(refused > 800 && loaded > 200, "{refused} refused, {loaded} loaded");
}
