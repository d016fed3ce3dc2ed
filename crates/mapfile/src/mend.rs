//! Repairs single messages.

use std::collections::BTreeMap;

use crate::repair::Repair;
use portolan_pbstream::decompress_points;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::mapping::{self, HybridGrid, Node, Submap};
use portolan_pbstream::proto::sensor::CompressedPointCloud;
use portolan_pbstream::proto::transform::{Quaterniond, Rigid3d};
use portolan_pbstream::{GridReport, check_grid_2d, check_hybrid_grid, mend_grid_2d, mend_hybrid_grid};
use portolan_pbstream::{is_rotation, pose_from_proto};

/// Minimum norm of a quaternion that is normalised, its inverse being the maximum; dimensionless.
const MIN_NORM: f64 = 0.5;

/// Result of repairing a message.
pub(crate) enum Mended {
    /// The message is good.
    Unchanged,
    /// The message was changed.
    Changed(Vec<Repair>),
    /// The message cannot be kept.
    Dropped(Repair),
}

/// Repairs a message in place.
pub(crate) fn mend(data: &mut Data) -> Mended {
    let mut repairs = Vec::new();
    let dropped = match data {
        Data::Submap(submap) => mend_submap(submap, &mut repairs),
        Data::Node(node) => mend_node(node, &mut repairs),
        Data::TrajectoryData(data) => {
            let pose = &mut data.fixed_frame_origin_in_map;
            let good = data.gravity_constant.is_finite()
                && (pose.is_none() || mend_pose(pose.as_mut(), &mut repairs));
            (!good).then_some(Repair::SensorDataDropped)
        }
        other => mend_sensor_data(other, &mut repairs),
    };
    match dropped {
        Some(repair) => Mended::Dropped(repair),
        None if repairs.is_empty() => Mended::Unchanged,
        None => Mended::Changed(repairs),
    }
}

/// Normalises the quaternion of a pose if that is its only fault. False if the pose cannot be repaired.
pub(crate) fn mend_pose(pose: Option<&mut Rigid3d>, repairs: &mut Vec<Repair>) -> bool {
    let Some(pose) = pose else { return false };
    if pose_from_proto(Some(pose)).is_some() {
        return true;
    }
    let Some(rotation) = pose.rotation.as_mut() else { return false };
    if !normalise(rotation) || pose_from_proto(Some(pose)).is_none() {
        return false;
    }
    repairs.push(Repair::QuaternionNormalised);
    true
}

fn norm(q: &Quaterniond) -> f64 {
    (q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w).sqrt()
}

fn normalise(q: &mut Quaterniond) -> bool {
    let norm = norm(q);
    if !(MIN_NORM..1.0 / MIN_NORM).contains(&norm) {
        return false;
    }
    *q = Quaterniond { x: q.x / norm, y: q.y / norm, z: q.z / norm, w: q.w / norm };
    true
}

fn mend_submap(submap: &mut Submap, repairs: &mut Vec<Repair>) -> Option<Repair> {
    let good = match (&mut submap.submap_2d, &mut submap.submap_3d) {
        (Some(submap), None) => {
            let grid = submap.grid.as_mut();
            mend_pose(submap.local_pose.as_mut(), repairs)
                && grid.is_some_and(|grid| {
                    let report = check_grid_2d(grid);
                    mend_cells(&report, repairs, || mend_grid_2d(grid))
                })
        }
        (None, Some(submap)) => {
            mend_histogram(&mut submap.rotational_scan_matcher_histogram, repairs);
            let mut mend_grid = |grid: Option<&mut HybridGrid>| {
                grid.is_some_and(|grid| {
                    let report = check_hybrid_grid(grid);
                    mend_cells(&report, repairs, || mend_hybrid_grid(grid))
                })
            };
            mend_grid(submap.high_resolution_hybrid_grid.as_mut())
                && mend_grid(submap.low_resolution_hybrid_grid.as_mut())
                && mend_pose(submap.local_pose.as_mut(), repairs)
        }
        _ => false,
    };
    (!good).then_some(Repair::SubmapDropped)
}

/// Repairs cells if needed; false if the grid cannot be used.
fn mend_cells(report: &GridReport, repairs: &mut Vec<Repair>, mend: impl FnOnce()) -> bool {
    if report.broken.is_none() && !report.is_good() {
        mend();
        repairs.push(Repair::CellsMended);
    }
    report.broken.is_none()
}

