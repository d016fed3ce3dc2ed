//! What the pose graph does beyond what Cartographer does.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use portolan_config::PortolanOptions;
use portolan_optimization::SensorPolicy;
use portolan_submaps::SearchWindow;

use crate::{MatchAcceptance, NodeId, SubmapId, TrajectoryId};

/// How far and how often nodes are searched in submaps that they are connected with.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoopSearchPolicy {
    /// Metres by which a node may be off for each metre of way since its submap was last seen; windows follow
    /// that. 0: windows are those of the options.
    pub drift: f64,
    /// A node is searched in a submap once in so many metres of way; 0: as `sampling_ratio` says.
    pub spacing: f64,
    /// Which matches are believed.
    pub acceptance: MatchAcceptance,
    /// Whether `max_constraint_distance` counts from where the nodes of a submap were taken, instead of from its origin.
    pub is_from_nodes: bool,
    /// Whether a trajectory without a place in the rest is searched in whole parts of the map at once; otherwise in whole submaps, as
    /// `global_sampling_ratio` says.
    pub searches_whole_maps: bool,
}

/// A node can be so far off however short the path was: cells, bent submaps, a slip of the wheels.
const LEAST_WINDOW: SearchWindow = SearchWindow { linear: 1.5, angular: 0.2 };
/// No window is wider than this, metres: what drifts farther is left to searching whole submaps.
const WIDEST_WINDOW: f64 = 30.0;

impl LoopSearchPolicy {
    /// How far poses drift over a way of so many metres. The place drifts with the way, as a heading that is off by a constant
    /// makes it; the heading itself does a random walk.
    pub(super) fn drift_over(&self, way: f64) -> SearchWindow {
        SearchWindow { linear: self.drift * way, angular: self.drift * way.sqrt() }
    }

    /// How far around its guess a node is searched after paths of so many metres since the place and since the heading
    /// were tied.
    pub(super) fn window(&self, travelled: f64, turned: f64) -> SearchWindow {
        let (linear, angular) = (self.drift_over(travelled).linear, self.drift_over(turned).angular);
        SearchWindow {
            linear: (LEAST_WINDOW.linear + linear).min(WIDEST_WINDOW),
            angular: (LEAST_WINDOW.angular + angular).min(PI),
        }
    }

    /// The widest window that any way makes, metres.
    pub(super) fn widest_window(&self) -> f64 {
        if self.drift > 0.0 { WIDEST_WINDOW } else { 0.0 }
    }
}

/// Loop closures over so many metres of way tell all they can; over less they tell less.
const TELLING_WAY: f64 = 20.0;
/// A fraction of all is searched all the same: places are measured better by being measured more often.
const LEAST_SHARE: f64 = 0.1;

/// When it is the turn of a node to be searched in one submap.
#[derive(Clone, Debug, Default)]
pub(super) struct Spacing {
    /// By trajectory: how far along it the last node was that had its turn, metres.
    last: BTreeMap<TrajectoryId, f64>,
    /// Searches that are due, of those that would tell less than others.
    due: f64,
}

impl Spacing {
    /// Whether the turn of a node at so many metres of its trajectory has come, one in `spacing` metres. Submaps
    /// take turns, so that not all are searched for the same nodes.
    pub fn is_due(&mut self, (submap, node): (SubmapId, NodeId), way: f64, spacing: f64) -> bool {
        let phase = (f64::from(submap.index) * GOLDEN).fract();
        let last = self.last.entry(node.trajectory_id).or_insert(way - phase * spacing);
        let is_due = (way - *last).abs() >= spacing;
        if is_due {
            *last = way;
        }
        is_due
    }

    /// Whether to search after a path of so many metres.
    pub fn is_telling(&mut self, travelled: f64) -> bool {
        self.due += (travelled / TELLING_WAY).clamp(LEAST_SHARE, 1.0);
        let is_due = self.due >= 1.0;
        self.due -= f64::from(u8::from(is_due));
        is_due
    }
}

/// Multiples of it fill an interval evenly.
pub(super) const GOLDEN: f64 = 0.618_033_988_749_895;

/// What the pose graph does beyond what Cartographer does; nothing by default.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseGraphPolicy {
    /// Loop closures that all others together contradict are dropped at the end.
    pub drops_contradicted: bool,
    /// What is made of what sensors say when optimising.
    pub sensors: SensorPolicy,
    /// How many matches in whole submaps must agree to connect two trajectories; with 1 a single match does.
    pub min_agreeing: usize,
    /// Trajectories without a place in the map are searched as soon as nodes come, as many times as real time
    /// allows, where the scanner can be (only in 3D).
    pub localises_while_recording: bool,
    /// Pairs that are to be tried in all before the last optimisation; 0 adds none.
    pub min_searches: u64,
    /// Searches in a window.
    pub loops: LoopSearchPolicy,
    /// So many of the newest submaps of each place stay, and the first; 0: all.
    pub submaps_per_place: usize,
    /// Submaps are drawn again from their scans when the map is finished (in 2D).
    pub redraws: bool,
}

impl Default for PoseGraphPolicy {
    fn default() -> Self {
        Self {
            drops_contradicted: false,
            sensors: SensorPolicy::default(),
            min_agreeing: 1,
            localises_while_recording: false,
            min_searches: 0,
            loops: LoopSearchPolicy::default(),
            submaps_per_place: 0,
            redraws: false,
        }
    }
}

/// A graph is optimised again when it has grown by this fraction.
const GROWTH: f64 = 0.05;

impl PoseGraphPolicy {
    /// After how many nodes to optimise a graph of so many nodes; `least` as the options say. Where windows follow
    /// the drift a large graph need not be optimised as often as a small one, so that the time for all of it grows
    /// with the number of nodes and not with its square.
    pub(super) fn nodes_between_optimizations(&self, least: i64, nodes: usize) -> i64 {
        let grown = if self.loops.drift > 0.0 { (GROWTH * nodes as f64) as i64 } else { 0 };
        if least > 0 { least.max(grown) } else { least }
    }

    /// As the options say.
    pub fn new(options: &PortolanOptions) -> Self {
        Self {
            drops_contradicted: options.drop_contradicted_loop_closures,
            sensors: SensorPolicy::new(options),
            min_agreeing: options.global_localization_min_matches,
            localises_while_recording: options.localises_while_recording(),
            min_searches: options.min_loop_closure_searches as u64,
            submaps_per_place: options.submaps_per_place,
            redraws: options.redraw_submaps,
            loops: LoopSearchPolicy {
                drift: options.loop_search_drift,
                searches_whole_maps: options.searches_whole_maps(),
                spacing: options.loop_search_spacing,
                is_from_nodes: options.measures_distance_from_nodes(),
                acceptance: MatchAcceptance {
                    min_explained: options.loop_min_explained as f32,
                    max_contradiction: options.loop_max_contradiction as f32,
                },
            },
        }
    }
}
