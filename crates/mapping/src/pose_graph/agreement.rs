//! Localisation by consensus: finds the pose of a trajectory in a map that it is not connected with yet.
//!
//! Scans that are searched in whole submaps also match in wrong places: corridors look alike. Each match
//! implies a pose of the whole trajectory. Wrong matches imply different poses, right ones agree. So matches
//! wait until enough of them agree.
//!
//! The same holds for loop closures within a connected map that would bend it. A single one may be a
//! perceptual alias of another corridor. Once it has bent the map, searches near it find nothing that
//! contradicts it. Such loop closures wait until scans of several nodes agree how the map is to be bent, or
//! until others have bent it so (pairwise consistency; Mangelson et al., ICRA 2018).

use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{Quaternion, Rigid3, Vector3, rotation_angle};
use portolan_submaps::SearchWindow;

use super::PoseGraph;
use super::travel::TravelGraph;
use crate::{Constraint, NodeId, OpenShift, Space, TrajectoryId, of_trajectory};

/// Maximum differences between the poses implied by two matches that agree, metres and radians: the drift of
/// a few submaps.
const MAX_TRANSLATION: f64 = 0.5;
const MAX_ROTATION: f64 = 0.09;
const NO_DRIFT: SearchWindow = SearchWindow { linear: 0.0, angular: 0.0 };
/// Minimum ratio of the support of the winning pose to that of any other.
const LEAD: f64 = 2.0;
/// Score that counts as zero weight: wrong matches between the halves of symmetric buildings reach it. The
/// weight of a match is its score above this.
const SCORE_BY_CHANCE: f64 = 0.5;
const MIN_WEIGHT: f64 = 0.01;
/// Maximum number of loop closures that wait for others to agree; the newest are kept.
const MOST_UNSUPPORTED: usize = 500;

/// Maximum path length over which the position along a corridor is known from other constraints, metres. Over
/// such a path it is known to some metres, and no other corridor is so near.
const SHORT_PATH: f64 = 50.0;

/// Cosine of the angle between degenerate directions that count as the same. Matches with different
/// degenerate directions are not comparable.
const PARALLEL: f64 = 0.98;

/// A match that waits for others to agree.
#[derive(Clone, Debug)]
struct WaitingMatch {
    constraint: Constraint,
    /// Takes the map frame of the later part to that of the earlier part.
    earlier_from_later: Rigid3,
    /// Position of the match in the map frame of the later part, metres.
    place_in_later: Vector3,
    /// The direction along which the match does not constrain the position, in the map frame of the earlier
    /// part.
    open: Option<OpenShift>,
    /// Rotates directions from that frame to the frame of the node.
    node_from_earlier: Quaternion,
    /// Whether odometry measured the motion between the parts, and agrees with the match.
    agrees_with_odometry: bool,
    /// Distance of its node along its trajectory, metres.
    path_length: f64,
}

impl WaitingMatch {
    /// Weight of the match in the vote.
    fn weight(&self) -> f64 {
        let score = self.constraint.score.map_or(1.0, f64::from);
        (score - SCORE_BY_CHANCE).max(MIN_WEIGHT)
    }

    fn log(&self) {
        let at = self.earlier_from_later.translation.vector;
        let yaw = self.earlier_from_later.rotation.euler_angles().2.to_degrees();
        let Constraint { node_id, submap_id, .. } = &self.constraint;
        tracing::debug!(
            "node {node_id} in submap {submap_id} says that the later part lies at {:.2}, {:.2}, {:.2} m, {yaw:.1} deg{}",
            at.x,
            at.y,
            at.z,
            if self.agrees_with_odometry { ", as odometry" } else { "" },
        );
    }
}

/// Two parts of the map that nothing connects, each named by its first trajectory, the earlier first.
type Parts = (TrajectoryId, TrajectoryId);

