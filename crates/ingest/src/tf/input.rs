//! Inserts recorded transforms into the tree.

use portolan_geometry::pose_from_xyz_quaternion;
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_recording::{TfMessage, TransformStamped};

use super::TfTree;

/// Name of a frame in the tree: without a leading slash.
pub fn frame_name(name: &str) -> &str {
    name.strip_prefix('/').unwrap_or(name)
}

/// Inserts transforms of a recording into a [`TfTree`] and counts those that cannot be used.
#[derive(Clone, Debug)]
pub struct TfInput {
    /// Transforms with this parent are results of mapping, not input.
    map_frame: String,
    issues: IssueLog,
}

impl TfInput {
    /// Leaves out transforms below `map_frame`.
    pub fn new(map_frame: &str) -> Self {
        Self { map_frame: frame_name(map_frame).to_owned(), issues: IssueLog::default() }
    }

    /// Inserts all transforms of a message.
    pub fn insert(&mut self, tree: &mut TfTree, message: &TfMessage) {
        for transform in &message.transforms {
            self.insert_one(tree, transform, message.is_static);
        }
    }

    fn insert_one(&mut self, tree: &mut TfTree, transform: &TransformStamped, is_static: bool) {
        let parent = frame_name(&transform.header.frame_id);
        let child = frame_name(&transform.child_frame_id);
        if parent == self.map_frame {
            self.issues.add(Issue::new(IssueKind::MapTransform).with("parent", parent).with("child", child));
            return;
        }
        if parent.is_empty() || child.is_empty() {
            self.issues.add(IssueKind::NamelessTransform);
            return;
        }
        let pose = &transform.transform;
        let Some(parent_from_child) = pose_from_xyz_quaternion(pose.position, pose.orientation_xyzw) else {
            let issue = Issue::new(IssueKind::InvalidTransform);
            self.issues.add(issue.with("parent", parent).with("child", child));
            return;
        };
        let inserted = if is_static {
            tree.insert_static(parent, child, parent_from_child)
        } else {
            tree.insert_moving(parent, child, transform.header.stamp, parent_from_child)
        };
        inserted.err().iter().for_each(|error| self.add(error.issue()));
    }

    /// Counts an issue that was found elsewhere.
    pub(crate) fn add(&mut self, issue: Issue) {
        self.issues.add(issue);
    }

    /// Issues of transforms that could not be used so far.
    pub fn issues(&self) -> &IssueLog {
        &self.issues
    }
}
