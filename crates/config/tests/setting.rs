//! Single options by path, listings, other forms.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use portolan_config::{ConfigError, Engine, Options, Value, catalogue, explain, explain_all};

fn set(setting: &str) -> Result<Options, ConfigError> {
    let mut options = Options::for_2d();
    options.set(setting).map(|()| options)
}

fn error(setting: &str) -> String {
    let mut options = Options::for_2d();
    let error = options.set(setting).unwrap_err().to_string();
    assert_eq!(options, Options::for_2d(), "{setting} must change nothing");
    error
}

#[test]
fn paths_may_be_full_or_short() {
    for path in [
        "map_builder.pose_graph.constraint_builder.min_score",
        "pose_graph.constraint_builder.min_score",
        "constraint_builder.min_score",
        "min_score",
        "POSE_GRAPH.constraint_builder.min_score",
        " options.map_builder.pose_graph.constraint_builder.min_score ",
    ] {
        let options = set(&format!("{path}=0.77")).unwrap();
        assert_eq!(options.map_builder.pose_graph.constraint_builder.min_score, 0.77, "{path}");
    }
    for path in ["use_odometry", "bridge.use_odometry", "options.use_odometry"] {
        assert!(set(&format!("{path} = true")).unwrap().bridge.use_odometry, "{path}");
    }
    assert_eq!(
        set("TRAJECTORY_BUILDER_2D.min_range=0.5")
            .unwrap()
            .trajectory_builder
            .trajectory_builder_2d
            .min_range,
        0.5
    );
}

#[test]
fn values_are_written_as_in_lua() {
    let window = |text: &str| {
        let path = "fast_correlative_scan_matcher.angular_search_window";
        let options = set(&format!("{path}={text}")).unwrap();
        options.map_builder.pose_graph.constraint_builder.fast_correlative_scan_matcher.angular_search_window
    };
    assert_eq!(window("0.25"), 0.25);
    assert_eq!(window("1e-1"), 0.1);
    assert_eq!(window("math.rad(45.)"), 45.0_f64.to_radians());
    assert_eq!(window("20deg"), 20.0_f64.to_radians());
    let options = set("trajectory_builder_2d.max_z=math.huge").unwrap();
    assert_eq!(options.trajectory_builder.trajectory_builder_2d.max_z, f32::INFINITY);
    assert_eq!(set("tracking_frame=imu").unwrap().bridge.tracking_frame, "imu");
    assert_eq!(set("tracking_frame=\"a = b\"").unwrap().bridge.tracking_frame, "a = b");
    let options = set("grid_type=TSDF").unwrap();
    assert_eq!(
        options.trajectory_builder.trajectory_builder_2d.submaps.grid_options_2d.grid_type.name(),
        "TSDF"
    );
}

#[test]
fn optional_tables_can_be_added_and_removed() {
    let mut options = set("pure_localization_trimmer.max_submaps_to_keep=4").unwrap();
    let keep = |options: &Options| {
        options
            .trajectory_builder
            .pure_localization_trimmer
            .as_ref()
            .map(|trimmer| trimmer.max_submaps_to_keep)
    };
    assert_eq!(keep(&options), Some(4));
    options.set("pure_localization_trimmer=nil").unwrap();
    assert_eq!(keep(&options), None);
    options.set("pure_localization_trimmer=default").unwrap();
    assert_eq!(keep(&options), Some(3));
    assert!(error("pure_localization_trimmer.max_submaps_to_keep=1").contains(">= 2"));
}

