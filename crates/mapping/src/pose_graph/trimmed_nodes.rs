//! Keeps the poses of nodes that trimmers removed: the trajectory of a recording is not lost with them.

use std::collections::BTreeMap;
use std::path::Path;

use portolan_geometry::{Rigid3, Time};
use portolan_recall::{Answer, Sink, Words};
use portolan_spool::Spool;

use crate::{Node, NodeId, TrajectoryId};

/// What is kept of a node that a trimmer removed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrimmedNode {
    /// Time of its scan.
    pub time: Time,
    /// Pose of the tracking frame in the local map.
    pub local_from_tracking: Rigid3,
    /// Global pose of the tracking frame when it was removed.
    pub map_from_tracking: Rigid3,
}

/// Removed nodes of all trajectories, in the order in which they were removed.
#[derive(Clone, Debug, Default)]
pub struct TrimmedNodes {
    nodes: Spool<Record>,
    /// Motions of whole trajectories, each with the number of nodes that were there before; `None` removed
    /// the trajectory.
    moves: Vec<(usize, TrajectoryId, Option<Rigid3>)>,
}

/// The node with which a removed node moves.
#[derive(Clone, Copy, Debug)]
pub(super) struct Anchor {
    /// A node that still existed when the other was removed.
    pub node: NodeId,
    /// Pose of the tracking frame in that of the other node.
    pub anchor_from_tracking: Rigid3,
}

impl TrimmedNodes {
    /// Keeps nodes in a file in this folder from now on. To be called before there are any.
    pub fn keep_in(&mut self, folder: &Path) {
        if self.nodes.is_empty() {
            self.nodes = Spool::in_folder(folder);
        }
    }

    /// Number of removed nodes.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether all requests so far could be answered.
    ///
    /// # Errors
    /// The file in which nodes are kept could not be read again.
    pub fn whole(&self) -> std::io::Result<()> {
        self.nodes.whole()
    }

    /// Whether none was removed.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// The nodes of a trajectory at their present poses, where other nodes are at the poses in `kept`.
    pub fn of(&self, id: TrajectoryId, kept: &BTreeMap<NodeId, Node>) -> BTreeMap<NodeId, TrimmedNode> {
        // The anchor of a node was removed later or still exists.
        let mut poses: BTreeMap<NodeId, TrimmedNode> = BTreeMap::new();
        let records: Vec<Record> = self.nodes.iter().collect();
        for (index, Record(id, node, anchor)) in records.into_iter().enumerate().rev() {
            let with_anchor = anchor.and_then(|anchor| {
                let known = kept.get(&anchor.node).map(|node| node.map_from_tracking);
                let gone = || poses.get(&anchor.node).map(|node| node.map_from_tracking);
                Some(known.or_else(gone)? * anchor.anchor_from_tracking)
            });
            let by_anchor = with_anchor.map(|map_from_tracking| TrimmedNode { map_from_tracking, ..node });
            poses.extend(self.moved(index, id, node).map(|moved| (id, by_anchor.unwrap_or(moved))));
        }
        poses.retain(|of, _| of.trajectory_id == id);
        poses
    }

    /// A node at its present pose.
    fn moved(&self, index: usize, id: NodeId, node: TrimmedNode) -> Option<TrimmedNode> {
        let later = self.moves.iter().filter(|(count, of, _)| index < *count && *of == id.trajectory_id);
        later.map(|(.., by)| *by).try_fold(node, |node, by| {
            Some(TrimmedNode { map_from_tracking: by? * node.map_from_tracking, ..node })
        })
    }

    pub(super) fn add(&mut self, id: NodeId, node: TrimmedNode, anchor: Option<Anchor>) {
        self.nodes.push(Record(id, node, anchor));
    }

    /// Moves the nodes of a trajectory.
    pub(super) fn shift(&mut self, id: TrajectoryId, by: &Rigid3) {
        self.change(id, Some(*by));
    }

    /// Forgets the nodes of a trajectory.
    pub(super) fn forget(&mut self, id: TrajectoryId) {
        self.change(id, None);
    }

    fn change(&mut self, id: TrajectoryId, by: Option<Rigid3>) {
        if !self.nodes.is_empty() {
            self.moves.push((self.nodes.len(), id, by));
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Record(NodeId, TrimmedNode, Option<Anchor>);

impl Answer for Record {
    fn write(&self, words: &mut impl Sink) {
        let Self(id, node, anchor) = self;
        [id.trajectory_id.0, id.index].write(words);
        (node.time, [node.local_from_tracking, node.map_from_tracking]).write(words);
        anchor.map(|a| ([a.node.trajectory_id.0, a.node.index], a.anchor_from_tracking)).write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let id = |[trajectory, index]: [u32; 2]| NodeId::new(TrajectoryId(trajectory), index);
        let (of_node, (time, [local_from_tracking, map_from_tracking])) = Answer::read(words)?;
        let node = TrimmedNode { time, local_from_tracking, map_from_tracking };
        let anchor = <Option<([u32; 2], Rigid3)>>::read(words)?;
        let anchor =
            anchor.map(|(of_node, anchor_from_tracking)| Anchor { node: id(of_node), anchor_from_tracking });
        Some(Self(id(of_node), node, anchor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn removed_nodes_move_with_their_trajectory() {
        let mut trimmed = TrimmedNodes::default();
        let [a, b] = [0, 1].map(TrajectoryId);
        let at = |x| TrimmedNode {
            time: Time::from_ticks(7),
            local_from_tracking: Rigid3::identity(),
            map_from_tracking: Rigid3::translation(x, 0.0, 0.0),
        };
        trimmed.add(NodeId::new(a, 5), at(1.0), None);
        trimmed.add(NodeId::new(b, 2), at(2.0), None);
        trimmed.shift(a, &Rigid3::translation(10.0, 0.0, 0.0));
        trimmed.forget(b);
        trimmed.add(NodeId::new(a, 3), at(3.0), None);
        trimmed.add(NodeId::new(b, 4), at(4.0), None);
        let kept = BTreeMap::new();
        let of = |id| {
            trimmed.of(id, &kept).into_iter().map(|(id, n)| (id.index, n.map_from_tracking.translation.x))
        };
        assert_eq!(of(a).collect::<Vec<_>>(), [(3, 3.0), (5, 11.0)]);
        assert_eq!(of(b).collect::<Vec<_>>(), [(4, 4.0)]);
        assert_eq!(trimmed.len(), 4);
    }

    #[test]
    fn removed_nodes_move_with_their_anchors() {
        let mut trimmed = TrimmedNodes::default();
        let id = |index| NodeId::new(TrajectoryId(0), index);
        let at = |x| TrimmedNode {
            time: Time::from_ticks(7),
            local_from_tracking: Rigid3::identity(),
            map_from_tracking: Rigid3::translation(x, 0.0, 0.0),
        };
        let anchor = |index, x| {
            Some(Anchor { node: id(index), anchor_from_tracking: Rigid3::translation(x, 0.0, 0.0) })
        };
        trimmed.add(id(0), at(1.0), anchor(1, 0.5));
        trimmed.add(id(1), at(0.5), anchor(2, -1.0));
        let node = crate::made_rooms::node((9.0, 7.0), (0.0, 0.0));
        let map_from_tracking = Rigid3::translation(20.0, 0.0, 0.0);
        let kept = [(id(2), Node { data: std::sync::Arc::new(node), map_from_tracking })].into();
        let poses = trimmed.of(TrajectoryId(0), &kept);
        let x: Vec<f64> = poses.values().map(|node| node.map_from_tracking.translation.x).collect();
        assert_eq!(x, [19.5, 19.0]);
    }
}
