//! Converts measurements, which files hold one by one (`formats.md` §2, order of messages ≥ 3).

use std::collections::BTreeMap;

use nalgebra::Vector3;
use portolan_geometry::{GeodeticPosition, Quaternion, Time};
use portolan_issue::{IssueKind, IssueLog};
use portolan_mapping::{PoseGraph, Space, TrajectoryId, of_trajectory};
use portolan_optimization::ImuState;
use portolan_sensor::{FixedFramePoseData, ImuData, LandmarkData, LandmarkObservation, OdometryData};

use super::values::{id_to_proto, place_to_proto, pose_in_file};
use super::{MapConversionError, WriteReport};
use crate::derived_imu::DerivedImu;
use portolan_pbstream::PbstreamError;
use portolan_pbstream::pose_to_proto;
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::sensor::{self, landmark_data};
use portolan_pbstream::proto::transform::{Quaterniond, Vector3d};

type Write<'a> = &'a mut dyn FnMut(Data) -> Result<(), PbstreamError>;

/// Writes trajectory data, IMU, odometry, fixed-frame and landmark data of these trajectories. Each
/// trajectory has the origin of its fixed frame on the Earth, if known.
pub(super) fn write_sensors<S: Space>(
    graph: &PoseGraph<S>,
    trajectories: &[(TrajectoryId, Option<GeodeticPosition>)],
    write: Write<'_>,
    report: &mut WriteReport,
) -> Result<(), MapConversionError> {
    let mut ids: Vec<(TrajectoryId, i32)> = Vec::new();
    for (id, _) in trajectories {
        ids.push((*id, id_to_proto(id.0)?));
    }
    ids.sort_unstable();
    let on_earth: BTreeMap<TrajectoryId, GeodeticPosition> =
        trajectories.iter().filter_map(|(id, place)| Some((*id, (*place)?))).collect();
    for (id, trajectory_id) in &ids {
        let origin = graph.problem().fixed_frame_origins.get(id).copied().flatten();
        let imu = graph.problem().sensors.get(id).map_or_else(ImuState::default, |s| s.imu_state);
        let q = imu.calibration.into_inner();
        write(Data::TrajectoryData(m::TrajectoryData {
            trajectory_id: *trajectory_id,
            gravity_constant: imu.gravity_constant,
            imu_calibration: Some(Quaterniond { x: q.i, y: q.j, z: q.k, w: q.w }),
            fixed_frame_origin_in_map: origin.map(|pose| pose_to_proto(&pose)),
            fixed_frame_origin_on_earth: on_earth.get(id).map(place_to_proto),
        }))?;
    }
    write_streams(graph, &ids, write)?;
    write_landmarks(graph, &ids, write, report)
}

fn write_streams<S: Space>(
    graph: &PoseGraph<S>,
    ids: &[(TrajectoryId, i32)],
    write: Write<'_>,
) -> Result<(), MapConversionError> {
    let sensors =
        || ids.iter().filter_map(|(id, file_id)| Some((*file_id, graph.problem().sensors.get(id)?)));
    for (id, trajectory_id) in ids {
        write_imu(graph, *id, *trajectory_id, write)?;
    }
    for (trajectory_id, sensors) in sensors() {
        for data in sensors.odometry.values() {
            let pose = Some(pose_to_proto(&data.odom_from_tracking));
            let odometry_data = Some(sensor::OdometryData { timestamp: data.time.ticks(), pose });
            write(Data::OdometryData(m::OdometryData { trajectory_id, odometry_data }))?;
        }
    }
    for (trajectory_id, sensors) in sensors() {
        for data in sensors.fixed_frame.values() {
            let pose = data.fixed_from_tracking.as_ref().map(pose_to_proto);
            let fixed_frame_pose_data =
                Some(sensor::FixedFramePoseData { timestamp: data.time.ticks(), pose });
            write(Data::FixedFramePoseData(m::FixedFramePoseData { trajectory_id, fixed_frame_pose_data }))?;
        }
    }
    Ok(())
}

