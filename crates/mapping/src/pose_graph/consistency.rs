//! Checks whether scans agree with submaps made of other scans: parts of one map with each other, and a
//! recording with known maps.
//!
//! A wrong motion estimate or a missed loop closure lays parts of a map over each other. The scans of one
//! part then contradict the other: they end in its free space and pass through its walls.

use std::collections::BTreeSet;

use portolan_geometry::{Rigid2, Rigid3, embed_3d};
use portolan_grids::ScanAgreement;
use portolan_local_slam::refutes_place;
use portolan_optimization::OptimizationNode;
use rayon::prelude::*;

use super::PoseGraph;
use super::policy::Spacing;
use crate::{Node, NodeId, Space, SubmapEntry, SubmapId, TrajectoryId};

/// Distance along the path between places, metres.
const SPACING: f64 = 1.0;
/// Fraction of the beams of a scan that a submap has to explain or contradict to count as knowing the place.
const KNOWN: f32 = 0.5;
/// Fraction of contradicted places above which parts of a map count as lying over each other. Real logs whose
/// maps are right, as recorded and degraded, reach at most 0.034. Maps that are torn only in a small part
/// reach less than the threshold; `IN_A_ROW` detects them (docs/experiments/2026-11-self-consistency.md,
/// 2026-11-panes-and-few-beams.md).
const CONTRADICTORY: f64 = 0.06;
/// Minimum number of contradicted places that are reported: a gate that was moved or a crowd explains fewer.
const FEWEST: usize = 5;
/// Offset within which a scan may fit better, metres and radians (a wall or two of the grid), without
/// contradicting the map: there it is bent, not torn.
const NEAR_BY: (f64, f64) = (0.1, 0.02);
/// Distance from its scans within which a 3D submap knows places, metres.
const NEAR: f64 = 3.0;
/// Number of consecutive contradicted places that show a part lying over another one, however large the rest
/// of the map is.
const IN_A_ROW: usize = 4;

/// Agreement of scans, at their poses in the finished map, with submaps made of other scans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Consistency {
    /// Places, one per metre of path, known to submaps made of other scans.
    pub places: usize,
    /// Places that no other submap knows.
    pub unknown: usize,
    /// Those that at least half of these submaps contradict.
    pub contradicted: usize,
    /// Those with which at least half of these submaps agree as well as is required of loop closures in the
    /// final search.
    pub confirmed: usize,
    /// Largest number of consecutive contradicted places along the path.
    pub longest_row: usize,
}

impl Consistency {
    /// Whether parts of the map lie over each other.
    pub fn is_contradictory(&self) -> bool {
        let is_torn = self.contradicted as f64 > CONTRADICTORY * self.places as f64;
        self.contradicted >= FEWEST && is_torn || self.longest_row >= IN_A_ROW
    }

    /// Whether scans fit the submaps made of others at most places that these know. Simulated offices seen by
    /// a poor lidar: at least 19 of 25 places at the right pose, at most 9 with an offset of 0.3 m or more.
    pub fn is_confirmed(&self) -> bool {
        self.is_known() && 2 * self.confirmed >= self.places
    }

    /// Whether there are enough places to judge by: on a short path, all of them suffice.
    pub fn is_known(&self) -> bool {
        self.places > 0 && self.places >= FEWEST.min(self.places + self.unknown)
    }

    /// From places in the order along the path.
    fn of(judged: &[Option<Verdict>]) -> Self {
        let places: Vec<Verdict> = judged.iter().copied().flatten().collect();
        let is_contradicted = |verdict: &Verdict| *verdict == Verdict::Contradicted;
        let rows = places.chunk_by(|a, b| a == b).filter(|row| row.first().is_some_and(is_contradicted));
        let lengths = rows.map(<[Verdict]>::len);
        Self {
            places: places.len(),
            unknown: judged.len() - places.len(),
            contradicted: lengths.clone().sum(),
            confirmed: places.iter().filter(|verdict| **verdict == Verdict::Confirmed).count(),
            longest_row: lengths.max().unwrap_or_default(),
        }
    }
}

