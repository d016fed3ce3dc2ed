//! The optimisation problem in 2D (`slam2d.md` §14.6).

use portolan_config::OptimizationProblemOptions;
use portolan_geometry::nalgebra as na;
use portolan_geometry::{Rigid3, embed_3d, project_2d};
use portolan_solver::{Loss, Problem, VariableId, factors};

use super::data::{LandmarkSighting, OptimizationData, OptimizationNode, OptimizationSummary};
use super::graph_problem::{GraphProblem, ProblemSpace, Role, SightingBetweenNodes, Weights, follows};
use crate::Constraint;

/// Moves submaps, nodes, landmarks and fixed-frame origins to where everything agrees best. The first
/// submap, frozen trajectories and frozen landmarks stay where they are.
pub fn optimize_2d(
    data: &mut OptimizationData,
    constraints: &[Constraint],
    options: &OptimizationProblemOptions,
) -> OptimizationSummary {
    if data.nodes.is_empty() || data.submaps.is_empty() {
        return OptimizationSummary::default();
    }
    let mut problem = GraphProblem::<InPlane>::new(data, options);
    problem.add_constraints(constraints, data);
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

/// Poses of the plane.
struct InPlane;

impl ProblemSpace for InPlane {
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
        // Shifts along x and y and the turn about z.
        let in_plane = root.remove_fixed_rows::<3>(2).remove_fixed_columns::<3>(2);
        let factor = factors::Se2BetweenInformation {
            variables,
            measurement: project_2d(measured),
            square_root_information: in_plane,
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
