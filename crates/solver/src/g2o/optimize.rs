//! Optimises a pose graph.

use std::ops::ControlFlow;

use super::connectivity::{Adjacency, anchors};
use super::graph::{Graph, GraphError, PoseGraph};
use super::initialize::{Initialization, initialize};
use super::pose::GraphPose;
use super::report::{EdgeChi2, Report};
use crate::factors::Se3ErrorConvention;
use crate::sparse::Prepared;
use crate::{Loss, Problem, SolverOptions, Summary, VariableId};

/// Relative difference of chi2 below which two sets of initial poses count as the same.
const SAME_START: f64 = 1e-3;
/// Ratio to the lowest cost above which a trial is stopped, from its second iteration on.
const MAX_COST_RATIO: f64 = 2.0;
/// If the trial iterations lower the chi2 of the relaxed rotations to no less than this fraction, the
/// relaxation is nearly exact. Other initial poses are not tried then: at best they would give the same
/// result.
const TIGHT: f64 = 0.9;

/// Options of the optimisation.
#[derive(Clone, Debug, PartialEq)]
pub struct OptimizeOptions {
    /// When to stop, and the size of the steps. Default: 100 iterations, function tolerance 1e-9, and a first
    /// step close to Gauss–Newton (radius 1e8), which suits pose graphs with fairly good initial poses.
    pub solver: SolverOptions,
    /// Method of the initial poses.
    pub initialization: Initialization,
    /// Number of iterations for each method that the automatic choice tries. Default 4.
    pub trial_iterations: u32,
    /// Definition of the six error components in 3D. Default: the logarithm of SE(3).
    pub convention: Se3ErrorConvention,
    /// Robust loss of `√(eᵀΩe)`. Default none.
    pub loss: Loss,
    /// Whether the loss also applies to edges between vertices with consecutive numbers (odometry). Default
    /// false.
    pub loss_on_odometry: bool,
    /// Number of the worst edges that the report lists. Default 10.
    pub worst_edges: usize,
    /// Whether to estimate the condition number of the normal equations; costs about one iteration. Default
    /// false.
    pub estimate_condition: bool,
}

impl Default for OptimizeOptions {
    fn default() -> Self {
        Self {
            solver: SolverOptions {
                max_num_iterations: 100,
                function_tolerance: 1e-9,
                initial_trust_region_radius: 1e8,
                ..Default::default()
            },
            initialization: Initialization::Automatic,
            trial_iterations: 4,
            convention: Se3ErrorConvention::default(),
            loss: Loss::None,
            loss_on_odometry: false,
            worst_edges: 10,
            estimate_condition: false,
        }
    }
}

/// Minimises `Σ ρ(eᵀΩe)` over all vertices that are not fixed. In a connected part without a fixed vertex the
/// first vertex is held; see [`Report::anchored`].
///
/// # Errors
/// As [`optimize_pose_graph`].
pub fn optimize_graph(graph: &mut Graph, options: &OptimizeOptions) -> Result<Report, GraphError> {
    match graph {
        Graph::TwoD(graph) => optimize_pose_graph(graph, options),
        Graph::ThreeD(graph) => optimize_pose_graph(graph, options),
    }
}

/// [`optimize_graph`] for poses of one kind.
///
/// # Errors
/// If the graph is not valid ([`PoseGraph::check`]), a vertex is not on the Earth, or the problem cannot be
/// solved; see [`GraphError`].
pub fn optimize_pose_graph<P: GraphPose>(
    graph: &mut PoseGraph<P>,
    options: &OptimizeOptions,
) -> Result<Report, GraphError> {
    graph.check()?;
    // The parameter tolerance is relative to the norm of the poses, so they must be near the origin.
    let frame = graph.near_frame()?;
    graph.move_by(&-frame.origin());
    let report = optimize_near(graph, options);
    graph.move_by(&frame.origin());
    report
}

