//! The pose graph: nodes and submaps joined by constraints, optimised now and then
//! (`slam2d.md` §14). One for 2D and 3D.
//!
//! Everything happens in the order of the calls, so that results do not depend on threads: searching runs in
//! parallel inside [`PoseGraph::add_node`] at the moments when an optimisation is due.

mod agreement;
mod consistency;
mod contradictions;
mod drift;
mod editing;
mod extension;
mod final_search;
mod found_places;
mod gap_verification;
mod gaps;
mod given_starts;
mod hypotheses;
mod insertion;
mod joining;
mod lifelong;
mod localisation;
mod matcher_cache;
mod open_nodes;
mod patching_2d;
mod patching_3d;
mod places;
mod policy;
mod reach;
mod redrawing;
mod renewing;
mod sampling;
mod search;
mod shortest_paths;
mod state;
mod summary_ties;
mod travel;
mod trimmed_nodes;
mod trimming;
mod visible_cells;

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use agreement::WaitingMatches;
pub use consistency::Consistency;
pub use drift::Drift;
pub use extension::Extension;
pub use found_places::FoundPlace;
pub use patching_2d::CellFate;
pub use patching_3d::VoxelFate;
pub use policy::{LoopSearchPolicy, PoseGraphPolicy};
pub use renewing::{Coverage, Replacement};
pub use search::SearchCounts;
pub use state::{
    Gap, GraphState, InitialTrajectoryPose, SubmapEntry, TrajectoryEntry, TrajectoryState, TrimmedTies,
};
use summary_ties::SummaryTies;
pub use trimmed_nodes::{TrimmedNode, TrimmedNodes};
pub use trimming::Trimmer;

use found_places::Tracked;
use localisation::Localisation;
use open_nodes::OpenNodes;
use places::PlaceSearches;
use portolan_config::PoseGraphOptions;
use portolan_geometry::{Dimension, Time};
use portolan_local_slam::{InsertedNode, UsualAgreement};
use portolan_optimization::{
    LandmarkSighting, OptimizationData, OptimizationSummary, TrajectoryConnectivity, unused_fixes,
};
use portolan_recall::Memory;
use portolan_sensor::{FixedFramePoseData, ImuData, LandmarkData, OdometryData};
use sampling::Samplers;
use search::ConstraintSearch;

use crate::histogram::Histogram;
use crate::remembered::Remembered;
use crate::stop::Stop;
use crate::{Constraint, ConstraintTag, GatheredVariance, NodeId, Space, SubmapId, TrajectoryId};

/// Number of scans of a submap from which the usual agreement of scans with the map is learnt.
const OWN_SCANS: usize = 8;

/// The pose graph.
pub struct PoseGraph<S: Space> {
    options: PoseGraphOptions,
    state: GraphState<S>,
    problem: OptimizationData,
    search: ConstraintSearch<S>,
    whole_submaps: Samplers<TrajectoryId>,
    places: PlaceSearches,
    tracked: Tracked,
    usual_agreement: UsualAgreement,
    trimmers: Vec<Trimmer>,
    /// Number of complete submaps when covered ones were dropped last.
    complete_after_dropping: usize,
    summaries: SummaryTies,
    nodes_since_optimization: i64,
    policy: PoseGraphPolicy,
    /// Distance of nodes along their trajectories, metres.
    path_lengths: BTreeMap<NodeId, f64>,
    /// Largest distance of the nodes of complete submaps from the submap origin, metres.
    extents: BTreeMap<SubmapId, f64>,
    /// Variance accumulated up to each node where scans did not constrain the position or the heading.
    gathered: BTreeMap<NodeId, GatheredVariance>,
    open_nodes: OpenNodes,
    contradicted: u64,
    /// Trajectories that began after local SLAM lost its pose, without a place in the rest.
    pieces: BTreeSet<TrajectoryId>,
    /// Those of `pieces` that odometry ties to the trajectory before a gap, since nothing else did at the time.
    tied_by_odometry: BTreeSet<TrajectoryId>,
    /// Trajectories whose scans contradict the start given by the user: distance between the given and the
    /// found start, metres and radians.
    refuted_starts: BTreeMap<TrajectoryId, (f64, f64)>,
    /// Trajectories that were moved to their place in the rest of the map.
    placed_parts: BTreeSet<TrajectoryId>,
    waiting: WaitingMatches,
    localisation: Localisation,
    self_consistency: Consistency,
    drift: Drift,
    optimizations: u64,
    last_summary: OptimizationSummary,
    remembered: Remembered,
    /// Once it is requested, nothing more is searched and redrawn.
    stop: Stop,
}