/// Verdict of the submaps that know a place on the scan taken there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// It was taken elsewhere.
    Contradicted,
    /// It was taken there.
    Confirmed,
    /// Neither.
    Undecided,
}

impl<S: Space> PoseGraph<S> {
    /// Consistency of the map with itself; known after the final optimisation where submaps are redrawn.
    pub fn self_consistency(&self) -> Consistency {
        self.self_consistency
    }

    pub(super) fn judge_self_consistency(&self) -> Consistency {
        if !self.policy.redraws {
            return Consistency::default();
        }
        self.consistency(|_| true, |submap, node| self.state.connectivity.are_connected(submap, node))
    }

    /// Agreement of the scans of some trajectories with the submaps of the others at their places, whether or
    /// not constraints tie them together.
    pub fn consistency_with_others(&self, of: &BTreeSet<TrajectoryId>) -> Consistency {
        self.consistency(|node| of.contains(&node), |submap, _| !of.contains(&submap))
    }

    fn consistency(
        &self,
        is_judged: impl Fn(TrajectoryId) -> bool,
        is_compared: impl Fn(TrajectoryId, TrajectoryId) -> bool + Sync,
    ) -> Consistency {
        let mut spacing = Spacing::default();
        let mut nodes: Vec<NodeId> = self.state.nodes.keys().copied().collect();
        nodes.retain(|id| {
            if !is_judged(id.trajectory_id) {
                return false;
            }
            let path_length = self.path_lengths.get(id).copied().unwrap_or(0.0);
            spacing.is_due((SubmapId::new(id.trajectory_id, 0), *id), path_length, SPACING)
        });
        let continues = || !self.stop.is_requested();
        let judged = nodes.par_iter().filter(|_| continues()).map(|id| self.judge(*id, &is_compared));
        let judged: Vec<Option<Verdict>> = judged.collect();
        if self.stop.is_requested() {
            return Consistency::default();
        }
        Consistency::of(&judged)
    }

    /// Verdict on the scan of a node by the submaps that know its place and were made without it; none if
    /// there is no such submap. Only submaps of trajectories that are to be compared with that of the node
    /// count.
    fn judge(&self, id: NodeId, is_compared: impl Fn(TrajectoryId, TrajectoryId) -> bool) -> Option<Verdict> {
        let (node, place) = (self.state.nodes.get(&id)?, self.problem.nodes.get(&id)?);
        let acceptance = self.acceptance_of_known_place();
        let (mut known, mut confirming, mut contradicting) = (0, 0, Vec::new());
        for (submap_id, entry) in &self.state.submaps {
            let is_requested =
                !entry.node_ids.contains(&id) && is_compared(submap_id.trajectory_id, id.trajectory_id);
            let (true, Some(submap), Some(map_from_submap)) =
                (is_requested, entry.submap.as_deref(), self.problem.submaps.get(submap_id))
            else {
                continue;
            };
            let submap_from_node = map_from_submap.inverse() * place.map_from_node;
            let Some(agreement) = self.agreement_where_known(entry, place, (submap, &submap_from_node), node)
            else {
                continue;
            };
            known += 1;
            confirming += usize::from(acceptance.accepts(Some(agreement)));
            if refutes_place(&agreement) {
                contradicting.push((submap, submap_from_node));
            }
        }
        let fits_near_by = |submap: &S::Submap, submap_from_node: &Rigid3| {
            near_by().any(|offset| {
                let agreement = S::agreement(submap, &node.data, &(submap_from_node * offset));
                agreement.is_none_or(|agreement| !refutes_place(&agreement))
            })
        };
        let is_half = |count: usize| 2 * count >= known;
        let mut count = contradicting.len();
        for (submap, submap_from_node) in &contradicting {
            if !is_half(count) {
                break;
            }
            count -= usize::from(fits_near_by(submap, submap_from_node));
        }
        (known > 0).then_some(match (is_half(count), is_half(confirming)) {
            (true, _) => Verdict::Contradicted,
            (false, true) => Verdict::Confirmed,
            (false, false) => Verdict::Undecided,
        })
    }
}

