//! Decides whether a result is sound and may be written. Signs of failed computations are poses that are not
//! finite or have invalid rotations, times that do not ascend, and constraints with impossible weights. Maps
//! are checked as `portolan check` checks their files.

use portolan_geometry::{Rigid3, Time, is_valid_pose};
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_mapfile::{MapConversionError, MapFileSpace, check_graph};
use portolan_mapping::PoseGraph;
use portolan_pbstream::{FindingKind, Severity};

use crate::pipeline::MappedRecording;

/// The valid poses (of the tracking frame in the map), without those earlier than the ones before them.
pub(crate) fn sound_poses(poses: Vec<(Time, Rigid3)>) -> Vec<(Time, Rigid3)> {
    let mut last = Time::MIN;
    let is_sound = |(time, pose): &(Time, Rigid3)| {
        let is_sound = is_valid_pose(pose) && *time >= last;
        last = if is_sound { *time } else { last };
        is_sound
    };
    let mut poses = poses;
    poses.retain(is_sound);
    poses
}

/// Errors of a pose graph that is to be written.
pub(crate) fn unsoundness<S: MapFileSpace>(graph: &PoseGraph<S>) -> Result<IssueLog, MapConversionError> {
    let errors = check_graph(graph)?.into_iter().filter(|finding| finding.severity == Severity::Error);
    let issue = |finding: portolan_pbstream::Finding| {
        let kind = match finding.kind {
            FindingKind::Time => IssueKind::GraphOutOfOrder,
            _ => IssueKind::GraphUnsound,
        };
        Issue::new(kind).with("finding", finding.text).times(finding.count)
    };
    Ok(errors.map(issue).collect())
}

impl<S: MapFileSpace> MappedRecording<S> {
    /// Checks the result, and counts its errors among the issues.
    pub(crate) fn judge(&mut self) -> Result<(), MapConversionError> {
        let left_out = |poses: Vec<(Time, Rigid3)>| poses.len() - sound_poses(poses).len();
        let pieces = self.pieces().into_iter();
        let count = pieces.map(|id| left_out(self.map.scan_poses(id))).sum::<usize>();
        self.issues.add(Issue::new(IssueKind::PoseNotFinite).times(count as u64));
        self.issues.append(&unsoundness(&self.map.graph)?);
        if self.map.graph.optimizations().1.failed {
            let finding = "its poses could not be optimised";
            self.issues.add(Issue::new(IssueKind::GraphUnsound).with("finding", finding));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use portolan_config::Options;
    use portolan_geometry::{Quaternion, nalgebra};
    use portolan_mapping::{NodeData, NodeId, Space3d, TrajectoryId};
    use portolan_sensor::PointCloud;

    use super::*;

    #[test]
    fn invalid_poses_are_left_out() {
        let at = |seconds: f64, x: f64| (Time::from_unix_seconds(seconds), Rigid3::translation(x, 0.0, 0.0));
        let mut long = at(3.0, 0.0);
        long.1.rotation = Quaternion::new_unchecked(nalgebra::Quaternion::new(2.0, 0.0, 0.0, 0.0));
        let poses = vec![at(1.0, 0.0), at(2.0, f64::NAN), long, at(4.0, 1.0), at(3.5, 2.0), at(4.0, 3.0)];
        assert_eq!(sound_poses(poses), [at(1.0, 0.0), at(4.0, 1.0), at(4.0, 3.0)]);
    }

    /// Kinds of the errors of a graph of two nodes, at these times (seconds) and positions.
    fn wrong_with(nodes: [(f64, f64); 2]) -> Vec<IssueKind> {
        let mut graph = PoseGraph::<Space3d>::new(Options::for_3d().map_builder.pose_graph);
        graph.load_trajectory(TrajectoryId(0), None);
        for (i, (seconds, x)) in nodes.into_iter().enumerate() {
            let pose = Rigid3::translation(x, 0.0, 0.0);
            let data = NodeData {
                time: Time::from_unix_seconds(seconds),
                gravity_alignment: Quaternion::identity(),
                filtered_gravity_aligned_point_cloud: PointCloud::default(),
                high_resolution_point_cloud: PointCloud::default(),
                low_resolution_point_cloud: PointCloud::default(),
                rotational_scan_matcher_histogram: Vec::new(),
                local_from_tracking: pose,
                scan: None,
            };
            graph.load_node(NodeId::new(TrajectoryId(0), i as u32), Arc::new(data), pose);
        }
        unsoundness(&graph).unwrap().counts().into_keys().collect()
    }

    #[test]
    fn graphs_with_invalid_results_are_reported() {
        assert_eq!(wrong_with([(1.0, 0.0), (2.0, 0.5)]), []);
        assert_eq!(wrong_with([(1.0, 0.0), (2.0, f64::INFINITY)]), [IssueKind::GraphUnsound]);
        assert_eq!(wrong_with([(2.0, 0.0), (2.0, 0.5)]), [IssueKind::GraphOutOfOrder]);
    }
}