impl<S: Space> PoseGraph<S> {
    /// An empty graph.
    pub fn new(options: PoseGraphOptions) -> Self {
        let trimmers = options.overlapping_submaps_trimmer_2d.iter().map(Trimmer::overlapping).collect();
        let stop = Stop::default();
        let mut graph = Self {
            search: ConstraintSearch::new(options.constraint_builder.clone(), stop.clone()),
            whole_submaps: Samplers::new(options.global_sampling_ratio),
            places: PlaceSearches::default(),
            tracked: Tracked::default(),
            usual_agreement: UsualAgreement::default(),
            options,
            state: GraphState::default(),
            problem: OptimizationData::default(),
            trimmers,
            complete_after_dropping: 0,
            summaries: SummaryTies::default(),
            nodes_since_optimization: 0,
            policy: PoseGraphPolicy::default(),
            path_lengths: BTreeMap::new(),
            extents: BTreeMap::new(),
            gathered: BTreeMap::new(),
            open_nodes: OpenNodes::default(),
            contradicted: 0,
            pieces: BTreeSet::new(),
            tied_by_odometry: BTreeSet::new(),
            refuted_starts: BTreeMap::new(),
            placed_parts: BTreeSet::new(),
            waiting: WaitingMatches::default(),
            localisation: Localisation::default(),
            self_consistency: Consistency::default(),
            drift: Drift::default(),
            optimizations: 0,
            last_summary: OptimizationSummary::default(),
            remembered: Remembered::default(),
            stop,
        };
        graph.search.set_policy(graph.loop_search());
        graph
    }

    /// The request to finish at once with the map as it is.
    pub(crate) fn stop(&self) -> &Stop {
        &self.stop
    }

    /// Everything in the graph.
    pub fn state(&self) -> &GraphState<S> {
        &self.state
    }

    /// Measurements, landmarks and fixed-frame origins.
    pub fn problem(&self) -> &OptimizationData {
        &self.problem
    }

    /// Pairs tried and found so far.
    pub fn search_counts(&self) -> SearchCounts {
        self.search.counts()
    }

    /// Number of optimisations, and the result of the last one.
    pub fn optimizations(&self) -> (u64, OptimizationSummary) {
        (self.optimizations, self.last_summary)
    }

    /// Sets the options that Cartographer does not have. To be called before anything is added.
    pub fn set_policy(&mut self, policy: PoseGraphPolicy) {
        self.problem.sensor_policy = policy.sensors;
        self.localisation.set_wanted(policy.localises_while_recording && S::DIMENSION == Dimension::ThreeD);
        self.policy = policy;
        self.search.set_policy(self.loop_search());
    }

    /// Caches the results of searches and optimisations in this memory. To be called before anything is
    /// added.
    pub fn remember_with(&mut self, memory: Memory) {
        self.remembered = Remembered::new(memory);
    }

    /// Registers a trajectory, with its initial pose if that is known.
    pub fn add_trajectory(&mut self, id: TrajectoryId, initial_pose: Option<InitialTrajectoryPose>) {
        let reference = initial_pose.as_ref().map(|p| (p.to_trajectory_id, p.time));
        self.state.trajectory_mut(id).initial_pose = initial_pose;
        if let Some((to, time)) = reference {
            self.state.connectivity.connect(id, to, time);
        }
    }

    /// Adds a node, constrains it to its submaps, searches it in finished submaps and, when it is due,
    /// optimises.
    pub fn add_node(&mut self, trajectory_id: TrajectoryId, inserted: InsertedNode<S>) -> NodeId {
        self.remembered.note_node(trajectory_id, &inserted);
        if let Some(agreement) = &inserted.agreement {
            self.usual_agreement.add(agreement);
            self.search.set_policy(self.loop_search());
        }
        let node_id = self.append_node(trajectory_id, &inserted.data);
        let submap_ids = self.register_submaps(trajectory_id, &inserted);
        self.place_node(node_id, &inserted, &submap_ids);
        for submap_id in self.searchable_submaps() {
            self.consider(node_id, submap_id);
        }
        self.look_everywhere(node_id);
        if let (Some(oldest), Some(id)) = (inserted.submaps.first(), submap_ids.first())
            && let Some(submap) = &oldest.finished
        {
            self.finish_submap(*id, Arc::clone(submap));
        }
        self.nodes_since_optimization += 1;
        self.localise(node_id);
        let due = self.policy.nodes_between_optimizations(
            i64::from(self.options.optimize_every_n_nodes),
            self.state.nodes.len(),
        );
        if due > 0 && self.nodes_since_optimization > due && !self.stop.is_requested() {
            self.optimize();
        }
        node_id
    }