/// Optimises a graph near the origin.
fn optimize_near<P: GraphPose>(
    graph: &mut PoseGraph<P>,
    options: &OptimizeOptions,
) -> Result<Report, GraphError> {
    let adjacency = Adjacency::new(graph);
    let (components, anchored) = anchors(graph, &adjacency);
    let mut held: Vec<bool> = graph.vertices.iter().map(|v| v.fixed).collect();
    for vertex in &anchored {
        held[*vertex as usize] = true;
    }
    let chi2_before = graph.chi2(options.convention);
    // Before the normal equations are allocated, because some methods solve equations of their own.
    let starts = Starts::collect(graph, &adjacency, &held, options);
    drop(adjacency);
    let mut optimizer = Optimizer::new(graph, &held, options)?;
    let start = optimizer.choose_start(starts, options)?;
    let summary = optimizer.finish(graph, &start, options)?;
    let condition = if options.estimate_condition { optimizer.condition()? } else { None };
    Ok(Report {
        chi2_before,
        chi2_initialized: start.chi2_initialized,
        chi2_after: graph.chi2(options.convention),
        iterations: start.iterations + summary.iterations,
        termination: summary.termination,
        initialization: start.how,
        trials: std::mem::take(&mut optimizer.trials),
        worst_edges: worst_edges(graph, options),
        residuals: optimizer.problem.residual_count(),
        unknowns: optimizer.problem.degrees_of_freedom(),
        components,
        anchored: anchored.iter().map(|v| graph.vertices[*v as usize].id).collect(),
        repaired_information: optimizer.repaired_information,
        condition,
    })
}

struct Optimizer {
    problem: Problem,
    prepared: Prepared,
    variables: Vec<VariableId>,
    repaired_information: usize,
    trials: Vec<(Initialization, f64)>,
}

/// Initial poses, or the poses after their trial.
struct Start<P> {
    how: Initialization,
    chi2_initialized: f64,
    iterations: u32,
    cost: f64,
    poses: Vec<P>,
}

/// All different sets of initial poses that could be computed.
struct Starts<P> {
    /// In ascending order of their initial chi2.
    starts: Vec<Start<P>>,
    /// The first error of a method that failed.
    error: Option<GraphError>,
}

impl<P: GraphPose> Starts<P> {
    fn collect(
        graph: &PoseGraph<P>,
        adjacency: &Adjacency,
        held: &[bool],
        options: &OptimizeOptions,
    ) -> Self {
        let mut starts: Vec<Start<P>> = Vec::new();
        let mut error = None;
        for how in options.initialization.candidates() {
            let mut candidate = graph.clone();
            if let Err(e) = initialize(&mut candidate, adjacency, held, *how) {
                error.get_or_insert(e);
                continue;
            }
            let chi2_initialized = candidate.chi2(options.convention);
            let is_same = |s: &Start<P>| (s.chi2_initialized / chi2_initialized - 1.0).abs() < SAME_START;
            if !starts.iter().any(is_same) {
                let poses = candidate.vertices.iter().map(|v| v.pose).collect();
                starts.push(Start { how: *how, chi2_initialized, iterations: 0, cost: f64::INFINITY, poses });
            }
        }
        starts.sort_by(|a, b| a.chi2_initialized.total_cmp(&b.chi2_initialized));
        Self { starts, error }
    }
}

impl Optimizer {
    fn new<P: GraphPose>(
        graph: &PoseGraph<P>,
        held: &[bool],
        options: &OptimizeOptions,
    ) -> Result<Self, GraphError> {
        let mut problem = Problem::new();
        problem.reserve_variables(graph.vertices.len(), 7);
        let variables: Vec<VariableId> =
            graph.vertices.iter().map(|v| v.pose.add_variable(&mut problem)).collect();
        for (id, held) in variables.iter().zip(held) {
            if *held {
                problem.set_constant(*id);
            }
        }
        let mut repaired_information = 0;
        for edge in &graph.edges {
            let (from, to) = (edge.from as usize, edge.to as usize);
            let step = graph.vertices[to].id.checked_sub(graph.vertices[from].id);
            let is_odometry = matches!(step, Some(-1 | 1));
            let loss = if is_odometry && !options.loss_on_odometry { Loss::None } else { options.loss };
            let pair = [variables[from], variables[to]];
            let (z, information) = (&edge.measurement, &edge.information);
            let (_, repaired) = P::add_edge(&mut problem, pair, z, information, options.convention, loss)?;
            repaired_information += usize::from(repaired);
        }
        problem.shrink_to_fit();
        let prepared = problem.prepare()?;
        Ok(Self { problem, prepared, variables, repaired_information, trials: Vec::new() })
    }

