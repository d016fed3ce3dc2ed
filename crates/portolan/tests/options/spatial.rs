//! Local SLAM in space and the search for constraints there.

use std::sync::OnceLock;

use portolan::config::Options;
use portolan::geometry::{
    Quaternion, Rigid3, Vector3, roll_pitch_yaw, rotation_angle, rotation_from_roll_pitch_yaw,
};
use portolan::mapping::{LocalSlam, MatchedPose, NodeData, SearchRegion, Space, Spatial, Submap3d};
use portolan::matching::HybridGrid;
use portolan::matching::grid::value::PROBABILITY_CODE;
use portolan::sensor::{Measurement, SensorKind, TimedPointCloudData};

use crate::effect::{Effect, check, effects};
use crate::run::{Run, run, sensor};
use crate::world::{dense_scan, distance, imu, odometry, on_circle, pose, spatial_scan};

fn base() -> Options {
    let mut options = Options::for_3d();
    let local = &mut options.trajectory_builder.trajectory_builder_3d;
    local.submaps.num_range_data = 4;
    local.motion_filter.max_time_seconds = 0.1;
    options.map_builder.pose_graph.constraint_builder.sampling_ratio = 0.0;
    options.map_builder.pose_graph.optimize_every_n_nodes = 0;
    options
}

/// Scans at these times and places of a robot whose IMU says that it stands level.
fn scans(options: &Options, scans: Vec<TimedPointCloudData>) -> Run<Spatial> {
    let mut measurements = vec![Measurement::Imu(imu(-0.01, 0.0, 0.0))];
    for scan in scans {
        let seconds = scan.time.seconds_since(crate::world::at(0.0));
        measurements.push(Measurement::Imu(imu(seconds + 0.01, 0.0, 0.0)));
        measurements.push(Measurement::Range(scan));
    }
    run(options, measurements)
}

/// Six scans on a circle, half a second apart, with an IMU that turns with it.
fn circle(options: &Options) -> Run<Spatial> {
    let mut measurements = vec![Measurement::Imu(imu(0.0, 0.0, 0.4))];
    for step in 1..=30 {
        let seconds = 0.1 * f64::from(step);
        measurements.push(Measurement::Imu(imu(seconds, 0.0, 0.4)));
        measurements.push(Measurement::Odometry(odometry(on_circle(seconds), seconds)));
        if step % 5 == 0 {
            measurements.push(Measurement::Range(spatial_scan(&on_circle(seconds), seconds)));
        }
    }
    run(options, measurements)
}

fn one_scan(options: &Options) -> Run<Spatial> {
    scans(options, vec![spatial_scan(&pose(0.0, 0.0, 0.0), 0.0)])
}

/// Two scans at rest, then one elsewhere that nothing foretells.
fn pushed(options: &Options, to: &Rigid3) -> Rigid3 {
    let mut options = options.clone();
    options.set("trajectory_builder_3d.submaps.range_data_inserter.hit_probability=0.9").unwrap();
    options.set("trajectory_builder_3d.voxel_filter_size=0.05").unwrap();
    options.set("trajectory_builder_3d.motion_filter.max_time_seconds=1").unwrap();
    let rest = pose(0.0, 0.0, 0.0);
    let clouds = vec![dense_scan(&rest, 0.0), spatial_scan(&rest, 0.2), spatial_scan(to, 0.4)];
    scans(&options, clouds).last_pose()
}

fn near() -> Rigid3 {
    Rigid3::from_parts(Vector3::new(0.06, 0.05, 0.02).into(), rotation_from_roll_pitch_yaw(0.01, 0.0, 0.03))
}

fn far() -> Rigid3 {
    Rigid3::from_parts(Vector3::new(0.35, 0.2, 0.0).into(), rotation_from_roll_pitch_yaw(0.0, 0.0, 0.06))
}

fn leaning() -> Rigid3 {
    Rigid3::from_parts(Vector3::zeros().into(), rotation_from_roll_pitch_yaw(0.04, 0.0, 0.0))
}

fn way(options: &Options, to: Rigid3) -> f64 {
    pushed(options, &to).translation.vector.norm()
}

fn turn(options: &Options, to: Rigid3) -> f64 {
    rotation_angle(&pushed(options, &to))
}

fn error(options: &Options, to: Rigid3) -> f64 {
    distance(&pushed(options, &to), &to)
}

fn turn_error(options: &Options, to: Rigid3) -> f64 {
    rotation_angle(&(pushed(options, &to).inverse() * to))
}

