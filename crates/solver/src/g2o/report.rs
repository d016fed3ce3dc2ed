//! What an optimisation of a graph found.

use super::Initialization;
use crate::Termination;

/// How badly an edge fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeChi2 {
    /// Index of the edge.
    pub edge: usize,
    /// Number of the vertex from which is measured.
    pub from: i64,
    /// Number of the vertex that is measured.
    pub to: i64,
    /// `eᵀΩe`.
    pub chi2: f64,
}

/// Result of [`optimize_graph`](super::optimize_graph).
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// `Σ eᵀΩe` of the poses as given.
    pub chi2_before: f64,
    /// `Σ eᵀΩe` after initialisation.
    pub chi2_initialized: f64,
    /// `Σ eᵀΩe` of the poses found.
    pub chi2_after: f64,
    /// Iterations from the chosen start, those of its trial included.
    pub iterations: u32,
    /// Why the solver stopped.
    pub termination: Termination,
    /// The start that was used.
    pub initialization: Initialization,
    /// Cost (half of chi2, robust loss applied) after the trial of each start; empty when there was one only.
    pub trials: Vec<(Initialization, f64)>,
    /// Edges by falling chi2, as many as asked for.
    pub worst_edges: Vec<EdgeChi2>,
    /// Number of residuals.
    pub residuals: usize,
    /// Number of unknowns.
    pub unknowns: usize,
    /// Connected parts of the graph.
    pub components: usize,
    /// Numbers of the vertices that were held because their part had none fixed: without them the graph
    /// could be moved as a whole (gauge freedom).
    pub anchored: Vec<i64>,
    /// Edges whose information matrix had negative eigenvalues, which were taken as zero.
    pub repaired_information: usize,
    /// Ratio of the largest to the smallest eigenvalue of the normal equations scaled to a unit diagonal,
    /// from a few power iterations (good to a factor of two or so); infinite when they are singular: some
    /// vertices are not determined by the edges.
    pub condition: Option<f64>,
}

impl Report {
    /// Residuals minus unknowns: what chi2 should be near when the information matrices are right.
    pub fn redundancy(&self) -> usize {
        self.residuals.saturating_sub(self.unknowns)
    }
}
