//! Keys of other versions of the program: converted to the present keys, with a warning.

use crate::value::{Table, Value};

/// Present meaning of an old key.
enum Now {
    /// It moved: the new path, relative to the same table.
    Moved(&'static str),
    /// It moved, and a switch became a number of sensors.
    Count(&'static str),
    /// It has no meaning any more, with the reason.
    Removed(&'static str),
}

const LOCAL_2D: &str = "trajectory_builder.trajectory_builder_2d";
const LOCAL_3D: &str = "trajectory_builder.trajectory_builder_3d";
const SUBMAPS_2D: &str = "trajectory_builder.trajectory_builder_2d.submaps";
const INSERTER_2D: &str = "trajectory_builder.trajectory_builder_2d.submaps.range_data_inserter";
const POSE_GRAPH: &str = "map_builder.pose_graph";
const CONSTRAINTS: &str = "map_builder.pose_graph.constraint_builder";
const PROBLEM: &str = "map_builder.pose_graph.optimization_problem";

/// Table, old key, present meaning. Tables come before the tables within them.
const RULES: &[(&str, &str, Now)] = &[
    ("", "use_laser_scan", Now::Count("num_laser_scans")),
    ("", "use_multi_echo_laser_scan", Now::Count("num_multi_echo_laser_scans")),
    ("", "use_horizontal_laser", Now::Count("num_laser_scans")),
    ("", "use_horizontal_multi_echo_laser", Now::Count("num_multi_echo_laser_scans")),
    ("", "num_lasers_3d", Now::Moved("num_point_clouds")),
    ("map_builder", "sparse_pose_graph", Now::Moved("pose_graph")),
    (POSE_GRAPH, "optimize_every_n_scans", Now::Moved("optimize_every_n_nodes")),
    (
        CONSTRAINTS,
        "adaptive_voxel_filter",
        Now::Removed("constraints are sought with the cloud of local SLAM"),
    ),
    (CONSTRAINTS, "max_covariance_trace", Now::Removed("covariances are not used")),
    (CONSTRAINTS, "lower_covariance_eigenvalue_bound", Now::Removed("covariances are not used")),
    (PROBLEM, "log_residual_histograms", Now::Removed("it stands in pose_graph now")),
    (
        PROBLEM,
        "consecutive_scan_translation_penalty_factor",
        Now::Removed("see local_slam_pose_translation_weight"),
    ),
    (
        PROBLEM,
        "consecutive_scan_rotation_penalty_factor",
        Now::Removed("see local_slam_pose_rotation_weight"),
    ),
    (PROBLEM, "consecutive_node_translation_weight", Now::Moved("local_slam_pose_translation_weight")),
    (PROBLEM, "consecutive_node_rotation_weight", Now::Moved("local_slam_pose_rotation_weight")),
    (LOCAL_2D, "scans_per_accumulation", Now::Moved("num_accumulated_range_data")),
    (LOCAL_2D, "laser_min_range", Now::Moved("min_range")),
    (LOCAL_2D, "laser_max_range", Now::Moved("max_range")),
    (LOCAL_2D, "laser_min_z", Now::Moved("min_z")),
    (LOCAL_2D, "laser_max_z", Now::Moved("max_z")),
    (LOCAL_2D, "laser_missing_echo_ray_length", Now::Moved("missing_data_ray_length")),
    (LOCAL_2D, "laser_voxel_filter_size", Now::Moved("voxel_filter_size")),
    (LOCAL_2D, "horizontal_laser_min_range", Now::Moved("min_range")),
    (LOCAL_2D, "horizontal_laser_max_range", Now::Moved("max_range")),
    (LOCAL_2D, "horizontal_laser_min_z", Now::Moved("min_z")),
    (LOCAL_2D, "horizontal_laser_max_z", Now::Moved("max_z")),
    (LOCAL_2D, "horizontal_laser_missing_echo_ray_length", Now::Moved("missing_data_ray_length")),
    (LOCAL_2D, "horizontal_laser_voxel_filter_size", Now::Moved("voxel_filter_size")),
    (LOCAL_2D, "num_odometry_states", Now::Removed("odometry enters the pose extrapolator")),
    (LOCAL_2D, "max_time_between_updates", Now::Removed("see motion_filter")),
    (LOCAL_3D, "scans_per_accumulation", Now::Moved("num_accumulated_range_data")),
    (LOCAL_3D, "laser_min_range", Now::Moved("min_range")),
    (LOCAL_3D, "laser_max_range", Now::Moved("max_range")),
    (LOCAL_3D, "laser_voxel_filter_size", Now::Moved("voxel_filter_size")),
    (LOCAL_3D, "num_odometry_states", Now::Removed("odometry enters the pose extrapolator")),
    (LOCAL_3D, "kalman_local_trajectory_builder", Now::Removed("the builder with a Kalman filter is gone")),
    (LOCAL_3D, "optimizing_local_trajectory_builder", Now::Removed("the optimising builder is gone")),
    (LOCAL_3D, "use", Now::Removed("there is one builder only")),
    (SUBMAPS_2D, "resolution", Now::Moved("grid_options_2d.resolution")),
    (SUBMAPS_2D, "num_laser_fans", Now::Moved("num_range_data")),
    (SUBMAPS_2D, "half_map_size", Now::Removed("grids grow as needed")),
    (SUBMAPS_2D, "output_debug_images", Now::Removed("submaps can be exported from the map")),
    (INSERTER_2D, "insert_free_space", Now::Moved("probability_grid_range_data_inserter.insert_free_space")),
    (INSERTER_2D, "hit_probability", Now::Moved("probability_grid_range_data_inserter.hit_probability")),
    (INSERTER_2D, "miss_probability", Now::Moved("probability_grid_range_data_inserter.miss_probability")),
];

/// An old key in a file: the path as written and what it was converted to.
pub(crate) struct OldKey {
    pub path: String,
    pub outcome: String,
}

/// Moves the values of old keys to their new places. If the new key is given, too, its value is used.
pub(crate) fn modernise(root: &mut Table) -> Vec<OldKey> {
    let mut found = Vec::new();
    for (path, key, now) in RULES {
        let Some(table) = table_mut(root, path, false) else { continue };
        let Some(value) = table.entries.remove(*key) else { continue };
        let outcome = match now {
            Now::Removed(reason) => format!("ignored, {reason}"),
            Now::Moved(to) => place(table, to, value),
            Now::Count(to) => place(table, to, count(value)),
        };
        found.push(OldKey { path: crate::catalogue::join(path, key), outcome });
    }
    found.extend(pure_localization(root));
    found
}

/// `pure_localization = true` of older versions, which kept the newest three submaps.
fn pure_localization(root: &mut Table) -> Option<OldKey> {
    let builder = table_mut(root, "trajectory_builder", false)?;
    let outcome = match builder.entries.get("pure_localization")? {
        Value::Boolean(true) => {
            let keep = Value::Number(3.0);
            place(builder, "pure_localization_trimmer.max_submaps_to_keep", keep)
        }
        Value::Boolean(false) => "ignored, localisation is off without pure_localization_trimmer".to_owned(),
        _ => return None,
    };
    builder.entries.remove("pure_localization");
    Some(OldKey { path: "trajectory_builder.pure_localization".to_owned(), outcome })
}

fn count(value: Value) -> Value {
    match value {
        Value::Boolean(on) => Value::Number(if on { 1.0 } else { 0.0 }),
        other => other,
    }
}

/// Stores a value at a path relative to a table unless there is one.
fn place(table: &mut Table, to: &str, value: Value) -> String {
    let (parent, key) = to.rsplit_once('.').unwrap_or(("", to));
    let Some(parent) = table_mut(table, parent, true) else {
        return format!("ignored, `{to}` cannot take it");
    };
    if parent.entries.contains_key(key) {
        return format!("ignored, `{to}` is given too");
    }
    let shown = if matches!(value, Value::Table(_)) {
        String::new()
    } else {
        format!(" = {}", crate::lua::lua_literal(&value))
    };
    parent.entries.insert(key.to_owned(), value);
    format!("read as `{to}`{shown}")
}

fn table_mut<'a>(root: &'a mut Table, path: &str, make: bool) -> Option<&'a mut Table> {
    let mut table = root;
    for key in path.split('.').filter(|key| !key.is_empty()) {
        if make && !table.entries.contains_key(key) {
            table.entries.insert(key.to_owned(), Value::Table(Table::default()));
        }
        match table.entries.get_mut(key) {
            Some(Value::Table(nested)) => table = nested,
            _ => return None,
        }
    }
    Some(table)
}
