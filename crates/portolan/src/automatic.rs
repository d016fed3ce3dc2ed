//! Chooses settings from the properties of the sensors, so that no configuration is needed.

use portolan_config::Options;
use portolan_geometry::Dimension;
use portolan_ingest::{RangeStatistics, SensorPlan, SensorStatistics};

/// Spacing of beams on a typical wall above which they do not fill cells of 5 cm, metres.
const SPARSE_BEAM_SPACING: f64 = 0.05;

/// Median range above which the lidar is taken to be outdoors, metres.
const OUTSIDE_MEDIAN_RANGE: f64 = 8.0;

/// Minimum number of loop closure searches: enough for single walls in recordings of a minute, and less than
/// what one of ten minutes tries anyway.
const MIN_SEARCHES: usize = 1000;

/// Maximum rate of whole sweeps, clouds a second: a lidar that turns ten times a second, whose stamps jitter.
/// Clouds at a higher rate may be parts of sweeps.
const MAX_SWEEPS_HZ: f64 = 11.0;
/// Approximate maximum duration of a scan that is gathered from range data, seconds.
const MAX_SCAN_DURATION: f64 = 0.1;

/// Properties of a lidar that settings depend on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lidar {
    /// Angle between neighbouring beams of a sweep, radians.
    pub angular_resolution_radians: f64,
    /// Median of the distances that it measures where it is used, metres: about 3 in rooms, 10 and more
    /// outdoors.
    pub median_range_metres: f64,
    /// Reading without a return, or otherwise the longest distance that it measures, metres; infinite if
    /// unknown.
    pub max_range_metres: f64,
    /// Scans or clouds a second; zero if unknown.
    pub scans_hz: f64,
}

/// Properties of the sensors that settings depend on.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensors {
    /// Whether to map in 2D, from planar scans, or in 3D, from clouds.
    pub dimension: Dimension,
    /// The lidar, or the first of several; none: settings as for any lidar.
    pub lidar: Option<Lidar>,
    /// Whether there are more of them.
    pub has_more_lidars: bool,
    /// Whether there is an IMU.
    pub has_imu: bool,
    /// Whether the tracking frame is that of the IMU.
    pub tracks_imu: bool,
    /// Whether there is odometry.
    pub has_odometry: bool,
    /// The frame whose motion is estimated: that of the IMU if there is one.
    pub tracking_frame: String,
}

impl Sensors {
    /// A lidar alone; its frame is the tracking frame.
    pub fn new(dimension: Dimension, lidar: Lidar, tracking_frame: &str) -> Self {
        let tracking_frame = tracking_frame.to_owned();
        Self {
            dimension,
            lidar: Some(lidar),
            has_more_lidars: false,
            has_imu: false,
            tracks_imu: false,
            has_odometry: false,
            tracking_frame,
        }
    }

    /// Those of a recording, to map it in this dimension.
    fn of(plan: &SensorPlan, statistics: &SensorStatistics, dimension: Dimension) -> Self {
        Self {
            dimension,
            lidar: statistics.range.first().map(|(_, range)| Lidar::from(range)),
            has_more_lidars: statistics.range.len() > 1,
            has_imu: plan.imu.is_some(),
            tracks_imu: plan.imu.as_ref().is_some_and(|imu| *imu.source.frame == *plan.tracking_frame),
            has_odometry: plan.odometry.is_some(),
            tracking_frame: plan.tracking_frame.clone(),
        }
    }
}

impl From<&RangeStatistics> for Lidar {
    fn from(range: &RangeStatistics) -> Self {
        Self {
            angular_resolution_radians: range.angular_resolution,
            median_range_metres: range.median_range,
            max_range_metres: range.saturation_range.unwrap_or(range.max_range),
            scans_hz: range.rate,
        }
    }
}

/// Good options for these sensors, without a recording: those that would be chosen for a recording with them.
pub fn settings_for(sensors: &Sensors) -> Options {
    let mut options = match sensors.dimension {
        Dimension::TwoD => settings_2d(sensors),
        Dimension::ThreeD => settings_3d(sensors),
    };
    options.bridge.tracking_frame.clone_from(&sensors.tracking_frame);
    options.bridge.use_odometry = sensors.has_odometry;
    options
}

/// Options for 2D mapping with the sensors of a recording.
pub fn options_2d(plan: &SensorPlan, statistics: &SensorStatistics) -> Options {
    settings_for(&Sensors::of(plan, statistics, Dimension::TwoD))
}

/// Options for mapping in 3D with the sensors of a recording.
pub fn options_3d(plan: &SensorPlan, statistics: &SensorStatistics) -> Options {
    settings_for(&Sensors::of(plan, statistics, Dimension::ThreeD))
}

fn settings_2d(sensors: &Sensors) -> Options {
    let mut options = Options::for_2d();
    set_local_slam(&mut options, sensors);
    set_pose_graph(&mut options);
    options
}

