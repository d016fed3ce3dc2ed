//! Finding nodes in submaps: which pairs are tried, and trying them in parallel
//! (`slam2d.md` §13).

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use portolan_config::ConstraintBuilderOptions;
use portolan_geometry::Rigid3;
use portolan_sensor::FixedRatioSampler;
use rayon::prelude::*;

use crate::{Constraint, ConstraintTag, NodeData, NodeId, SearchRegion, Space, SubmapId};

/// Matchers that are kept between searches; building one takes milliseconds, keeping one megabytes.
const MAX_KEPT_MATCHERS: usize = 48;

/// A pair to try.
struct SearchTask<S: Space> {
    submap_id: SubmapId,
    submap: Arc<S::Submap>,
    node_id: NodeId,
    node: Arc<NodeData>,
    guess_submap_from_node: Rigid3,
    region: SearchRegion,
}

/// How many pairs were tried and found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SearchCounts {
    /// Pairs tried in a window.
    pub window_searched: u64,
    /// Pairs found in a window.
    pub window_found: u64,
    /// Pairs tried in a whole submap.
    pub whole_submap_searched: u64,
    /// Pairs found in a whole submap.
    pub whole_submap_found: u64,
}

type MatcherCell<S> = Arc<OnceLock<Option<<S as Space>::Matcher>>>;

/// Collects pairs, and tries all of them at the next [`ConstraintSearch::run`].
///
/// Results come in the order in which the pairs were added, so that they do not depend on the number
/// of threads.
pub struct ConstraintSearch<S: Space> {
    options: ConstraintBuilderOptions,
    tasks: Vec<SearchTask<S>>,
    samplers: Samplers<SubmapId>,
    matchers: BTreeMap<SubmapId, (u64, MatcherCell<S>)>,
    rounds: u64,
    counts: SearchCounts,
}

impl<S: Space> ConstraintSearch<S> {
    /// Nothing to try yet.
    pub fn new(options: ConstraintBuilderOptions) -> Self {
        Self {
            samplers: Samplers::new(options.sampling_ratio),
            options,
            tasks: Vec::new(),
            matchers: BTreeMap::new(),
            rounds: 0,
            counts: SearchCounts::default(),
        }
    }

    /// Adds a pair whose relative pose is roughly known, if it is near enough and its turn in the
    /// submap's sampling has come.
    pub fn add_local(
        &mut self,
        (submap_id, submap): (SubmapId, &Arc<S::Submap>),
        (node_id, node): (NodeId, &Arc<NodeData>),
        guess_submap_from_node: Rigid3,
    ) {
        if guess_submap_from_node.translation.vector.norm() > self.options.max_constraint_distance {
            return;
        }
        if !self.samplers.pulse(submap_id) {
            return;
        }
        self.push(submap_id, submap, node_id, node, guess_submap_from_node, SearchRegion::Window);
    }

