//! Local SLAM in 3D.

use portolan::config::Options;
use portolan::geometry::{Quaternion, Rigid3, Vector3, roll_pitch_yaw, rotation_from_roll_pitch_yaw};
use portolan::grids::HybridGrid;
use portolan::grids::value::PROBABILITY_CODE;
use portolan::mapping::{LocalSlam, Space, Space3d};
use portolan::sensor::{Measurement, SensorKind, TimedPointCloudData};
use portolan::submaps::Submap3d;

use crate::effect::{Effect, check, effects};
use crate::run::{Run, run, sensor};
use crate::world::{imu, odometry, on_circle, pose, scan_3d};

pub fn base() -> Options {
    let mut options = Options::for_3d();
    let local = &mut options.trajectory_builder.trajectory_builder_3d;
    local.submaps.num_range_data = 4;
    local.motion_filter.max_time_seconds = 0.1;
    options.map_builder.pose_graph.constraint_builder.sampling_ratio = 0.0;
    options.map_builder.pose_graph.optimize_every_n_nodes = 0;
    options
}

/// Scans at these times and places of a robot whose IMU says that it stands level.
pub fn scans(options: &Options, scans: Vec<TimedPointCloudData>) -> Run<Space3d> {
    let mut measurements = vec![Measurement::Imu(imu(-0.01, 0.0, 0.0))];
    for scan in scans {
        let seconds = scan.time.seconds_since(crate::world::at(0.0));
        measurements.push(Measurement::Imu(imu(seconds + 0.01, 0.0, 0.0)));
        measurements.push(Measurement::Range(scan));
    }
    run(options, measurements)
}

/// Six scans on a circle, half a second apart, with an IMU that turns with it.
pub fn circle(options: &Options) -> Run<Space3d> {
    let mut measurements = vec![Measurement::Imu(imu(0.0, 0.0, 0.4))];
    for step in 1..=30 {
        let seconds = 0.1 * f64::from(step);
        measurements.push(Measurement::Imu(imu(seconds, 0.0, 0.4)));
        measurements.push(Measurement::Odometry(odometry(on_circle(seconds), seconds)));
        if step % 5 == 0 {
            measurements.push(Measurement::Range(scan_3d(&on_circle(seconds), seconds)));
        }
    }
    run(options, measurements)
}

pub fn leaning() -> Rigid3 {
    Rigid3::from_parts(Vector3::zeros().into(), rotation_from_roll_pitch_yaw(0.04, 0.0, 0.0))
}

pub fn roll(rotation: &Quaternion) -> f64 {
    roll_pitch_yaw(rotation).0.abs()
}

fn one_scan(options: &Options) -> Run<Space3d> {
    scans(options, vec![scan_3d(&pose(0.0, 0.0, 0.0), 0.0)])
}

fn high_points(run: &Run<Space3d>) -> f64 {
    run.map.graph.state().nodes.values().map(|n| n.data.high_resolution_point_cloud.len() as f64).sum()
}

fn low_points(run: &Run<Space3d>) -> f64 {
    run.map.graph.state().nodes.values().map(|n| n.data.low_resolution_point_cloud.len() as f64).sum()
}

fn buckets(run: &Run<Space3d>) -> f64 {
    let node = run.map.graph.state().nodes.values().next().unwrap();
    node.data.rotational_scan_matcher_histogram.len() as f64
}

pub fn first_submap(run: &Run<Space3d>) -> &Submap3d {
    run.map.graph.state().submaps.values().next().unwrap().submap.as_ref().unwrap()
}

fn fine_cells(run: &Run<Space3d>) -> f64 {
    first_submap(run).high_resolution_grid.num_cells() as f64
}

fn known(grid: &HybridGrid) -> Vec<f64> {
    let mut probabilities = Vec::new();
    grid.for_each_cell(|_, code| probabilities.push(f64::from(PROBABILITY_CODE.decode(code, 0.1))));
    probabilities
}

fn fine(run: &Run<Space3d>) -> Vec<f64> {
    known(&first_submap(run).high_resolution_grid)
}

