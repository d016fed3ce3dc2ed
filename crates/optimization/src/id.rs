//! Identities of trajectories, nodes and submaps, ordered as files order them.

use std::collections::BTreeMap;
use std::fmt;

/// Index of a trajectory in its map, counted from zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TrajectoryId(pub u32);

/// A node: one inserted scan of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId {
    /// The trajectory that it belongs to.
    pub trajectory_id: TrajectoryId,
    /// Counted from zero; gaps are left by trimming.
    pub index: u32,
}

/// A submap of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SubmapId {
    /// The trajectory that it belongs to.
    pub trajectory_id: TrajectoryId,
    /// Counted from zero; gaps are left by trimming.
    pub index: u32,
}

impl NodeId {
    /// Node `index` of a trajectory.
    pub const fn new(trajectory_id: TrajectoryId, index: u32) -> Self {
        Self { trajectory_id, index }
    }
}

impl SubmapId {
    /// Submap `index` of a trajectory.
    pub const fn new(trajectory_id: TrajectoryId, index: u32) -> Self {
        Self { trajectory_id, index }
    }
}

impl fmt::Display for TrajectoryId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}, {})", self.trajectory_id, self.index)
    }
}

impl fmt::Display for SubmapId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}, {})", self.trajectory_id, self.index)
    }
}

/// An identity made of a trajectory and an index, as nodes and submaps have.
pub trait IndexedId: Copy + Ord {
    /// The identity `index` of a trajectory.
    fn from_parts(trajectory_id: TrajectoryId, index: u32) -> Self;
    /// The trajectory.
    fn trajectory_id(&self) -> TrajectoryId;
    /// The index within the trajectory.
    fn index(&self) -> u32;
}

impl IndexedId for NodeId {
    fn from_parts(trajectory_id: TrajectoryId, index: u32) -> Self {
        Self { trajectory_id, index }
    }
    fn trajectory_id(&self) -> TrajectoryId {
        self.trajectory_id
    }
    fn index(&self) -> u32 {
        self.index
    }
}

impl IndexedId for SubmapId {
    fn from_parts(trajectory_id: TrajectoryId, index: u32) -> Self {
        Self { trajectory_id, index }
    }
    fn trajectory_id(&self) -> TrajectoryId {
        self.trajectory_id
    }
    fn index(&self) -> u32 {
        self.index
    }
}

/// The entries of one trajectory, in order of index.
pub fn of_trajectory<I: IndexedId, T>(
    map: &BTreeMap<I, T>,
    trajectory_id: TrajectoryId,
) -> impl DoubleEndedIterator<Item = (I, &T)> {
    let first = I::from_parts(trajectory_id, 0);
    let last = I::from_parts(trajectory_id, u32::MAX);
    map.range(first..=last).map(|(id, value)| (*id, value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn iteration_is_ordered_by_trajectory_then_index() {
        let id = |t, i| NodeId::new(TrajectoryId(t), i);
        let map: BTreeMap<NodeId, i32> = [(id(7, 0), 2), (id(42, 0), 3), (id(0, 1), 1), (id(0, 0), 0)].into();
        assert_eq!(map.values().copied().collect::<Vec<_>>(), [0, 1, 2, 3]);
        let of_zero: Vec<i32> = of_trajectory(&map, TrajectoryId(0)).map(|(_, v)| *v).collect();
        assert_eq!(of_zero, [0, 1]);
        assert_eq!(of_trajectory(&map, TrajectoryId(1)).count(), 0);
    }
}
