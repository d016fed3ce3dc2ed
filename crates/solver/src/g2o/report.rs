//! Report of the optimisation of a graph.

use portolan_numeric::counted;

use super::{Graph, Initialization};
use crate::Termination;

/// Residual of an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeChi2 {
    /// Index of the edge.
    pub edge: usize,
    /// Number in the file of the vertex whose frame the measurement is in.
    pub from: i64,
    /// Number in the file of the vertex whose pose was measured.
    pub to: i64,
    /// `eᵀΩe`.
    pub chi2: f64,
}

/// Result of [`optimize_graph`](super::optimize_graph).
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// `Σ eᵀΩe` of the given poses.
    pub chi2_before: f64,
    /// `Σ eᵀΩe` after initialisation.
    pub chi2_initialized: f64,
    /// `Σ eᵀΩe` of the optimised poses.
    pub chi2_after: f64,
    /// Number of iterations from the chosen initial poses, including those of its trial.
    pub iterations: u32,
    /// Why the solver stopped.
    pub termination: Termination,
    /// Method of the initial poses that were used.
    pub initialization: Initialization,
    /// Cost (half of chi2, robust loss applied) after the trial of each method; empty if there was only one.
    pub trials: Vec<(Initialization, f64)>,
    /// Edges with the largest chi2, in descending order, as many as requested.
    pub worst_edges: Vec<EdgeChi2>,
    /// Number of residuals.
    pub residuals: usize,
    /// Number of unknowns.
    pub unknowns: usize,
    /// Number of connected parts of the graph.
    pub components: usize,
    /// Numbers of the vertices that were held because their part had no fixed one: otherwise the part could
    /// be moved as a whole (gauge freedom).
    pub anchored: Vec<i64>,
    /// Number of edges whose information matrix had negative eigenvalues, which were set to zero.
    pub repaired_information: usize,
    /// Ratio of the largest to the smallest eigenvalue of the normal equations scaled to a unit diagonal,
    /// from a few power iterations (accurate to a factor of about two). Infinite if they are singular: the
    /// edges do not constrain some vertices.
    pub condition: Option<f64>,
}

impl Report {
    /// The graph and the result as text for the user.
    pub fn text(&self, graph: &Graph) -> String {
        let dimension = if matches!(graph, Graph::TwoD(_)) { "in 2D" } else { "in 3D" };
        let mut text = format!(
            "{} {dimension}, {}, {}\n",
            counted(graph.vertex_count() as u64, "pose", "poses"),
            counted(graph.edge_count() as u64, "edge", "edges"),
            counted(self.components as u64, "part", "parts")
        );
        text += &format!("chi2 of the file     {:.6}\n", self.chi2_before);
        text += &format!("chi2 at the start    {:.6} ({})\n", self.chi2_initialized, self.initialization);
        text += &format!("chi2 after           {:.6} (redundancy {})\n", self.chi2_after, self.redundancy());
        let iterations = counted(self.iterations as u64, "iteration", "iterations");
        text += &format!("{iterations}: {}\n", self.termination);
        if self.repaired_information > 0 {
            let matrices = counted(
                self.repaired_information as u64,
                "information matrix was",
                "information matrices were",
            );
            text += &format!("{matrices} indefinite: negative eigenvalues taken as zero\n");
        }
        if let Some(condition) = self.condition {
            text += &format!("condition            {condition:.3e}\n");
        }
        if self.components > 1 {
            let held: Vec<String> = self.anchored.iter().take(10).map(ToString::to_string).collect();
            text += &format!("the graph is not connected; held in its parts: {}\n", held.join(", "));
        }
        if !self.worst_edges.is_empty() {
            text += "edges that fit worst\n";
        }
        for edge in &self.worst_edges {
            text += &format!("  {} -> {}  chi2 {:.6}\n", edge.from, edge.to, edge.chi2);
        }
        text
    }

    /// Residuals minus unknowns: the expected chi2 if the information matrices are correct.
    pub fn redundancy(&self) -> usize {
        self.residuals.saturating_sub(self.unknowns)
    }
}
