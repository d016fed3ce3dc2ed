//! The pose graph in 3D: what it shares with that in 2D has its effects there, too.

use std::collections::BTreeSet;

use portolan::config::Options;
use portolan::geometry::Rigid3;
use portolan::mapping::{
    ConstraintTag, InitialTrajectoryPose, Map, PoseGraph, SearchCounts, Space3d, TrajectoryId,
};
use portolan::sensor::{Measurement, SensorId, SensorKind};

use crate::effect::{Effect, check, effects};
use crate::run::{Run, mapper, run, sensor, trajectory};
use crate::world::{at, imu, on_circle, scan_3d};

pub fn base() -> Options {
    let mut options = crate::local_3d::base();
    options.trajectory_builder.trajectory_builder_3d.submaps.num_range_data = 2;
    options.trajectory_builder.trajectory_builder_3d.submaps.high_resolution = 0.3;
    let search = &mut options.map_builder.pose_graph.constraint_builder;
    search.sampling_ratio = 0.5;
    search.min_score = 0.2;
    let window = &mut search.fast_correlative_scan_matcher_3d;
    (window.linear_xy_search_window, window.linear_z_search_window) = (0.3, 0.3);
    (window.angular_search_window, window.min_low_resolution_score) = (0.05, 0.2);
    window.min_rotational_score = 0.2;
    options
}

/// So many steps of half a second round a circle, with an IMU in between.
pub fn laps(steps: u32) -> Vec<Measurement> {
    let mut measurements = vec![Measurement::Imu(imu(-0.01, 0.0, 0.4))];
    for tick in 0..5 * steps {
        let seconds = 0.1 * f64::from(tick);
        measurements.push(Measurement::Imu(imu(seconds, 0.0, 0.4)));
        if tick % 5 == 0 {
            measurements.push(Measurement::Range(scan_3d(&on_circle(seconds), seconds)));
        }
    }
    measurements
}

fn lap(options: &Options) -> Run<Space3d> {
    run(options, laps(10))
}

fn searches(options: &Options) -> SearchCounts {
    lap(options).map.graph.search_counts()
}

/// The same path twice, as two trajectories; the start of the second may be given.
fn two_laps(options: &Options, is_start_given: bool) -> Map<Space3d> {
    let mut mapper = mapper::<Space3d>(options);
    let sensors: BTreeSet<SensorId> = [SensorKind::Range, SensorKind::Imu].map(sensor).into_iter().collect();
    for lap in 0..2 {
        let start = (lap == 1 && is_start_given).then(|| InitialTrajectoryPose {
            to_trajectory_id: TrajectoryId(0),
            relative_pose: Rigid3::identity(),
            time: at(0.0),
        });
        let id = mapper.add_trajectory(&sensors, start).unwrap();
        for measurement in laps(6) {
            mapper.add(id, &sensor(measurement.kind()), measurement).unwrap();
        }
        mapper.finish_trajectory(id).unwrap();
    }
    mapper.finish().unwrap().0
}

fn weight(options: &Options, tag: ConstraintTag, which: usize) -> f64 {
    let run = lap(options);
    let constraints = &run.map.graph.state().constraints;
    let found = constraints.iter().find(|c| c.tag == tag).unwrap();
    [found.translation_weight, found.rotation_weight][which]
}

/// Submaps while the trajectory is still being mapped.
fn submaps_meanwhile(options: &Options) -> f64 {
    let mut mapper = mapper::<Space3d>(options);
    let id = trajectory(&mut mapper, &[SensorKind::Range, SensorKind::Imu]);
    for measurement in laps(12) {
        mapper.add(id, &sensor(measurement.kind()), measurement).unwrap();
    }
    let count = |graph: &mut PoseGraph<Space3d>| {
        graph.optimize();
        graph.state().submaps.len()
    };
    mapper.with_pose_graph(count).unwrap() as f64
}

fn table() -> Vec<Effect> {
    effects! {
        "optimize_every_n_nodes", "0" => "3", Rises, |o| lap(o).map.graph.optimizations().0 as f64;
        "max_num_final_iterations", "1" => "200", Rises, |o| f64::from(lap(o).map.graph.optimizations().1.iterations),
            ["optimization_problem.ceres_solver_options.max_num_iterations=1", "portolan.drop_contradicted_loop_closures=false"];
        "matcher_translation_weight", "100" => "1000", Rises, |o| weight(o, ConstraintTag::IntraSubmap, 0);
        "matcher_rotation_weight", "100" => "1000", Rises, |o| weight(o, ConstraintTag::IntraSubmap, 1);
        "loop_closure_translation_weight", "100" => "1000", Rises, |o| weight(o, ConstraintTag::InterSubmap, 0);
        "loop_closure_rotation_weight", "100" => "1000", Rises, |o| weight(o, ConstraintTag::InterSubmap, 1);
        "constraint_builder.sampling_ratio", "0.1" => "1", Rises, |o| searches(o).window_searched as f64;
        "constraint_builder.max_constraint_distance", "0.05" => "15", Rises, |o| searches(o).window_searched as f64;
        "constraint_builder.min_score", "0.1" => "0.99", Falls, |o| searches(o).window_found as f64;
        "constraint_builder.global_localization_min_score", "0.1" => "0.99", Falls,
            |o| two_laps(o, false).graph.search_counts().whole_submap_found as f64,
            ["pose_graph.global_sampling_ratio=0.2", "pose_graph.global_constraint_search_after_n_seconds=0"];
        "pose_graph.global_sampling_ratio", "0" => "0.2", Rises,
            |o| two_laps(o, false).graph.search_counts().whole_submap_searched as f64,
            ["pose_graph.global_constraint_search_after_n_seconds=0"];
        "pose_graph.global_constraint_search_after_n_seconds", "0" => "100000", Falls,
            |o| two_laps(o, true).graph.search_counts().whole_submap_searched as f64,
            ["pose_graph.global_sampling_ratio=0.2"];
        "pure_localization_trimmer.max_submaps_to_keep", "2" => "4", Rises, submaps_meanwhile;
    }
}

#[test]
fn options_of_the_pose_graph_have_their_effects_in_3d() {
    check(&base(), &table());
}