    /// Search windows, search rate, and acceptance criteria adapted to the agreement seen so far.
    fn loop_search(&self) -> LoopSearchPolicy {
        let loops = self.policy.loops;
        let wanted = S::wanted_acceptance(loops.acceptance, &self.options.constraint_builder);
        LoopSearchPolicy { acceptance: self.usual_agreement.acceptance(wanted), ..loops }
    }

    /// Learns from a complete submap how well its own scans agree with it, where local SLAM does not report
    /// it.
    fn note_own_agreement(&mut self, id: SubmapId) {
        let Some((entry, submap)) = self.state.submaps.get(&id).and_then(|e| Some((e, e.submap.as_ref()?)))
        else {
            return;
        };
        let nodes = entry.node_ids.iter().filter_map(|id| self.state.nodes.get(id));
        let stride = entry.node_ids.len().div_ceil(OWN_SCANS).max(1);
        let submap_from_local = entry.local_from_submap.inverse();
        let agreements: Vec<_> = nodes
            .step_by(stride)
            .filter_map(|node| {
                S::own_agreement(submap, &node.data, &(submap_from_local * node.data.local_from_tracking))
            })
            .collect();
        if !agreements.is_empty() {
            agreements.iter().for_each(|agreement| self.usual_agreement.add(agreement));
            self.search.set_policy(self.loop_search());
        }
    }

    fn searchable_submaps(&self) -> Vec<SubmapId> {
        self.state.submaps.iter().filter(|(_, s)| s.searchable).map(|(id, _)| *id).collect()
    }

    /// Marks a submap as complete: from now on nodes are searched in it, starting with all earlier nodes.
    fn finish_submap(&mut self, id: SubmapId, submap: Arc<S::Submap>) {
        let Some(entry) = self.state.submaps.get_mut(&id) else { return };
        entry.submap = Some(submap);
        entry.insertion_finished = true;
        entry.searchable = true;
        self.note_extent(id);
        self.note_own_agreement(id);
        let earlier: Vec<NodeId> = self.problem.nodes.keys().copied().collect();
        for node_id in earlier {
            self.consider(node_id, id);
        }
    }

    /// Schedules the search for a node in a submap, nearby or everywhere, or not at all
    /// (`slam2d.md` §14.3, ComputeConstraint).
    fn consider(&mut self, node_id: NodeId, submap_id: SubmapId) {
        let (Some(entry), Some(node)) = (self.state.submaps.get(&submap_id), self.state.nodes.get(&node_id))
        else {
            return;
        };
        if !entry.insertion_finished || entry.node_ids.contains(&node_id) {
            return;
        }
        let Some(submap) = &entry.submap else { return };
        let path_length = self.path_lengths.get(&node_id).copied().unwrap_or(0.0);
        if self.both_frozen(node_id, submap_id) {
            return;
        }
        let (a, b) = (node_id.trajectory_id, submap_id.trajectory_id);
        let time = node.data.time.max(self.state.time_of_last_node(entry).unwrap_or(Time::MIN));
        let recently =
            portolan_geometry::Duration::from_seconds(self.options.global_constraint_search_after_n_seconds);
        let connectivity = &self.state.connectivity;
        let was_connected = || time < connectivity.last_connection_time(a, b) + recently;
        let is_near = a == b || (connectivity.are_connected(a, b) && was_connected());
        if is_near || self.is_beyond_gap(a, b) {
            let Some(guess) = self.problem.submap_from_node(submap_id, node_id) else { return };
            if self.is_in_reach(
                (submap_id, entry),
                node_id,
                &guess.translation.vector,
                self.policy.loops.widest_window(),
            ) {
                self.search.add_local((submap_id, submap), (node_id, &node.data), guess, path_length);
            }
            return;
        }
        if self.searches_whole_maps() {
            return;
        }
        if self.whole_submaps.pulse(a) {
            self.search.add_anywhere((submap_id, submap), (node_id, &node.data));
        }
    }