    /// Adds a pair whose relative pose is unknown.
    pub fn add_global(
        &mut self,
        (submap_id, submap): (SubmapId, &Arc<S::Submap>),
        (node_id, node): (NodeId, &Arc<NodeData>),
    ) {
        self.push(submap_id, submap, node_id, node, Rigid3::identity(), SearchRegion::WholeSubmap);
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

    /// Pairs tried and found so far.
    pub fn counts(&self) -> SearchCounts {
        self.counts
    }

    /// Tries all pairs on the threads of the current pool and returns the constraints found, in the
    /// order in which the pairs were added.
    pub fn run(&mut self) -> Vec<Constraint> {
        let tasks = std::mem::take(&mut self.tasks);
        let cells: Vec<MatcherCell<S>> = tasks.iter().map(|t| self.matcher_cell(t.submap_id)).collect();
        let options = &self.options;
        let found: Vec<Option<Constraint>> = tasks
            .par_iter()
            .zip(&cells)
            .map(|(task, cell)| {
                let matcher = cell.get_or_init(|| S::build_matcher(&task.submap, options));
                find_constraint::<S>(matcher.as_ref()?, task, options)
            })
            .collect();
        for (task, result) in tasks.iter().zip(&found) {
            self.count(task.region, result.is_some());
        }
        self.drop_old_matchers();
        found.into_iter().flatten().collect()
    }

    fn matcher_cell(&mut self, submap_id: SubmapId) -> MatcherCell<S> {
        let rounds = self.rounds;
        let entry = self.matchers.entry(submap_id).or_default();
        entry.0 = rounds;
        Arc::clone(&entry.1)
    }

    fn count(&mut self, region: SearchRegion, found: bool) {
        let (searched, hits) = match region {
            SearchRegion::Window => (&mut self.counts.window_searched, &mut self.counts.window_found),
            SearchRegion::WholeSubmap => {
                (&mut self.counts.whole_submap_searched, &mut self.counts.whole_submap_found)
            }
        };
        *searched += 1;
        *hits += u64::from(found);
    }

    /// Keeps the most recently used matchers; ties go to the newer submap.
    fn drop_old_matchers(&mut self) {
        self.rounds += 1;
        if self.matchers.len() <= MAX_KEPT_MATCHERS {
            return;
        }
        let mut by_use: Vec<(u64, SubmapId)> =
            self.matchers.iter().map(|(id, (used, _))| (*used, *id)).collect();
        by_use.sort_unstable();
        for (_, id) in &by_use[..by_use.len() - MAX_KEPT_MATCHERS] {
            self.matchers.remove(id);
        }
    }

    /// Forgets what was precomputed for a submap, and restarts its sampling.
    pub fn delete_matcher(&mut self, submap_id: SubmapId) {
        self.matchers.remove(&submap_id);
        self.samplers.forget(&submap_id);
    }

    /// Drops waiting pairs of a submap that is about to go.
    pub fn forget_tasks(&mut self, mut concerns: impl FnMut(SubmapId, NodeId) -> bool) {
        self.tasks.retain(|task| !concerns(task.submap_id, task.node_id));
    }
}

/// Samplers that are made when they are first needed.
pub(super) struct Samplers<K> {
    ratio: f64,
    samplers: BTreeMap<K, FixedRatioSampler>,
}

impl<K: Ord> Samplers<K> {
    /// All with one ratio; one that makes no sense (options are checked elsewhere) samples nothing.
    pub fn new(ratio: f64) -> Self {
        Self { ratio, samplers: BTreeMap::new() }
    }

    /// Whether the turn of this one has come.
    pub fn pulse(&mut self, key: K) -> bool {
        if let Some(sampler) = self.samplers.get_mut(&key) {
            return sampler.pulse();
        }
        let Ok(mut sampler) = FixedRatioSampler::new(self.ratio) else { return false };
        let turn = sampler.pulse();
        self.samplers.insert(key, sampler);
        turn
    }

    /// Starts anew for this one.
    pub fn forget(&mut self, key: &K) {
        self.samplers.remove(key);
    }
}

fn find_constraint<S: Space>(
    matcher: &S::Matcher,
    task: &SearchTask<S>,
    options: &ConstraintBuilderOptions,
) -> Option<Constraint> {
    let found =
        S::find_node(matcher, &task.submap, &task.node, &task.guess_submap_from_node, task.region, options)?;
    if options.log_matches {
        log_match(task.node_id, task.submap_id, task.region, &task.guess_submap_from_node, &found);
    }
    Some(Constraint {
        submap_id: task.submap_id,
        node_id: task.node_id,
        submap_from_node: found.submap_from_node,
        translation_weight: options.loop_closure_translation_weight,
        rotation_weight: options.loop_closure_rotation_weight,
        tag: ConstraintTag::InterSubmap,
        score: Some(found.score),
    })
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
        SearchRegion::WholeSubmap => {
            tracing::debug!("Node {node_id} on submap {submap_id} matches with score {score:.1}%.");
        }
        SearchRegion::Window => {
            let difference = guess.inverse() * found.submap_from_node;
            tracing::debug!(
                "Node {node_id} on submap {submap_id} differs by translation {:.2} rotation {:.3} with score {score:.1}%.",
                difference.translation.vector.norm(),
                portolan_geometry::rotation_angle(&difference),
            );
        }
    }
}