#[test]
fn errors_give_advice() {
    assert_eq!(
        error("min_scor=1"),
        "unknown option `min_scor`; did you mean `map_builder.pose_graph.constraint_builder.min_score`?"
    );
    assert!(
        error("constrain_builder.min_score=1")
            .contains("`map_builder.pose_graph.constraint_builder.min_score`")
    );
    assert!(
        error("pose_graph.min_score=1").contains("`map_builder.pose_graph.constraint_builder.min_score`")
    );
    assert!(error("voxel_filter_size=1").contains("fits several options"));
    assert!(
        error("voxel_filter_size=1").contains("trajectory_builder.trajectory_builder_3d.voxel_filter_size")
    );
    assert!(error("min_score").contains("path=value"));
    assert!(error("=1").contains("path=value"));
    assert!(error("min_score=high").contains("must be number, but is `high`"));
    assert!(error("use_odometry=1").contains("must be boolean"));
    assert!(error("optimize_every_n_nodes=1.5").contains("must be integer"));
    assert!(error("pose_graph.global_sampling_ratio=2").contains("0 to 1"));
    assert!(error("global_sampling_ratio=0/0").contains("out of bounds"));
    assert!(error("trajectory_builder_2d.voxel_filter_size=1e-60").contains("> 0"));
    assert!(error("num_background_threads=-3").contains("1 to 1024"));
    assert!(error("num_range_data=1").contains("fits several"));
    assert!(error("constraint_builder=1").contains("a table"));
    assert!(error("grid_type=GRID").contains("PROBABILITY_GRID"));
    assert!(error("min_score=while true do end").contains("must be number"));
}

#[test]
fn every_option_can_be_set_to_its_value_by_its_full_path() {
    let mut options = Options::for_2d();
    for entry in Options::for_2d().entries() {
        let text = match &entry.value {
            Value::Text(text) => text.clone(),
            _ => entry.to_string().split_once(" = ").unwrap().1.to_owned(),
        };
        options
            .set(&format!("{}={text}", entry.path))
            .unwrap_or_else(|error| panic!("{}: {error}", entry.path));
        assert_eq!(options.get(&entry.path).unwrap(), Some(entry.value), "{}", entry.path);
    }
    assert_eq!(options, Options::for_2d());
}

#[test]
fn absent_tables_have_documented_options() {
    let doc = explain("overlapping_submaps_trimmer_2d.min_covered_area").unwrap();
    assert_eq!((doc.default.as_str(), doc.unit, doc.is_table), ("2", "m²", false));
    assert_eq!(Options::default().get("overlapping_submaps_trimmer_2d.min_covered_area").unwrap(), None);
    assert_eq!(explain("nothing"), None);
    assert_eq!(explain("voxel_filter_size"), None);
    assert_eq!(explain_all("voxel_filter_size").len(), 2);
    assert!(explain("constraint_builder").unwrap().is_table);
}

#[test]
fn defaults_are_within_their_bounds_and_names_are_sound() {
    for options in [Options::for_2d(), Options::for_3d()] {
        assert_eq!(options.validate(), Ok(()));
    }
    assert!(Options::default().validate().is_err(), "a dimension must be chosen");
    let options = catalogue().iter().filter(|doc| !doc.is_table).count();
    assert!(options > 200, "{options}");
    let mut paths: Vec<_> = catalogue().iter().map(|doc| &doc.path).collect();
    paths.sort();
    assert!(paths.windows(2).all(|pair| pair[0] != pair[1]));
}

#[test]
fn validate_finds_every_number_out_of_bounds() {
    let mut options = Options::for_2d();
    options.map_builder.pose_graph.constraint_builder.sampling_ratio = 1.5;
    options.trajectory_builder.trajectory_builder_2d.min_range = f32::NAN;
    options.trajectory_builder.trajectory_builder_3d.min_range = -1.0;
    let errors = options.validate().unwrap_err();
    assert_eq!(errors.len(), 2, "{errors:?}");
    assert!(errors[0].to_string().contains("constraint_builder.sampling_ratio` = 1.5"));
    assert!(errors[1].to_string().contains("trajectory_builder_2d.min_range` = NaN"));
    options.map_builder.use_trajectory_builder_2d = false;
    options.map_builder.use_trajectory_builder_3d = true;
    assert!(options.validate().unwrap_err()[1].to_string().contains("trajectory_builder_3d.min_range` = -1"));
}

