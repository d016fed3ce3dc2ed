//! What is known of a node: one scan that was inserted into submaps.

use std::sync::Arc;

use portolan_geometry::{Quaternion, Rigid3, Time};
use portolan_sensor::PointCloud;

use portolan_submaps::PlanarScan;

/// The unchanging part of a node. Files have the same fields in 2D and 3D; the dimension decides
/// which clouds are filled.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeData {
    /// Time of the last point of the scan.
    pub time: Time,
    /// Rotation from the tracking frame to a gravity-aligned frame.
    pub gravity_alignment: Quaternion,
    /// 2D: the matching cloud, gravity aligned.
    pub filtered_gravity_aligned_point_cloud: PointCloud,
    /// 3D: the cloud matched against the fine grid, in the tracking frame.
    pub high_resolution_point_cloud: PointCloud,
    /// 3D: the cloud matched against the coarse grid, in the tracking frame.
    pub low_resolution_point_cloud: PointCloud,
    /// 3D: histogram of directions for rotational matching.
    pub rotational_scan_matcher_histogram: Vec<f32>,
    /// Pose of the tracking frame in the local map.
    pub local_from_tracking: Rigid3,
    /// 2D: the whole scan, gravity aligned, to draw submaps again; none if it came from a file.
    pub scan: Option<PlanarScan>,
}

/// A node of the pose graph.
#[derive(Clone, Debug)]
pub struct Node {
    /// The unchanging part.
    pub data: Arc<NodeData>,
    /// Pose of the tracking frame in the global map.
    pub map_from_tracking: Rigid3,
}
