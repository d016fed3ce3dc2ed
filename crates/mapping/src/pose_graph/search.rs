//! Searches nodes in submaps: selects pairs and matches them in parallel (`slam2d.md` §13).

use std::collections::BTreeMap;
use std::sync::Arc;

use portolan_config::ConstraintBuilderOptions;
use portolan_geometry::Rigid3;
use portolan_submaps::SearchWindow;
use rayon::prelude::*;

use super::matcher_cache::MatcherCache;
use super::policy::{LoopSearchPolicy, Spacing};
use super::sampling::Samplers;
use super::travel::{Lengths, TravelGraph};
use crate::histogram::Histogram;
use crate::remembered::Remembered;
use crate::stop::Stop;
use crate::{
    Constraint, ConstraintTag, MatchedPose, Nearby, NodeData, NodeId, SearchRegion, Space, SubmapId,
};

/// A pair to match.
struct SearchTask<S: Space> {
    submap_id: SubmapId,
    submap: Arc<S::Submap>,
    node_id: NodeId,
    node: Arc<NodeData>,
    guess_submap_from_node: Rigid3,
    region: SearchRegion,
}

impl<S: Space> SearchTask<S> {
    /// `lengths` are the lengths of the shortest paths from the submap to others.
    fn set_travelled(&mut self, travel: &TravelGraph, lengths: &Lengths, policy: LoopSearchPolicy) {
        if let SearchRegion::Window { travelled, window, .. } = &mut self.region {
            let of_node = travel.submap_of(self.node_id);
            let length = |length: Option<f64>| length.unwrap_or(f64::INFINITY);
            let turned = length(of_node.and_then(|id| lengths.of_heading(id)));
            *travelled = match travel.open_nodes.contains(&self.node_id) {
                true => turned,
                false => length(of_node.and_then(|id| lengths.of_place(id))),
            };
            *window = (policy.drift > 0.0).then(|| policy.window(*travelled, turned));
        }
    }
}

/// Numbers of pairs that were searched and found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SearchCounts {
    /// Pairs searched in a window.
    pub window_searched: u64,
    /// Pairs found in a window.
    pub window_found: u64,
    /// Pairs searched in a whole submap.
    pub whole_submap_searched: u64,
    /// Pairs found in a whole submap.
    pub whole_submap_found: u64,
}

/// Collects pairs, and matches all of them at the next [`ConstraintSearch::run`].
///
/// Results come in the order in which the pairs were added, so that they do not depend on the number
/// of threads.
pub struct ConstraintSearch<S: Space> {
    options: ConstraintBuilderOptions,
    policy: LoopSearchPolicy,
    tasks: Vec<SearchTask<S>>,
    samplers: Samplers<SubmapId>,
    spacings: BTreeMap<SubmapId, Spacing>,
    matchers: MatcherCache<S>,
    counts: SearchCounts,
    /// Once it is requested, pairs are dropped instead of matched.
    stop: Stop,
}

impl<S: Space> ConstraintSearch<S> {
    /// Without pairs.
    pub fn new(options: ConstraintBuilderOptions, stop: Stop) -> Self {
        Self {
            samplers: Samplers::new(options.sampling_ratio),
            options,
            policy: LoopSearchPolicy::default(),
            tasks: Vec::new(),
            spacings: BTreeMap::new(),
            matchers: MatcherCache::default(),
            counts: SearchCounts::default(),
            stop,
        }
    }

    /// Sets the search windows and rate. To be called before anything is added.
    pub fn set_policy(&mut self, policy: LoopSearchPolicy) {
        self.policy = policy;
    }

    /// Adds a pair whose relative pose is roughly known, if the sampling of the submap selects it.
    /// `path_length` is the distance of the node along its trajectory, metres.
    pub fn add_local(
        &mut self,
        (submap_id, submap): (SubmapId, &Arc<S::Submap>),
        (node_id, node): (NodeId, &Arc<NodeData>),
        guess_submap_from_node: Rigid3,
        path_length: f64,
    ) {
        let spacing = self.policy.spacing;
        let is_due = if spacing > 0.0 {
            self.spacings.entry(submap_id).or_default().is_due((submap_id, node_id), path_length, spacing)
        } else {
            self.samplers.pulse(submap_id)
        };
        if !is_due {
            return;
        }
        self.add_unsampled((submap_id, submap), (node_id, node), guess_submap_from_node);
    }

