//! Examines how well the places of a map can be told apart: searches the scans of its nodes in the whole map
//! as localisation would.

use std::ops::ControlFlow;

use portolan_geometry::{Rigid3, Vector3, rotation_angle, to_f32};
use portolan_mapping::{GraphState, Node, NodeId, of_trajectory};
use rayon::prelude::*;

use crate::evidence::Verdict;
use crate::hypothesis::Hypothesis;
use crate::information::degenerate_direction;
use crate::known_map::KnownMap;
use crate::paired::Discordant;
use crate::recent::{KeyScan, RecentScans, is_alike};
use crate::search::{Decision, Judge, Places, Searcher};
use crate::settings::matching::NARROWEST_WINDOW;
use crate::settings::scans::KEPT_SCANS;
use crate::settings::search::{ELSEWHERE, EXAMINED_SPACING, MOST_EXAMINED};
use crate::state::Reason;

/// Number of places that are examined at once; it does not depend on the number of threads.
const BATCH: usize = 8;

/// How well a place can be distinguished from the others of its map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Distinctness {
    /// Localisation would accept the place, and it is constrained in all directions.
    Distinct,
    /// The place would be accepted, but the scan has a degenerate direction.
    Degenerate,
    /// Another place fits nearly as well, or better.
    Ambiguous,
    /// The map explains too little of the scans even at their true place.
    Thin,
}

impl Distinctness {
    /// All of them, the best first.
    pub const ALL: [Self; 4] = [Self::Distinct, Self::Degenerate, Self::Ambiguous, Self::Thin];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Distinct => "distinct",
            Self::Degenerate => "degenerate",
            Self::Ambiguous => "ambiguous",
            Self::Thin => "thin",
        }
    }
}

/// Another place where a scan fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OtherPlace {
    /// Pose of the tracking frame in the map.
    pub map_from_tracking: Rigid3,
    /// Mean fraction of beams that the map explains there less the fraction that it contradicts.
    pub fit: f64,
}

/// A place of a map that was examined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExaminedPlace {
    /// The node whose scan was searched in the map.
    pub node_id: NodeId,
    /// Pose of the tracking frame in the map when the scan was taken.
    pub map_from_tracking: Rigid3,
    /// Length of the path segment that the place stands for, metres.
    pub path_length: f64,
    /// Result of the examination.
    pub distinctness: Distinctness,
    /// Mean fraction of beams that the map explains less the fraction that it contradicts, of the scans on
    /// the path to the place.
    pub fit: f64,
    /// Fraction of the beams of the node's scan that the map explains.
    pub explained: f64,
    /// The best other place, if any fits.
    pub other: Option<OtherPlace>,
    /// The degenerate direction in the map, along which the scan can be shifted without changing its fit; of
    /// length 0 if only a rotation is degenerate.
    pub degenerate_direction: Option<Vector3>,
}

/// A node that is to be examined, and the distance travelled since the last one.
struct Stop<'a> {
    id: NodeId,
    node: &'a Node,
    path_length: f64,
    /// Nodes on the path before it, the newest first, as many as scans are kept.
    before: Vec<&'a Node>,
}

/// Examines places of a map.
pub struct PlaceExaminer<'a, M: KnownMap> {
    searcher: Searcher<M>,
    stops: Vec<Stop<'a>>,
}