    fn write<P: GraphPose>(&mut self, poses: impl Iterator<Item = P>) -> Result<(), GraphError> {
        for (id, pose) in self.variables.iter().zip(poses) {
            pose.write_variable(&mut self.problem, *id)?;
        }
        Ok(())
    }

    fn read<P: GraphPose>(&self) -> Vec<P> {
        self.variables.iter().map(|id| P::read_variable(&self.problem, *id)).collect()
    }

    /// Tries all initial poses for a few iterations, in ascending order of their initial chi2. A trial is
    /// stopped if its cost stays far above the lowest so far. A method that fails is left out if another one
    /// succeeds.
    fn choose_start<P: GraphPose>(
        &mut self,
        starts: Starts<P>,
        options: &OptimizeOptions,
    ) -> Result<Start<P>, GraphError> {
        let Starts { mut starts, mut error } = starts;
        if starts.len() > 1 {
            let mut lowest = f64::INFINITY;
            for start in &mut starts {
                if let Err(e) = self.try_start(start, lowest, options) {
                    error.get_or_insert(e);
                }
                lowest = lowest.min(start.cost);
                let is_relaxed = start.how == Initialization::RotationsFirst && options.loss == Loss::None;
                if is_relaxed && 2.0 * start.cost >= TIGHT * start.chi2_initialized {
                    break;
                }
            }
            self.trials = starts.iter().filter(|s| s.cost.is_finite()).map(|s| (s.how, s.cost)).collect();
        }
        let best = starts.into_iter().reduce(|best, s| if s.cost < best.cost { s } else { best });
        best.ok_or_else(|| error.unwrap_or(GraphError::NoVertices))
    }

    fn try_start<P: GraphPose>(
        &mut self,
        start: &mut Start<P>,
        lowest: f64,
        options: &OptimizeOptions,
    ) -> Result<(), GraphError> {
        let max_num_iterations = options.trial_iterations.min(options.solver.max_num_iterations);
        let trial = SolverOptions { max_num_iterations, ..options.solver.clone() };
        self.write(start.poses.iter().copied())?;
        let summary = self.problem.solve_with(&mut self.prepared, &trial, &mut |progress| {
            let is_hopeless_trial = progress.iteration >= 2 && progress.cost > MAX_COST_RATIO * lowest;
            if is_hopeless_trial { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })?;
        (start.cost, start.iterations) = (summary.final_cost, summary.iterations);
        start.poses = self.read();
        Ok(())
    }

    fn finish<P: GraphPose>(
        &mut self,
        graph: &mut PoseGraph<P>,
        start: &Start<P>,
        options: &OptimizeOptions,
    ) -> Result<Summary, GraphError> {
        self.write(start.poses.iter().copied())?;
        let max_num_iterations = options.solver.max_num_iterations.saturating_sub(start.iterations);
        let rest = SolverOptions { max_num_iterations, ..options.solver.clone() };
        let summary = self.problem.solve_prepared(&mut self.prepared, &rest)?;
        for (vertex, pose) in graph.vertices.iter_mut().zip(self.read::<P>()) {
            vertex.pose = pose;
        }
        Ok(summary)
    }

    fn condition(&mut self) -> Result<Option<f64>, GraphError> {
        Ok(self.problem.condition_prepared(&mut self.prepared)?)
    }
}

fn worst_edges<P: GraphPose>(graph: &PoseGraph<P>, options: &OptimizeOptions) -> Vec<EdgeChi2> {
    let id = |vertex: u32| graph.vertices[vertex as usize].id;
    let mut edges: Vec<EdgeChi2> = graph
        .edges
        .iter()
        .enumerate()
        .map(|(edge, e)| EdgeChi2 {
            edge,
            from: id(e.from),
            to: id(e.to),
            chi2: graph.edge_chi2(e, options.convention),
        })
        .collect();
    edges.sort_by(|a, b| b.chi2.total_cmp(&a.chi2).then(a.edge.cmp(&b.edge)));
    edges.truncate(options.worst_edges);
    edges
}
