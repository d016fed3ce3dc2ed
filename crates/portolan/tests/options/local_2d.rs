//! Local SLAM in 2D.

use portolan::config::Options;
use portolan::geometry::{Rigid3, roll_pitch_yaw, rotation_angle};
use portolan::grids::{CellBox, CellIndex, Grid2d};
use portolan::mapping::Space2d;
use portolan::sensor::Measurement;
use portolan::submaps::Submap2d;

use crate::effect::{Effect, check, effects};
use crate::run::{Run, run};
use crate::world::{at, distance, imu, odometry, on_circle, pose, scan_2d};

fn base() -> Options {
    let mut options = Options::for_2d();
    let local = &mut options.trajectory_builder.trajectory_builder_2d;
    local.use_imu_data = false;
    local.submaps.num_range_data = 6;
    // Nothing is searched: that is not what is observed here.
    options.map_builder.pose_graph.constraint_builder.sampling_ratio = 0.0;
    options.map_builder.pose_graph.optimize_every_n_nodes = 0;
    options
}

/// Twelve scans on a circle, 0.4 s apart, with exact odometry.
fn circle(options: &Options) -> Run<Space2d> {
    let mut measurements = Vec::new();
    for step in 0..48 {
        let seconds = 0.1 * f64::from(step);
        let truth = on_circle(seconds);
        measurements.push(Measurement::Odometry(odometry(truth, seconds)));
        if step % 4 == 0 {
            measurements.push(Measurement::Range(scan_2d(&truth, seconds)));
        }
    }
    run(options, measurements)
}

/// Scans at these times and places, and no other sensor.
fn scans(options: &Options, places: &[(f64, Rigid3)]) -> Run<Space2d> {
    let scan = |(seconds, truth): &(f64, Rigid3)| Measurement::Range(scan_2d(truth, *seconds));
    run(options, places.iter().map(scan).collect())
}

/// One scan.
fn one_scan(options: &Options) -> Run<Space2d> {
    scans(options, &[(0.0, pose(0.0, 0.0, 0.0))])
}

/// Two scans at rest in strong colours, then one elsewhere that nothing foretells.
fn pushed(options: &Options, to: Rigid3) -> Rigid3 {
    let mut options = options.clone();
    options.set("trajectory_builder_2d.submaps.range_data_inserter.probability_grid_range_data_inserter.hit_probability=0.9").unwrap();
    let rest = pose(0.0, 0.0, 0.0);
    scans(&options, &[(0.0, rest), (0.2, rest), (0.4, to)]).last_pose()
}

const NEAR: [f64; 3] = [0.04, 0.03, 0.03];
const FAR: [f64; 3] = [0.22, 0.12, 0.15];

fn truth([x, y, yaw]: [f64; 3]) -> Rigid3 {
    pose(x, y, yaw)
}

fn moved(options: &Options, to: [f64; 3]) -> f64 {
    pushed(options, truth(to)).translation.vector.norm()
}

fn turn(options: &Options, to: [f64; 3]) -> f64 {
    rotation_angle(&pushed(options, truth(to)))
}

fn error(options: &Options, to: [f64; 3]) -> f64 {
    distance(&pushed(options, truth(to)), &truth(to))
}

fn turn_error(options: &Options, to: [f64; 3]) -> f64 {
    rotation_angle(&(pushed(options, truth(to)).inverse() * truth(to)))
}

fn roll(pose: &Rigid3) -> f64 {
    roll_pitch_yaw(&pose.rotation).0.abs()
}

/// Level for a second, then the accelerometer alone says that the robot leans.
fn roll_after_leaning(options: &Options) -> f64 {
    let mut measurements = Vec::new();
    for step in 0..40 {
        let seconds = 0.05 * f64::from(step);
        let mut sample = imu(seconds, if seconds < 1.0 { 0.0 } else { 0.2 }, 0.0);
        sample.angular_velocity.fill(0.0);
        measurements.push(Measurement::Imu(sample));
        if step % 4 == 0 {
            measurements.push(Measurement::Range(scan_2d(&pose(0.0, 0.0, 0.0), seconds)));
        }
    }
    roll(&run::<Space2d>(options, measurements).last_pose())
}

