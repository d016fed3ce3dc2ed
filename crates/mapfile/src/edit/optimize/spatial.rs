//! The problem in space: constraints, neighbouring nodes, fixed frames (`slam3d.md` §9, with local SLAM in
//! place of the IMU).

use std::collections::BTreeMap;

use portolan_config::OptimizationProblemOptions;
use portolan_geometry::Rigid3;
use portolan_mapping::{Constraint, OptimizationData, OptimizationSummary, of_trajectory};
use portolan_solver::factors::Se3Between;
use portolan_solver::{Loss, Problem, ProblemError, SolverOptions, VariableId};

/// Moves submaps, nodes and fixed-frame origins.
pub(super) fn optimize(
    data: &mut OptimizationData,
    constraints: &[Constraint],
    options: &OptimizationProblemOptions,
) -> Result<OptimizationSummary, String> {
    solve(data, constraints, options).map_err(|error| error.to_string())
}

fn solve(
    data: &mut OptimizationData,
    constraints: &[Constraint],
    options: &OptimizationProblemOptions,
) -> Result<OptimizationSummary, ProblemError> {
    let mut problem = Problem::new();
    let submaps: BTreeMap<_, VariableId> =
        data.submaps.iter().map(|(id, pose)| (*id, problem.add_se3(pose))).collect();
    let nodes: BTreeMap<_, VariableId> =
        data.nodes.iter().map(|(id, node)| (*id, problem.add_se3(&node.map_from_node))).collect();
    if let Some(first) = submaps.values().next() {
        problem.set_constant(*first);
    }
    for constraint in constraints {
        let (Some(submap), Some(node)) = (submaps.get(&constraint.submap_id), nodes.get(&constraint.node_id))
        else {
            continue;
        };
        let loss = if constraint.is_loop_closure() { Loss::Huber(options.huber_scale) } else { Loss::None };
        let weights = (constraint.translation_weight, constraint.rotation_weight);
        add(&mut problem, [*submap, *node], constraint.submap_from_node, weights, loss)?;
    }
    let weights = (options.local_slam_pose_translation_weight, options.local_slam_pose_rotation_weight);
    for ((id_a, a), (id_b, b)) in data.nodes.iter().zip(data.nodes.iter().skip(1)) {
        if id_a.trajectory_id == id_b.trajectory_id && id_b.index == id_a.index + 1 {
            let measured = a.local_from_node.inverse() * b.local_from_node;
            add(&mut problem, [nodes[id_a], nodes[id_b]], measured, weights, Loss::None)?;
        }
    }
    let origins = add_fixed_frames(&mut problem, data, options, &nodes)?;
    let settings = SolverOptions {
        max_num_iterations: data.max_iterations_override.unwrap_or(50),
        use_nonmonotonic_steps: options.ceres_solver_options.use_nonmonotonic_steps,
        ..SolverOptions::default()
    };
    let summary = problem.solve(&settings)?;
    for (id, variable) in submaps {
        data.submaps.insert(id, problem.se3(variable));
    }
    for (id, node) in &mut data.nodes {
        node.map_from_node = problem.se3(nodes[id]);
    }
    for (id, variable) in origins {
        data.fixed_frame_origins.insert(id, Some(problem.se3(variable)));
    }
    Ok(OptimizationSummary {
        initial_cost: summary.initial_cost,
        final_cost: summary.final_cost,
        iterations: summary.iterations,
        converged: summary.termination.is_convergence(),
    })
}

fn add(
    problem: &mut Problem,
    variables: [VariableId; 2],
    measurement: Rigid3,
    (translation_weight, rotation_weight): (f64, f64),
    loss: Loss,
) -> Result<(), ProblemError> {
    let factor = Se3Between { variables, measurement, translation_weight, rotation_weight };
    problem.add_factor(factor, loss).map(drop)
}

type Origins = BTreeMap<portolan_mapping::TrajectoryId, VariableId>;

/// Ties nodes to the fixed frame of their trajectory, where a fixed-frame pose has exactly their time or two
/// lie around it.
fn add_fixed_frames(
    problem: &mut Problem,
    data: &OptimizationData,
    options: &OptimizationProblemOptions,
    nodes: &BTreeMap<portolan_mapping::NodeId, VariableId>,
) -> Result<Origins, ProblemError> {
    let weights = (options.fixed_frame_pose_translation_weight, options.fixed_frame_pose_rotation_weight);
    let mut origins = Origins::new();
    for (trajectory, sensors) in &data.sensors {
        for (id, node) in of_trajectory(&data.nodes, *trajectory) {
            let before = sensors.fixed_frame.range(..=node.time).next_back();
            let after = sensors.fixed_frame.range(node.time..).next();
            let (Some((start, before)), Some((end, after))) = (before, after) else { continue };
            let (Some(a), Some(b)) = (before.fixed_from_tracking, after.fixed_from_tracking) else {
                continue;
            };
            let measured = portolan_geometry::interpolate(*start, &a, *end, &b, node.time);
            let origin = *origins.entry(*trajectory).or_insert_with(|| {
                let known = data.fixed_frame_origins.get(trajectory).copied().flatten();
                problem.add_se3(&known.unwrap_or_else(|| node.map_from_node * measured.inverse()))
            });
            add(problem, [origin, nodes[&id]], measured, weights, Loss::None)?;
        }
    }
    Ok(origins)
}