fn roll(rotation: &Quaternion) -> f64 {
    roll_pitch_yaw(rotation).0.abs()
}

/// Level for a second, then the accelerometer alone says that the robot leans; what the last node believes.
fn roll_after_leaning(options: &Options) -> f64 {
    let mut measurements = Vec::new();
    for step in 0..40 {
        let seconds = 0.05 * f64::from(step);
        let mut sample = imu(seconds, if seconds < 1.0 { 0.0 } else { 0.2 }, 0.0);
        sample.angular_velocity.fill(0.0);
        measurements.push(Measurement::Imu(sample));
        if step % 10 == 9 {
            measurements.push(Measurement::Range(spatial_scan(&pose(0.0, 0.0, 0.0), seconds)));
        }
    }
    let run = run::<Spatial>(options, measurements);
    roll(&run.map.graph.state().nodes.values().next_back().unwrap().data.gravity_alignment)
}

/// At rest, then 0.5 m/s ahead, well matched; the last scan sees next to nothing, so that it is put where
/// predicted.
fn way_predicted(options: &Options) -> f64 {
    let mut options = options.clone();
    for setting in [
        "trajectory_builder_3d.ceres_scan_matcher.occupied_space_weight_0=30",
        "trajectory_builder_3d.ceres_scan_matcher.occupied_space_weight_1=30",
        "trajectory_builder_3d.ceres_scan_matcher.translation_weight=0.1",
        "trajectory_builder_3d.submaps.range_data_inserter.hit_probability=0.9",
        "trajectory_builder_3d.submaps.range_data_inserter.miss_probability=0.4",
        "trajectory_builder_3d.voxel_filter_size=0.05",
    ] {
        options.set(setting).unwrap();
    }
    let place = |step: u32| pose(0.1 * f64::from(step.saturating_sub(6)), 0.0, 0.0);
    let mut clouds: Vec<_> = (0..9).map(|step| dense_scan(&place(step), 0.2 * f64::from(step))).collect();
    let mut blind = spatial_scan(&place(9), 1.8);
    blind.points_in_tracking.truncate(1);
    blind.intensities.truncate(1);
    blind.points_in_tracking[0].position = [1.5, 0.0, 1.0].into();
    clouds.push(blind);
    scans(&options, clouds).last_pose().translation.x
}

/// Places of scans that are put where predicted: with odometry, in a curve at changing speed.
fn error_with_odometry(options: &Options) -> f64 {
    let mut options = options.clone();
    options.set("trajectory_builder_3d.ceres_scan_matcher.translation_weight=1e6").unwrap();
    let place = |seconds: f64| on_circle(0.5 * seconds * seconds);
    let mut measurements = Vec::new();
    for step in 0..=30 {
        let seconds = 0.1 * f64::from(step);
        measurements.push(Measurement::Imu(imu(seconds, 0.0, 0.4 * seconds)));
        measurements.push(Measurement::Odometry(odometry(place(seconds), seconds)));
        if step % 10 == 0 {
            measurements.push(Measurement::Range(spatial_scan(&place(seconds), seconds)));
        }
    }
    let run = run::<Spatial>(&options, measurements);
    let (first, last) = (run.results[0].local_from_tracking, run.last_pose());
    ((first.inverse() * last).translation.vector.norm() - distance(&place(0.0), &place(3.0))).abs()
}

/// Along a line, then a scan that sees next to nothing, so that it is put where predicted; meanwhile IMU and
/// odometry contradict each other, the more the wilder.
fn predicted(options: &Options, wild: f64) -> Rigid3 {
    let mut options = options.clone();
    for setting in [
        "trajectory_builder_3d.ceres_scan_matcher.translation_weight=1000",
        "trajectory_builder_3d.motion_filter.max_time_seconds=0.01",
    ] {
        options.set(setting).unwrap();
    }
    let mut measurements = Vec::new();
    for step in 0..=60 {
        let seconds = 0.02 * f64::from(step);
        let is_late = step > 50;
        let mut sample = imu(seconds, 0.0, if is_late { 0.5 * wild } else { 0.0 });
        sample.linear_acceleration.x = if is_late { 1.0 } else { 0.0 };
        measurements.push(Measurement::Imu(sample));
        let truth = pose(0.3 * seconds, 0.0, 0.0);
        let drifting = pose(0.5 * seconds, 0.1 * seconds, -0.2 * wild * seconds);
        measurements.push(Measurement::Odometry(odometry(drifting, seconds)));
        if step % 10 != 0 {
            continue;
        }
        let mut scan = spatial_scan(&truth, seconds);
        if step == 60 {
            scan.points_in_tracking.truncate(1);
            scan.intensities.truncate(1);
            scan.points_in_tracking[0].position = [1.5, 0.0, 1.0].into();
        }
        measurements.push(Measurement::Range(scan));
    }
    run::<Spatial>(&options, measurements).last_pose()
}