#[test]
fn lua_and_json_round_trip_to_equal_options() {
    let mut options = Options::for_3d();
    for setting in [
        "pure_localization_trimmer.max_submaps_to_keep=5",
        "trajectory_builder_3d.max_range=math.huge",
        "trajectory_builder_3d.voxel_filter_size=0.1",
        "map_frame=a \"quoted\" \\ frame",
        "intensity_cost_function_options_1=default",
        "huber_scale=0.1",
    ] {
        if setting.starts_with("huber") {
            options.set("optimization_problem.huber_scale=0.30000000000000004").unwrap();
        } else {
            options
                .set(
                    &setting
                        .replace("intensity_cost", "trajectory_builder_3d.ceres_scan_matcher.intensity_cost"),
                )
                .unwrap();
        }
    }
    assert_eq!(Options::from_lua("x.lua", &options.to_lua()).unwrap().options, options);
    assert_eq!(Options::from_json(&options.to_json()).unwrap().options, options);
    assert!(options.to_lua().contains("match_surfaces = false"));
    options.set_engine(Engine::Planes);
    assert!(!options.to_lua().contains("portolan"));
    assert_eq!(Options::from_lua("x.lua", &options.to_lua()).unwrap().options, options);
    options.portolan.use_all_odometry = false;
    assert_eq!(Options::from_lua("x.lua", &options.to_lua()).unwrap().options, options);
    assert!(serde_json::to_string(&options).unwrap().contains("\"voxel_filter_size\":0.1}"));
}

#[test]
fn json_may_be_partial_and_must_be_valid() {
    let text = r#"{ "map_builder": { "use_trajectory_builder_2d": true }, "num_laser_scans": 1 }"#;
    let config = Options::from_json(text).unwrap();
    assert_eq!((config.options, config.warnings.len()), (Options::for_2d(), 0));
    for text in ["", "[]", "{", r#"{ "speed": 1 }"#, r#"{ "use_odometry": "yes" }"#] {
        assert!(Options::from_json(text).is_err(), "{text}");
    }
}

#[test]
fn fingerprints_of_different_configurations_differ() {
    let options = Options::for_2d();
    assert_eq!(options.fingerprint().len(), 32);
    assert_eq!(options.fingerprint(), Options::for_2d().fingerprint());
    let mut seen = vec![options.fingerprint()];
    for setting in
        ["min_score=0.56", "map_frame=m", "pure_localization_trimmer={}", "portolan.use_all_odometry=false"]
    {
        seen.push(set(setting).unwrap().fingerprint());
    }
    seen.sort();
    seen.dedup();
    assert_eq!(seen.len(), 5);
}

#[test]
fn changes_are_listed() {
    let options = set("min_score=0.6").unwrap();
    let changes: Vec<_> = options.changed_entries().iter().map(ToString::to_string).collect();
    assert_eq!(
        changes,
        [
            "map_builder.use_trajectory_builder_2d = true",
            "map_builder.pose_graph.constraint_builder.min_score = 0.6",
            "num_laser_scans = 1"
        ]
    );
}

#[test]
fn bands_must_not_be_empty() {
    let mut options = Options::for_2d();
    options.set("trajectory_builder_2d.min_range=30").unwrap();
    options.set("trajectory_builder_2d.min_z=3").unwrap();
    // Not in use.
    options.set("trajectory_builder_3d.min_range=90").unwrap();
    let errors: Vec<String> = options.validate().unwrap_err().iter().map(ToString::to_string).collect();
    assert_eq!(errors.len(), 2, "{errors:?}");
    assert!(errors[0].contains("min_range` = 30 must be less than") && errors[1].contains("max_z` = 2"));
    let mut options = Options::for_3d();
    options.set("trajectory_builder_3d.min_range=60").unwrap();
    assert_eq!(options.validate().unwrap_err().len(), 1);
}
