//! Another crate's search tree, to compare with.
#![allow(dead_code)] // not every test uses everything

use nabo::{CandidateContainer, KDTree, NotNan, Parameters, Point};

/// A point as that crate wants it.
#[derive(Clone, Copy, Default)]
pub struct Place([NotNan<f32>; 3]);

impl Point<f32> for Place {
    const DIM: u32 = 3;

    fn set(&mut self, i: u32, value: NotNan<f32>) {
        self.0[i as usize] = value;
    }

    fn get(&self, i: u32) -> NotNan<f32> {
        self.0[i as usize]
    }
}

fn place(p: &[f32; 3]) -> Place {
    Place(p.map(|v| NotNan::new(v).unwrap_or_default()))
}

/// The tree of crate `nabo`.
pub struct OtherTree(KDTree<f32, Place>);

impl OtherTree {
    /// Over finite points.
    pub fn new(points: &[[f32; 3]]) -> Self {
        Self(KDTree::new(&points.iter().map(place).collect::<Vec<_>>()))
    }

    /// Indices and squared distances of the nearest points within `reach`, nearest first.
    pub fn k_nearest(&self, query: [f32; 3], count: u32, reach: f32) -> Vec<(u32, f32)> {
        let parameters =
            Parameters { epsilon: 0.0, max_radius: reach, allow_self_match: true, sort_results: true };
        let found = self.0.knn_advanced(count, &place(&query), CandidateContainer::Linear, &parameters, None);
        found.into_iter().map(|n| (n.index, *n.dist2)).collect()
    }

    /// The nearest point within `reach`.
    pub fn nearest(&self, query: [f32; 3], reach: f32) -> Option<(u32, f32)> {
        self.k_nearest(query, 1, reach).first().copied()
    }
}
