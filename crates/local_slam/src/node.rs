//! Nodes: scans that local SLAM inserted into submaps.

use std::sync::Arc;

use portolan_geometry::{Quaternion, Rigid3, Time};
use portolan_grids::ScanAgreement;
use portolan_motion::Observability;
use portolan_sensor::PointCloud;
use portolan_submaps::KeptScan2d;

use crate::LocalSlamSpace;

/// The constant part of a node. Files have the same fields in 2D and 3D; the dimension decides which
/// clouds are filled.
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
    /// 2D: the whole scan, gravity aligned, to rasterise submaps again; none if it was loaded from a file.
    pub scan: Option<KeptScan2d>,
}

/// A submap into which local SLAM inserted a scan.
#[derive(Clone, Debug)]
pub struct InsertionSubmap<S: LocalSlamSpace> {
    /// Index, counted from zero within the trajectory.
    pub index: u32,
    /// Pose in the local map.
    pub local_from_submap: Rigid3,
    /// The complete submap, if this scan was the last one inserted into it.
    pub finished: Option<Arc<S::Submap>>,
}

/// Variances of predicted motion in degenerate directions, accumulated since the start of the recording.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GatheredVariance {
    /// Metres².
    pub translation: f64,
    /// Radians².
    pub rotation: f64,
}

/// A scan that local SLAM inserted.
#[derive(Clone, Debug)]
pub struct InsertedNode<S: LocalSlamSpace> {
    /// The node.
    pub data: Arc<NodeData>,
    /// The submaps that it was inserted into, oldest first.
    pub submaps: Vec<InsertionSubmap<S>>,
    /// Directions of motion that its scan constrains.
    pub open: Observability,
    /// Variance accumulated until this scan (2D).
    pub gathered: GatheredVariance,
    /// Agreement of the scan with the map without it (2D); none where there is no map to compare with.
    pub agreement: Option<ScanAgreement>,
}

impl<S: LocalSlamSpace> InsertedNode<S> {
    /// A scan that constrains all of its motion, without accumulated variance or agreement.
    pub fn new(data: Arc<NodeData>, submaps: Vec<InsertionSubmap<S>>) -> Self {
        let (open, gathered) = (Observability::default(), GatheredVariance::default());
        Self { data, submaps, open, gathered, agreement: None }
    }
}
