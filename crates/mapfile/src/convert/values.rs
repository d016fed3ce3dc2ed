//! Converts ids, poses and point clouds between files and memory.

use nalgebra as na;
use portolan_geometry::{GeodeticPosition, Quaternion, Rigid3, is_valid_pose};
use portolan_mapping::{NodeId, SubmapId, TrajectoryId};
use portolan_sensor::{CompressedPointCloud, CompressedPointCloudError, PointCloud};

use super::MapConversionError;
use portolan_pbstream::IdInFile;
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::proto::sensor::CompressedPointCloud as CloudMessage;
use portolan_pbstream::proto::transform::{Quaterniond, Rigid3d};

/// Deviation of the norm of a quaternion from one up to which it is not normalised, so that a map that is
/// read and written again keeps its bytes.
const EXACT_NORM: f64 = 1e-9;

/// A number of a trajectory, node or submap in a message.
pub(super) fn id_to_proto(id: u32) -> Result<i32, MapConversionError> {
    i32::try_from(id).map_err(|_| MapConversionError::IdTooLarge(id))
}

/// The id of a submap in a message.
pub(super) fn submap_id_to_proto(id: SubmapId) -> Result<m::SubmapId, MapConversionError> {
    Ok(m::SubmapId { trajectory_id: id_to_proto(id.trajectory_id.0)?, submap_index: id_to_proto(id.index)? })
}

/// The id of a node in a message.
pub(super) fn node_id_to_proto(id: NodeId) -> Result<m::NodeId, MapConversionError> {
    Ok(m::NodeId { trajectory_id: id_to_proto(id.trajectory_id.0)?, node_index: id_to_proto(id.index)? })
}

/// A geodetic position as a message.
pub(super) fn place_to_proto(place: &GeodeticPosition) -> m::GeodeticPosition {
    let GeodeticPosition { latitude_degrees, longitude_degrees, altitude } = *place;
    m::GeodeticPosition { latitude_degrees, longitude_degrees, altitude }
}

/// A geodetic position from its message; none if it is missing or not valid.
pub(super) fn place_in_file(place: Option<&m::GeodeticPosition>) -> Option<GeodeticPosition> {
    let m::GeodeticPosition { latitude_degrees, longitude_degrees, altitude } = *place?;
    let place = GeodeticPosition { latitude_degrees, longitude_degrees, altitude };
    place.is_valid().then_some(place)
}

/// An id for error messages.
pub(super) fn id_for_errors(trajectory_id: TrajectoryId, index: u32) -> IdInFile {
    let number = |v| i32::try_from(v).unwrap_or(i32::MAX);
    (number(trajectory_id.0), number(index))
}

/// A rotation from its message; none if it is missing, not finite or not a rotation.
pub(super) fn rotation_in_file(rotation: Option<&Quaterniond>) -> Option<Quaternion> {
    let pose = Rigid3d { translation: None, rotation: rotation.copied() };
    pose_in_file(Some(&pose)).map(|p| p.rotation)
}

/// A pose from its message. Like [`portolan_pbstream::pose_from_proto`], but a quaternion whose norm is one
/// to nine digits is not changed.
pub(super) fn pose_in_file(pose: Option<&Rigid3d>) -> Option<Rigid3> {
    let pose = pose?;
    let t = pose.translation.unwrap_or_default();
    let q = pose.rotation?;
    let exact = Rigid3::from_parts(
        na::Translation3::new(t.x, t.y, t.z),
        Quaternion::new_unchecked(na::Quaternion::new(q.w, q.x, q.y, q.z)),
    );
    if !is_valid_pose(&exact) {
        return None;
    }
    let norm = exact.rotation.quaternion().norm();
    if (norm - 1.0).abs() <= EXACT_NORM {
        return Some(exact);
    }
    Some(Rigid3::from_parts(exact.translation, Quaternion::new_normalize(*exact.rotation.quaternion())))
}

/// A rotation as a message.
pub(super) fn rotation_to_proto(rotation: &Quaternion) -> Quaterniond {
    let q = rotation.quaternion();
    Quaterniond { x: q.i, y: q.j, z: q.k, w: q.w }
}

/// A cloud as stored in nodes, and the number of points left out because they are not finite or beyond 8388 m.
pub(super) fn cloud_to_proto(cloud: &PointCloud) -> Result<(CloudMessage, usize), CompressedPointCloudError> {
    let (compressed, left_out) = CompressedPointCloud::compress_within_bounds(&cloud.points)?;
    let CompressedPointCloud { num_points, point_data } = compressed;
    Ok((CloudMessage { num_points, point_data }, left_out))
}

/// A cloud from its message; empty if there is none.
pub(super) fn cloud_from_proto(cloud: Option<CloudMessage>) -> Result<PointCloud, CompressedPointCloudError> {
    let CloudMessage { num_points, point_data } = cloud.unwrap_or_default();
    let points = CompressedPointCloud { num_points, point_data }.decompress()?;
    Ok(PointCloud::new(points))
}
