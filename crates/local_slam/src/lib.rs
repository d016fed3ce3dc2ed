#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod active_submaps;
mod node;
mod remembered_scans;
mod space;
mod three_d;
mod two_d;
mod usual_agreement;

pub use active_submaps::ActiveSubmaps;
pub use node::{GatheredVariance, InsertedNode, InsertionSubmap, NodeData};
pub use space::{LocalSlamSpace, Space2d, Space3d};
pub use three_d::{LocalSlam3d, LocalSlam3dSettings};
pub use two_d::{LocalSlam2d, LocalSlamExtras, refutes_place};
pub use usual_agreement::{AT_RIGHT_PLACES, AT_WRONG_PLACES, MatchAcceptance, Shares, UsualAgreement};

use std::collections::VecDeque;

use portolan_config::{AdaptiveVoxelFilterOptions, MotionFilterOptions};
use portolan_geometry::{Duration, Rigid3, Time};
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_lidar_odometry::SweepPoint;
use portolan_motion::{DegenerateInterval, ExtrapolatorCounts, MotionFilter, PoseExtrapolator};
use portolan_recall::Memory;
use portolan_sensor::{
    ImuData, OdometryData, PointCloud, RangeData, RangeDataCollatorCounts, SensorId, SynchronizedRanges,
    TimedPointCloudData, adaptive_voxel_filter,
};

/// Options that contradict each other.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("these options cannot be used together: {0}")]
pub struct LocalSlamError(pub String);

/// Result of a scan.
#[derive(Clone, Debug)]
pub struct MatchingResult<S: LocalSlamSpace> {
    /// Time of its last point.
    pub time: Time,
    /// Pose of the tracking frame in the local map.
    pub local_from_tracking: Rigid3,
    /// The scan in the local map, down-sampled if it is a node, without occluding returns.
    pub range_data_in_local: RangeData,
    /// Its raw points, in range and down-sampled with small voxels, whatever motion was estimated for the
    /// sweep (3D).
    pub measured: Vec<SweepPoint>,
    /// The node, if the scan was different enough from the last one to be inserted.
    pub inserted: Option<InsertedNode<S>>,
    /// Set if the pose was lost before this scan: it begins a new piece of map, whose pose relative to the
    /// old one is unknown.
    pub lost: Option<Lost<S>>,
}

impl<S: LocalSlamSpace> MatchingResult<S> {
    /// Result of a scan that is not a node.
    fn not_inserted(time: Time, local_from_tracking: Rigid3, range_data_in_local: RangeData) -> Self {
        Self {
            time,
            local_from_tracking,
            range_data_in_local,
            measured: Vec::new(),
            inserted: None,
            lost: None,
        }
    }
}

/// Standard deviations of a motion that only odometry measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryBridge {
    /// Along each axis, metres.
    pub translation: f64,
    /// Radians.
    pub rotation: f64,
    /// Whether there were scans meanwhile that contradict the map: the scanner may have been carried
    /// elsewhere.
    pub is_contradicted: bool,
}

/// End of a piece of map, after which the pose of the scanner was unconstrained, or constrained only by
/// odometry.
#[derive(Clone, Debug)]
pub struct Lost<S: LocalSlamSpace> {
    /// Time of the first scan that no longer fitted, or of the last one before a gap.
    pub since: Time,
    /// The submaps that were being filled then.
    pub remaining: Vec<InsertionSubmap<S>>,
    /// Transform from the local map of the new piece to that of the old one, as if the scanner had stayed
    /// at its last accepted pose.
    pub old_from_new: Rigid3,
    /// Uncertainty of the motion from the last scan of the old piece to the first one of the new piece, if
    /// odometry measured it. Both scans are then in one local map.
    pub bridge: Option<OdometryBridge>,
}

impl<S: LocalSlamSpace> Lost<S> {
    /// Whether there were no scans meanwhile and odometry measured the motion. Otherwise scans did not
    /// fit.
    pub fn is_gap(&self) -> bool {
        self.bridge.is_some_and(|bridge| !bridge.is_contradicted)
    }
}

/// Maximum number of points in an accumulated scan; it is then matched, whatever number of messages the
/// options demand.
const MOST_GATHERED_POINTS: usize = 5_000_000;