    /// A constraint between two frozen trajectories would change nothing.
    fn both_frozen(&self, node_id: NodeId, submap_id: SubmapId) -> bool {
        let frozen = |id| self.state.trajectory_state(id) == TrajectoryState::Frozen;
        frozen(node_id.trajectory_id) && frozen(submap_id.trajectory_id)
    }

    /// Searches the waiting pairs, adds the constraints found, optimises, and trims.
    pub fn optimize(&mut self) {
        let travel = self.travel_graph();
        let found = self.search.run(&travel, &self.remembered);
        self.add_found(found);
        self.run_optimization();
        self.delete_requested_trajectories();
        self.run_trimmers();
        self.drop_covered();
        self.nodes_since_optimization = 0;
    }

    /// Final optimisation, with as many iterations as the options allow at the end:
    ///
    /// 1. Searches pieces of map that are not connected yet, ties those that were not found over their gaps
    ///    by odometry, and searches more pairs if too few were searched so far.
    ///
    /// 2. Optimises.
    ///
    /// 3. Searches trajectories elsewhere whose scans contradict their given start, and moves parts after gaps
    ///    back to where odometry puts them if their scans contradict less of the map there.
    ///
    /// 4. Searches for loop closures that the optimised map shows to have been missed, and optimises with
    ///    them; settles loop closures with a degenerate direction.
    ///
    /// 5. If wanted, drops contradicted loop closures and optimises again.
    ///
    /// 6. Redraws submaps and compares the map with itself.
    ///
    /// Once the map is requested as it is, it is optimised once, and nothing else is done.
    pub fn run_final_optimization(&mut self) {
        self.place_pieces();
        self.tie_over_gaps();
        self.search_more();
        self.problem.max_iterations_override = u32::try_from(self.options.max_num_final_iterations).ok();
        self.optimize();
        if self.take_supported() > 0 {
            self.run_optimization();
        }
        self.verify_given_starts();
        self.verify_places_after_gaps();
        self.search_missed();
        if self.settle_open_loop_closures() {
            self.run_optimization();
        }
        if self.policy.drops_contradicted && self.drop_contradicted_loop_closures() > 0 {
            self.run_optimization();
        }
        self.problem.max_iterations_override = None;
        self.redraw_submaps();
        self.self_consistency = self.judge_self_consistency();
        self.drift = self.judge_drift();
    }

    fn connect_by(&mut self, constraint: &Constraint) {
        if let Some((a, b, time)) = self.connection_by(constraint) {
            self.state.connectivity.connect(a, b, time);
        }
    }

    /// The trajectories that a constraint connects, and the time of the later of its ends.
    fn connection_by(&self, constraint: &Constraint) -> Option<(TrajectoryId, TrajectoryId, Time)> {
        let (node, entry) =
            (self.state.nodes.get(&constraint.node_id)?, self.state.submaps.get(&constraint.submap_id)?);
        let time = node.data.time.max(self.state.time_of_last_node(entry).unwrap_or(Time::MIN));
        Some((constraint.node_id.trajectory_id, constraint.submap_id.trajectory_id, time))
    }

    /// Which trajectories are connected by constraints for which `counts` holds, by the initial poses of
    /// trajectories for which `has_start` holds, and because both are frozen.
    fn connectivity_by(
        &self,
        counts: impl Fn(&Constraint) -> bool,
        has_start: impl Fn(TrajectoryId) -> bool,
    ) -> TrajectoryConnectivity {
        let mut connectivity = TrajectoryConnectivity::default();
        for (id, entry) in &self.state.trajectories {
            connectivity.add(*id);
            if let Some(start) = entry.initial_pose.as_ref().filter(|_| has_start(*id)) {
                connectivity.connect(*id, start.to_trajectory_id, start.time);
            }
        }
        let frozen = &self.problem.frozen;
        for (a, b) in frozen.iter().flat_map(|a| frozen.iter().map(move |b| (*a, *b))) {
            if !connectivity.are_connected(a, b) {
                connectivity.connect(a, b, Time::from_ticks(0));
            }
        }
        let across = |c: &&Constraint| c.node_id.trajectory_id != c.submap_id.trajectory_id;
        let ties = self.state.constraints.iter().filter(across).filter(|c| counts(c));
        for (a, b, time) in ties.filter_map(|constraint| self.connection_by(constraint)) {
            connectivity.connect(a, b, time);
        }
        connectivity
    }

