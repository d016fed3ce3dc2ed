//! Connected parts of a graph, anchors and breadth-first walks.

use std::collections::VecDeque;

use super::graph::PoseGraph;
use super::pose::GraphPose;

/// Edges at each vertex, by vertex, in the order of edges.
pub(super) struct Adjacency {
    starts: Vec<u32>,
    /// Index of the edge, and whether it starts at this vertex.
    entries: Vec<(u32, bool)>,
}

impl Adjacency {
    pub fn new<P: GraphPose>(graph: &PoseGraph<P>) -> Self {
        let n = graph.vertices.len();
        let mut starts = vec![0u32; n + 1];
        for edge in &graph.edges {
            starts[edge.from as usize + 1] += 1;
            starts[edge.to as usize + 1] += 1;
        }
        for i in 0..n {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let mut entries = vec![(0, false); 2 * graph.edges.len()];
        for (index, edge) in graph.edges.iter().enumerate() {
            for (vertex, forward) in [(edge.from, true), (edge.to, false)] {
                let slot = &mut next[vertex as usize];
                entries[*slot as usize] = (index as u32, forward);
                *slot += 1;
            }
        }
        Self { starts, entries }
    }

    pub fn of(&self, vertex: u32) -> &[(u32, bool)] {
        let range = self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize;
        &self.entries[range]
    }
}

/// Visits vertices breadth-first from those that are `known`. When everything reachable has been visited, it
/// continues from the first vertex left, for which `start` is called. `reach` gets the edge, whether it is
/// followed along its direction, and the two vertices, the known one first.
pub(super) fn walk<P: GraphPose>(
    graph: &PoseGraph<P>,
    adjacency: &Adjacency,
    known: &mut [bool],
    mut start: impl FnMut(u32),
    mut reach: impl FnMut(u32, bool, u32, u32),
) {
    let mut queue: VecDeque<u32> = (0..known.len() as u32).filter(|i| known[*i as usize]).collect();
    let mut first_left = 0;
    loop {
        while let Some(vertex) = queue.pop_front() {
            for (edge_index, forward) in adjacency.of(vertex) {
                let edge = &graph.edges[*edge_index as usize];
                let other = if *forward { edge.to } else { edge.from };
                if !std::mem::replace(&mut known[other as usize], true) {
                    reach(*edge_index, *forward, vertex, other);
                    queue.push_back(other);
                }
            }
        }
        match known[first_left..].iter().position(|k| !k) {
            Some(ahead) => {
                first_left += ahead;
                known[first_left] = true;
                start(first_left as u32);
                queue.push_back(first_left as u32);
            }
            None => return,
        }
    }
}

/// Number of connected parts, and the vertices to be held in addition to the fixed ones: the first vertex of
/// each part that has no fixed one.
pub(super) fn anchors<P: GraphPose>(graph: &PoseGraph<P>, adjacency: &Adjacency) -> (usize, Vec<u32>) {
    let n = graph.vertices.len();
    let mut part_of = vec![u32::MAX; n];
    let mut known = vec![false; n];
    let mut starts = Vec::new();
    // The visit of one part is finished before the next begins.
    let part_of_start = std::cell::RefCell::new(&mut part_of);
    walk(
        graph,
        adjacency,
        &mut known,
        |vertex| {
            part_of_start.borrow_mut()[vertex as usize] = starts.len() as u32;
            starts.push(vertex);
        },
        |_, _, from, to| {
            let mut part_of = part_of_start.borrow_mut();
            part_of[to as usize] = part_of[from as usize];
        },
    );
    let mut has_fixed = vec![false; starts.len()];
    for (vertex, part) in graph.vertices.iter().zip(&part_of) {
        if let Some(entry) = has_fixed.get_mut(*part as usize) {
            *entry |= vertex.fixed;
        }
    }
    let free = starts.iter().zip(&has_fixed).filter(|(_, fixed)| !**fixed).map(|(start, _)| *start).collect();
    (starts.len(), free)
}