impl<S: Space> PoseGraph<S> {
    /// Agreement of a submap with the scan of a node if it knows the place: it knows at least half of the
    /// beams ([`KNOWN`]), or in 3D, where planes do not represent free space, it has scans near by.
    fn agreement_where_known(
        &self,
        entry: &SubmapEntry<S>,
        place: &OptimizationNode,
        (submap, submap_from_node): (&S::Submap, &Rigid3),
        node: &Node,
    ) -> Option<ScanAgreement> {
        if let Some(agreement) = S::agreement(submap, &node.data, submap_from_node) {
            return (agreement.explained + agreement.contradicted() >= KNOWN).then_some(agreement);
        }
        let position = |node: &OptimizationNode| node.map_from_node.translation.vector;
        let mut others = entry.node_ids.iter().filter_map(|id| self.problem.nodes.get(id));
        others
            .any(|other| (position(other) - position(place)).norm() <= NEAR)
            .then(|| S::own_agreement(submap, &node.data, submap_from_node))?
    }
}

/// Poses around one, within the offset that parts of a map may have that is not torn: thin walls and noisy
/// scans contradict each other by less.
fn near_by() -> impl Iterator<Item = Rigid3> {
    let steps = |largest: f64| (-2..=2).map(move |i| f64::from(i) / 2.0 * largest);
    steps(NEAR_BY.0).flat_map(move |x| {
        steps(NEAR_BY.0).flat_map(move |y| steps(NEAR_BY.1).map(move |yaw| embed_3d(&Rigid2::new(x, y, yaw))))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Space2d;
    use crate::made_rooms::{node, submap};

    #[test]
    fn a_scan_of_one_room_contradicts_another_room_at_the_same_place() {
        let (large, small) = ((9.0, 7.0), (6.0, 5.0));
        let agreement =
            |of, at, pose: &Rigid3| Space2d::agreement(&submap(of), &node(large, at), pose).unwrap();
        let at_true_pose = agreement(large, (1.0, -0.5), &Rigid3::translation(1.0, -0.5, 0.0));
        assert!(at_true_pose.explained > 0.9 && !refutes_place(&at_true_pose), "{at_true_pose:?}");
        let elsewhere = agreement(small, (0.0, 0.0), &Rigid3::identity());
        assert!(refutes_place(&elsewhere), "{elsewhere:?}");
        let outside = Rigid3::translation(7.0, 0.0, 0.0);
        assert!(Space2d::agreement(&submap(large), &node(large, (0.0, 0.0)), &outside).is_none());
    }

    #[test]
    fn a_few_contradicted_places_do_not_make_a_map_contradictory() {
        let is_contradictory = |places, contradicted| {
            Consistency { places, contradicted, longest_row: 1, ..Consistency::default() }.is_contradictory()
        };
        assert!(!is_contradictory(0, 0) && !is_contradictory(10, 4) && !is_contradictory(149, 5));
        assert!(is_contradictory(328, 90) && is_contradictory(97, 42) && is_contradictory(122, 11));
    }

    #[test]
    fn a_part_is_confirmed_by_most_of_its_known_places() {
        let of =
            |places, unknown, confirmed| Consistency { places, unknown, confirmed, ..Consistency::default() };
        assert!(of(25, 0, 13).is_confirmed() && of(5, 40, 4).is_confirmed() && of(2, 0, 2).is_confirmed());
        assert!(!of(25, 0, 12).is_confirmed() && !of(0, 9, 0).is_known() && !of(0, 0, 0).is_known());
        assert!(!of(2, 20, 2).is_known());
    }

    #[test]
    fn a_short_row_of_contradicted_places_is_not_contradictory() {
        let of = |row: usize| {
            let [yes, no] = [Verdict::Contradicted, Verdict::Undecided].map(Some);
            let fits = vec![Some(Verdict::Confirmed); 10];
            Consistency::of(&[vec![no; 90], vec![yes; row], vec![None; 7], fits, vec![yes, no, yes]].concat())
        };
        let three = Consistency { places: 106, unknown: 7, contradicted: 5, confirmed: 10, longest_row: 3 };
        assert_eq!(of(3), three);
        assert!(!of(0).is_contradictory() && !of(3).is_contradictory() && of(4).is_contradictory());
        assert_eq!(Consistency::of(&[]), Consistency::default());
    }
}