/// Matches that wait.
#[derive(Clone, Debug, Default)]
pub(super) struct WaitingMatches {
    by_parts: BTreeMap<Parts, Vec<WaitingMatch>>,
    /// Loop closures that would bend the map, in the order of the search.
    unsupported: Vec<Constraint>,
    /// Number of those that were dropped because too many waited.
    forgotten: usize,
}

impl<S: Space> PoseGraph<S> {
    /// Adds constraints found by a search. Those that would connect trajectories wait until enough of them
    /// agree.
    pub(super) fn add_found(&mut self, found: Vec<Constraint>) {
        // Searched in a window, or anywhere: that depends on what was connected when it was searched.
        let was_connected: Vec<bool> = found.iter().map(|c| self.is_within_part(c)).collect();
        for (constraint, was_connected) in found.into_iter().zip(was_connected) {
            if self.policy.min_agreeing <= 1 {
                self.take(constraint);
            } else if was_connected {
                self.waiting.unsupported.push(constraint);
            } else if self.is_within_part(&constraint) {
                // Its parts have just been connected: it can be compared with the map.
                if self.fits(&constraint) {
                    self.take(constraint);
                }
            } else if constraint.open.is_some() {
                // Parts that it alone connected would be free to slide along its degenerate direction.
                self.waiting.unsupported.push(constraint);
            } else {
                self.wait_for_agreement(constraint);
            }
        }
        self.take_supported();
    }

    /// Whether the trajectories of node and submap are connected already.
    fn is_within_part(&self, constraint: &Constraint) -> bool {
        let [node, submap] = [constraint.node_id.trajectory_id, constraint.submap_id.trajectory_id];
        self.state.connectivity.are_connected(node, submap)
    }

    /// Number of loop closures that still wait for others to agree: at the end they are left out.
    pub fn unsupported_loop_closures(&self) -> usize {
        self.waiting.unsupported.len() + self.waiting.forgotten
    }

    /// Accepts loop closures that fit the map, or that others agree with; the rest keeps waiting. Returns the
    /// number accepted.
    pub(super) fn take_supported(&mut self) -> usize {
        let waiting = std::mem::take(&mut self.waiting.unsupported);
        let travel = TravelGraph::new(&self.state, &self.path_lengths);
        let is_placed =
            |c: &Constraint| c.open.is_none() || travel.is_tied((c.submap_id, c.node_id), SHORT_PATH);
        let within_part = |c: &Constraint| self.is_within_part(c).then(|| self.bending_match(c)).flatten();
        let matches: Vec<Option<WaitingMatch>> = waiting.iter().map(within_part).collect();
        let fits = |c: &Constraint| self.fits(c) && is_placed(c);
        let taken: Vec<Option<Constraint>> = matches
            .iter()
            .map(|m| match m.as_ref()? {
                m if fits(&m.constraint) => Some(m.constraint.clone()),
                m => supported(m, matches.iter().flatten(), self.policy.min_agreeing),
            })
            .collect();
        let count = taken.iter().flatten().count();
        for (constraint, taken) in waiting.into_iter().zip(taken) {
            match taken {
                Some(taken) => self.take(taken),
                None => self.waiting.unsupported.push(constraint),
            }
        }
        let superfluous = self.waiting.unsupported.len().saturating_sub(MOST_UNSUPPORTED);
        self.waiting.unsupported.drain(..superfluous);
        self.waiting.forgotten += superfluous;
        count
    }

    /// How a loop closure would bend the map: what was mapped later moves relative to what was mapped earlier.
    fn bending_match(&self, constraint: &Constraint) -> Option<WaitingMatch> {
        let submap_time = self.state.time_of_last_node(self.state.submaps.get(&constraint.submap_id)?)?;
        let is_node_later = submap_time < self.problem.nodes.get(&constraint.node_id)?.time;
        let waiting = self.as_waiting(constraint, is_node_later)?;
        let earlier_from_node = match is_node_later {
            true => self.problem.submaps.get(&constraint.submap_id)? * constraint.submap_from_node,
            false => self.problem.nodes.get(&constraint.node_id)?.map_from_node,
        };
        let turned = |open: OpenShift| OpenShift { direction: earlier_from_node.rotation * open.direction };
        let node_from_earlier = earlier_from_node.rotation.inverse();
        Some(WaitingMatch { open: constraint.open.map(turned), node_from_earlier, ..waiting })
    }

