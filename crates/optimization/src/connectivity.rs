//! Which trajectories are connected by constraints, and since when (`slam2d.md` §14.5).

use std::collections::BTreeMap;

use portolan_geometry::Time;

use crate::TrajectoryId;

/// Connected components of trajectories with the last time at which each pair was connected.
#[derive(Clone, Debug, Default)]
pub struct TrajectoryConnectivity {
    component: BTreeMap<TrajectoryId, TrajectoryId>,
    last_connection_time: BTreeMap<(TrajectoryId, TrajectoryId), Time>,
}

fn ordered(a: TrajectoryId, b: TrajectoryId) -> (TrajectoryId, TrajectoryId) {
    (a.min(b), a.max(b))
}

impl TrajectoryConnectivity {
    /// Adds a trajectory, connected only to itself.
    pub fn add(&mut self, trajectory_id: TrajectoryId) {
        self.component.entry(trajectory_id).or_insert(trajectory_id);
    }

    /// Connects two trajectories at a time. Between connected ones only the time of this pair is
    /// raised; otherwise every pair across the two components gets the time.
    pub fn connect(&mut self, a: TrajectoryId, b: TrajectoryId, time: Time) {
        self.add(a);
        self.add(b);
        if self.are_connected(a, b) {
            let last = self.last_connection_time.entry(ordered(a, b)).or_insert(time);
            *last = time.max(*last);
            return;
        }
        let members_a = self.members(a);
        let members_b = self.members(b);
        for m in &members_a {
            for n in &members_b {
                self.last_connection_time.insert(ordered(*m, *n), time);
            }
        }
        let root = self.component.get(&a).copied().unwrap_or(a);
        for m in members_b {
            self.component.insert(m, root);
        }
    }

    /// Whether a chain of connections joins the two. A known trajectory is connected to itself.
    pub fn are_connected(&self, a: TrajectoryId, b: TrajectoryId) -> bool {
        match (self.component.get(&a), self.component.get(&b)) {
            (Some(x), Some(y)) => x == y,
            _ => false,
        }
    }

    /// The last time at which the pair was connected; tick zero if never.
    pub fn last_connection_time(&self, a: TrajectoryId, b: TrajectoryId) -> Time {
        self.last_connection_time.get(&ordered(a, b)).copied().unwrap_or(Time::from_ticks(0))
    }

    /// All connected components, each in ascending order.
    pub fn components(&self) -> Vec<Vec<TrajectoryId>> {
        let mut by_root: BTreeMap<TrajectoryId, Vec<TrajectoryId>> = BTreeMap::new();
        for (id, root) in &self.component {
            by_root.entry(*root).or_default().push(*id);
        }
        by_root.into_values().collect()
    }

    /// The first of all trajectories that a chain of connections joins with this one.
    pub fn first_connected(&self, of: TrajectoryId) -> TrajectoryId {
        self.members(of).first().copied().unwrap_or(of)
    }

    /// All trajectories that a chain of connections joins with this one, itself among them, in ascending
    /// order. An unknown one has none.
    pub fn members(&self, of: TrajectoryId) -> Vec<TrajectoryId> {
        let Some(root) = self.component.get(&of).copied() else { return Vec::new() };
        self.component.iter().filter(|(_, r)| **r == root).map(|(id, _)| *id).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn t(id: u32) -> TrajectoryId {
        TrajectoryId(id)
    }

    #[test]
    fn unknown_pairs_are_not_connected() {
        let connectivity = TrajectoryConnectivity::default();
        assert!(!connectivity.are_connected(t(0), t(1)));
        assert_eq!(connectivity.last_connection_time(t(0), t(1)).ticks(), 0);
        assert!(connectivity.components().is_empty());
    }

    #[test]
    fn connection_times_never_decrease() {
        let mut connectivity = TrajectoryConnectivity::default();
        for (tick, expected) in [(5, 5), (9, 9), (7, 9)] {
            connectivity.connect(t(0), t(1), Time::from_ticks(tick));
            assert_eq!(connectivity.last_connection_time(t(1), t(0)).ticks(), expected);
        }
    }

    #[test]
    fn joining_components_times_all_cross_pairs() {
        let mut connectivity = TrajectoryConnectivity::default();
        connectivity.connect(t(0), t(1), Time::from_ticks(1));
        connectivity.connect(t(2), t(3), Time::from_ticks(2));
        assert!(!connectivity.are_connected(t(0), t(3)));
        connectivity.connect(t(1), t(2), Time::from_ticks(30));
        assert!(connectivity.are_connected(t(0), t(3)));
        assert_eq!(connectivity.last_connection_time(t(0), t(3)).ticks(), 30);
        assert_eq!(connectivity.last_connection_time(t(0), t(1)).ticks(), 1);
        assert_eq!(connectivity.components(), [[t(0), t(1), t(2), t(3)].to_vec()]);
    }
}
