//! Initial values from two linear problems, rotations first (Carlone et al., "Initialization techniques for
//! 3D SLAM", ICRA 2015, section III-B).
//!
//! 1. Rotation matrices are estimated without the constraint of orthogonality, `min Σ w_r ‖R_j − R_i R_ij‖²`,
//!    and then projected to rotations. The rows of all R decouple and share one matrix.
//! 2. With known rotations, positions are a linear problem: `min Σ w_t ‖t_j − t_i − R_i t_ij‖²`.

use super::graph::{GraphError, PoseGraph};
use super::pose::GraphPose;
use crate::ProblemError;
use crate::sparse::BlockSystem;

/// Information assumed for edges without information, relative to one; keeps the equations regular.
const LEAST_INFORMATION: f64 = 1e-9;

/// One linear problem over the vertices that are not held, with blocks of equal size.
struct Relaxation {
    system: BlockSystem,
    /// Position of each vertex in the order of elimination, if it is free.
    position: Vec<Option<u32>>,
    size: usize,
}

impl Relaxation {
    fn new<P: GraphPose>(graph: &PoseGraph<P>, held: &[bool], size: usize) -> Result<Self, ProblemError> {
        let mut block_of = vec![None; held.len()];
        let mut count = 0u32;
        for (block, held) in block_of.iter_mut().zip(held) {
            if !held {
                *block = Some(count);
                count += 1;
            }
        }
        let free_pair = |from: u32, to: u32| {
            let (a, b) = (block_of[from as usize]?, block_of[to as usize]?);
            Some((a.min(b), a.max(b)))
        };
        let mut pairs: Vec<(u32, u32)> = graph.edges.iter().filter_map(|e| free_pair(e.from, e.to)).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let system = BlockSystem::new(&vec![size as u32; count as usize], &pairs)?;
        let position = block_of.iter().map(|b| b.map(|b| system.pattern.position[b as usize])).collect();
        Ok(Self { system, position, size })
    }

    /// Index of the first unknown of a vertex.
    fn start(&self, vertex: u32) -> Option<usize> {
        self.position[vertex as usize].map(|p| self.system.pattern.starts[p as usize] as usize)
    }

    fn add_diagonal(&mut self, vertex: u32, weight: f64) {
        let Some(position) = self.position[vertex as usize] else { return };
        let base = self.system.pattern.base(position as usize);
        let stride = self.system.pattern.heights[position as usize] as usize + 1;
        for k in 0..self.size {
            self.system.values[base + k * stride] += weight;
        }
    }

    /// Adds `entry(r, c)` to the block with row vertex `row` and column vertex `column`, or its transpose to
    /// the transposed block, depending on which one is stored.
    fn add_block(&mut self, row: u32, column: u32, entry: impl Fn(usize, usize) -> f64) {
        let (Some(row), Some(column)) = (self.position[row as usize], self.position[column as usize]) else {
            return;
        };
        let stored = self.system.pattern.block_offset(row.max(column), row.min(column));
        let Some(offset) = stored else { return };
        let stride = self.system.pattern.heights[row.min(column) as usize] as usize;
        for c in 0..self.size {
            for r in 0..self.size {
                let value = if row >= column { entry(r, c) } else { entry(c, r) };
                self.system.values[offset as usize + c * stride + r] += value;
            }
        }
    }

    fn factorize(&mut self) -> Result<(), ProblemError> {
        let zero = vec![0.0; self.system.size()];
        if self.system.factorize(&zero) { Ok(()) } else { Err(ProblemError::Singular) }
    }
}

/// Computes the poses of all vertices that are not `held`.
pub(super) fn initialize<P: GraphPose>(graph: &mut PoseGraph<P>, held: &[bool]) -> Result<(), GraphError> {
    relax_rotations(graph, held)?;
    relax_translations(graph, held)?;
    Ok(())
}