    /// The transform that a match implies for the later of node and submap.
    fn as_waiting(&self, constraint: &Constraint, is_node_later: bool) -> Option<WaitingMatch> {
        let map_from_submap = self.problem.submaps.get(&constraint.submap_id)?;
        let known = self.problem.nodes.get(&constraint.node_id)?.map_from_node;
        let found = map_from_submap * constraint.submap_from_node;
        let found_from_known = found * known.inverse();
        let (earlier_from_later, place) = match is_node_later {
            true => (found_from_known, known),
            false => (found_from_known.inverse(), found),
        };
        let place_in_later = place.translation.vector;
        Some(WaitingMatch {
            constraint: constraint.clone(),
            earlier_from_later,
            place_in_later,
            open: None,
            node_from_earlier: Quaternion::identity(),
            agrees_with_odometry: false,
            path_length: self.path_lengths.get(&constraint.node_id).copied().unwrap_or(0.0),
        })
    }

    pub(super) fn take(&mut self, constraint: Constraint) {
        self.connect_by(&constraint);
        self.state.constraints.push(constraint);
    }

    /// For the map as all other constraints shape it: a loop closure with a degenerate direction becomes a
    /// full constraint if the map agrees with it along that direction, and the path is too short for another
    /// place that looks alike. The others are shifted along their degenerate direction to where the map has
    /// the node. Returns whether any became a full constraint.
    pub(super) fn settle_open_loop_closures(&mut self) -> bool {
        let travel = TravelGraph::new(&self.state, &self.path_lengths);
        let mut constraints = std::mem::take(&mut self.state.constraints);
        let mut is_any = false;
        for constraint in &mut constraints {
            let (Some(open), Some(error)) = (constraint.open, self.error_of(constraint)) else { continue };
            let along = open.direction.dot(&error.translation.vector);
            let is_tied = travel.is_tied((constraint.submap_id, constraint.node_id), SHORT_PATH);
            if along.abs() <= MAX_TRANSLATION && is_tied {
                constraint.open = None;
                is_any = true;
            } else {
                let shift = open.direction * along;
                constraint.submap_from_node *= Rigid3::translation(shift.x, shift.y, shift.z);
            }
        }
        self.state.constraints = constraints;
        is_any
    }

    fn fits(&self, constraint: &Constraint) -> bool {
        self.disagreement(constraint)
            .is_some_and(|(metres, radians)| metres <= MAX_TRANSLATION && radians <= MAX_ROTATION)
    }

    fn wait_for_agreement(&mut self, constraint: Constraint) {
        let Some((parts, waiting)) = self.waiting_match(&constraint) else { return };
        waiting.log();
        let waiting_here = self.waiting.by_parts.entry(parts).or_default();
        waiting_here.push(waiting);
        let mut likely: Vec<_> = waiting_here.iter().filter(|m| m.agrees_with_odometry).cloned().collect();
        let (needed, loops) = (self.policy.min_agreeing, self.policy.loops);
        let agreed = agreed(&mut likely, needed, |path_length| loops.drift_over(path_length))
            .or_else(|| agreed(waiting_here, needed, |_| NO_DRIFT));
        if let Some(agreed) = agreed {
            self.waiting.by_parts.remove(&parts);
            self.connect_parts(parts, agreed);
        }
    }

