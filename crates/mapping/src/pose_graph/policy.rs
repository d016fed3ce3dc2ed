//! Options of the pose graph that Cartographer does not have.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use portolan_config::PortolanOptions;
use portolan_optimization::SensorPolicy;
use portolan_submaps::SearchWindow;

use crate::{MatchAcceptance, NodeId, SubmapId, TrajectoryId};

/// Size of the search windows for loop closures between a node and a submap of the same connected map, and
/// how often such pairs are searched.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoopSearchPolicy {
    /// Drift, metres for each metre of path since the submap was last seen; search windows grow with it. 0:
    /// windows are those of the options.
    pub drift: f64,
    /// Distance along the trajectory between two searches in the same submap, metres; 0: searches follow
    /// `sampling_ratio`.
    pub spacing: f64,
    /// Criteria by which matches are accepted.
    pub acceptance: MatchAcceptance,
    /// Whether `max_constraint_distance` is measured from the nodes of a submap instead of from its origin.
    pub is_from_nodes: bool,
    /// Whether a trajectory that is not connected with the rest is searched in whole connected parts of the
    /// map at once; otherwise in whole submaps, at the rate of `global_sampling_ratio`.
    pub searches_whole_maps: bool,
}

/// Smallest window, metres and radians: errors that do not depend on the path length (cell size, bent
/// submaps, wheel slip).
const LEAST_WINDOW: SearchWindow = SearchWindow { linear: 1.5, angular: 0.2 };
/// Widest window, metres. Larger drift is left to the search of whole submaps.
const WIDEST_WINDOW: f64 = 30.0;

impl LoopSearchPolicy {
    /// Drift over a path, metres: metres and radians. The position error grows linearly with
    /// the path length, as it does with a constant heading error; the heading error is a random walk (square
    /// root of the path length).
    pub(super) fn drift_over(&self, path_length: f64) -> SearchWindow {
        SearchWindow { linear: self.drift * path_length, angular: self.drift * path_length.sqrt() }
    }

    /// Search window around the guess. `travelled` and `turned` are the path lengths, metres, over which the
    /// position and the heading have drifted since they were last constrained.
    pub(super) fn window(&self, travelled: f64, turned: f64) -> SearchWindow {
        let (linear, angular) = (self.drift_over(travelled).linear, self.drift_over(turned).angular);
        SearchWindow {
            linear: (LEAST_WINDOW.linear + linear).min(WIDEST_WINDOW),
            angular: (LEAST_WINDOW.angular + angular).min(PI),
        }
    }

    /// Widest window for any path length, metres.
    pub(super) fn widest_window(&self) -> f64 {
        if self.drift > 0.0 { WIDEST_WINDOW } else { 0.0 }
    }
}

/// Path length from which a loop closure has its full information, metres; over shorter paths it has
/// proportionally less.
const INFORMATIVE_PATH: f64 = 20.0;
/// Minimum fraction of pairs that are searched however short the path: repeated measurements still improve
/// the poses.
const LEAST_SHARE: f64 = 0.1;

/// Decides which nodes are searched in one submap.
#[derive(Clone, Debug, Default)]
pub(super) struct Spacing {
    /// By trajectory: distance along it of the last node that was searched, metres.
    last: BTreeMap<TrajectoryId, f64>,
    /// Accumulated fraction of searches with reduced information; a search is due at 1.
    due: f64,
}

impl Spacing {
    /// Whether a node at distance `path_length` along its trajectory is to be searched: one node in `spacing`
    /// metres. Each submap has its own phase, so that not all submaps are searched for the same nodes.
    pub fn is_due(&mut self, (submap, node): (SubmapId, NodeId), path_length: f64, spacing: f64) -> bool {
        let phase = (f64::from(submap.index) * GOLDEN).fract();
        let last = self.last.entry(node.trajectory_id).or_insert(path_length - phase * spacing);
        let is_due = (path_length - *last).abs() >= spacing;
        if is_due {
            *last = path_length;
        }
        is_due
    }

    /// Whether to search a pair whose path length is `travelled`, metres. Pairs with a short path are
    /// searched less often.
    pub fn is_informative(&mut self, travelled: f64) -> bool {
        self.due += (travelled / INFORMATIVE_PATH).clamp(LEAST_SHARE, 1.0);
        let is_due = self.due >= 1.0;
        self.due -= f64::from(u8::from(is_due));
        is_due
    }
}

/// Golden ratio − 1; the fractional parts of its multiples fill an interval evenly.
pub(super) const GOLDEN: f64 = 0.618_033_988_749_895;

/// Options of the pose graph that Cartographer does not have; by default all are off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseGraphPolicy {
    /// Whether loop closures that all others together contradict are dropped at the end.
    pub drops_contradicted: bool,
    /// How the optimisation uses other sensors.
    pub sensors: SensorPolicy,
    /// Number of matches in whole submaps that must agree to connect two trajectories; with 1 a single match
    /// suffices.
    pub min_agreeing: usize,
    /// Whether trajectories that are not connected with the map are searched while they are recorded, as
    /// often as real time allows, where the scanner can be (3D only).
    pub localises_while_recording: bool,
    /// Minimum number of pairs searched before the last optimisation; 0 adds none.
    pub min_searches: u64,
    /// Searches in a window.
    pub loops: LoopSearchPolicy,
    /// Number of newest submaps of each place that are kept, besides the first; 0: all.
    pub submaps_per_place: usize,
    /// Whether submaps are inserted again from their scans at the final poses when the map is finished (2D).
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

/// Growth of the graph after which it is optimised again, as a fraction of its nodes.
const GROWTH: f64 = 0.05;

impl PoseGraphPolicy {
    /// Number of new nodes after which a graph of `nodes` nodes is optimised again; `least` is the option.
    /// Where windows follow the drift, a large graph needs to be optimised less often than a small one. The
    /// total time then grows with the number of nodes and not with its square.
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