/// Whether each message is a scan: not if several lidars take turns, or a turn of one comes in parts. The
/// times of the points do not determine the duration of a scan: clouds may be cropped, or have equal times.
fn is_message_a_scan(sensors: &Sensors) -> bool {
    let hertz = sensors.lidar.map_or(0.0, |lidar| lidar.scans_hz);
    !sensors.has_more_lidars && hertz > 0.0 && hertz < MAX_SWEEPS_HZ
}

/// Spacing of key frames in 3D, and their submaps and clouds.
struct Keyframes {
    /// Distance between key frames, metres.
    max_distance: f64,
    /// Rotation between key frames, radians.
    max_angle: f64,
    per_half_submap: usize,
    /// Minimum number of points in the fine and in the coarse cloud of a key frame, if it has that many.
    points: [usize; 2],
}

/// Indoors, or without IMU: about every second sweep at walking speed; the sweeps between are registered,
/// too. With every sweep as key frame mapping takes a quarter more time, for maps that are a little better
/// (docs/experiments/2026-11-settings-3d.md).
const KEYFRAMES_USUAL: Keyframes =
    Keyframes { max_distance: 0.15, max_angle: 0.05, per_half_submap: 45, points: [150, 200] };

/// Outdoors with an IMU. Where ranges are long, sweeps overlap well two metres further on, and with a
/// gyroscope the sweeps between key frames need no pose graph: every fifth sweep at walking speed, every
/// second or third of a car. A map keeps as many points per metre of path
/// (docs/experiments/2026-11-gyroscope-prior.md).
const KEYFRAMES_FAR_APART: Keyframes =
    Keyframes { max_distance: 2.0, max_angle: 0.5, per_half_submap: 24, points: [400, 500] };

fn settings_3d(sensors: &Sensors) -> Options {
    let mut options = Options::for_3d();
    let local = &mut options.trajectory_builder.trajectory_builder_3d;
    let is_outside = sensors.lidar.as_ref().is_some_and(|l| l.median_range_metres > OUTSIDE_MEDIAN_RANGE);
    if sensors.lidar.is_some() {
        // The spinning head and the platform are not part of the map.
        local.min_range = 0.5;
        local.submaps.high_resolution = if is_outside { 0.2 } else { 0.1 };
        local.max_range = if is_outside { 100.0 } else { 60.0 };
    }
    options.portolan.match_surfaces = true;
    // A tenth of a second is one sweep of most lidars, and short enough for motion to be straight.
    options.portolan.min_scan_duration = if is_message_a_scan(sensors) { 0.0 } else { MAX_SCAN_DURATION };
    let keyframes = if is_outside && sensors.has_imu { &KEYFRAMES_FAR_APART } else { &KEYFRAMES_USUAL };
    local.motion_filter.max_distance_meters = keyframes.max_distance;
    local.motion_filter.max_angle_radians = keyframes.max_angle;
    local.submaps.num_range_data = keyframes.per_half_submap;
    let [fine, coarse] = keyframes.points;
    local.high_resolution_adaptive_voxel_filter.min_num_points = fine;
    local.low_resolution_adaptive_voxel_filter.min_num_points = coarse;
    local.ceres_scan_matcher.translation_weight = 1.0;
    local.ceres_scan_matcher.rotation_weight = 10.0;
    // The tracking frame is that of the IMU itself: if lidar and gyroscope rotate about different axes, the
    // mounting of the lidar is wrong.
    options.map_builder.pose_graph.optimization_problem.use_online_imu_extrinsics_in_3d = !sensors.tracks_imu;
    leave_odometry_to_local_slam(&mut options);
    weigh_loop_closures(&mut options);
    let graph = &mut options.map_builder.pose_graph;
    graph.constraint_builder.loop_closure_rotation_weight = 5e3;
    graph.optimization_problem.huber_scale = 200.0;
    graph.constraint_builder.min_score = MIN_EXPLAINED_3D;
    options.portolan.loop_search_spacing = 1.0;
    // Pieces of map that begin where the pose was lost are searched in the rest, and accepted once matches
    // agree.
    options.portolan.global_localization_min_matches = 3;
    graph.global_sampling_ratio = 0.1;
    graph.constraint_builder.global_localization_min_score = MIN_SCORE_ANYWHERE_3D;
    options
}

/// Minimum fraction of the points of a loop closure that are on planes; in odometry nearly all are. Correct
/// ones in simulated museums and garages reach 0.5 in the median, poses with errors of 0.1 to 1 m in 3 of
/// 100.
const MIN_EXPLAINED_3D: f64 = 0.5;

/// Minimum mean probability of the fine cells at the points of a node for a match in the whole map. The
/// median of correct matches in real drives is 0.43 to 0.67 (docs/experiments/2026-11-real-loops-3d.md).
const MIN_SCORE_ANYWHERE_3D: f64 = 0.4;

/// A scan is matched to an old submap as accurately as to its own, so both constraints get the same weight.
/// The robust loss limits the influence of a wrong loop closure. Cartographer gives loop closures 22 times
/// (translation) and 63 times (rotation) the weight, which distorts correct maps and takes the solver several
/// times as many steps.
fn weigh_loop_closures(options: &mut Options) {
    let graph = &mut options.map_builder.pose_graph;
    let search = &mut graph.constraint_builder;
    search.loop_closure_translation_weight = graph.matcher_translation_weight;
    search.loop_closure_rotation_weight = graph.matcher_rotation_weight;
}

