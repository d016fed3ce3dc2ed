//! Caches results of matches, searches and optimisations, so that an interrupted job can continue.

use portolan_geometry::{Rigid3, Vector3};
use portolan_optimization::{OptimizationData, OptimizationSummary, remembered_optimum};
use portolan_recall::{Answer, Fingerprint, Memory, Sink, Words};

use crate::{Constraint, MatchedPose, NodeId, OpenShift, SearchRegion, Space, SubmapId, TrajectoryId};
use portolan_local_slam::InsertedNode;

/// A memory, and a fingerprint of the pose graph so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct Remembered {
    pub memory: Memory,
    seen: Fingerprint,
}

impl Remembered {
    /// With this memory.
    pub fn new(memory: Memory) -> Self {
        Self { memory, seen: Fingerprint::of("pose graph") }
    }

    /// Adds a new node to the fingerprint. Submaps follow from the nodes before.
    pub fn note_node<S: Space>(&mut self, trajectory_id: TrajectoryId, inserted: &InsertedNode<S>) {
        if !self.memory.is_on() {
            return;
        }
        let data = &inserted.data;
        self.seen.add((trajectory_id.0, data.time));
        self.seen.add((data.local_from_tracking, data.gravity_alignment));
        let clouds = [
            &data.filtered_gravity_aligned_point_cloud,
            &data.high_resolution_point_cloud,
            &data.low_resolution_point_cloud,
        ];
        for cloud in clouds {
            self.seen.add_f32s(cloud.points.iter().flat_map(|p| [p.x, p.y, p.z]));
        }
        for submap in &inserted.submaps {
            self.seen.add((submap.index, submap.finished.is_some()));
        }
    }

    /// The key of a search for a node in a submap; none without a memory.
    pub fn where_is(
        &self,
        (submap_id, node_id): (SubmapId, NodeId),
        guess_submap_from_node: &Rigid3,
        region: &SearchRegion,
    ) -> Option<u64> {
        self.memory.question(|question| {
            question.add_text("search");
            question.add_word(self.seen.value());
            question.add([submap_id.trajectory_id.0, submap_id.index]);
            question.add([node_id.trajectory_id.0, node_id.index]);
            question.add(*guess_submap_from_node);
            add_region(question, region);
        })
    }

    /// Optimises, or takes the result from the memory if it was done before.
    pub fn optimize(
        &self,
        data: &mut OptimizationData,
        constraints: &[Constraint],
        optimize: impl FnOnce(&mut OptimizationData, &[Constraint]) -> OptimizationSummary,
    ) -> OptimizationSummary {
        remembered_optimum(&self.memory, self.seen.value(), data, constraints, optimize)
    }
}

fn add_region(question: &mut Fingerprint, region: &SearchRegion) {
    match region {
        SearchRegion::Window { travelled, window, acceptance } => {
            question.add(0u32);
            question.add((*travelled, *window));
            question.add([acceptance.min_explained, acceptance.max_contradiction]);
        }
        SearchRegion::WholeSubmap { acceptance, around_guess } => {
            question.add(1u32);
            question.add([acceptance.min_explained, acceptance.max_contradiction]);
            question.add(*around_guess);
        }
    }
}

impl Answer for MatchedPose {
    fn write(&self, words: &mut impl Sink) {
        let open = self.open.map(|open| open.direction);
        ((self.submap_from_node, self.score), open).write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let ((submap_from_node, score), open): (_, Option<Vector3>) = Answer::read(words)?;
        let open = open.map(|direction| OpenShift { direction });
        Some(Self { submap_from_node, open, score })
    }
}