    /// Adds a pair whose relative pose is roughly known, without sampling.
    pub fn add_unsampled(
        &mut self,
        (submap_id, submap): (SubmapId, &Arc<S::Submap>),
        (node_id, node): (NodeId, &Arc<NodeData>),
        guess_submap_from_node: Rigid3,
    ) {
        let region = SearchRegion::Window {
            travelled: f64::INFINITY,
            window: None,
            acceptance: self.policy.acceptance,
        };
        self.push(submap_id, submap, node_id, node, guess_submap_from_node, region);
    }

    /// The waiting pairs whose relative pose is roughly known.
    pub(super) fn waiting_pairs(&self) -> impl Iterator<Item = (SubmapId, NodeId)> {
        self.tasks.iter().filter(|task| is_window(task.region)).map(|task| (task.submap_id, task.node_id))
    }

    /// Adds a pair whose relative pose is unknown, to be matched around a pose that a search of the whole map
    /// proposed.
    pub fn add_proposed(
        &mut self,
        (submap_id, submap): (SubmapId, &Arc<S::Submap>),
        (node_id, node): (NodeId, &Arc<NodeData>),
        proposed_submap_from_node: Rigid3,
        around: SearchWindow,
    ) {
        let acceptance = self.policy.acceptance;
        let region = SearchRegion::WholeSubmap { acceptance, around_guess: Some(around) };
        self.push(submap_id, submap, node_id, node, proposed_submap_from_node, region);
    }

    /// Adds a pair whose relative pose is unknown.
    pub fn add_anywhere(
        &mut self,
        (submap_id, submap): (SubmapId, &Arc<S::Submap>),
        (node_id, node): (NodeId, &Arc<NodeData>),
    ) {
        let region = SearchRegion::WholeSubmap { acceptance: self.policy.acceptance, around_guess: None };
        self.push(submap_id, submap, node_id, node, Rigid3::identity(), region);
    }

    /// Whether there are waiting pairs whose relative pose is unknown.
    pub fn has_unplaced(&self) -> bool {
        self.tasks.iter().any(|task| !is_window(task.region))
    }

    /// Matches the pairs whose relative pose is unknown, as [`Self::run`] does.
    pub(crate) fn run_unplaced(&mut self, remembered: &Remembered) -> Vec<Constraint> {
        let (unplaced, others) =
            std::mem::take(&mut self.tasks).into_iter().partition(|t| !is_window(t.region));
        self.tasks = others;
        self.run_tasks(unplaced, &TravelGraph::default(), remembered)
    }

    fn push(
        &mut self,
        submap_id: SubmapId,
        submap: &Arc<S::Submap>,
        node_id: NodeId,
        node: &Arc<NodeData>,
        guess_submap_from_node: Rigid3,
        region: SearchRegion,
    ) {
        self.tasks.push(SearchTask {
            submap_id,
            submap: Arc::clone(submap),
            node_id,
            node: Arc::clone(node),
            guess_submap_from_node,
            region,
        });
    }

    /// Pairs searched and found so far.
    pub fn counts(&self) -> SearchCounts {
        self.counts
    }

    /// Matches all pairs on the threads of the current pool and returns the constraints found, in the order
    /// in which the pairs were added. `travel` gives the current path lengths between nodes and submaps.
    pub(crate) fn run(&mut self, travel: &TravelGraph, remembered: &Remembered) -> Vec<Constraint> {
        let tasks = std::mem::take(&mut self.tasks);
        self.run_tasks(tasks, travel, remembered)
    }

