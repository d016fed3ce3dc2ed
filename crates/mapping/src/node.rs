//! Nodes of the pose graph.

use std::sync::Arc;

use portolan_geometry::Rigid3;

use crate::NodeData;

/// A node of the pose graph.
#[derive(Clone, Debug)]
pub struct Node {
    /// The unchanging part.
    pub data: Arc<NodeData>,
    /// Pose of the tracking frame in the global map.
    pub map_from_tracking: Rigid3,
}