impl<'a, M: KnownMap> PlaceExaminer<'a, M> {
    /// For a map and the pose graph that it was made of; `threads` as in
    /// [`LocalizerSettings`](crate::LocalizerSettings).
    ///
    /// # Errors
    /// If threads cannot be started.
    pub fn new(
        map: M,
        state: &'a GraphState<M::Space>,
        threads: usize,
    ) -> Result<Self, rayon::ThreadPoolBuildError> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        Ok(Self { searcher: Searcher { map, pool }, stops: stops::<M>(state) })
    }

    /// Examines places along all trajectories. `observe` receives the numbers of finished and of all places,
    /// and may stop it. The result is the same for any number of threads.
    pub fn examine(&self, observe: &mut dyn FnMut(usize, usize) -> ControlFlow<()>) -> Vec<ExaminedPlace> {
        let mut places = Vec::new();
        for batch in self.stops.chunks(BATCH) {
            if observe(places.len(), self.stops.len()).is_break() {
                break;
            }
            let examined = || batch.par_iter().map(|stop| self.place(stop)).collect();
            let examined: Vec<ExaminedPlace> = self.searcher.pool.install(examined);
            places.extend(examined);
        }
        places
    }

    /// Searches the whole map for the scans on the path to a node, as localisation would.
    fn place(&self, stop: &Stop) -> ExaminedPlace {
        let map = &self.searcher.map;
        let map_from_tracking = stop.node.map_from_tracking;
        let truth = M::local_from_scan(&map_from_tracking);
        let scan_from_tracking = truth.inverse() * map_from_tracking;
        let mut recent = RecentScans::default();
        for node in stop.before.iter().rev().copied().chain([stop.node]) {
            recent.offer(self.scan_of(node));
        }
        let here = map.find(&self.scan_of(stop.node).scan, &truth, NARROWEST_WINDOW);
        let own = Hypothesis::along(map, &recent, &truth);
        let mut others = self.searcher.propose(&recent, None, &|pose| !is_elsewhere(pose, &truth));
        others.retain(|other| is_elsewhere(&other.belief.pose, &truth));
        let other = others.first().map(|other| OtherPlace {
            map_from_tracking: other.belief.pose * scan_from_tracking,
            fit: other.fit(),
        });
        let degenerate_direction = degenerate_direction(&here.information, M::FREEDOM);
        let fit = own.as_ref().map_or(0.0, Hypothesis::fit);
        let judged = own.map(|own| judge(own, others, &self.searcher, &recent));
        let distinctness = match judged {
            _ if Verdict::of(&here.agreement) != Verdict::Supports => Distinctness::Thin,
            None => Distinctness::Thin,
            Some(Distinctness::Distinct) if degenerate_direction.is_some() => Distinctness::Degenerate,
            Some(judged) => judged,
        };
        let (node_id, path_length) = (stop.id, stop.path_length);
        let explained = f64::from(here.agreement.explained);
        ExaminedPlace {
            node_id,
            map_from_tracking,
            path_length,
            distinctness,
            fit,
            explained,
            other,
            degenerate_direction,
        }
    }

    /// The scan of a node at its pose in the map.
    fn scan_of(&self, node: &Node) -> KeyScan<M::Scan> {
        let map_from_scan = M::local_from_scan(&node.map_from_tracking);
        let scan_from_tracking = to_f32(&(map_from_scan.inverse() * node.map_from_tracking));
        let points = M::points_in_tracking(&node.data).transformed(&scan_from_tracking);
        KeyScan {
            time: node.data.time,
            local_from_scan: map_from_scan,
            scan: self.searcher.map.scan(&points),
        }
    }
}

/// Whether the true place would be accepted among the others.
fn judge<M: KnownMap>(
    own: Hypothesis,
    others: Vec<Hypothesis>,
    searcher: &Searcher<M>,
    recent: &RecentScans<M::Scan>,
) -> Distinctness {
    let mut places = Places::of_complete_search(std::iter::once(own).chain(others).collect());
    let evidence =
        |a: &Hypothesis, b: &Hypothesis| Discordant::between(&searcher.map, recent, [a, b]).deviations();
    let judge = Judge { motion: recent.motion(), agreement_with_start: &|_| 0.0, evidence: &evidence };
    match places.decide(&judge, true) {
        Decision::Accepted(0) => Distinctness::Distinct,
        Decision::Nothing | Decision::Tentative(0, Reason::TooLittleSeen) => Distinctness::Thin,
        Decision::Accepted(_) | Decision::Tentative(..) => Distinctness::Ambiguous,
    }
}

fn is_elsewhere(pose: &Rigid3, truth: &Rigid3) -> bool {
    let off = truth.inverse() * pose;
    off.translation.vector.norm() > ELSEWHERE.metres || rotation_angle(&off) > ELSEWHERE.radians
}

/// Nodes at even distances along all trajectories.
fn stops<M: KnownMap>(state: &GraphState<M::Space>) -> Vec<Stop<'_>> {
    let trajectories: Vec<Vec<(NodeId, &Node)>> =
        state.trajectories.keys().map(|id| of_trajectory(&state.nodes, *id).collect()).collect();
    let step = |a: &Node, b: &Node| {
        (a.map_from_tracking.translation.vector - b.map_from_tracking.translation.vector).norm()
    };
    let path_length = |nodes: &Vec<(NodeId, &Node)>| {
        nodes.iter().zip(nodes.iter().skip(1)).map(|((_, a), (_, b))| step(a, b)).sum::<f64>()
    };
    let spacing = EXAMINED_SPACING.max(trajectories.iter().map(path_length).sum::<f64>() / MOST_EXAMINED);
    let mut stops = Vec::new();
    for nodes in &trajectories {
        let (mut path_length, mut next) = (0.0, 0.0);
        for (i, (id, node)) in nodes.iter().enumerate() {
            let (before, _) = nodes.split_at(i);
            path_length += before.last().map_or(0.0, |(_, last)| step(last, node));
            if path_length >= next {
                let before = nodes_before::<M>(before, node);
                stops.push(Stop { id: *id, node, path_length, before });
                (path_length, next) = (0.0, spacing);
            }
        }
    }
    stops
}

/// The nodes on the path to a node whose scans localisation would keep, the newest first.
fn nodes_before<'a, M: KnownMap>(nodes: &[(NodeId, &'a Node)], node: &Node) -> Vec<&'a Node> {
    let mut after = M::local_from_scan(&node.map_from_tracking);
    let mut kept: Vec<&Node> = Vec::new();
    for (_, node) in nodes.iter().rev() {
        let here = M::local_from_scan(&node.map_from_tracking);
        if !is_alike(&after, &here) {
            kept.push(node);
            after = here;
        }
        if kept.len() + 1 == KEPT_SCANS {
            break;
        }
    }
    kept
}