    fn run_tasks(
        &mut self,
        mut tasks: Vec<SearchTask<S>>,
        travel: &TravelGraph,
        remembered: &Remembered,
    ) -> Vec<Constraint> {
        let mut by_submap: BTreeMap<SubmapId, Vec<usize>> = BTreeMap::new();
        for (index, task) in tasks.iter().enumerate() {
            by_submap.entry(task.submap_id).or_default().push(index);
        }
        // One submap after the other, so that no more matchers are in memory than there are threads.
        let groups: Vec<(SubmapId, Vec<usize>)> = by_submap.into_iter().collect();
        for (submap_id, members) in &groups {
            let lengths = travel.lengths_from(*submap_id);
            for i in members {
                if let Some(task) = tasks.get_mut(*i) {
                    task.set_travelled(travel, &lengths, self.policy);
                }
            }
        }
        let skipped = self.skip_needless(&tasks);
        let mut found: Vec<(usize, Option<Constraint>)> = groups
            .par_iter()
            .with_max_len(1)
            .flat_map_iter(|(submap_id, members)| {
                let wanted = members.iter().filter(|i| skipped.get(**i) == Some(&false));
                let wanted: Vec<(usize, &SearchTask<S>)> =
                    wanted.filter_map(|i| Some((*i, tasks.get(*i)?))).collect();
                self.search_submap(*submap_id, &wanted, remembered)
            })
            .collect();
        found.sort_unstable_by_key(|(index, _)| *index);
        for (index, result) in &found {
            if let Some(task) = tasks.get(*index) {
                self.count(task.region, result.is_some());
            }
        }
        self.matchers.shrink();
        if self.options.log_matches && !found.is_empty() {
            log_scores(tasks.iter().map(|task| task.region), &found);
        }
        found.into_iter().filter_map(|(_, result)| result).collect()
    }

    /// Matches the tasks of one submap, except those whose results are cached. Returns nothing for dropped
    /// tasks.
    fn search_submap(
        &self,
        submap_id: SubmapId,
        tasks: &[(usize, &SearchTask<S>)],
        remembered: &Remembered,
    ) -> Vec<(usize, Option<Constraint>)> {
        let (memory, options) = (&remembered.memory, &self.options);
        let continues = || !self.stop.is_requested();
        let pending = tasks.par_iter().filter(|_| continues()).map(|(i, task)| {
            let pair = (task.submap_id, task.node_id);
            let question = remembered.where_is(pair, &task.guess_submap_from_node, &task.region);
            let outcome = match memory.recall::<Option<MatchedPose>>(question) {
                Some(known) => known.map_or(Nearby::Absent, Nearby::Found),
                None => find_nearby(task, options),
            };
            (*i, *task, question, outcome)
        });
        let pending: Vec<_> = pending.collect();
        // The matcher is expensive to build.
        let unknown = pending.iter().find(|(.., nearby)| *nearby == Nearby::Unknown);
        let matcher =
            unknown.and_then(|(_, task, ..)| self.matchers.get_or_build(submap_id, &task.submap, options));
        let found = pending.into_par_iter().filter(|_| continues()).map(|(i, task, question, nearby)| {
            let found = match nearby {
                Nearby::Found(found) => Some(found),
                Nearby::Unknown => search_node(matcher.as_deref(), task, options),
                Nearby::Ambiguous | Nearby::Absent => None,
            };
            memory.keep(question, &found);
            (i, found.map(|found| constraint_of(task, &found, options)))
        });
        found.collect()
    }

    /// Which tasks to skip: those out of reach for the path length since the submap was last seen, and most
    /// of those with little information, because the path over other loop closures is short.
    fn skip_needless(&mut self, tasks: &[SearchTask<S>]) -> Vec<bool> {
        let policy = self.policy;
        let farthest = self.options.max_constraint_distance;
        let is_needless = |task: &SearchTask<S>| {
            let SearchRegion::Window { travelled, window: Some(window), .. } = task.region else {
                return false;
            };
            let distance = task.guess_submap_from_node.translation.vector.norm();
            if distance > farthest + window.linear {
                return true;
            }
            policy.spacing > 0.0
                && !self.spacings.entry(task.submap_id).or_default().is_informative(travelled)
        };
        tasks.iter().map(is_needless).collect()
    }