/// Writes measured IMU samples and, in 3D, derived ones in gaps.
fn write_imu<S: Space>(
    graph: &PoseGraph<S>,
    id: TrajectoryId,
    trajectory_id: i32,
    write: Write<'_>,
) -> Result<(), PbstreamError> {
    let nodes = of_trajectory(&graph.state().nodes, id).filter(|_| S::OPTIMIZES_WITH_IMU);
    let nodes = nodes.map(|(_, node)| (node.data.time, node.map_from_tracking)).collect();
    let mut derived = DerivedImu::new(trajectory_id, nodes);
    let sensors = graph.problem().sensors.get(&id);
    derived.set_state(sensors.map_or_else(ImuState::default, |s| s.imu_state));
    for data in sensors.into_iter().flat_map(|s| s.imu.values()) {
        derived.before(data.time).into_iter().try_for_each(|d| write(Data::ImuData(d)))?;
        let imu_data = Some(imu_to_proto(data));
        write(Data::ImuData(m::ImuData { trajectory_id, imu_data, derived_from_poses: false }))?;
    }
    derived.rest().into_iter().try_for_each(|d| write(Data::ImuData(d)))
}

/// Writes one message for each observation. Observations by deleted trajectories could not be read again and
/// are left out.
fn write_landmarks<S: Space>(
    graph: &PoseGraph<S>,
    ids: &[(TrajectoryId, i32)],
    write: Write<'_>,
    report: &mut WriteReport,
) -> Result<(), MapConversionError> {
    let ids: BTreeMap<TrajectoryId, i32> = ids.iter().copied().collect();
    for (name, landmark) in &graph.problem().landmarks {
        for sighting in &landmark.sightings {
            let Some(trajectory_id) = ids.get(&sighting.trajectory_id).copied() else {
                report.landmark_sightings_left_out += 1;
                continue;
            };
            let seen = &sighting.observation;
            let observation = landmark_data::LandmarkObservation {
                id: name.clone().into_bytes(),
                landmark_to_tracking_transform: Some(pose_to_proto(&seen.tracking_from_landmark)),
                translation_weight: seen.translation_weight,
                rotation_weight: seen.rotation_weight,
            };
            let landmark_data = Some(sensor::LandmarkData {
                timestamp: sighting.time.ticks(),
                landmark_observations: vec![observation],
            });
            write(Data::LandmarkData(m::LandmarkData { trajectory_id, landmark_data }))?;
        }
    }
    Ok(())
}

/// Gravity and calibration of an IMU; none if they are not valid. A file without gravity has the default.
pub(crate) fn imu_state_from_proto(data: &m::TrajectoryData) -> Option<ImuState> {
    let default = ImuState::default();
    let gravity_constant =
        if data.gravity_constant == 0.0 { default.gravity_constant } else { data.gravity_constant };
    let calibration = match &data.imu_calibration {
        None => default.calibration,
        Some(q) => {
            let raw = nalgebra::Quaternion::new(q.w, q.x, q.y, q.z);
            ((raw.norm() - 1.0).abs() < 1e-3).then(|| Quaternion::new_normalize(raw))?
        }
    };
    let is_possible = gravity_constant.is_finite() && gravity_constant > 0.0;
    is_possible.then_some(ImuState { gravity_constant, calibration })
}

/// Adds a measurement of a file to the graph. Measurements that cannot be used are counted by reason.
pub(super) fn load_sensor_data<S: Space>(
    data: Data,
    trajectory_ids: &BTreeMap<i32, TrajectoryId>,
    graph: &mut PoseGraph<S>,
    issues: &mut IssueLog,
) {
    let trajectory_id = match &data {
        Data::ImuData(d) if d.derived_from_poses => return,
        Data::ImuData(d) => d.trajectory_id,
        Data::OdometryData(d) => d.trajectory_id,
        Data::FixedFramePoseData(d) => d.trajectory_id,
        Data::LandmarkData(d) => d.trajectory_id,
        _ => return,
    };
    let dropped = match trajectory_ids.get(&trajectory_id) {
        None => Some(IssueKind::MeasurementOfNoTrajectory),
        Some(id) => add_measurement(data, *id, graph).err(),
    };
    if let Some(reason) = dropped {
        issues.count(reason, 1);
    }
}

