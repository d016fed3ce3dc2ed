//! Taking recorded transforms into the tree.

use portolan_geometry::pose_from_xyz_quaternion;
use portolan_recording::{RepairLog, TfMessage, TransformStamped};

use super::{TfError, TfTree};

/// A frame's name as the tree has it: without a leading slash.
pub fn frame_name(name: &str) -> &str {
    name.strip_prefix('/').unwrap_or(name)
}

/// Takes transforms of a recording into a [`TfTree`] and counts those that cannot be used.
#[derive(Clone, Debug)]
pub struct TfInput {
    /// Transforms with this parent are results of mapping, not input.
    map_frame: String,
    repairs: RepairLog,
}

impl TfInput {
    /// Leaves out transforms below `map_frame`.
    pub fn new(map_frame: &str) -> Self {
        Self { map_frame: frame_name(map_frame).to_owned(), repairs: RepairLog::default() }
    }

    /// Takes all transforms of a message.
    pub fn insert(&mut self, tree: &mut TfTree, message: &TfMessage) {
        for transform in &message.transforms {
            self.insert_one(tree, transform, message.is_static);
        }
    }

    fn insert_one(&mut self, tree: &mut TfTree, transform: &TransformStamped, is_static: bool) {
        let parent = frame_name(&transform.header.frame_id);
        let child = frame_name(&transform.child_frame_id);
        if parent == self.map_frame {
            self.repairs.repaired(format!(
                "transforms from \"{parent}\" to \"{child}\" were not used: that is the output of a mapping program"
            ));
            return;
        }
        if parent.is_empty() || child.is_empty() {
            self.repairs.lost("transforms without the name of a frame were left out");
            return;
        }
        let pose = &transform.transform;
        let Some(parent_from_child) = pose_from_xyz_quaternion(pose.position, pose.orientation_xyzw) else {
            self.repairs.lost(format!(
                "transforms from \"{parent}\" to \"{child}\" with an invalid pose were left out"
            ));
            return;
        };
        let inserted = if is_static {
            tree.insert_static(parent, child, parent_from_child)
        } else {
            tree.insert_moving(parent, child, transform.header.stamp, parent_from_child)
        };
        match inserted {
            Err(error @ (TfError::Loop { .. } | TfError::TooManyFrames { .. })) => {
                self.repairs.lost(error.to_string())
            }
            Err(error) => self.repairs.repaired(error.to_string()),
            Ok(()) => {}
        }
    }

    /// Counts something that does no harm.
    pub(crate) fn note(&mut self, what: String) {
        self.repairs.repaired(what);
    }

    /// What could not be used so far.
    pub fn repairs(&self) -> &RepairLog {
        &self.repairs
    }
}