    fn waiting_match(&self, constraint: &Constraint) -> Option<(Parts, WaitingMatch)> {
        let part = |id: TrajectoryId| self.state.connectivity.first_connected(id);
        let submap_part = part(constraint.submap_id.trajectory_id);
        let node_part = part(constraint.node_id.trajectory_id);
        let parts = (submap_part.min(node_part), submap_part.max(node_part));
        let waiting = self.as_waiting(constraint, submap_part < node_part)?;
        let agrees_with_odometry = self.agrees_with_odometry(constraint);
        Some((parts, WaitingMatch { agrees_with_odometry, ..waiting }))
    }

    /// Moves one part to its pose in the other part that the matches imply, and adds the matches as
    /// constraints.
    fn connect_parts(&mut self, (earlier, later): Parts, agreed: Vec<WaitingMatch>) {
        let best = agreed.iter().max_by(|a, b| {
            a.constraint.score.partial_cmp(&b.constraint.score).unwrap_or(std::cmp::Ordering::Equal)
        });
        let Some(earlier_from_later) = best.map(|m| m.earlier_from_later) else { return };
        let holds_still = |graph: &Self, part: TrajectoryId| {
            graph.state.connectivity.members(part).iter().any(|id| graph.problem.frozen.contains(id))
        };
        let newest = self.problem.nodes.iter().next_back().map(|(_, node)| node.time);
        self.localisation.placed_at = self.localisation.placed_at.or(newest);
        // The later part moves, unless only that one is frozen.
        let (moved, by) = match holds_still(self, later) && !holds_still(self, earlier) {
            true => (earlier, earlier_from_later.inverse()),
            false => (later, earlier_from_later),
        };
        self.move_part(moved, &by);
        self.placed_parts.extend(self.state.connectivity.members(moved));
        for waiting in agreed {
            self.take(waiting.constraint);
        }
    }

    pub(super) fn move_part(&mut self, part: TrajectoryId, by: &Rigid3) {
        for id in self.state.connectivity.members(part) {
            if self.problem.frozen.contains(&id) {
                continue;
            }
            self.state.trimmed_nodes.shift(id, by);
            for (_, pose) in self.problem.submaps.iter_mut().filter(|(s, _)| s.trajectory_id == id) {
                *pose = by * *pose;
            }
            let nodes: Vec<NodeId> = of_trajectory(&self.problem.nodes, id).map(|(id, _)| id).collect();
            for node_id in nodes {
                if let Some(node) = self.problem.nodes.get_mut(&node_id) {
                    node.map_from_node = by * node.map_from_node;
                }
            }
        }
    }
}

/// The matches that agree with the newest one, if they are enough and clearly outweigh any others that
/// contradict it. Matches contradict it if they differ by more than trajectories drift on the path between
/// the two nodes; `drift` gives the drift over a path, metres.
fn agreed(
    waiting: &mut Vec<WaitingMatch>,
    needed: usize,
    drift: impl Fn(f64) -> SearchWindow,
) -> Option<Vec<WaitingMatch>> {
    let support = |of: &WaitingMatch| {
        // A scan that matches in several submaps of a place counts once.
        let mut nodes: BTreeMap<NodeId, f64> = BTreeMap::new();
        for m in waiting.iter().filter(|m| agree(m, of)) {
            let weight = nodes.entry(m.constraint.node_id).or_default();
            *weight = weight.max(m.weight());
        }
        (nodes.len(), nodes.values().sum::<f64>())
    };
    let newest = waiting.last()?.clone();
    let (nodes, own) = support(&newest);
    if nodes < needed {
        return None;
    }
    let contradicts =
        |m: &&WaitingMatch| !agree_within(m, &newest, drift((m.path_length - newest.path_length).abs()));
    let others = waiting.iter().filter(contradicts).map(|m| support(m).1).fold(0.0, f64::max);
    if own < LEAD * others {
        return None;
    }
    waiting.retain(|m| agree(m, &newest));
    Some(std::mem::take(waiting))
}