/// Sets the options for finding a recording with unknown start in a map of `submaps` submaps.
pub fn search_in_known_map(options: &mut Options, submaps: usize) {
    options.portolan.global_localization_min_matches = 3;
    let graph = &mut options.map_builder.pose_graph;
    // One or two whole submaps for each node, other ones every time: steps of the golden ratio repeat last.
    // The 0.3 % of Cartographer takes minutes to find the first one in a small map. In 3D the newest nodes
    // are searched as they come.
    let golden = if options.portolan.localises_while_recording() { 0.618 } else { 1.618 };
    graph.global_sampling_ratio = (golden / submaps.max(1) as f64).min(1.0);
    if options.portolan.match_surfaces {
        graph.constraint_builder.global_localization_min_score = MIN_SCORE_ANYWHERE_3D;
    }
    // Once the recording is found it is not lost any more.
    graph.global_constraint_search_after_n_seconds = f64::INFINITY;
}

fn set_local_slam(options: &mut Options, sensors: &Sensors) {
    let local = &mut options.trajectory_builder.trajectory_builder_2d;
    local.use_imu_data = sensors.has_imu;
    if let Some(lidar) = &sensors.lidar {
        let spacing = lidar.angular_resolution_radians * lidar.median_range_metres;
        local.submaps.grid_options_2d.resolution = if spacing > SPARSE_BEAM_SPACING { 0.1 } else { 0.05 };
        // A reading at the scanner's mark for "no return" is not a wall.
        let mark = lidar.max_range_metres;
        if mark.is_finite() && mark > 1.0 {
            local.max_range = (0.98 * mark).min(60.0) as f32;
        }
    }
    local.use_online_correlative_scan_matching = true;
    options.portolan.adaptive_search = true;
    options.portolan.submap_length = 10.0;
    options.portolan.redraw_submaps = true;
    options.portolan.join_surfaces = true;
    let moves_unseen = !sensors.has_odometry;
    options.portolan.search_penalty_limit = if moves_unseen { 1.0 } else { 0.15 };
    let search = &mut local.real_time_correlative_scan_matcher;
    search.linear_search_window = if moves_unseen { 0.3 } else { 0.15 };
    search.angular_search_window = if moves_unseen { 25.0_f64 } else { 10.0 }.to_radians();
    search.translation_delta_cost_weight = if moves_unseen { 2.0 } else { 8.0 };
    search.rotation_delta_cost_weight = if moves_unseen { 0.1 } else { 1.0 };
    local.ceres_scan_matcher.occupied_space_weight = 10.0;
    local.ceres_scan_matcher.translation_weight = if moves_unseen { 5.0 } else { 30.0 };
    local.ceres_scan_matcher.rotation_weight = 1.0;
    local.motion_filter.max_distance_meters = 0.1;
    local.motion_filter.max_angle_radians = 0.25_f64.to_radians();
    local.submaps.num_range_data = 40;
    let inserter = &mut local.submaps.range_data_inserter.probability_grid_range_data_inserter;
    inserter.hit_probability = 0.7;
    inserter.miss_probability = 0.4;
}

/// Local SLAM has used odometry already, and detects where it fails; as a constraint between nodes it would
/// count twice.
fn leave_odometry_to_local_slam(options: &mut Options) {
    let problem = &mut options.map_builder.pose_graph.optimization_problem;
    (problem.odometry_translation_weight, problem.odometry_rotation_weight) = (0.0, 0.0);
}

fn set_pose_graph(options: &mut Options) {
    weigh_loop_closures(options);
    let graph = &mut options.map_builder.pose_graph;
    // The relative pose of consecutive scans is as accurate as their pose in the submap, so a chain of them
    // gets the same weight as submap constraints: with Cartographer's weight, 200 times as much, a few loop
    // closures cannot correct an error of metres.
    graph.optimization_problem.local_slam_pose_translation_weight = graph.matcher_translation_weight;
    graph.optimization_problem.local_slam_pose_rotation_weight = graph.matcher_rotation_weight;
    graph.optimization_problem.huber_scale = 100.0;
    leave_odometry_to_local_slam(options);
    let graph = &mut options.map_builder.pose_graph;
    options.portolan.min_loop_closure_searches = MIN_SEARCHES;
    // A piece of map that begins after the scanner was lost is connected to the rest by scans that agree, and
    // is then searched near it.
    options.portolan.global_localization_min_matches = 3;
    graph.global_constraint_search_after_n_seconds = f64::INFINITY;
    graph.constraint_builder.min_score = 0.6;
    // docs/experiments/2026-11-loops-in-the-plane.md has the matches of six real logs that these thresholds
    // separate.
    options.portolan.loop_search_drift = 0.04;
    options.portolan.loop_search_spacing = 2.5;
    options.portolan.loop_min_explained = 0.65;
    options.portolan.loop_max_contradiction = 0.15;
}

#[cfg(test)]
mod tests;