/// One number for a predicted pose.
fn prediction(options: &Options) -> f64 {
    let pose = predicted(options, 1.0);
    pose.translation.vector.sum() + 10.0 * rotation_angle(&pose)
}

/// The sum of several that are hard to fit.
fn hard_predictions(options: &Options) -> f64 {
    [5.0, 15.0, 25.0, 40.0].map(|wild| predicted(options, wild).translation.vector.sum()).iter().sum()
}

fn high_points(run: &Run<Spatial>) -> f64 {
    run.map.graph.state().nodes.values().map(|n| n.data.high_resolution_point_cloud.len() as f64).sum()
}

fn low_points(run: &Run<Spatial>) -> f64 {
    run.map.graph.state().nodes.values().map(|n| n.data.low_resolution_point_cloud.len() as f64).sum()
}

fn buckets(run: &Run<Spatial>) -> f64 {
    let node = run.map.graph.state().nodes.values().next().unwrap();
    node.data.rotational_scan_matcher_histogram.len() as f64
}

fn first_submap(run: &Run<Spatial>) -> &Submap3d {
    run.map.graph.state().submaps.values().next().unwrap().submap.as_ref().unwrap()
}

fn fine_cells(run: &Run<Spatial>) -> f64 {
    first_submap(run).high_resolution_grid.num_cells() as f64
}

fn known(grid: &HybridGrid) -> Vec<f64> {
    let mut probabilities = Vec::new();
    grid.for_each_cell(|_, code| probabilities.push(f64::from(PROBABILITY_CODE.decode(code, 0.1))));
    probabilities
}

fn fine(run: &Run<Spatial>) -> Vec<f64> {
    known(&first_submap(run).high_resolution_grid)
}

fn coarse(run: &Run<Spatial>) -> Vec<f64> {
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
    let mut slam = Spatial::new_local_slam(options, &[sensor(SensorKind::Range)]).unwrap();
    slam.add_imu_data(&imu(-0.01, 0.0, 0.0));
    slam.add_range_data(&sensor(SensorKind::Range), spatial_scan(&pose(0.0, 0.0, 0.0), 0.0));
    let submaps = slam.active_submaps();
    submaps[0].1.intensity_grid.as_ref().map_or(0.0, |grid| grid.num_cells() as f64)
}

pub fn table() -> Vec<Effect> {
    let mut table = local_slam();
    table.extend(matching());
    table.extend(submaps());
    table.extend(search());
    table.extend(imu_based());
    table
}

