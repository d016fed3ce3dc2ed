//! Constraints between submaps and nodes.

use portolan_geometry::Rigid3;

use crate::{NodeId, SubmapId};

/// Where a constraint comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ConstraintTag {
    /// The node was inserted into the submap.
    IntraSubmap,
    /// The node was matched against the submap: a loop closure.
    InterSubmap,
}

/// A measured pose of a node in a submap.
#[derive(Clone, Debug, PartialEq)]
pub struct Constraint {
    /// The submap.
    pub submap_id: SubmapId,
    /// The node.
    pub node_id: NodeId,
    /// Pose of the node in the submap. In 2D the node frame is the *gravity-aligned* tracking frame
    /// while the map is in memory; files have the tracking frame (`formats.md` §2.1).
    pub submap_from_node: Rigid3,
    /// Weight of the translation residual, 1/m.
    pub translation_weight: f64,
    /// Weight of the rotation residual, 1/rad.
    pub rotation_weight: f64,
    /// Where it comes from.
    pub tag: ConstraintTag,
    /// Match score in [0, 1] for those found by matching in this run; files do not keep it.
    pub score: Option<f32>,
}

impl Constraint {
    /// Whether it is a loop closure.
    pub fn is_loop_closure(&self) -> bool {
        self.tag == ConstraintTag::InterSubmap
    }
}
