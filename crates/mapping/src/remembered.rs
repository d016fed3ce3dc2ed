//! What is remembered of matches, searches and optimisations, so that a job that was cut off can go on.

use portolan_geometry::{Rigid3, Time};
use portolan_recall::{Answer, Fingerprint, Memory, Sink, Words};
use portolan_sensor::PointCloud;

use crate::optimization::{ImuState, OptimizationData, OptimizationSummary};
use crate::pose_graph::InsertedNode;
use crate::scan_matching_2d::ScanMatch2d;
use crate::{Constraint, MatchedPose, NodeId, SearchRegion, SearchWindow, Space, SubmapId, TrajectoryId};

/// A memory, and what has happened to a pose graph so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct Remembered {
    pub memory: Memory,
    seen: Fingerprint,
}

impl Remembered {
    /// Remembers with this.
    pub fn new(memory: Memory) -> Self {
        Self { memory, seen: Fingerprint::of("pose graph") }
    }

    /// Takes note of a new node. Submaps follow from the nodes before.
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

    /// The question where a node lies in a submap; none without a memory.
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

    /// Optimises, or takes over what was found when it was done before.
    pub fn optimize(
        &self,
        data: &mut OptimizationData,
        constraints: &[Constraint],
        optimize: impl FnOnce(&mut OptimizationData, &[Constraint]) -> OptimizationSummary,
    ) -> OptimizationSummary {
        let question = self.memory.question(|question| {
            question.add_text("optimization");
            question.add_word(self.seen.value());
            add_problem(question, data, constraints);
        });
        let known = self.memory.recall::<Optimized>(question);
        if let Some(known) = known.filter(|known| known.fits(data)) {
            return known.give_to(data);
        }
        let summary = optimize(data, constraints);
        if question.is_some() {
            self.memory.keep(question, &Optimized::of(data, summary));
        }
        summary
    }
}

/// A memory, and which scans local SLAM has seen so far.
#[derive(Debug)]
pub(crate) struct RememberedScans {
    memory: Memory,
    seen: Fingerprint,
}

impl Default for RememberedScans {
    fn default() -> Self {
        Self::new(&Memory::default())
    }
}

impl RememberedScans {
    /// Remembers with this.
    pub fn new(memory: &Memory) -> Self {
        Self { memory: memory.clone(), seen: Fingerprint::of("scans") }
    }

    /// Takes note of the next scan. Grids follow from the scans before.
    pub fn note(&mut self, time: Time, prediction: &Rigid3, clouds: [&PointCloud; 2]) {
        if !self.memory.is_on() {
            return;
        }
        self.seen.add((time, *prediction));
        for cloud in clouds {
            self.seen.add_f32s(cloud.points.iter().flat_map(|p| [p.x, p.y, p.z]));
        }
    }

    /// Where the scan is, looked for around a place, or what was found when it was done before.
    pub fn answer<T: Answer>(&self, around: impl Answer, find: impl FnOnce() -> T) -> T {
        let ask = |question: &mut Fingerprint| {
            question.add_word(self.seen.value());
            question.add(around);
        };
        self.memory.answer(ask, find)
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
        SearchRegion::NearNodes { level_from_submap, half_size } => {
            question.add(2u32);
            question.add((*level_from_submap, *half_size));
        }
    }
}

/// Adds what an optimisation begins with, beside what sensors measured, which nodes tell apart.
fn add_problem(question: &mut Fingerprint, data: &OptimizationData, constraints: &[Constraint]) {
    data.submaps.values().for_each(|pose| question.add(*pose));
    data.nodes.values().for_each(|node| question.add(node.map_from_node));
    for c in constraints {
        question.add([c.submap_id.trajectory_id.0, c.submap_id.index]);
        question.add([c.node_id.trajectory_id.0, c.node_id.index]);
        question.add((c.submap_from_node, [c.translation_weight, c.rotation_weight]));
    }
    for (id, sensors) in &data.sensors {
        question
            .add((id.0, [sensors.imu.len(), sensors.odometry.len(), sensors.fixed_frame.len()].map(count)));
    }
    for landmark in data.landmarks.values() {
        question.add((count(landmark.sightings.len()), landmark.map_from_landmark));
    }
    for id in &data.anchors {
        question.add([id.trajectory_id.0, id.index]);
    }
    question.add((data.doubts_sensors, data.max_iterations_override));
}

fn count(number: usize) -> u64 {
    number as u64
}