fn imu_based() -> Vec<Effect> {
    effects! {
        "trajectory_builder_3d.pose_extrapolator.use_imu_based", "false" => "true", Changes, prediction;
        "trajectory_builder_3d.pose_extrapolator.imu_based.pose_queue_duration", "0.3" => "5", Changes, prediction,
            ["trajectory_builder_3d.pose_extrapolator.use_imu_based=true"];
        "trajectory_builder_3d.pose_extrapolator.imu_based.gravity_constant", "9.806" => "8", Changes, prediction,
            ["trajectory_builder_3d.pose_extrapolator.use_imu_based=true"];
        "trajectory_builder_3d.pose_extrapolator.imu_based.pose_translation_weight", "0.01" => "100", Changes, prediction,
            ["trajectory_builder_3d.pose_extrapolator.use_imu_based=true"];
        "trajectory_builder_3d.pose_extrapolator.imu_based.pose_rotation_weight", "0.01" => "100", Changes, prediction,
            ["trajectory_builder_3d.pose_extrapolator.use_imu_based=true"];
        "trajectory_builder_3d.pose_extrapolator.imu_based.imu_acceleration_weight", "0.01" => "100", Changes, prediction,
            ["trajectory_builder_3d.pose_extrapolator.use_imu_based=true"];
        "trajectory_builder_3d.pose_extrapolator.imu_based.imu_rotation_weight", "0.01" => "100", Changes, prediction,
            ["trajectory_builder_3d.pose_extrapolator.use_imu_based=true"];
        "trajectory_builder_3d.pose_extrapolator.imu_based.odometry_translation_weight", "0.01" => "100", Changes, prediction,
            ["trajectory_builder_3d.pose_extrapolator.use_imu_based=true"];
        "trajectory_builder_3d.pose_extrapolator.imu_based.odometry_rotation_weight", "0.01" => "100", Changes, prediction,
            ["trajectory_builder_3d.pose_extrapolator.use_imu_based=true"];
        "trajectory_builder_3d.pose_extrapolator.imu_based.solver_options.max_num_iterations", "1" => "10", Changes, prediction,
            ["trajectory_builder_3d.pose_extrapolator.use_imu_based=true"];
        "trajectory_builder_3d.pose_extrapolator.imu_based.solver_options.use_nonmonotonic_steps", "false" => "true", Changes, hard_predictions,
            ["trajectory_builder_3d.pose_extrapolator.use_imu_based=true", "trajectory_builder_3d.pose_extrapolator.imu_based.odometry_rotation_weight=100",
             "trajectory_builder_3d.pose_extrapolator.imu_based.imu_rotation_weight=100", "trajectory_builder_3d.pose_extrapolator.imu_based.imu_acceleration_weight=100", "trajectory_builder_3d.pose_extrapolator.imu_based.solver_options.max_num_iterations=50"];
    }
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
        "trajectory_builder_3d.pose_extrapolator.constant_velocity.imu_gravity_time_constant", "0.1" => "100", Falls, roll_after_leaning;
        "trajectory_builder_3d.pose_extrapolator.constant_velocity.pose_queue_duration", "0.001" => "1", Falls, way_predicted;
    }
}

