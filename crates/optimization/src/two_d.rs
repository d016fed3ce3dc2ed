//! The optimisation problem in 2D (`slam2d.md` §14.6).

use portolan_config::OptimizationProblemOptions;
use portolan_geometry::nalgebra as na;
use portolan_geometry::{Rigid3, embed_3d, project_2d};
use portolan_solver::{Loss, Problem, VariableId, factors};

use super::data::{LandmarkSighting, OptimizationData, OptimizationNode, OptimizationSummary};
use super::graph_problem::{GraphProblem, ProblemSpace, Role, SightingBetweenNodes, Weights, follows};
use crate::Constraint;

/// Optimises submaps, nodes, landmarks and fixed-frame origins for the best agreement of all measurements.
/// The first submap, frozen trajectories and frozen landmarks keep their poses.
pub fn optimize_2d(
    data: &mut OptimizationData,
    constraints: &[Constraint],
    options: &OptimizationProblemOptions,
) -> OptimizationSummary {
    if data.nodes.is_empty() || data.submaps.is_empty() {
        return OptimizationSummary::default();
    }
    let mut problem = GraphProblem::<ProblemSpace2d>::new(data, options);
    problem.add_constraints(constraints, data);
    problem.add_given_starts(data);
    problem.add_landmarks(data);
    for (first, second) in data.nodes.iter().zip(data.nodes.iter().skip(1)) {
        if follows(first.0, second.0) && !data.frozen.contains(&first.0.trajectory_id) {
            problem.add_local_motion(data, (*first.0, first.1), (*second.0, second.1));
        }
    }
    problem.add_fixed_frames(data);
    let summary = problem.solve(data);
    problem.write_back(data);
    summary
}

/// Poses in 2D.
struct ProblemSpace2d;

impl ProblemSpace for ProblemSpace2d {
    type Between = factors::Se2Between;
    type Landmark = factors::Landmark2d;

    fn add_pose(
        problem: &mut Problem,
        pose: &Rigid3,
        role: Role,
        _options: &OptimizationProblemOptions,
    ) -> VariableId {
        let id = problem.add_se2(&project_2d(pose));
        if matches!(role, Role::Frozen | Role::Anchor) {
            problem.set_constant(id);
        }
        id
    }

    fn pose(problem: &Problem, variable: VariableId) -> Rigid3 {
        embed_3d(&problem.se2(variable))
    }

    fn between(variables: [VariableId; 2], measured: &Rigid3, weights: Weights) -> Self::Between {
        let (translation_weight, rotation_weight) = weights;
        factors::Se2Between {
            variables,
            measurement: project_2d(measured),
            translation_weight,
            rotation_weight,
        }
    }

    fn add_open_between(
        problem: &mut Problem,
        variables: [VariableId; 2],
        measured: &Rigid3,
        root: &na::Matrix6<f64>,
        loss: Loss,
    ) -> bool {
        // Translation along x and y and rotation about z.
        let root_in_2d = root.remove_fixed_rows::<3>(2).remove_fixed_columns::<3>(2);
        let factor = factors::Se2BetweenInformation {
            variables,
            measurement: project_2d(measured),
            square_root_information: root_in_2d,
        };
        problem.add_factor(factor, loss).is_ok()
    }

    fn landmark(
        variables: [VariableId; 3],
        seen: &SightingBetweenNodes<'_>,
        sighting: &LandmarkSighting,
    ) -> Self::Landmark {
        factors::Landmark2d {
            variables,
            interpolation_factor: seen.factor,
            gravity_alignments: [seen.previous.1.gravity_alignment, seen.next.1.gravity_alignment],
            tracking_from_landmark: sighting.observation.tracking_from_landmark,
            translation_weight: sighting.observation.translation_weight,
            rotation_weight: sighting.observation.rotation_weight,
        }
    }

    /// Nodes are gravity-aligned.
    fn map_from_tracking(node: &OptimizationNode) -> Rigid3 {
        node.map_from_node * node.gravity_alignment
    }

    fn between_nodes(a: &OptimizationNode, b: &OptimizationNode, a_from_b_tracking: &Rigid3) -> Rigid3 {
        a.gravity_alignment * a_from_b_tracking * b.gravity_alignment.inverse()
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::{Time, Vector3};

    use super::*;
    use crate::{ConstraintTag, NodeId, OpenShift, SubmapId, TrajectoryId};

    const KNOWN: TrajectoryId = TrajectoryId(0);
    const NEW: TrajectoryId = TrajectoryId(1);

    fn relate(submap: TrajectoryId, node: NodeId, measured: Rigid3, open: Option<OpenShift>) -> Constraint {
        let is_loop = submap != node.trajectory_id;
        Constraint {
            submap_id: SubmapId::new(submap, 0),
            node_id: node,
            submap_from_node: measured,
            translation_weight: if is_loop { 1.1e4 } else { 500.0 },
            rotation_weight: if is_loop { 1e5 } else { 1600.0 },
            tag: if is_loop { ConstraintTag::InterSubmap } else { ConstraintTag::IntraSubmap },
            open,
            score: None,
        }
    }

    /// Pose of the first of two nodes, 2 m apart, in a known map in which matches are degenerate along lines
    /// which meet 30 m away, if the given start is 1 m off the true one.
    fn first_node(is_given: bool) -> Rigid3 {
        let mut data = OptimizationData::default();
        data.frozen.insert(KNOWN);
        data.submaps.insert(SubmapId::new(KNOWN, 0), Rigid3::identity());
        let given = Rigid3::translation(1.0, 0.3, 0.0);
        data.submaps.insert(SubmapId::new(NEW, 0), given);
        let mut constraints = Vec::new();
        for index in 0..2 {
            let local_from_node = Rigid3::translation(2.0 * f64::from(index), 0.0, 0.0);
            let id = NodeId::new(NEW, index);
            let node = OptimizationNode {
                time: Time::from_unix_seconds(f64::from(index)),
                local_from_node,
                map_from_node: given * local_from_node,
                gravity_alignment: portolan_geometry::Quaternion::identity(),
            };
            data.nodes.insert(id, node);
            constraints.push(relate(NEW, id, local_from_node, None));
            let tilt = 0.02 * f64::from(index);
            let direction = Vector3::new(1.0, tilt, 0.0).normalize();
            let seen = Rigid3::translation(2.0 * f64::from(index), -0.6 * f64::from(index), 0.0);
            constraints.push(relate(KNOWN, id, seen, Some(OpenShift { direction })));
        }
        if is_given {
            data.given_starts.insert(NodeId::new(NEW, 0), given);
        }
        optimize_2d(&mut data, &constraints, &OptimizationProblemOptions::default());
        data.nodes.get(&NodeId::new(NEW, 0)).map(|node| node.map_from_node).unwrap()
    }

    #[test]
    fn a_given_start_constrains_degenerate_directions() {
        let [given, free] = [true, false].map(first_node);
        let x = |pose: &Rigid3| pose.translation.vector.x;
        assert!((x(&given) - 1.0).abs() < 0.5, "{given:?}");
        assert!(given.translation.vector.y.abs() < 0.35, "{given:?}");
        assert!((free.translation.vector.x - 1.0).abs() > 5.0, "{free:?}");
    }
}
