//! Initial poses of the optimisation.

use super::chordal;
use super::connectivity::{Adjacency, walk};
use super::graph::{GraphError, PoseGraph};
use super::pose::GraphPose;

/// How initial poses are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Initialization {
    /// All other methods are tried for a few iterations; the lowest cost wins. Default.
    #[default]
    Automatic,
    /// The poses as they are.
    FromFile,
    /// By following measurements between vertices with consecutive numbers first, the others breadth-first.
    Odometry,
    /// By following measurements breadth-first from the anchors: short chains, so little drift.
    SpanningTree,
    /// Rotations by linear relaxation, then translations; works well even if the given poses are far off.
    RotationsFirst,
}

impl std::fmt::Display for Initialization {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Automatic => "the best start of several",
            Self::FromFile => "poses of the file",
            Self::Odometry => "along consecutive poses",
            Self::SpanningTree => "along a spanning tree",
            Self::RotationsFirst => "rotations first",
        })
    }
}

impl Initialization {
    /// The methods to try, in this order; of equal ones the earlier wins.
    pub(super) fn candidates(&self) -> &[Self] {
        match self {
            Self::Automatic => &[Self::FromFile, Self::RotationsFirst, Self::SpanningTree, Self::Odometry],
            one => std::slice::from_ref(one),
        }
    }
}

/// Sets the poses of all vertices that are not `held`. [`Initialization::Automatic`] leaves them.
pub(super) fn initialize<P: GraphPose>(
    graph: &mut PoseGraph<P>,
    adjacency: &Adjacency,
    held: &[bool],
    how: Initialization,
) -> Result<(), GraphError> {
    match how {
        Initialization::Automatic | Initialization::FromFile => Ok(()),
        Initialization::SpanningTree => {
            follow(graph, adjacency, held.to_vec());
            Ok(())
        }
        Initialization::Odometry => {
            let known = chain(graph, held);
            follow(graph, adjacency, known);
            Ok(())
        }
        Initialization::RotationsFirst => chordal::initialize(graph, held),
    }
}

/// Computes poses by following measurements breadth-first from the known vertices. In parts without a known
/// vertex the first vertex keeps its pose.
pub(super) fn follow<P: GraphPose>(graph: &mut PoseGraph<P>, adjacency: &Adjacency, mut known: Vec<bool>) {
    let mut steps = Vec::with_capacity(graph.vertices.len());
    walk(
        graph,
        adjacency,
        &mut known,
        |_| {},
        |edge, forward, from, to| steps.push((edge, forward, from, to)),
    );
    for (edge, forward, from, to) in steps {
        let measurement = graph.edges[edge as usize].measurement;
        let step = if forward { measurement } else { measurement.inverted() };
        graph.vertices[to as usize].pose = graph.vertices[from as usize].pose * step;
    }
}

/// Follows edges from each number to the next, beginning at known vertices; returns the vertices that are
/// known then.
fn chain<P: GraphPose>(graph: &mut PoseGraph<P>, held: &[bool]) -> Vec<bool> {
    let mut known = held.to_vec();
    let mut consecutive: Vec<u32> = (0..graph.edges.len() as u32)
        .filter(|i| {
            let edge = &graph.edges[*i as usize];
            let id = |v: u32| graph.vertices[v as usize].id;
            id(edge.from).checked_add(1) == Some(id(edge.to))
        })
        .collect();
    consecutive.sort_by_key(|i| (graph.vertices[graph.edges[*i as usize].from as usize].id, *i));
    for index in consecutive {
        let edge = &graph.edges[index as usize];
        let (from, to, measurement) = (edge.from as usize, edge.to as usize, edge.measurement);
        if known[from] && !known[to] {
            graph.vertices[to].pose = graph.vertices[from].pose * measurement;
            known[to] = true;
        }
    }
    known
}