/// At rest, then 0.5 m/s ahead; the last scan sees next to nothing, so that it is put where predicted.
fn predicted_distance(options: &Options) -> f64 {
    let mut options = options.clone();
    for setting in [
        "trajectory_builder_2d.use_online_correlative_scan_matching=true",
        "trajectory_builder_2d.real_time_correlative_scan_matcher.angular_search_window=0.02",
        "trajectory_builder_2d.ceres_scan_matcher.occupied_space_weight=20",
        "trajectory_builder_2d.ceres_scan_matcher.translation_weight=1",
    ] {
        options.set(setting).unwrap();
    }
    let place = |step: u32| pose(0.1 * f64::from(step.saturating_sub(6)), 0.0, 0.0);
    let mut measurements: Vec<Measurement> =
        (0..10).map(|step| Measurement::Range(scan_2d(&place(step), 0.2 * f64::from(step)))).collect();
    let mut blind = scan_2d(&place(10), 2.0);
    blind.points_in_tracking.truncate(1);
    blind.points_in_tracking[0].position = [0.6, 0.0, 0.0].into();
    measurements.push(Measurement::Range(blind));
    run::<Space2d>(&options, measurements).last_pose().translation.x
}

/// Places of scans that are put where predicted: with odometry, in a curve at changing speed.
fn error_with_odometry(options: &Options) -> f64 {
    let mut options = options.clone();
    options.set("trajectory_builder_2d.ceres_scan_matcher.translation_weight=1e5").unwrap();
    options.set("trajectory_builder_2d.ceres_scan_matcher.rotation_weight=1e5").unwrap();
    let place = |seconds: f64| on_circle(0.5 * seconds * seconds);
    let mut measurements = Vec::new();
    for step in 0..=30 {
        let seconds = 0.1 * f64::from(step);
        measurements.push(Measurement::Odometry(odometry(place(seconds), seconds)));
        if step % 10 == 0 {
            measurements.push(Measurement::Range(scan_2d(&place(seconds), seconds)));
        }
    }
    distance(&run::<Space2d>(&options, measurements).last_pose(), &place(3.0))
}

/// A scan 1.2 m away after three seconds without any sensor.
fn error_after_gap(options: &Options) -> f64 {
    let (rest, there) = (pose(0.0, 0.0, 0.0), pose(1.0, 0.6, 0.4));
    distance(&scans(options, &[(0.0, rest), (0.2, rest), (3.2, there)]).last_pose(), &there)
}

fn matching_points(run: &Run<Space2d>) -> f64 {
    let nodes = run.map.graph.state().nodes.values();
    nodes.map(|n| n.data.filtered_gravity_aligned_point_cloud.len() as f64).sum()
}

fn first_submap(run: &Run<Space2d>) -> &Submap2d {
    run.map.graph.state().submaps.values().next().unwrap().submap.as_ref().unwrap()
}

/// Something of each known cell of the first submap.
fn cells(run: &Run<Space2d>, of_cell: impl Fn(&Grid2d, CellIndex) -> f64) -> Vec<f64> {
    let grid = &first_submap(run).grid;
    let known = grid.known_cells_box().map(CellBox::cells).into_iter().flatten();
    known.filter(|cell| grid.is_known(*cell)).map(|cell| of_cell(grid, cell)).collect()
}

fn known(run: &Run<Space2d>) -> f64 {
    cells(run, |_, _| 1.0).len() as f64
}

fn occupied(run: &Run<Space2d>) -> Vec<f64> {
    cells(run, |grid, cell| 1.0 - f64::from(grid.correspondence_cost(cell)))
}

fn solid(run: &Run<Space2d>) -> f64 {
    occupied(run).iter().filter(|probability| **probability > 0.5).count() as f64
}

fn weights(run: &Run<Space2d>) -> Vec<f64> {
    cells(run, |grid, cell| match grid {
        Grid2d::Tsdf(tsdf) => f64::from(tsdf.weight(cell)),
        Grid2d::Probability(_) => 0.0,
    })
}

