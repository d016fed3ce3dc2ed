//! Converts poses and ids between messages and our types.

use portolan_geometry::{Rigid3, pose_from_xyz_quaternion};

use crate::proto::mapping::{NodeId, PoseGraph, SubmapId};
use crate::proto::transform::{Quaterniond, Rigid3d, Vector3d};

/// `(trajectory id, index)` of a submap or a node in a file.
pub type IdInFile = (i32, i32);

/// The id of a submap; a missing one is (0, 0), as in protobuf.
pub fn submap_id(id: Option<&SubmapId>) -> IdInFile {
    id.map_or((0, 0), |id| (id.trajectory_id, id.submap_index))
}

/// The id of a node; a missing one is (0, 0), as in protobuf.
pub fn node_id(id: Option<&NodeId>) -> IdInFile {
    id.map_or((0, 0), |id| (id.trajectory_id, id.node_index))
}

/// Reads a pose from its message. None if it, or a part of it, is missing, not finite, or not a rotation
/// (norm of the quaternion off by more than 1e-3).
pub fn pose_from_proto(pose: Option<&Rigid3d>) -> Option<Rigid3> {
    let pose = pose?;
    let t = pose.translation.unwrap_or_default();
    let q = pose.rotation?;
    pose_from_xyz_quaternion([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])
}

/// A pose as a message.
pub fn pose_to_proto(pose: &Rigid3) -> Rigid3d {
    let (t, q) = (&pose.translation, pose.rotation.quaternion());
    Rigid3d {
        translation: Some(Vector3d { x: t.x, y: t.y, z: t.z }),
        rotation: Some(Quaterniond { x: q.i, y: q.j, z: q.k, w: q.w }),
    }
}

/// All `(id, map_from_submap)` with a valid pose, in ascending order.
pub fn submap_poses(pose_graph: &PoseGraph) -> std::collections::BTreeMap<IdInFile, Rigid3> {
    let submaps = pose_graph.trajectory.iter().flat_map(|t| {
        t.submap.iter().map(|s| ((t.trajectory_id, s.submap_index), pose_from_proto(s.pose.as_ref())))
    });
    submaps.filter_map(|(id, pose)| Some((id, pose?))).collect()
}

/// Whether a quaternion in a file is a rotation (norm within 1e-3 of one).
pub fn is_rotation(q: &Quaterniond) -> bool {
    pose_from_xyz_quaternion([0.0; 3], [q.x, q.y, q.z, q.w]).is_some()
}