fn mend_histogram(histogram: &mut Vec<f32>, repairs: &mut Vec<Repair>) {
    if !histogram.iter().all(|v| v.is_finite()) {
        histogram.clear();
        repairs.push(Repair::HistogramDropped);
    }
}

fn mend_node(node: &mut Node, repairs: &mut Vec<Repair>) -> Option<Repair> {
    let Some(data) = &mut node.node_data else { return Some(Repair::NodeDropped) };
    let Some(gravity) = &mut data.gravity_alignment else { return Some(Repair::NodeDropped) };
    if !is_rotation(gravity) {
        if !normalise(gravity) {
            return Some(Repair::NodeDropped);
        }
        repairs.push(Repair::QuaternionNormalised);
    }
    if !mend_pose(data.local_pose.as_mut(), repairs) {
        return Some(Repair::NodeDropped);
    }
    let clouds = [
        &mut data.filtered_gravity_aligned_point_cloud,
        &mut data.high_resolution_point_cloud,
        &mut data.low_resolution_point_cloud,
    ];
    for cloud in clouds.into_iter().flatten() {
        if decompress_points(cloud).is_err() {
            *cloud = CompressedPointCloud::default();
            repairs.push(Repair::PointCloudDropped);
        }
    }
    mend_histogram(&mut data.rotational_scan_matcher_histogram, repairs);
    None
}

fn mend_sensor_data(data: &mut Data, repairs: &mut Vec<Repair>) -> Option<Repair> {
    let good = match data {
        Data::ImuData(data) => data.imu_data.as_ref().is_some_and(|imu| {
            let values = [imu.linear_acceleration, imu.angular_velocity].map(Option::unwrap_or_default);
            values.iter().all(|v| v.x.is_finite() && v.y.is_finite() && v.z.is_finite())
        }),
        Data::OdometryData(data) => {
            data.odometry_data.as_mut().is_some_and(|d| mend_pose(d.pose.as_mut(), repairs))
        }
        Data::FixedFramePoseData(data) => data
            .fixed_frame_pose_data
            .as_mut()
            .is_some_and(|d| d.pose.is_none() || mend_pose(d.pose.as_mut(), repairs)),
        Data::LandmarkData(data) => data.landmark_data.as_mut().is_some_and(|landmarks| {
            let seen = &mut landmarks.landmark_observations;
            seen.iter_mut().all(|s| mend_pose(s.landmark_to_tracking_transform.as_mut(), repairs))
        }),
        _ => true,
    };
    (!good).then_some(Repair::SensorDataDropped)
}

/// Checks that the times of sensor data ascend in each stream.
#[derive(Default)]
pub(crate) struct SensorTimes {
    last: BTreeMap<(i32, u32), i64>,
}

impl SensorTimes {
    /// Whether this message is later than all before it in its stream. Landmarks may come in any order.
    pub fn is_next(&mut self, data: &Data) -> bool {
        let (trajectory, stream, time) = match data {
            Data::ImuData(d) => (d.trajectory_id, 6, d.imu_data.as_ref().map(|d| d.timestamp)),
            Data::OdometryData(d) => (d.trajectory_id, 7, d.odometry_data.as_ref().map(|d| d.timestamp)),
            Data::FixedFramePoseData(d) => {
                (d.trajectory_id, 8, d.fixed_frame_pose_data.as_ref().map(|d| d.timestamp))
            }
            _ => return true,
        };
        let Some(time) = time else { return false };
        let last = self.last.entry((trajectory, stream));
        match last {
            std::collections::btree_map::Entry::Occupied(mut last) => {
                let ascends = time > *last.get();
                if ascends {
                    last.insert(time);
                }
                ascends
            }
            std::collections::btree_map::Entry::Vacant(last) => {
                last.insert(time);
                true
            }
        }
    }
}

/// Trajectory of sensor data or trajectory data.
pub(crate) fn trajectory_of(data: &Data) -> Option<i32> {
    match data {
        Data::TrajectoryData(mapping::TrajectoryData { trajectory_id, .. })
        | Data::ImuData(mapping::ImuData { trajectory_id, .. })
        | Data::OdometryData(mapping::OdometryData { trajectory_id, .. })
        | Data::FixedFramePoseData(mapping::FixedFramePoseData { trajectory_id, .. })
        | Data::LandmarkData(mapping::LandmarkData { trajectory_id, .. }) => Some(*trajectory_id),
        _ => None,
    }
}