fn coarse(run: &Run<Space3d>) -> Vec<f64> {
    known(&first_submap(run).low_resolution_grid)
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

fn smallest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Cells that know how bright they are, while the submap grows.
fn bright_cells(options: &Options) -> f64 {
    let mut slam = Space3d::new_local_slam(options, &[sensor(SensorKind::Range)]).unwrap();
    slam.add_imu_data(&imu(-0.01, 0.0, 0.0));
    slam.add_range_data(&sensor(SensorKind::Range), scan_3d(&pose(0.0, 0.0, 0.0), 0.0));
    let submaps = slam.active_submaps();
    submaps[0].1.intensity_grid.as_ref().map_or(0.0, |grid| grid.num_cells() as f64)
}

pub fn table() -> Vec<Effect> {
    let mut table = local_slam();
    table.extend(submaps());
    table
}

fn local_slam() -> Vec<Effect> {
    effects! {
        "trajectory_builder_3d.min_range", "1" => "3", Falls, |o| one_scan(o).returns();
        "trajectory_builder_3d.max_range", "60" => "4", Falls, |o| one_scan(o).returns();
        "trajectory_builder_3d.num_accumulated_range_data", "1" => "3", Falls, |o| circle(o).results.len() as f64;
        "trajectory_builder_3d.voxel_filter_size", "0.15" => "0.8", Falls, |o| one_scan(o).returns();
        "high_resolution_adaptive_voxel_filter.max_length", "0.2" => "4", Falls, |o| high_points(&one_scan(o)),
            ["high_resolution_adaptive_voxel_filter.min_num_points=1"];
        "high_resolution_adaptive_voxel_filter.min_num_points", "5" => "400", Rises, |o| high_points(&one_scan(o)),
            ["high_resolution_adaptive_voxel_filter.max_length=4"];
        "high_resolution_adaptive_voxel_filter.max_range", "15" => "4", Falls, |o| high_points(&one_scan(o)),
            ["high_resolution_adaptive_voxel_filter.min_num_points=1", "high_resolution_adaptive_voxel_filter.max_length=0.3"];
        "low_resolution_adaptive_voxel_filter.max_length", "0.2" => "4", Falls, |o| low_points(&one_scan(o)),
            ["low_resolution_adaptive_voxel_filter.min_num_points=1"];
        "low_resolution_adaptive_voxel_filter.min_num_points", "5" => "400", Rises, |o| low_points(&one_scan(o)),
            ["low_resolution_adaptive_voxel_filter.max_length=4"];
        "low_resolution_adaptive_voxel_filter.max_range", "60" => "4", Falls, |o| low_points(&one_scan(o)),
            ["low_resolution_adaptive_voxel_filter.min_num_points=1", "low_resolution_adaptive_voxel_filter.max_length=0.3"];
        "trajectory_builder_3d.motion_filter.max_time_seconds", "0.1" => "100", Falls, |o| circle(o).nodes(),
            ["trajectory_builder_3d.motion_filter.max_distance_meters=100", "trajectory_builder_3d.motion_filter.max_angle_radians=10"];
        "trajectory_builder_3d.motion_filter.max_distance_meters", "0.1" => "100", Falls, |o| circle(o).nodes(),
            ["trajectory_builder_3d.motion_filter.max_time_seconds=100", "trajectory_builder_3d.motion_filter.max_angle_radians=10"];
        "trajectory_builder_3d.motion_filter.max_angle_radians", "0.05" => "10", Falls, |o| circle(o).nodes(),
            ["trajectory_builder_3d.motion_filter.max_time_seconds=100", "trajectory_builder_3d.motion_filter.max_distance_meters=100"];
        "rotational_histogram_size", "60" => "180", Rises, |o| buckets(&one_scan(o));
    }
}

fn submaps() -> Vec<Effect> {
    effects! {
        "trajectory_builder_3d.submaps.high_resolution", "0.1" => "0.4", Falls, |o| fine(&one_scan(o)).len() as f64;
        "trajectory_builder_3d.submaps.high_resolution_max_range", "20" => "4", Falls, |o| fine_cells(&one_scan(o));
        "trajectory_builder_3d.submaps.low_resolution", "0.45" => "1", Falls, |o| coarse(&one_scan(o)).len() as f64;
        "trajectory_builder_3d.submaps.num_range_data", "2" => "4", Falls, |o| circle(o).submaps();
        "trajectory_builder_3d.submaps.range_data_inserter.hit_probability", "0.55" => "0.8", Rises, |o| largest(&fine(&one_scan(o)));
        "trajectory_builder_3d.submaps.range_data_inserter.miss_probability", "0.49" => "0.3", Falls, |o| smallest(&fine(&one_scan(o)));
        "num_free_space_voxels", "0" => "8", Rises, |o| fine(&one_scan(o)).len() as f64;
        "trajectory_builder_3d.submaps.range_data_inserter.intensity_threshold", "40" => "15", Falls, bright_cells, ["use_intensities=true"];
        "use_intensities", "false" => "true", Rises, bright_cells;
    }
}

#[test]
fn options_of_local_slam_in_3d_have_their_effects() {
    check(&base(), &local_slam());
}

#[test]
fn options_of_submaps_in_3d_have_their_effects() {
    check(&base(), &submaps());
}

#[test]
fn submaps_in_3d_are_not_trimmed_by_the_trimmer_in_2d() {
    let mut options = base();
    options.set("overlapping_submaps_trimmer_2d.min_added_submaps_count=0").unwrap();
    assert_eq!(circle(&options).submaps(), circle(&base()).submaps());
}