fn relax_rotations<P: GraphPose>(graph: &mut PoseGraph<P>, held: &[bool]) -> Result<(), ProblemError> {
    let d = P::SPACE_DIMENSION;
    let mut relaxation = Relaxation::new(graph, held, d)?;
    let weight_of = |information| P::mean_information(information).1.max(LEAST_INFORMATION);
    for edge in &graph.edges {
        let weight = weight_of(&edge.information);
        relaxation.add_diagonal(edge.from, weight);
        relaxation.add_diagonal(edge.to, weight);
        // Rows of R as columns: x_j = R_ijᵀ x_i.
        relaxation.add_block(edge.to, edge.from, |r, c| -weight * edge.measurement.rotation_entry(c, r));
    }
    relaxation.factorize()?;
    let mut rows = vec![[[0.0; 3]; 3]; graph.vertices.len()];
    let mut unknowns = vec![0.0; relaxation.system.size()];
    for row in 0..P::ROTATION_ROWS {
        unknowns.fill(0.0);
        for edge in &graph.edges {
            let weight = weight_of(&edge.information);
            let known =
                |vertex: u32, k: usize| weight * graph.vertices[vertex as usize].pose.rotation_entry(row, k);
            match (relaxation.start(edge.from), relaxation.start(edge.to)) {
                (None, Some(to)) => {
                    for k in 0..d {
                        unknowns[to + k] += (0..d)
                            .map(|m| edge.measurement.rotation_entry(m, k) * known(edge.from, m))
                            .sum::<f64>();
                    }
                }
                (Some(from), None) => {
                    for k in 0..d {
                        unknowns[from + k] += (0..d)
                            .map(|m| edge.measurement.rotation_entry(k, m) * known(edge.to, m))
                            .sum::<f64>();
                    }
                }
                _ => {}
            }
        }
        relaxation.system.solve(&mut unknowns);
        for (vertex, rows) in rows.iter_mut().enumerate() {
            if let Some(start) = relaxation.start(vertex as u32) {
                rows[row][..d].copy_from_slice(&unknowns[start..start + d]);
            }
        }
    }
    for ((vertex, rows), held) in graph.vertices.iter_mut().zip(&rows).zip(held) {
        if !held {
            // A vertex without a solution keeps its previous rotation.
            vertex.pose = vertex.pose.with_nearest_rotation(&rows[..P::ROTATION_ROWS]).unwrap_or(vertex.pose);
        }
    }
    Ok(())
}

fn relax_translations<P: GraphPose>(graph: &mut PoseGraph<P>, held: &[bool]) -> Result<(), ProblemError> {
    let d = P::SPACE_DIMENSION;
    let mut relaxation = Relaxation::new(graph, held, 1)?;
    let weight_of = |information| P::mean_information(information).0.max(LEAST_INFORMATION);
    for edge in &graph.edges {
        let weight = weight_of(&edge.information);
        relaxation.add_diagonal(edge.from, weight);
        relaxation.add_diagonal(edge.to, weight);
        relaxation.add_block(edge.to, edge.from, |_, _| -weight);
    }
    relaxation.factorize()?;
    let mut translations = vec![[0.0; 3]; graph.vertices.len()];
    let mut unknowns = vec![0.0; relaxation.system.size()];
    for component in 0..d {
        unknowns.fill(0.0);
        for edge in &graph.edges {
            let weight = weight_of(&edge.information);
            let from = &graph.vertices[edge.from as usize].pose;
            let to = &graph.vertices[edge.to as usize].pose;
            let step: f64 = (0..d)
                .map(|k| from.rotation_entry(component, k) * edge.measurement.translation_entry(k))
                .sum();
            let (start_from, start_to) = (relaxation.start(edge.from), relaxation.start(edge.to));
            if let Some(at) = start_from {
                let known = if start_to.is_none() { to.translation_entry(component) } else { 0.0 };
                unknowns[at] += weight * (known - step);
            }
            if let Some(at) = start_to {
                let known = if start_from.is_none() { from.translation_entry(component) } else { 0.0 };
                unknowns[at] += weight * (known + step);
            }
        }
        relaxation.system.solve(&mut unknowns);
        for (vertex, translation) in translations.iter_mut().enumerate() {
            if let Some(start) = relaxation.start(vertex as u32) {
                translation[component] = unknowns[start];
            }
        }
    }
    for ((vertex, translation), held) in graph.vertices.iter_mut().zip(&translations).zip(held) {
        if !held && translation.iter().all(|v| v.is_finite()) {
            vertex.pose = vertex.pose.with_translation(translation);
        }
    }
    Ok(())
}