    fn count(&mut self, region: SearchRegion, found: bool) {
        let (searched, hits) = match region {
            SearchRegion::Window { .. } => (&mut self.counts.window_searched, &mut self.counts.window_found),
            SearchRegion::WholeSubmap { .. } => {
                (&mut self.counts.whole_submap_searched, &mut self.counts.whole_submap_found)
            }
        };
        *searched += 1;
        *hits += u64::from(found);
    }

    /// Drops the matcher of a submap, and restarts its sampling.
    pub fn delete_matcher(&mut self, submap_id: SubmapId) {
        self.matchers.remove(&submap_id);
        self.samplers.forget(&submap_id);
        self.spacings.remove(&submap_id);
    }

    /// Drops the waiting pairs for which `concerns` is true, as those of a submap that is removed.
    pub fn forget_tasks(&mut self, mut concerns: impl FnMut(SubmapId, NodeId) -> bool) {
        self.tasks.retain(|task| !concerns(task.submap_id, task.node_id));
    }
}

fn is_window(region: SearchRegion) -> bool {
    matches!(region, SearchRegion::Window { .. })
}

fn find_nearby<S: Space>(task: &SearchTask<S>, options: &ConstraintBuilderOptions) -> Nearby {
    S::find_nearby(&task.submap, &task.node, &task.guess_submap_from_node, &task.region, options)
}

fn search_node<S: Space>(
    matcher: Option<&S::Matcher>,
    task: &SearchTask<S>,
    options: &ConstraintBuilderOptions,
) -> Option<MatchedPose> {
    S::find_node(matcher?, &task.submap, &task.node, &task.guess_submap_from_node, task.region, options)
}

fn constraint_of<S: Space>(
    task: &SearchTask<S>,
    found: &MatchedPose,
    options: &ConstraintBuilderOptions,
) -> Constraint {
    if options.log_matches {
        log_match(task.node_id, task.submap_id, task.region, &task.guess_submap_from_node, found);
    }
    Constraint {
        submap_id: task.submap_id,
        node_id: task.node_id,
        submap_from_node: found.submap_from_node,
        translation_weight: options.loop_closure_translation_weight,
        rotation_weight: options.loop_closure_rotation_weight,
        tag: ConstraintTag::InterSubmap,
        open: found.open,
        score: Some(found.score),
    }
}

/// Logs the scores of matches, separately for the two kinds of search.
fn log_scores(regions: impl Iterator<Item = SearchRegion>, found: &[(usize, Option<Constraint>)]) {
    if !tracing::enabled!(tracing::Level::INFO) {
        return;
    }
    let regions: Vec<SearchRegion> = regions.collect();
    for (in_window, words) in [(true, "a window"), (false, "whole submaps")] {
        let is_of = |region: &SearchRegion| is_window(*region) == in_window;
        let scores = found.iter().filter(|(index, _)| regions.get(*index).is_some_and(is_of));
        let scores: Histogram =
            scores.filter_map(|(_, constraint)| constraint.as_ref()?.score).map(f64::from).collect();
        tracing::info!("Scores of matches in {words}: {scores}");
    }
}

fn log_match(
    node_id: NodeId,
    submap_id: SubmapId,
    region: SearchRegion,
    guess: &Rigid3,
    found: &crate::MatchedPose,
) {
    let score = 100.0 * found.score;
    match region {
        SearchRegion::WholeSubmap { .. } => {
            tracing::debug!("Node {node_id} on submap {submap_id} matches with score {score:.1}%.");
        }
        SearchRegion::Window { .. } => {
            let difference = guess.inverse() * found.submap_from_node;
            tracing::debug!(
                "Node {node_id} on submap {submap_id} differs by translation {:.2} rotation {:.3} with score {score:.1}%.",
                difference.translation.vector.norm(),
                portolan_geometry::rotation_angle(&difference),
            );
        }
    }
}