/// A loop closure that would bend the map, if matches of at least `needed` waiting nodes agree with it. If
/// too few of these constrain the position along some direction that the others do not, it is accepted with
/// that direction as degenerate.
fn supported<'a>(
    of: &WaitingMatch,
    waiting: impl Iterator<Item = &'a WaitingMatch>,
    needed: usize,
) -> Option<Constraint> {
    let agreeing: Vec<&WaitingMatch> = waiting.filter(|m| agree(m, of)).collect();
    let nodes = |leaves_open: &dyn Fn(&WaitingMatch) -> bool| {
        let constrained = agreeing.iter().filter(|m| !leaves_open(m));
        constrained.map(|m| m.constraint.node_id).collect::<BTreeSet<NodeId>>().len()
    };
    if nodes(&|_| false) < needed {
        return None;
    }
    let is_along = |m: &WaitingMatch, direction: &Vector3| {
        m.open.is_some_and(|open| open.direction.dot(direction).abs() >= PARALLEL)
    };
    let directions = agreeing.iter().filter_map(|m| m.open).map(|open| open.direction);
    let least = directions
        .map(|direction| (nodes(&|m| is_along(m, &direction)), direction))
        .min_by_key(|(nodes, _)| *nodes)
        .filter(|(nodes, _)| of.open.is_none() && *nodes < needed);
    let open = least.map(|(_, direction)| OpenShift { direction: of.node_from_earlier * direction });
    Some(Constraint { open: open.or(of.constraint.open), ..of.constraint.clone() })
}

fn agree(a: &WaitingMatch, b: &WaitingMatch) -> bool {
    agree_within(a, b, NO_DRIFT)
}