fn add_measurement<S: Space>(
    data: Data,
    id: TrajectoryId,
    graph: &mut PoseGraph<S>,
) -> Result<(), IssueKind> {
    match data {
        Data::ImuData(m::ImuData { imu_data: Some(imu), .. }) => {
            let imu = imu_from_proto(&imu).ok_or(IssueKind::ImuSampleNotFinite)?;
            is_new(graph.problem().sensors.get(&id).is_none_or(|s| !s.imu.contains_key(&imu.time)))?;
            graph.add_imu_data(id, imu);
        }
        Data::OdometryData(m::OdometryData { odometry_data: Some(odometry), .. }) => {
            let odom_from_tracking =
                pose_in_file(odometry.pose.as_ref()).ok_or(IssueKind::OdometryWithoutPose)?;
            let time = Time::from_ticks(odometry.timestamp);
            is_new(graph.problem().sensors.get(&id).is_none_or(|s| !s.odometry.contains_key(&time)))?;
            graph.add_odometry_data(id, OdometryData { time, odom_from_tracking });
        }
        Data::FixedFramePoseData(m::FixedFramePoseData { fixed_frame_pose_data: Some(fixed), .. }) => {
            let fixed_from_tracking = match &fixed.pose {
                None => None,
                pose => Some(pose_in_file(pose.as_ref()).ok_or(IssueKind::FixedFramePoseInvalid)?),
            };
            let time = Time::from_ticks(fixed.timestamp);
            is_new(graph.problem().sensors.get(&id).is_none_or(|s| !s.fixed_frame.contains_key(&time)))?;
            graph.add_fixed_frame_pose_data(id, FixedFramePoseData { time, fixed_from_tracking });
        }
        Data::LandmarkData(m::LandmarkData { landmark_data: Some(landmarks), .. }) => {
            let time = Time::from_ticks(landmarks.timestamp);
            let seen = landmarks.landmark_observations.into_iter().map(observation_from_proto);
            let observations = seen.collect::<Option<_>>().ok_or(IssueKind::LandmarkSightingInvalid)?;
            graph.add_landmark_data(id, LandmarkData { time, observations });
        }
        _ => return Err(IssueKind::MeasurementWithoutContent),
    }
    Ok(())
}

/// Of several measurements with the same time stamp the first is used.
fn is_new(new: bool) -> Result<(), IssueKind> {
    if new { Ok(()) } else { Err(IssueKind::MeasurementRepeated) }
}

fn observation_from_proto(seen: landmark_data::LandmarkObservation) -> Option<LandmarkObservation> {
    if ![seen.translation_weight, seen.rotation_weight].iter().all(|w| w.is_finite() && *w >= 0.0) {
        return None;
    }
    Some(LandmarkObservation {
        // Names may be any bytes; those that are not UTF-8 stay distinct.
        id: String::from_utf8(seen.id).unwrap_or_else(|e| e.as_bytes().escape_ascii().to_string()),
        tracking_from_landmark: pose_in_file(seen.landmark_to_tracking_transform.as_ref())?,
        translation_weight: seen.translation_weight,
        rotation_weight: seen.rotation_weight,
    })
}

fn imu_to_proto(data: &ImuData) -> sensor::ImuData {
    let vector = |v: &Vector3<f64>| Some(Vector3d { x: v.x, y: v.y, z: v.z });
    sensor::ImuData {
        timestamp: data.time.ticks(),
        linear_acceleration: vector(&data.linear_acceleration),
        angular_velocity: vector(&data.angular_velocity),
    }
}

/// A sample of an IMU; none if it is not finite.
pub(crate) fn imu_from_proto(data: &sensor::ImuData) -> Option<ImuData> {
    let vector = |v: Option<Vector3d>| {
        let v = v.unwrap_or_default();
        let v = Vector3::new(v.x, v.y, v.z);
        v.iter().all(|c| c.is_finite()).then_some(v)
    };
    Some(ImuData {
        time: Time::from_ticks(data.timestamp),
        linear_acceleration: vector(data.linear_acceleration)?,
        angular_velocity: vector(data.angular_velocity)?,
    })
}
