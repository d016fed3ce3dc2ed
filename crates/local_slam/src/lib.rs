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

/// What became of a scan.
#[derive(Clone, Debug)]
pub struct MatchingResult<S: LocalSlamSpace> {
    /// Time of its last point.
    pub time: Time,
    /// Where it was taken, in the local map.
    pub local_from_tracking: Rigid3,
    /// The scan itself in the local map, thinned if it is a node, without returns that hide the place.
    pub range_data_in_local: RangeData,
    /// Its points as they were measured, in range and thinned with small voxels, whatever was found of the
    /// motion on the way (3D).
    pub measured: Vec<SweepPoint>,
    /// The node, if the scan was different enough from the last one to be inserted.
    pub inserted: Option<InsertedNode<S>>,
    /// The pose was lost before this scan: it begins a new piece of map, whose place in the old one is not known.
    pub lost: Option<Lost<S>>,
}

impl<S: LocalSlamSpace> MatchingResult<S> {
    /// Of a scan that is no node.
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

/// How well odometry alone tells a motion: standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryBridge {
    /// Along each axis, metres.
    pub translation: f64,
    /// Radians.
    pub rotation: f64,
    /// There were scans meanwhile, and they contradict the map: the scanner may have been carried elsewhere.
    pub is_contradicted: bool,
}

/// The end of a piece of map, after which nothing, or odometry alone, constrained the pose of the scanner.
#[derive(Clone, Debug)]
pub struct Lost<S: LocalSlamSpace> {
    /// Time of the first scan that did not fit any more, or of the last one before a gap.
    pub since: Time,
    /// The submaps that were being filled then.
    pub remaining: Vec<InsertionSubmap<S>>,
    /// From the local map of the new piece to that of the one that ended, as if the scanner had stayed where it was last
    /// found.
    pub ended_from_begun: Rigid3,
    /// Odometry measured the motion from the last scan of the old piece to the first one of the new piece, which both are
    /// drawn in one local map; none where nothing did.
    pub bridge: Option<OdometryBridge>,
}

impl<S: LocalSlamSpace> Lost<S> {
    /// Whether there were no scans meanwhile, and odometry measured the motion; else scans did not fit.
    pub fn is_gap(&self) -> bool {
        self.bridge.is_some_and(|bridge| !bridge.is_contradicted)
    }
}

/// A scan is matched when so many points are gathered, however many messages it was to have.
const MOST_GATHERED_POINTS: usize = 5_000_000;

/// The local SLAM of one trajectory.
pub trait LocalSlam<S: LocalSlamSpace>: Send {
    /// A range measurement. Gives what became of scans whose turn has come, this one or earlier ones.
    fn add_range_data(&mut self, sensor_id: &SensorId, data: TimedPointCloudData) -> Vec<MatchingResult<S>>;

    /// An IMU sample.
    fn add_imu_data(&mut self, data: &ImuData);

    /// An odometry pose. Gives what became of scans that waited for it.
    fn add_odometry_data(&mut self, data: &OdometryData) -> Vec<MatchingResult<S>>;

    /// Matches what still waits for odometry that will not come.
    fn flush(&mut self) -> Vec<MatchingResult<S>>;

    /// Remembers where scans were found with this. To be called before anything is added.
    fn remember_with(&mut self, memory: &Memory);

    /// Ends the trajectory and hands over the submaps that were being filled.
    fn finish(&mut self) -> Vec<InsertionSubmap<S>>;

    /// Copies of the submaps that are being filled, with their indices.
    fn active_submaps(&self) -> Vec<(u32, S::Submap)>;

    /// Since when scans have fitted nothing where they were looked for, if the last ones do not and where they were taken is a
    /// guess.
    fn lost_since(&self) -> Option<Time>;

    /// What was dropped or repaired so far.
    fn issues(&self) -> IssueLog;

    /// Where scans left directions unconstrained so far, if that is watched.
    fn degenerate_intervals(&self) -> Vec<DegenerateInterval> {
        Vec::new()
    }
}

/// Adds what was left out or put in order while scans were gathered.
fn count_collated(counts: RangeDataCollatorCounts, issues: &mut IssueLog) {
    issues.count(IssueKind::PointOlderThanScan, counts.earlier_points);
    issues.count(IssueKind::PointWithoutTime, counts.points_without_time);
    issues.count(IssueKind::PointsReordered, counts.reordered_messages);
    issues.count(IssueKind::UnexpectedRangeSensor, counts.unexpected_messages);
}

/// Adds what the extrapolator noticed and nobody else counts.
fn count_extrapolated(counts: &ExtrapolatorCounts, issues: &mut IssueLog) {
    issues.count(IssueKind::OdometryJumped, counts.odometry_jumps);
}

/// Notes how many times as far as scans odometry goes, if it is corrected by that.
fn note_corrected_odometry(factor: Option<f64>, issues: &mut IssueLog) {
    if let Some(factor) = factor {
        let issue = Issue::new(IssueKind::OdometryCorrected);
        issues.add(issue.with_number("factor", format_args!("{factor:.2}")));
    }
}

/// Gives odometry to the extrapolator. Before the first scan there is none; the newest two poses wait
/// then, because the first scan will want to know how the robot was moving. False if the pose is too old
/// to be used.
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

/// The filter that the options describe.
pub fn motion_filter(options: &MotionFilterOptions) -> MotionFilter {
    MotionFilter::new(options.max_time_seconds, options.max_distance_meters, options.max_angle_radians)
}

/// Time of the first point of a message.
fn first_point_time(ranges: &SynchronizedRanges) -> Time {
    let relative = ranges.points.first().map_or(0.0, |p| f64::from(p.point.time));
    ranges.time + Duration::from_seconds(relative)
}

/// A cloud thinned as the options say.
fn filtered(cloud: &PointCloud, options: &AdaptiveVoxelFilterOptions) -> PointCloud {
    adaptive_voxel_filter(cloud, options.max_length, options.min_num_points, options.max_range)
}