fn matching() -> Vec<Effect> {
    effects! {
        "trajectory_builder_3d.use_online_correlative_scan_matching", "false" => "true", Falls, |o| error(o, far()),
            ["trajectory_builder_3d.submaps.high_resolution=0.2", "trajectory_builder_3d.real_time_correlative_scan_matcher.linear_search_window=0.4",
             "trajectory_builder_3d.ceres_scan_matcher.translation_weight=0.1"];
        "trajectory_builder_3d.real_time_correlative_scan_matcher.linear_search_window", "0.1" => "0.4", Falls, |o| error(o, far()),
            ["trajectory_builder_3d.submaps.high_resolution=0.2", "trajectory_builder_3d.use_online_correlative_scan_matching=true",
             "trajectory_builder_3d.ceres_scan_matcher.translation_weight=0.1"];
        "trajectory_builder_3d.real_time_correlative_scan_matcher.angular_search_window", "0" => "0.08", Falls, |o| turn_error(o, far()),
            ["trajectory_builder_3d.submaps.high_resolution=0.2", "trajectory_builder_3d.use_online_correlative_scan_matching=true",
             "trajectory_builder_3d.real_time_correlative_scan_matcher.linear_search_window=0.4"];
        "trajectory_builder_3d.real_time_correlative_scan_matcher.translation_delta_cost_weight", "0.1" => "100", Falls, |o| way(o, far()),
            ["trajectory_builder_3d.submaps.high_resolution=0.2", "trajectory_builder_3d.use_online_correlative_scan_matching=true",
             "trajectory_builder_3d.real_time_correlative_scan_matcher.linear_search_window=0.4"];
        "trajectory_builder_3d.real_time_correlative_scan_matcher.rotation_delta_cost_weight", "0.1" => "1000", Falls, |o| turn(o, far()),
            ["trajectory_builder_3d.submaps.high_resolution=0.2", "trajectory_builder_3d.use_online_correlative_scan_matching=true",
             "trajectory_builder_3d.real_time_correlative_scan_matcher.linear_search_window=0.4",
             "trajectory_builder_3d.real_time_correlative_scan_matcher.angular_search_window=0.08"];
        "trajectory_builder_3d.ceres_scan_matcher.occupied_space_weight_0", "0.1" => "20", Falls, |o| error(o, near());
        "trajectory_builder_3d.ceres_scan_matcher.occupied_space_weight_1", "0.1" => "20", Rises, |o| way(o, near());
        "trajectory_builder_3d.ceres_scan_matcher.translation_weight", "0.1" => "1000", Falls, |o| way(o, near());
        "trajectory_builder_3d.ceres_scan_matcher.rotation_weight", "1" => "100000", Falls, |o| turn(o, near());
        "trajectory_builder_3d.ceres_scan_matcher.only_optimize_yaw", "false" => "true", Falls,
            |o| roll(&pushed(o, &leaning()).rotation), ["trajectory_builder_3d.ceres_scan_matcher.rotation_weight=1"];
        "trajectory_builder_3d.ceres_scan_matcher.ceres_solver_options.max_num_iterations", "1" => "12", Falls, |o| error(o, near()),
            ["trajectory_builder_3d.ceres_scan_matcher.translation_weight=0.1", "trajectory_builder_3d.ceres_scan_matcher.rotation_weight=1"];
        "trajectory_builder_3d.ceres_scan_matcher.ceres_solver_options.use_nonmonotonic_steps", "false" => "true", Changes,
            |o| (1..5).map(|i| 0.09 * f64::from(i)).map(|d| way(o, pose(d, -0.6 * d, 0.2 * d))).sum(),
            ["trajectory_builder_3d.ceres_scan_matcher.translation_weight=0.1", "trajectory_builder_3d.ceres_scan_matcher.rotation_weight=1",
             "trajectory_builder_3d.ceres_scan_matcher.occupied_space_weight_0=30"];
        "trajectory_builder_3d.ceres_scan_matcher.intensity_cost_function_options_0.weight", "0.01" => "5", Changes, |o| way(o, near()),
            ["use_intensities=true"];
        "trajectory_builder_3d.ceres_scan_matcher.intensity_cost_function_options_0.huber_scale", "0.01" => "100", Changes, |o| way(o, near()),
            ["use_intensities=true"];
        "trajectory_builder_3d.ceres_scan_matcher.intensity_cost_function_options_0.intensity_threshold", "15" => "40", Changes, |o| way(o, near()),
            ["use_intensities=true"];
        "use_intensities", "false" => "true", Changes, |o| way(o, near());
        "portolan.use_all_odometry", "false" => "true", Falls, error_with_odometry;
        "portolan.match_surfaces", "false" => "true", Changes, |o| circle(o).last_pose().translation.x;
        "portolan.surface_voxel_size", "0.5" => "2", Changes, |o| circle(o).last_pose().translation.x,
            ["portolan.match_surfaces=true"];
        "portolan.min_scan_duration", "0" => "1.2", Falls, |o| circle(o).results.len() as f64;
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

/// A finished submap of a scan at rest and the node of that scan.
fn submap_and_node() -> &'static (Submap3d, NodeData) {
    static MADE: OnceLock<(Submap3d, NodeData)> = OnceLock::new();
    MADE.get_or_init(|| {
        let mut options = base();
        let local = &mut options.trajectory_builder.trajectory_builder_3d;
        local.submaps.range_data_inserter.hit_probability = 0.9;
        local.submaps.high_resolution = 0.2;
        local.voxel_filter_size = 0.1;
        let run = scans(&options, vec![dense_scan(&pose(0.0, 0.0, 0.0), 0.0)]);
        let node = run.map.graph.state().nodes.values().next().unwrap();
        (first_submap(&run).clone(), NodeData::clone(&node.data))
    })
}

/// Looks for the node where it is believed to be, this far from where it is.
fn find(options: &Options, offset: Rigid3) -> Option<MatchedPose> {
    let search = &options.map_builder.pose_graph.constraint_builder;
    let (submap, node) = submap_and_node();
    let matcher = Spatial::build_matcher(submap, search).unwrap();
    let guess = submap.local_from_submap.inverse() * node.local_from_tracking * offset;
    Spatial::find_node(
        &matcher,
        submap,
        node,
        &guess,
        SearchRegion::Window { travelled: f64::INFINITY },
        search,
    )
}

fn is_found(options: &Options, offset: Rigid3) -> f64 {
    f64::from(u8::from(find(options, offset).is_some()))
}

/// A guess that is no whole number of cells off.
fn guess() -> Rigid3 {
    Rigid3::from_parts(
        Vector3::new(0.237, -0.161, 0.043).into(),
        rotation_from_roll_pitch_yaw(0.0, 0.0, 0.013),
    )
}

/// Where a node is found, as seen from where it is.
fn found(options: &Options, offset: Rigid3) -> Rigid3 {
    let (submap, node) = submap_and_node();
    let truth = submap.local_from_submap.inverse() * node.local_from_tracking;
    truth.inverse() * find(options, offset).unwrap().submap_from_node
}

/// Where the search finds the node before the match is refined.
fn unrefined(options: &Options) -> Rigid3 {
    let mut options = options.clone();
    for weight in ["translation_weight", "rotation_weight"] {
        options.set(&format!("ceres_scan_matcher_3d.{weight}=1e9")).unwrap();
    }
    found(&options, guess())
}

/// How far the refinement moves the node, metres.
fn refined_by(options: &Options) -> f64 {
    (unrefined(options).inverse() * found(options, guess())).translation.vector.norm()
}

/// How far the refinement turns the node, radians.
fn turned_by(options: &Options) -> f64 {
    rotation_angle(&(unrefined(options).inverse() * found(options, guess())))
}

fn memory(options: &Options) -> f64 {
    let search = &options.map_builder.pose_graph.constraint_builder;
    Spatial::matcher_bytes(&Spatial::build_matcher(&submap_and_node().0, search).unwrap()) as f64
}

fn search() -> Vec<Effect> {
    effects! {
        "fast_correlative_scan_matcher_3d.branch_and_bound_depth", "2" => "7", Rises, memory;
        "fast_correlative_scan_matcher_3d.full_resolution_depth", "1" => "6", Rises, memory;
        "min_rotational_score", "0.5" => "1.01", Falls, |o| is_found(o, guess());
        "min_low_resolution_score", "0.2" => "0.99", Falls, |o| is_found(o, guess());
        "linear_xy_search_window", "0.2" => "2", Rises, |o| is_found(o, Rigid3::translation(1.0, 0.5, 0.0));
        "linear_z_search_window", "0.2" => "1.5", Rises, |o| is_found(o, Rigid3::translation(0.0, 0.0, 1.0));
        "fast_correlative_scan_matcher_3d.angular_search_window", "0.05" => "0.4", Rises, |o| is_found(o, pose(0.0, 0.0, 0.3));
        "ceres_scan_matcher_3d.occupied_space_weight_0", "0.001" => "5", Rises, refined_by,
            ["ceres_scan_matcher_3d.occupied_space_weight_1=0.001"];
        "ceres_scan_matcher_3d.occupied_space_weight_1", "0.001" => "30", Rises, refined_by,
            ["ceres_scan_matcher_3d.occupied_space_weight_0=0.001"];
        "ceres_scan_matcher_3d.translation_weight", "1" => "100000", Falls, refined_by;
        "ceres_scan_matcher_3d.rotation_weight", "1" => "100000", Falls, turned_by;
        "ceres_scan_matcher_3d.only_optimize_yaw", "false" => "true", Rises,
            |o| rotation_angle(&found(o, leaning())), ["constraint_builder.min_score=0.2", "min_low_resolution_score=0.2"];
        "ceres_scan_matcher_3d.ceres_solver_options.max_num_iterations", "1" => "10", Changes, refined_by;
        "ceres_scan_matcher_3d.ceres_solver_options.use_nonmonotonic_steps", "false" => "true", Changes,
            |o| (0..6).map(|i| 0.013 * f64::from(i)).map(|d| found(o, Rigid3::from_parts(Vector3::new(d, 0.7, 0.3 * d).into(), rotation_from_roll_pitch_yaw(2.0 * d, -d, d))).translation.x).sum(),
            ["constraint_builder.min_score=0.1", "min_low_resolution_score=0.1", "ceres_scan_matcher_3d.translation_weight=0.01", "ceres_scan_matcher_3d.rotation_weight=0.01",
             "ceres_scan_matcher_3d.ceres_solver_options.max_num_iterations=50"];
    }
}

#[test]
fn options_of_local_slam_in_space_have_their_effects() {
    check(&base(), &local_slam());
}

#[test]
fn options_of_predicting_by_optimisation_have_their_effects() {
    check(&base(), &imu_based());
}

#[test]
fn options_of_matching_in_space_have_their_effects() {
    check(&base(), &matching());
}

#[test]
fn options_of_submaps_in_space_have_their_effects() {
    check(&base(), &submaps());
}

#[test]
fn options_of_the_search_for_constraints_in_space_have_their_effects() {
    check(&base(), &search());
}

#[test]
fn submaps_in_space_are_not_trimmed_by_the_trimmer_of_the_plane() {
    let mut options = base();
    options.set("overlapping_submaps_trimmer_2d.min_added_submaps_count=0").unwrap();
    assert_eq!(circle(&options).submaps(), circle(&base()).submaps());
}