/// The local SLAM of one trajectory.
pub trait LocalSlam<S: LocalSlamSpace>: Send {
    /// Adds a range measurement. Gives the results of the scans that are now processed, this one or
    /// earlier ones.
    fn add_range_data(&mut self, sensor_id: &SensorId, data: TimedPointCloudData) -> Vec<MatchingResult<S>>;

    /// Adds an IMU sample.
    fn add_imu_data(&mut self, data: &ImuData);

    /// Adds an odometry pose. Gives the results of scans that waited for it.
    fn add_odometry_data(&mut self, data: &OdometryData) -> Vec<MatchingResult<S>>;

    /// Matches scans that still wait for odometry that will not come.
    fn flush(&mut self) -> Vec<MatchingResult<S>>;

    /// Sets the memory in which matched poses are remembered. To be called before any data is added.
    fn remember_with(&mut self, memory: &Memory);

    /// Ends the trajectory and hands over the submaps that were being filled.
    fn finish(&mut self) -> Vec<InsertionSubmap<S>>;

    /// Copies of the submaps that are being filled, with their indices.
    fn active_submaps(&self) -> Vec<(u32, S::Submap)>;

    /// Time since which scans have fitted nowhere in the search window, if the last ones do not fit and
    /// their pose is a guess.
    fn lost_since(&self) -> Option<Time>;

    /// Data that was dropped or repaired so far.
    fn issues(&self) -> IssueLog;

    /// Degenerate intervals so far, if local SLAM detects them.
    fn degenerate_intervals(&self) -> Vec<DegenerateInterval> {
        Vec::new()
    }
}

/// Adds the counts of points that the collator dropped or reordered.
fn count_collated(counts: RangeDataCollatorCounts, issues: &mut IssueLog) {
    issues.count(IssueKind::PointOlderThanScan, counts.earlier_points);
    issues.count(IssueKind::PointWithoutTime, counts.points_without_time);
    issues.count(IssueKind::PointsReordered, counts.reordered_messages);
    issues.count(IssueKind::UnexpectedRangeSensor, counts.unexpected_messages);
}

/// Adds the issues of the extrapolator that are not counted elsewhere.
fn count_extrapolated(counts: &ExtrapolatorCounts, issues: &mut IssueLog) {
    issues.count(IssueKind::OdometryJumped, counts.odometry_jumps);
}

/// Adds the ratio of the distance by odometry to that by scans, if odometry is corrected by it.
fn note_corrected_odometry(factor: Option<f64>, issues: &mut IssueLog) {
    if let Some(factor) = factor {
        let issue = Issue::new(IssueKind::OdometryCorrected);
        issues.add(issue.with_number("factor", format_args!("{factor:.2}")));
    }
}

/// Passes odometry to the extrapolator. Before the first scan there is none, and the two newest poses
/// wait, since the first scan needs the velocity of the robot. False if the pose is too old to be used.
fn take_odometry(
    data: &OdometryData,
    extrapolator: Option<&mut PoseExtrapolator>,
    waiting: &mut VecDeque<OdometryData>,
) -> bool {
    let Some(extrapolator) = extrapolator else {
        waiting.push_back(*data);
        if waiting.len() > 2 {
            waiting.pop_front();
        }
        return true;
    };
    extrapolator.add_odometry(data).is_ok()
}

/// The motion filter of these options.
pub fn motion_filter(options: &MotionFilterOptions) -> MotionFilter {
    MotionFilter::new(options.max_time_seconds, options.max_distance_meters, options.max_angle_radians)
}

/// Time of the first point of a message.
fn first_point_time(ranges: &SynchronizedRanges) -> Time {
    let relative = ranges.points.first().map_or(0.0, |p| f64::from(p.point.time));
    ranges.time + Duration::from_seconds(relative)
}

/// The cloud, down-sampled by the adaptive voxel filter of these options.
fn filtered(cloud: &PointCloud, options: &AdaptiveVoxelFilterOptions) -> PointCloud {
    adaptive_voxel_filter(cloud, options.max_length, options.min_num_points, options.max_range)
}
