//! Options that are read, checked and written, but have no effect.
//!
//! Files of Cartographer must load, so these keys exist. This list is the only place that defines which they
//! are: the documentation of each option in it, or within a table in it, ends with the reason.

use crate::catalogue::explain;
use crate::options::Options;

const LIVE: &str = "it belongs to the live output of ROS, and Portolan publishes nothing";
const NO_THREADS: &str = "one scan match runs on one thread; `--threads` and `num_background_threads` say how many \
                          searches run side by side and how many threads optimise";
const NOT_IN_2D: &str = "in 2D poses are predicted with constant velocity only, as in Cartographer";
const LIVE_GRAVITY: &str = "the live pose output of ROS reads it; mapping reads \
                            `pose_extrapolator.constant_velocity.imu_gravity_time_constant`";
const NO_FINISHED_INTENSITIES: &str = "finished submaps hold no intensities, in Cartographer neither";

/// Paths of options and tables with the reason why they have no effect. A path that begins with `*` matches
/// all paths with this end.
const WITHOUT_EFFECT: &[(&str, &str)] = &[
    ("*solver_options.num_threads", NO_THREADS),
    (
        "map_builder.pose_graph.constraint_builder.ceres_scan_matcher_3d.intensity_cost_function_options_0",
        NO_FINISHED_INTENSITIES,
    ),
    (
        "map_builder.pose_graph.constraint_builder.ceres_scan_matcher_3d.intensity_cost_function_options_1",
        NO_FINISHED_INTENSITIES,
    ),
    (
        "trajectory_builder.trajectory_builder_2d.loop_closure_adaptive_voxel_filter",
        "maps keep it; loop closures use the cloud of `adaptive_voxel_filter`, as in Cartographer",
    ),
    ("trajectory_builder.trajectory_builder_2d.imu_gravity_time_constant", LIVE_GRAVITY),
    ("trajectory_builder.trajectory_builder_2d.pose_extrapolator.imu_based", NOT_IN_2D),
    (
        "trajectory_builder.trajectory_builder_3d.ceres_scan_matcher.intensity_cost_function_options_1",
        "the low-resolution grid holds no intensities",
    ),
    ("trajectory_builder.trajectory_builder_3d.imu_gravity_time_constant", LIVE_GRAVITY),
    ("published_frame", LIVE),
    ("odom_frame", LIVE),
    ("provide_odom_frame", LIVE),
    ("publish_frame_projected_to_2d", LIVE),
    ("lookup_transform_timeout_sec", "all transforms of a recording are known from the start"),
    ("submap_publish_period_sec", LIVE),
    ("pose_publish_period_sec", LIVE),
    ("trajectory_publish_period_sec", LIVE),
    ("publish_to_tf", LIVE),
    ("publish_tracked_pose", LIVE),
    ("use_pose_extrapolator", LIVE),
];

const GRIDS_ONLY: &str = "scans are matched to planes, and to grids only where that fails, unless --engine grids \
                          (`portolan.match_surfaces = false`) is given";
const NO_WHEELS_WITH_IMU: &str = "in 3D with an IMU, wheel odometry is used in local SLAM and adds no constraints \
                                  of its own, unless `fix_z_in_3d` is on";

/// Paths of options of 3D mapping that have an effect only if scans are matched to grids, with the reason.
const WITHOUT_EFFECT_ON_SURFACES: &[(&str, &str)] = &[
    ("trajectory_builder.trajectory_builder_3d.ceres_scan_matcher", GRIDS_ONLY),
    ("trajectory_builder.trajectory_builder_3d.use_online_correlative_scan_matching", GRIDS_ONLY),
    ("trajectory_builder.trajectory_builder_3d.real_time_correlative_scan_matcher", GRIDS_ONLY),
    ("trajectory_builder.trajectory_builder_3d.use_intensities", GRIDS_ONLY),
    ("map_builder.pose_graph.constraint_builder.ceres_scan_matcher_3d", GRIDS_ONLY),
];

/// Why an option that the user set, given by its path or an end of it, has little or no effect with these
/// `options`.
pub fn little_effect(path: &str, options: &Options, has_imu: bool) -> Option<&'static str> {
    let path = explain(path)?.path;
    let in_3d = options.map_builder.use_trajectory_builder_3d;
    let problem = &options.map_builder.pose_graph.optimization_problem;
    let of_wheels = path.starts_with("map_builder.pose_graph.optimization_problem.odometry_");
    if of_wheels && in_3d && has_imu && !problem.fix_z_in_3d {
        return Some(NO_WHEELS_WITH_IMU);
    }
    let is_on = in_3d && options.portolan.match_surfaces;
    let meant = |entry: &&(&str, &str)| path.strip_prefix(entry.0).is_some_and(is_end_of_name);
    let on_surfaces = WITHOUT_EFFECT_ON_SURFACES.iter().find(meant).filter(|_| is_on);
    on_surfaces.map(|(_, reason)| *reason).or_else(|| without_effect(&path))
}

fn is_end_of_name(rest: &str) -> bool {
    rest.is_empty() || rest.starts_with('.')
}

/// Why the option or table at a full path has no effect; `None` if it has one.
pub(crate) fn without_effect(path: &str) -> Option<&'static str> {
    let is_meant = |entry: &str| match entry.strip_prefix('*') {
        Some(end) => path.ends_with(end),
        None => path.strip_prefix(entry).is_some_and(is_end_of_name),
    };
    WITHOUT_EFFECT.iter().find(|(entry, _)| is_meant(entry)).map(|(_, reason)| *reason)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalogue::catalogue;

    #[test]
    fn options_of_grids_are_reported_where_surfaces_are_matched() {
        let mut options = Options::for_3d();
        for (entry, reason) in WITHOUT_EFFECT_ON_SURFACES {
            assert!(explain(entry).is_some(), "{entry} is no option");
            options.portolan.match_surfaces = true;
            assert_eq!(little_effect(entry, &options, true), Some(*reason));
            options.portolan.match_surfaces = false;
            assert_eq!(little_effect(entry, &options, true), None);
        }
        let wheels = "optimization_problem.odometry_translation_weight";
        assert_eq!(little_effect(wheels, &options, true), Some(NO_WHEELS_WITH_IMU));
        assert_eq!(little_effect(wheels, &options, false), None);
        assert_eq!(little_effect(wheels, &Options::for_2d(), true), None);
        assert_eq!(little_effect("publish_to_tf", &options, true), Some(LIVE));
    }

    #[test]
    fn every_entry_is_an_option_with_documentation() {
        for (entry, reason) in WITHOUT_EFFECT {
            let meant = |path: &str| match entry.strip_prefix('*') {
                Some(end) => path.ends_with(end),
                None => path == *entry,
            };
            let mut docs = catalogue().iter().filter(|doc| meant(&doc.path)).peekable();
            assert!(docs.peek().is_some(), "{entry} is no option");
            for doc in docs {
                assert!(doc.doc.contains(reason) && doc.without_effect == Some(*reason), "{}", doc.path);
            }
        }
        let inner = "trajectory_builder.trajectory_builder_2d.pose_extrapolator.imu_based.gravity_constant";
        assert_eq!(without_effect(inner), Some(NOT_IN_2D));
        assert_eq!(without_effect("published_frames"), None);
    }
}
