//! Caches the results of optimisations, so that an interrupted job can continue.

use portolan_geometry::Rigid3;
use portolan_recall::{Answer, Fingerprint, Memory, Sink, Words};

use crate::{Constraint, ImuState, OptimizationData, OptimizationSummary, SensorPolicy, TrajectoryId};

/// Optimises, or takes the result from the memory if it was done before. `seen` is a fingerprint of all
/// measurements so far.
pub fn remembered_optimum(
    memory: &Memory,
    seen: u64,
    data: &mut OptimizationData,
    constraints: &[Constraint],
    optimize: impl FnOnce(&mut OptimizationData, &[Constraint]) -> OptimizationSummary,
) -> OptimizationSummary {
    let question = memory.question(|question| {
        question.add_text("optimization");
        question.add_word(seen);
        add_problem(question, data, constraints);
    });
    let known = memory.recall::<Optimized>(question);
    if let Some(known) = known.filter(|known| known.fits(data)) {
        return known.give_to(data);
    }
    let summary = optimize(data, constraints);
    if question.is_some() {
        memory.keep(question, &Optimized::of(data, summary));
    }
    summary
}

/// Adds the initial state of an optimisation to the key. Measurements are identified by the nodes.
fn add_problem(question: &mut Fingerprint, data: &OptimizationData, constraints: &[Constraint]) {
    data.submaps.values().for_each(|pose| question.add(*pose));
    data.nodes.values().for_each(|node| question.add(node.map_from_node));
    for c in constraints {
        question.add([c.submap_id.trajectory_id.0, c.submap_id.index]);
        question.add([c.node_id.trajectory_id.0, c.node_id.index]);
        question.add((c.submap_from_node, [c.translation_weight, c.rotation_weight]));
        question.add(c.open.map(|open| open.direction));
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
    for pose in data.given_starts.values() {
        question.add(*pose);
    }
    let SensorPolicy {
        estimates_imu_biases,
        holds_imu_mounting,
        weighs_fixes_by_scatter,
        has_robust_fixes,
        holds_start_level,
    } = data.sensor_policy;
    question.add([
        estimates_imu_biases,
        holds_imu_mounting,
        weighs_fixes_by_scatter,
        has_robust_fixes,
        holds_start_level,
    ]);
    question.add(data.max_iterations_override);
}

fn count(number: usize) -> u64 {
    number as u64
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
        let ended = (self.iterations, (self.converged, self.failed));
        ([self.initial_cost, self.final_cost], ended).write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let ([initial_cost, final_cost], (iterations, (converged, failed))) = Answer::read(words)?;
        Some(Self { initial_cost, final_cost, iterations, converged, failed })
    }
}

/// Everything that an optimisation changes, in order of ids; frozen trajectories keep their poses.
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