/// Whether two matches agree within the usual tolerances plus `drift`. Compared at the positions of the
/// scans: far from the origin a small rotation moves much.
fn agree_within(a: &WaitingMatch, b: &WaitingMatch, drift: SearchWindow) -> bool {
    if a.open.zip(b.open).is_some_and(|(a, b)| a.direction.dot(&b.direction).abs() < PARALLEL) {
        return false;
    }
    let place = nalgebra::Point3::from((a.place_in_later + b.place_in_later) / 2.0);
    let apart = a.earlier_from_later * place - b.earlier_from_later * place;
    let apart = [a, b].iter().filter_map(|m| m.open).fold(apart, |apart, open| open.closed_part(&apart));
    let turned = rotation_angle(&(a.earlier_from_later.inverse() * b.earlier_from_later));
    apart.norm() <= MAX_TRANSLATION + drift.linear && turned <= MAX_ROTATION + drift.angular
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ConstraintTag, SubmapId};

    fn at(node: u32, x: f64, yaw: f64) -> WaitingMatch {
        let constraint = Constraint {
            submap_id: SubmapId::new(TrajectoryId(0), 0),
            node_id: NodeId::new(TrajectoryId(1), node),
            submap_from_node: Rigid3::identity(),
            translation_weight: 1.0,
            rotation_weight: 1.0,
            tag: ConstraintTag::InterSubmap,
            open: None,
            score: Some(0.75),
        };
        let earlier_from_later = Rigid3::from_parts(
            Vector3::new(x, 0.0, 0.0).into(),
            Quaternion::from_axis_angle(&Vector3::z_axis(), yaw),
        );
        WaitingMatch {
            constraint,
            earlier_from_later,
            place_in_later: Vector3::zeros(),
            open: None,
            node_from_earlier: Quaternion::identity(),
            agrees_with_odometry: false,
            path_length: 0.0,
        }
    }

    #[test]
    fn places_that_differ_are_not_accepted() {
        let mut waiting: Vec<WaitingMatch> = (0..6).map(|i| at(i, 3.0 * f64::from(i), 0.0)).collect();
        assert!(agreed(&mut waiting, 3, |_| NO_DRIFT).is_none());
        waiting.extend([at(7, 40.0, 0.5), at(8, 40.2, -0.5), at(9, 40.1, 0.5)]);
        assert!(agreed(&mut waiting, 3, |_| NO_DRIFT).is_none());
        assert_eq!(waiting.len(), 9);
    }

    #[test]
    fn good_matches_outweigh_as_many_poor_ones() {
        let scored = |node, x, score| {
            let mut waiting = at(node, x, 0.0);
            waiting.constraint.score = Some(score);
            waiting
        };
        let poor = || (0..4).map(|i| scored(i, 9.0, 0.56));
        let good = |score| (4..8).map(move |i| scored(i, 1.0, score));
        assert!(agreed(&mut poor().chain(good(0.6)).collect(), 3, |_| NO_DRIFT).is_none());
        let mut waiting = poor().chain(good(0.75)).collect();
        assert_eq!(agreed(&mut waiting, 3, |_| NO_DRIFT).unwrap().len(), 4);
        assert!(agreed(&mut good(0.75).chain(poor()).collect(), 3, |_| NO_DRIFT).is_none());
    }

    #[test]
    fn three_agreeing_matches_are_accepted_and_the_others_dropped() {
        let mut waiting = vec![at(0, 1.0, 0.0), at(1, 50.0, 0.0), at(2, 1.2, 0.02), at(3, 0.9, -0.03)];
        let taken: Vec<u32> = agreed(&mut waiting, 3, |_| NO_DRIFT)
            .unwrap()
            .iter()
            .map(|m| m.constraint.node_id.index)
            .collect();
        assert_eq!(taken, [0, 2, 3]);
        assert!(waiting.is_empty());
    }

    #[test]
    fn degenerate_directions_do_not_contradict() {
        let along =
            |direction: Vector3| WaitingMatch { open: Some(OpenShift { direction }), ..at(0, 1.0, 0.0) };
        assert!(agree(&along(Vector3::x()), &at(1, 6.0, 0.0)));
        assert!(agree(&at(1, 6.0, 0.0), &along(Vector3::x())));
        assert!(!agree(&along(Vector3::y()), &at(1, 6.0, 0.0)));
        assert!(!agree(&along(Vector3::x()), &at(1, 1.0, 0.2)));
    }

    #[test]
    fn degenerate_matches_support_only_constrained_directions() {
        let along = |node, direction: Vector3| WaitingMatch {
            open: Some(OpenShift { direction }),
            ..at(node, 0.0, 0.0)
        };
        let of = |waiting: &[WaitingMatch]| supported(&at(0, 0.1, 0.0), waiting.iter(), 3).map(|c| c.open);
        let full = [0, 1, 2].map(|node| at(node, 0.0, 0.0));
        assert_eq!(of(&full[..2]), None);
        assert_eq!(of(&full), Some(None));
        let [x, y] = [Vector3::x(), Vector3::y()];
        let one_direction = [at(0, 0.1, 0.0), along(1, x), along(2, x)];
        assert_eq!(of(&one_direction), Some(Some(OpenShift { direction: x })));
        let both_directions = [at(0, 0.1, 0.0), along(1, x), along(2, x), along(3, y), along(4, y)];
        assert_eq!(of(&both_directions), Some(None));
    }

    #[test]
    fn one_scan_in_three_submaps_counts_once() {
        let mut waiting = vec![at(4, 1.0, 0.0), at(4, 1.1, 0.0), at(4, 0.9, 0.0)];
        assert!(agreed(&mut waiting, 3, |_| NO_DRIFT).is_none());
    }

    #[test]
    fn ambiguous_places_need_more_matches() {
        let mut waiting =
            vec![at(0, 9.0, 0.0), at(1, 9.0, 0.0), at(2, 1.0, 0.0), at(3, 1.0, 0.0), at(5, 1.0, 0.0)];
        assert!(agreed(&mut waiting, 3, |_| NO_DRIFT).is_none());
        waiting.push(at(6, 1.0, 0.0));
        assert_eq!(agreed(&mut waiting, 3, |_| NO_DRIFT).unwrap().len(), 4);
    }
}
