//! Configurations of real robots load.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::{Path, PathBuf};

use portolan_config::{ConfigWarning, LoadedConfig, Options};
use portolan_testing::real_data;

/// The Lua files of a folder of the real data that return the configuration of a robot; nothing when
/// the data is missing.
fn robots(folder: &str) -> Vec<PathBuf> {
    let Some(folder) = real_data(folder) else { return Vec::new() };
    let entries = std::fs::read_dir(folder).unwrap();
    let mut files: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "lua"));
    files.retain(|path| String::from_utf8_lossy(&std::fs::read(path).unwrap()).contains("return options"));
    files.sort();
    assert!(!files.is_empty());
    files
}

fn load(path: &Path) -> LoadedConfig {
    Options::from_lua_file(path, &[]).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn every_configuration_of_a_robot_loads_and_survives_a_round_trip() {
    for path in robots("configs").iter().chain(&robots("maps/reference")) {
        let config = load(path);
        let is_old_key = |warning: &ConfigWarning| matches!(warning, ConfigWarning::OtherVersion { .. });
        let name = path.file_name().unwrap().to_str().unwrap();
        let expected =
            usize::from(matches!(name, "ironfish_allcarto_locali.lua" | "ironfish_seperate_locali.lua"));
        assert_eq!(config.warnings.len(), expected, "{name}: {:?}", config.warnings);
        assert!(config.warnings.iter().all(is_old_key), "{name}: {:?}", config.warnings);
        let again = Options::from_lua("again.lua", &config.options.to_lua()).unwrap();
        assert_eq!(again.options, config.options, "{name}");
        assert_eq!(again.warnings, [], "{name}");
        assert_eq!(Options::from_json(&config.options.to_json()).unwrap().options, config.options, "{name}");
    }
}

#[test]
fn values_of_some_real_robots() {
    for path in robots("configs") {
        let options = load(&path).options;
        let builder = &options.trajectory_builder;
        match path.file_stem().unwrap().to_str().unwrap() {
            "AGV_backpack_2d_localization" => {
                assert_eq!(builder.pure_localization_trimmer.as_ref().unwrap().max_submaps_to_keep, 2);
                assert_eq!(options.map_builder.pose_graph.optimize_every_n_nodes, 15);
                assert_eq!(builder.trajectory_builder_2d.max_range, 6.0);
                assert!(options.bridge.publish_tracked_pose);
            }
            "ironfish_allcarto_locali" => {
                assert_eq!(builder.pure_localization_trimmer.as_ref().unwrap().max_submaps_to_keep, 3);
                assert_eq!(options.bridge.odometry_sampling_ratio, 0.5);
            }
            "jetbot" => assert_eq!(builder.trajectory_builder_2d.submaps.num_range_data, 35),
            _ => {}
        }
    }
}