impl Answer for MatchedPose {
    fn write(&self, words: &mut impl Sink) {
        (self.submap_from_node, self.score).write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let (submap_from_node, score) = Answer::read(words)?;
        Some(Self { submap_from_node, score })
    }
}

impl Answer for ScanMatch2d {
    fn write(&self, words: &mut impl Sink) {
        (self.pose, self.score).write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let (pose, score) = Answer::read(words)?;
        Some(Self { pose, score })
    }
}

impl Answer for SearchWindow {
    fn write(&self, words: &mut impl Sink) {
        [self.linear, self.angular].write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let [linear, angular] = Answer::read(words)?;
        Some(Self { linear, angular })
    }
}

impl Answer for ImuState {
    fn write(&self, words: &mut impl Sink) {
        (self.gravity_constant, self.calibration).write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let (gravity_constant, calibration) = Answer::read(words)?;
        Some(Self { gravity_constant, calibration })
    }
}

impl Answer for OptimizationSummary {
    fn write(&self, words: &mut impl Sink) {
        ([self.initial_cost, self.final_cost], (self.iterations, self.converged)).write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let ([initial_cost, final_cost], (iterations, converged)) = Answer::read(words)?;
        Some(Self { initial_cost, final_cost, iterations, converged })
    }
}

/// Everything that an optimisation changes, in order of ids; frozen trajectories stay as they are.
struct Optimized {
    summary: OptimizationSummary,
    submaps: Vec<Rigid3>,
    nodes: Vec<Rigid3>,
    landmarks: Vec<Option<Rigid3>>,
    origins: Vec<(u32, Option<Rigid3>)>,
    imus: Vec<(u32, ImuState)>,
}

impl Optimized {
    fn of(data: &OptimizationData, summary: OptimizationSummary) -> Self {
        let moves = |id: TrajectoryId| !data.frozen.contains(&id);
        let submaps = data.submaps.iter().filter(|(id, _)| moves(id.trajectory_id));
        let nodes = data.nodes.iter().filter(|(id, _)| moves(id.trajectory_id));
        Self {
            summary,
            submaps: submaps.map(|(_, pose)| *pose).collect(),
            nodes: nodes.map(|(_, node)| node.map_from_node).collect(),
            landmarks: data.landmarks.values().map(|landmark| landmark.map_from_landmark).collect(),
            origins: data.fixed_frame_origins.iter().map(|(id, origin)| (id.0, *origin)).collect(),
            imus: data.sensors.iter().map(|(id, sensors)| (id.0, sensors.imu_state)).collect(),
        }
    }

    fn fits(&self, data: &OptimizationData) -> bool {
        let moves = |id: TrajectoryId| !data.frozen.contains(&id);
        self.submaps.len() == data.submaps.keys().filter(|id| moves(id.trajectory_id)).count()
            && self.nodes.len() == data.nodes.keys().filter(|id| moves(id.trajectory_id)).count()
            && self.landmarks.len() == data.landmarks.len()
    }

    fn give_to(self, data: &mut OptimizationData) -> OptimizationSummary {
        let OptimizationData { submaps, nodes, landmarks, frozen, .. } = data;
        let moves = |id: TrajectoryId| !frozen.contains(&id);
        let submaps = submaps.iter_mut().filter(|(id, _)| moves(id.trajectory_id));
        submaps.zip(self.submaps).for_each(|((_, pose), optimized)| *pose = optimized);
        let nodes = nodes.iter_mut().filter(|(id, _)| moves(id.trajectory_id));
        nodes.zip(self.nodes).for_each(|((_, node), optimized)| node.map_from_node = optimized);
        let landmarks = landmarks.values_mut().zip(self.landmarks);
        landmarks.for_each(|(landmark, optimized)| landmark.map_from_landmark = optimized);
        let origins = self.origins.into_iter().map(|(id, origin)| (TrajectoryId(id), origin));
        data.fixed_frame_origins.extend(origins);
        for (id, state) in self.imus {
            data.sensors_mut(TrajectoryId(id)).imu_state = state;
        }
        self.summary
    }
}

impl Answer for Optimized {
    fn write(&self, words: &mut impl Sink) {
        self.summary.write(words);
        self.submaps.write(words);
        self.nodes.write(words);
        self.landmarks.write(words);
        self.origins.write(words);
        self.imus.write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        Some(Self {
            summary: Answer::read(words)?,
            submaps: Answer::read(words)?,
            nodes: Answer::read(words)?,
            landmarks: Answer::read(words)?,
            origins: Answer::read(words)?,
            imus: Answer::read(words)?,
        })
    }
}