fn distances(run: &Run<Space2d>) -> f64 {
    let distances = cells(run, |grid, cell| match grid {
        Grid2d::Tsdf(tsdf) => f64::from(tsdf.signed_distance(cell).abs()),
        Grid2d::Probability(_) => 0.0,
    });
    distances.iter().sum()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

fn smallest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// How much the least trusted cell counts against the most trusted one.
fn evenness(options: &Options) -> f64 {
    let weights = weights(&one_scan(options));
    smallest(&weights) / largest(&weights)
}

fn contradictions(options: &Options) -> f64 {
    options.validate().err().map_or(0.0, |errors| errors.len() as f64)
}

fn is_tsdf(options: &Options) -> f64 {
    match options.validate() {
        Ok(()) => f64::from(u8::from(matches!(first_submap(&one_scan(options)).grid, Grid2d::Tsdf(_)))),
        Err(_) => 0.0,
    }
}

pub fn table() -> Vec<Effect> {
    let mut table = local_slam();
    table.extend(matching());
    table.extend(submaps());
    table.extend(tsdf());
    table
}

fn local_slam() -> Vec<Effect> {
    effects! {
        "trajectory_builder_2d.use_imu_data", "false" => "true", Rises, roll_after_leaning,
            ["trajectory_builder_2d.pose_extrapolator.constant_velocity.imu_gravity_time_constant=0.1"];
        "trajectory_builder_2d.min_range", "0" => "3", Falls, |o| circle(o).returns();
        "trajectory_builder_2d.max_range", "30" => "3", Falls, |o| circle(o).returns();
        "trajectory_builder_2d.min_z", "-0.8" => "0.1", Falls, |o| circle(o).returns();
        "trajectory_builder_2d.max_z", "2" => "0.1", Falls, |o| circle(o).returns();
        "trajectory_builder_2d.missing_data_ray_length", "0.5" => "2.5", Rises, |o| circle(o).longest_miss(),
            ["trajectory_builder_2d.max_range=3"];
        "trajectory_builder_2d.num_accumulated_range_data", "1" => "3", Falls, |o| circle(o).results.len() as f64;
        "trajectory_builder_2d.voxel_filter_size", "0.025" => "0.5", Falls, |o| circle(o).returns();
        "trajectory_builder_2d.adaptive_voxel_filter.max_length", "0.1" => "3", Falls, |o| matching_points(&circle(o)),
            ["trajectory_builder_2d.adaptive_voxel_filter.min_num_points=1"];
        "trajectory_builder_2d.adaptive_voxel_filter.min_num_points", "5" => "150", Rises, |o| matching_points(&circle(o)),
            ["trajectory_builder_2d.adaptive_voxel_filter.max_length=3"];
        "trajectory_builder_2d.adaptive_voxel_filter.max_range", "50" => "3", Falls, |o| matching_points(&circle(o));
        "trajectory_builder_2d.motion_filter.max_time_seconds", "0.1" => "100", Falls, |o| circle(o).nodes(),
            ["trajectory_builder_2d.motion_filter.max_distance_meters=100", "trajectory_builder_2d.motion_filter.max_angle_radians=10"];
        "trajectory_builder_2d.motion_filter.max_distance_meters", "0.1" => "100", Falls, |o| circle(o).nodes(),
            ["trajectory_builder_2d.motion_filter.max_time_seconds=100", "trajectory_builder_2d.motion_filter.max_angle_radians=10"];
        "trajectory_builder_2d.motion_filter.max_angle_radians", "0.1" => "10", Falls, |o| circle(o).nodes(),
            ["trajectory_builder_2d.motion_filter.max_distance_meters=100", "trajectory_builder_2d.motion_filter.max_time_seconds=100"];
        "trajectory_builder_2d.pose_extrapolator.use_imu_based", "false" => "true", Rises, contradictions;
        "trajectory_builder_2d.pose_extrapolator.constant_velocity.imu_gravity_time_constant", "0.1" => "100", Falls,
            roll_after_leaning, ["trajectory_builder_2d.use_imu_data=true", "portolan.use_all_odometry=false"];
        "trajectory_builder_2d.pose_extrapolator.constant_velocity.pose_queue_duration", "0.001" => "1", Falls, predicted_distance;
        "portolan.use_all_odometry", "false" => "true", Falls, error_with_odometry;
        "portolan.wide_search_after_gap", "0" => "0.5", Falls, error_after_gap;
    }
}

fn matching() -> Vec<Effect> {
    effects! {
        "trajectory_builder_2d.use_online_correlative_scan_matching", "false" => "true", Falls, |o| error(o, FAR),
            ["trajectory_builder_2d.ceres_scan_matcher.occupied_space_weight=20", "trajectory_builder_2d.ceres_scan_matcher.translation_weight=1",
             "trajectory_builder_2d.real_time_correlative_scan_matcher.linear_search_window=0.3"];
        "trajectory_builder_2d.real_time_correlative_scan_matcher.linear_search_window", "0.05" => "0.4", Falls, |o| error(o, FAR),
            ["trajectory_builder_2d.use_online_correlative_scan_matching=true", "trajectory_builder_2d.ceres_scan_matcher.occupied_space_weight=20",
             "trajectory_builder_2d.ceres_scan_matcher.translation_weight=1"];
        "trajectory_builder_2d.real_time_correlative_scan_matcher.angular_search_window", "0.01" => "0.3", Falls, |o| turn_error(o, FAR),
            ["trajectory_builder_2d.use_online_correlative_scan_matching=true", "trajectory_builder_2d.ceres_scan_matcher.occupied_space_weight=20",
             "trajectory_builder_2d.real_time_correlative_scan_matcher.linear_search_window=0.3"];
        "trajectory_builder_2d.real_time_correlative_scan_matcher.translation_delta_cost_weight", "0.1" => "100", Falls, |o| moved(o, FAR),
            ["trajectory_builder_2d.use_online_correlative_scan_matching=true", "trajectory_builder_2d.ceres_scan_matcher.translation_weight=1",
             "trajectory_builder_2d.real_time_correlative_scan_matcher.linear_search_window=0.3"];
        "trajectory_builder_2d.real_time_correlative_scan_matcher.rotation_delta_cost_weight", "0.1" => "100", Falls, |o| turn(o, FAR),
            ["trajectory_builder_2d.use_online_correlative_scan_matching=true", "trajectory_builder_2d.real_time_correlative_scan_matcher.linear_search_window=0.3"];
        "portolan.adaptive_search", "false" => "true", Changes, |o| error(o, FAR),
            ["trajectory_builder_2d.use_online_correlative_scan_matching=true",
             "trajectory_builder_2d.real_time_correlative_scan_matcher.linear_search_window=0.05"];
        "portolan.search_penalty_limit", "0.01" => "1", Falls, |o| moved(o, FAR),
            ["trajectory_builder_2d.use_online_correlative_scan_matching=true",
             "trajectory_builder_2d.real_time_correlative_scan_matcher.linear_search_window=0.3",
             "trajectory_builder_2d.real_time_correlative_scan_matcher.translation_delta_cost_weight=100"];
        "trajectory_builder_2d.ceres_scan_matcher.occupied_space_weight", "1" => "30", Rises, |o| moved(o, NEAR);
        "trajectory_builder_2d.ceres_scan_matcher.translation_weight", "1" => "1000", Falls, |o| moved(o, NEAR),
            ["trajectory_builder_2d.ceres_scan_matcher.occupied_space_weight=20"];
        "trajectory_builder_2d.ceres_scan_matcher.rotation_weight", "1" => "10000", Falls, |o| turn(o, NEAR),
            ["trajectory_builder_2d.ceres_scan_matcher.occupied_space_weight=20"];
        "trajectory_builder_2d.ceres_scan_matcher.ceres_solver_options.max_num_iterations", "1" => "20", Changes, |o| moved(o, NEAR),
            ["trajectory_builder_2d.ceres_scan_matcher.occupied_space_weight=20", "trajectory_builder_2d.ceres_scan_matcher.translation_weight=1"];
        "trajectory_builder_2d.ceres_scan_matcher.ceres_solver_options.use_nonmonotonic_steps", "false" => "true", Changes,
            |o| (1..8).map(|i| f64::from(i) * 0.07).map(|d| moved(o, [d, -0.5 * d, 0.4 * d])).sum(),
            ["trajectory_builder_2d.ceres_scan_matcher.occupied_space_weight=50", "trajectory_builder_2d.ceres_scan_matcher.translation_weight=0.1",
             "trajectory_builder_2d.ceres_scan_matcher.rotation_weight=0.1"];
    }
}

/// Twelve scans 0.5 m apart, to and fro, with exact odometry.
fn sparse(options: &Options) -> Run<Space2d> {
    let x = |i: i32| 0.5 * f64::from(((i + 3) % 6 - 3).abs());
    let steps = (0..12).map(|i| (0.4 * f64::from(i), pose(x(i), 0.0, 0.0)));
    let measure = |(seconds, truth)| {
        [Measurement::Odometry(odometry(truth, seconds)), Measurement::Range(scan_2d(&truth, seconds))]
    };
    run(options, steps.flat_map(measure).collect())
}

fn submaps() -> Vec<Effect> {
    effects! {
        "portolan.submap_length", "0" => "1.2", Rises, |o| sparse(o).submaps();
        "portolan.redraw_submaps", "false" => "true", Rises, |o| mean(&occupied(&one_scan(o)));
        "portolan.join_surfaces", "false" => "true", Rises, |o| solid(&one_scan(o)),
            ["trajectory_builder_2d.submaps.grid_options_2d.resolution=0.02"];
        "trajectory_builder_2d.submaps.num_range_data", "2" => "6", Falls, |o| circle(o).submaps();
        "trajectory_builder_2d.submaps.grid_options_2d.resolution", "0.05" => "0.2", Falls, |o| known(&one_scan(o));
        "grid_type", "PROBABILITY_GRID" => "TSDF", Rises, is_tsdf, ["range_data_inserter_type=TSDF_INSERTER_2D"];
        "range_data_inserter_type", "PROBABILITY_GRID_INSERTER_2D" => "TSDF_INSERTER_2D", Rises, is_tsdf, ["grid_type=TSDF"];
        "probability_grid_range_data_inserter.insert_free_space", "true" => "false", Falls, |o| known(&one_scan(o));
        "probability_grid_range_data_inserter.hit_probability", "0.55" => "0.8", Rises, |o| largest(&occupied(&one_scan(o)));
        "probability_grid_range_data_inserter.miss_probability", "0.49" => "0.3", Falls, |o| smallest(&occupied(&one_scan(o)));
    }
}

fn tsdf() -> Vec<Effect> {
    effects! {
        "tsdf_range_data_inserter.truncation_distance", "0.2" => "0.5", Rises, |o| known(&one_scan(o)),
            ["grid_type=TSDF", "range_data_inserter_type=TSDF_INSERTER_2D"];
        "tsdf_range_data_inserter.maximum_weight", "10" => "1", Falls, |o| largest(&weights(&circle(o))),
            ["grid_type=TSDF", "range_data_inserter_type=TSDF_INSERTER_2D"];
        "tsdf_range_data_inserter.update_free_space", "false" => "true", Rises, |o| known(&one_scan(o)),
            ["grid_type=TSDF", "range_data_inserter_type=TSDF_INSERTER_2D"];
        "tsdf_range_data_inserter.normal_estimation_options.num_normal_samples", "2" => "30", Changes, |o| distances(&one_scan(o)),
            ["grid_type=TSDF", "range_data_inserter_type=TSDF_INSERTER_2D"];
        "tsdf_range_data_inserter.normal_estimation_options.sample_radius", "0.1" => "2", Changes, |o| distances(&one_scan(o)),
            ["grid_type=TSDF", "range_data_inserter_type=TSDF_INSERTER_2D"];
        "tsdf_range_data_inserter.project_sdf_distance_to_scan_normal", "false" => "true", Falls, |o| distances(&one_scan(o)),
            ["grid_type=TSDF", "range_data_inserter_type=TSDF_INSERTER_2D"];
        "tsdf_range_data_inserter.update_weight_range_exponent", "0" => "2", Falls, |o| weights(&one_scan(o)).iter().sum(),
            ["grid_type=TSDF", "range_data_inserter_type=TSDF_INSERTER_2D"];
        "tsdf_range_data_inserter.update_weight_angle_scan_normal_to_ray_kernel_bandwidth", "0.5" => "5", Rises, evenness,
            ["grid_type=TSDF", "range_data_inserter_type=TSDF_INSERTER_2D"];
        "tsdf_range_data_inserter.update_weight_distance_cell_to_hit_kernel_bandwidth", "0.1" => "5", Rises, evenness,
            ["grid_type=TSDF", "range_data_inserter_type=TSDF_INSERTER_2D"];
    }
}

#[test]
fn options_of_local_slam_in_2d_have_their_effects() {
    check(&base(), &local_slam());
}

#[test]
fn options_of_matching_in_2d_have_their_effects() {
    check(&base(), &matching());
}

#[test]
fn options_of_submaps_in_2d_have_their_effects() {
    check(&base(), &submaps());
    check(&base(), &tsdf());
}

#[test]
fn the_run_on_a_circle_follows_the_truth() {
    let circle = circle(&base());
    assert_eq!(circle.results.len(), 12);
    assert!(circle.issues.is_empty(), "{:?}", circle.issues);
    assert!(distance(&circle.last_pose(), &on_circle(4.4)) < 0.06, "{}", circle.last_pose());
    assert_eq!(circle.results.last().unwrap().time, at(4.4));
}
