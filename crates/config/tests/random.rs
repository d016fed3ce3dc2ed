//! Whatever stands in a file: an answer, no panic.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::time::Duration;

use portolan_config::lua::{Limits, dump, evaluate_text};
use portolan_config::{Loader, Options, Strictness};
use proptest::prelude::*;

fn loader() -> Loader {
    let limits = Limits { time: Duration::from_millis(200), memory: 16 << 20 };
    Loader { limits, strictness: Strictness::Warn, ..Loader::default() }
}

/// Pieces of configurations, put together at random.
fn fragment() -> impl Strategy<Value = String> {
    let paths = prop::sample::select(vec![
        "options.map_frame",
        "options.num_laser_scans",
        "options.trajectory_builder",
        "MAP_BUILDER.pose_graph",
        "MAP_BUILDER.num_background_threads",
        "POSE_GRAPH.constraint_builder.min_score",
        "POSE_GRAPH.unknown",
        "TRAJECTORY_BUILDER.pure_localization_trimmer",
        "TRAJECTORY_BUILDER.pure_localization",
        "TRAJECTORY_BUILDER_2D.submaps",
        "TRAJECTORY_BUILDER_2D.submaps.resolution",
        "TRAJECTORY_BUILDER_2D.voxel_filter_size",
        "TRAJECTORY_BUILDER_2D.submaps.grid_options_2d.grid_type",
        "x",
    ]);
    let values = prop_oneof![
        any::<f64>()
            .prop_map(|number| format!("{number:?}").replace("NaN", "0/0").replace("inf", "math.huge")),
        any::<i64>().prop_map(|number| number.to_string()),
        prop::sample::select(vec![
            "nil",
            "true",
            "{}",
            "{ 1, 2 }",
            "{ max_submaps_to_keep = 3 }",
            "'text'",
            "\"TSDF\"",
            "print",
            "choose(true, 1, 2)",
            "include 'pr2.lua'",
            "options",
            "'\\200'",
            "{ { {} } }",
            "math.rad(3)",
        ])
        .prop_map(str::to_owned),
    ];
    (paths, values).prop_map(|(path, value)| format!("{path} = {value}\n"))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn random_text_never_panics(text in "\\PC{0,200}") {
        let _ = loader().load_text("random.lua", &text);
        let _ = Options::from_json(&text);
        let _ = Options::for_2d().set(&text);
    }

    #[test]
    fn random_assignments_never_panic_and_load_only_valid_options(lines in prop::collection::vec(fragment(), 0..5)) {
        let text = format!("include 'backpack_2d.lua'\n{}return options\n", lines.concat());
        if let Ok(config) = loader().load_text("random.lua", &text) {
            prop_assert_eq!(config.options.validate(), Ok(()));
            let again = Options::from_lua("again.lua", &config.options.to_lua()).unwrap();
            prop_assert_eq!(&again.options, &config.options);
            let again = Options::from_json(&config.options.to_json()).unwrap();
            prop_assert_eq!(again.options, config.options);
        }
    }

    #[test]
    fn a_cut_configuration_never_panics(end in 0_usize..1200) {
        let text = portolan_config::lua::built_in_file("pose_graph.lua").unwrap();
        let cut = text.get(..end.min(text.len())).unwrap();
        let _ = loader().load_text("cut.lua", &format!("{cut}\nreturn POSE_GRAPH"));
    }

    #[test]
    fn dumps_parse_back(entries in prop::collection::btree_map("[a-z_]{1,6}", "\\PC{0,12}", 0..6)) {
        let reserved = ["and", "break", "do", "else", "elseif", "end", "false", "for", "goto", "if", "in", "local",
            "nil", "not", "or", "repeat", "return", "then", "true", "until", "while"];
        prop_assume!(entries.keys().all(|key| !reserved.contains(&key.as_str())));
        let table = portolan_config::Table {
            array: Vec::new(),
            entries: entries.into_iter().map(|(key, text)| (key, portolan_config::Value::Text(text))).collect(),
        };
        let again = evaluate_text("dump", &format!("return {}", dump(&table)), &[], Limits::default()).unwrap();
        prop_assert_eq!(again.table, table);
    }

    #[test]
    fn random_settings_never_panic(path in "[a-z_.]{0,40}", value in "\\PC{0,20}") {
        let mut options = Options::for_2d();
        let _ = options.set(&format!("{path}={value}"));
        prop_assert_eq!(options.validate(), Ok(()));
    }
}