    fn run_optimization(&mut self) {
        if self.problem.submaps.is_empty() || self.problem.nodes.is_empty() {
            return;
        }
        self.problem.set_anchors(&self.state.connectivity);
        let constraints = constraints_that_move(&self.state.constraints, &self.problem.frozen);
        let options = &self.options.optimization_problem;
        let optimize = |data: &mut _, constraints: &_| S::optimize(data, constraints, options);
        self.last_summary = self.remembered.optimize(&mut self.problem, &constraints, optimize);
        self.optimizations += 1;
        self.publish_poses();
        // As in Cartographer only in 3D.
        if self.options.log_residual_histograms && S::DIMENSION == Dimension::ThreeD {
            self.log_residuals();
        }
    }

    /// Logs the residuals of nodes against the poses that local SLAM gave them in their submaps.
    fn log_residuals(&self) {
        if !tracing::enabled!(tracing::Level::INFO) {
            return;
        }
        let intra = self.state.constraints.iter().filter(|c| c.tag == ConstraintTag::IntraSubmap);
        let (metres, radians): (Vec<f64>, Vec<f64>) = intra.filter_map(|c| self.disagreement(c)).unzip();
        let [metres, radians] = [metres, radians].map(|values| values.into_iter().collect::<Histogram>());
        tracing::info!("Translation residuals within submaps, metres: {metres}");
        tracing::info!("Rotation residuals within submaps, radians: {radians}");
    }

    /// Takes over optimised poses; nodes that are not in the optimisation problem move with their trajectory.
    fn publish_poses(&mut self) {
        let trajectories: Vec<TrajectoryId> = self.state.trajectories.keys().copied().collect();
        let old: BTreeMap<_, _> =
            trajectories.iter().map(|id| (*id, self.state.map_from_local(*id))).collect();
        self.state.optimized_submaps.clone_from(&self.problem.submaps);
        let moved: BTreeMap<_, _> =
            old.iter().map(|(id, old)| (*id, self.state.map_from_local(*id) * old.inverse())).collect();
        // Frozen ones did not move; transforming their poses forth and back would change the last bits.
        let frozen = &self.problem.frozen;
        for (id, node) in self.state.nodes.iter_mut().filter(|(id, _)| !frozen.contains(&id.trajectory_id)) {
            if let Some(optimized) = self.problem.nodes.get(id) {
                node.map_from_tracking =
                    S::tracking_pose(&optimized.map_from_node, &optimized.gravity_alignment);
            } else if let Some(correction) = moved.get(&id.trajectory_id) {
                node.map_from_tracking = correction * node.map_from_tracking;
            }
        }
    }

    /// Adds an IMU sample (kept only where the optimisation uses it).
    pub fn add_imu_data(&mut self, id: TrajectoryId, data: ImuData) {
        self.problem.sensors_mut(id).imu.entry(data.time).or_insert(data);
    }

    /// Adds an odometry pose.
    pub fn add_odometry_data(&mut self, id: TrajectoryId, data: OdometryData) {
        self.problem.sensors_mut(id).odometry.entry(data.time).or_insert(data);
    }

    /// Number of nodes of a trajectory with satellite fixes that are not used, because they contradict the
    /// map or the robot moved too little for a heading.
    pub fn unused_fixes(&self, id: TrajectoryId) -> usize {
        unused_fixes(&self.problem, id, &self.options.optimization_problem)
    }

    /// Adds a fixed-frame pose.
    pub fn add_fixed_frame_pose_data(&mut self, id: TrajectoryId, data: FixedFramePoseData) {
        self.problem.sensors_mut(id).fixed_frame.entry(data.time).or_insert(data);
    }

    /// Adds landmark observations.
    pub fn add_landmark_data(&mut self, id: TrajectoryId, data: LandmarkData) {
        for observation in data.observations {
            let landmark = self.problem.landmarks.entry(observation.id.clone()).or_default();
            landmark.sightings.push(LandmarkSighting { trajectory_id: id, time: data.time, observation });
        }
    }
}

/// All constraints but those between frozen trajectories, which would only cost time.
fn constraints_that_move<'a>(
    constraints: &'a [Constraint],
    frozen: &BTreeSet<TrajectoryId>,
) -> Cow<'a, [Constraint]> {
    if frozen.is_empty() {
        return Cow::Borrowed(constraints);
    }
    let is_fixed = |c: &Constraint| {
        frozen.contains(&c.submap_id.trajectory_id) && frozen.contains(&c.node_id.trajectory_id)
    };
    Cow::Owned(constraints.iter().filter(|c| !is_fixed(c)).cloned().collect())
}
