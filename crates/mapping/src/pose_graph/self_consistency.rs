//! Whether a finished map contradicts itself.
//!
//! A wrong motion or a loop closure that is missed lays parts of a map over each other. The scans taken in the one part
//! then contradict what the other shows there: they end in free space and pass through walls.

use portolan_geometry::{Rigid2, Rigid3, embed_3d};
use rayon::prelude::*;

use super::PoseGraph;
use super::policy::Spacing;
use crate::{NodeId, Space, SubmapId};
use portolan_local_slam::refutes_place;

/// Places are this far apart along the way, metres.
const SPACING: f64 = 1.0;
/// A submap knows a place if it explains or contradicts this fraction of the beams of its scan.
const KNOWN: f32 = 0.5;
/// A map of which more places than this fraction are contradicted lies over itself. Real logs that come out right, as recorded and spoilt,
/// come to at most 0.034; maps that are torn in a small part only come to less, and are told by `IN_A_ROW`
/// (docs/experiments/2026-11-self-consistency.md, 2026-11-panes-and-few-beams.md).
const CONTRADICTORY: f64 = 0.06;
/// Fewer contradicted places are not reported: a gate that was moved or a crowd explains them.
const FEWEST: usize = 5;
/// A scan that fits within so many metres and radians of its place, a wall or two of the grid, contradicts nothing: the map is bent
/// there, not torn.
const NEAR_BY: (f64, f64) = (0.1, 0.02);
/// So many contradicted places in a row are a part that lies over another one, however large the rest of the map is.
const IN_A_ROW: usize = 4;

/// How a finished map agrees with itself (in 2D).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SelfConsistency {
    /// Places, one in a metre of way, known to submaps that were drawn from other scans.
    pub places: usize,
    /// Those that at least half of these submaps contradict.
    pub contradicted: usize,
    /// The most of them that follow each other along the way.
    pub longest_row: usize,
}

impl SelfConsistency {
    /// Whether parts of the map lie over each other.
    pub fn is_contradictory(&self) -> bool {
        let is_torn = self.contradicted as f64 > CONTRADICTORY * self.places as f64;
        self.contradicted >= FEWEST && is_torn || self.longest_row >= IN_A_ROW
    }

    /// Of places in the order of the way, each contradicted or not.
    fn of(places: &[bool]) -> Self {
        let rows = places.chunk_by(|a, b| a == b).filter(|row| row.first() == Some(&true));
        let lengths = rows.map(<[bool]>::len);
        Self {
            places: places.len(),
            contradicted: lengths.clone().sum(),
            longest_row: lengths.max().unwrap_or_default(),
        }
    }
}

impl<S: Space> PoseGraph<S> {
    /// How the map agrees with itself; known after the final optimisation where submaps are drawn again.
    pub fn self_consistency(&self) -> SelfConsistency {
        self.self_consistency
    }

    pub(super) fn judge_self_consistency(&self) -> SelfConsistency {
        if !self.policy.redraws {
            return SelfConsistency::default();
        }
        let mut spacing = Spacing::default();
        let mut nodes: Vec<NodeId> = self.state.nodes.keys().copied().collect();
        nodes.retain(|id| {
            let way = self.ways.get(id).copied().unwrap_or(0.0);
            spacing.is_due((SubmapId::new(id.trajectory_id, 0), *id), way, SPACING)
        });
        let goes_on = || !self.stop.is_asked();
        let contradicted = nodes.par_iter().filter(|_| goes_on()).filter_map(|id| self.is_contradicted(*id));
        let contradicted: Vec<bool> = contradicted.collect();
        if self.stop.is_asked() {
            return SelfConsistency::default();
        }
        SelfConsistency::of(&contradicted)
    }

    /// Whether at least half of the submaps that know the place of a node, and were drawn without it, contradict its scan;
    /// none if there is no such submap. Parts that nothing ties together are not compared.
    fn is_contradicted(&self, id: NodeId) -> Option<bool> {
        let (node, place) = (self.state.nodes.get(&id)?, self.problem.nodes.get(&id)?);
        let (mut known, mut contradicting) = (0, Vec::new());
        for (submap_id, entry) in &self.state.submaps {
            let is_compared = !entry.node_ids.contains(&id)
                && self.state.connectivity.are_connected(submap_id.trajectory_id, id.trajectory_id);
            let (true, Some(submap), Some(map_from_submap)) =
                (is_compared, entry.submap.as_deref(), self.problem.submaps.get(submap_id))
            else {
                continue;
            };
            let submap_from_node = map_from_submap.inverse() * place.map_from_node;
            let Some(agreement) = S::agreement(submap, &node.data, &submap_from_node) else { continue };
            if agreement.explained + agreement.contradicted() < KNOWN {
                continue;
            }
            known += 1;
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
        (known > 0).then_some(is_half(count))
    }
}

/// Poses around one as far off as parts of a map that is not torn: thin walls and noisy scans contradict each other by less.
fn near_by() -> impl Iterator<Item = Rigid3> {
    let steps = |largest: f64| (-2..=2).map(move |i| f64::from(i) / 2.0 * largest);
    steps(NEAR_BY.0).flat_map(move |x| {
        steps(NEAR_BY.0).flat_map(move |y| steps(NEAR_BY.1).map(move |yaw| embed_3d(&Rigid2::new(x, y, yaw))))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Planar;
    use crate::made_rooms::{node, submap};

    #[test]
    fn a_scan_of_one_room_contradicts_another_that_lies_over_it() {
        let (large, small) = ((9.0, 7.0), (6.0, 5.0));
        let agreement =
            |of, at, pose: &Rigid3| Planar::agreement(&submap(of), &node(large, at), pose).unwrap();
        let seen_there = agreement(large, (1.0, -0.5), &Rigid3::translation(1.0, -0.5, 0.0));
        assert!(seen_there.explained > 0.9 && !refutes_place(&seen_there), "{seen_there:?}");
        let elsewhere = agreement(small, (0.0, 0.0), &Rigid3::identity());
        assert!(refutes_place(&elsewhere), "{elsewhere:?}");
        let outside = Rigid3::translation(7.0, 0.0, 0.0);
        assert!(Planar::agreement(&submap(large), &node(large, (0.0, 0.0)), &outside).is_none());
    }

    #[test]
    fn a_few_contradicted_places_are_no_torn_map() {
        let is_contradictory = |places, contradicted| {
            SelfConsistency { places, contradicted, longest_row: 1 }.is_contradictory()
        };
        assert!(!is_contradictory(0, 0) && !is_contradictory(10, 4) && !is_contradictory(149, 5));
        assert!(is_contradictory(328, 90) && is_contradictory(97, 42) && is_contradictory(122, 11));
    }

    #[test]
    fn a_few_contradicted_places_in_a_row_are_one() {
        let of = |row: usize| {
            let places =
                [vec![false; 90], vec![true; row], vec![false; 10], vec![true, false, true]].concat();
            SelfConsistency::of(&places)
        };
        assert_eq!(of(3), SelfConsistency { places: 106, contradicted: 5, longest_row: 3 });
        assert!(!of(0).is_contradictory() && !of(3).is_contradictory() && of(4).is_contradictory());
        assert_eq!(SelfConsistency::of(&[]), SelfConsistency::default());
    }
}
