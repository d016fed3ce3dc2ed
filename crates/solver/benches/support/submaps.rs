//! A made-up pose graph as mapping makes it: nodes in two submaps each, consecutive nodes, loop closures.

use portolan_geometry::{Rigid2, Rigid3, embed_3d};
use portolan_solver::factors::{Se2Between, Se3Between};
use portolan_solver::{Loss, Problem, VariableId};

const NODES_PER_SUBMAP: usize = 90;

/// Poses of nodes and submaps and all constraints, before they become a problem.
pub struct SubmapGraph {
    nodes: Vec<Rigid2>,
    submaps: Vec<Rigid2>,
    intra: Vec<(usize, usize, Rigid2)>,
    inter: Vec<(usize, usize, Rigid2)>,
}

/// Rounds of a long corridor with a little drift; every tenth node is matched with a submap of the round
/// before.
pub fn submap_graph(nodes: usize) -> SubmapGraph {
    let per_round = 1000.0;
    let truth = |i: usize| {
        let a = std::f64::consts::TAU * i as f64 / per_round;
        Rigid2::new(30.0 * a.cos(), 20.0 * a.sin(), a)
    };
    let drift = |i: usize| {
        let k = i as f64;
        Rigid2::new(1e-4 * k, 0.02 * (0.01 * k).sin(), 2e-5 * k) * truth(i)
    };
    let half = NODES_PER_SUBMAP / 2;
    let submaps: Vec<usize> = (0..nodes.div_ceil(half)).map(|s| s * half).collect();
    let mut graph = SubmapGraph {
        nodes: (0..nodes).map(drift).collect(),
        submaps: submaps.iter().map(|first| drift(*first)).collect(),
        intra: Vec::new(),
        inter: Vec::new(),
    };
    for i in 0..nodes {
        let newest = i / half;
        for (submap, first) in submaps.iter().enumerate().take(newest + 1).skip(newest.saturating_sub(1)) {
            graph.intra.push((submap, i, drift(*first).inverse() * drift(i)));
        }
        if i % 10 == 0 && i as f64 > per_round {
            let submap = (i - per_round as usize) / half;
            let noise =
                Rigid2::new(0.02 * (i as f64).sin(), 0.02 * (i as f64).cos(), 0.002 * (3.0 * i as f64).sin());
            graph.inter.push((submap, i, truth(submaps[submap]).inverse() * truth(i) * noise));
        }
    }
    graph
}

impl SubmapGraph {
    /// The 2D problem of slam2d §14.6 without odometry.
    pub fn problem_2d(&self) -> Problem {
        let mut problem = Problem::new();
        let submaps: Vec<VariableId> = self.submaps.iter().map(|p| problem.add_se2(p)).collect();
        let nodes: Vec<VariableId> = self.nodes.iter().map(|p| problem.add_se2(p)).collect();
        problem.set_constant(submaps[0]);
        let mut add = |from, to, measurement, (translation_weight, rotation_weight), loss| {
            let factor =
                Se2Between { variables: [from, to], measurement, translation_weight, rotation_weight };
            problem.add_factor(factor, loss).ok()
        };
        for (submap, node, z) in &self.intra {
            add(submaps[*submap], nodes[*node], *z, (500.0, 1600.0), Loss::None);
        }
        for (submap, node, z) in &self.inter {
            add(submaps[*submap], nodes[*node], *z, (1.1e4, 1e5), Loss::Huber(10.0));
        }
        for i in 1..nodes.len() {
            let z = self.nodes[i - 1].inverse() * self.nodes[i];
            add(nodes[i - 1], nodes[i], z, (1e5, 1e5), Loss::None);
        }
        problem
    }

    /// The same with poses in 3D.
    pub fn problem_3d(&self) -> Problem {
        let mut problem = Problem::new();
        let submaps: Vec<VariableId> = self.submaps.iter().map(|p| problem.add_se3(&embed_3d(p))).collect();
        let nodes: Vec<VariableId> = self.nodes.iter().map(|p| problem.add_se3(&embed_3d(p))).collect();
        problem.set_constant(submaps[0]);
        let mut add = |from, to, z: Rigid2, (translation_weight, rotation_weight), loss| {
            let measurement: Rigid3 = embed_3d(&z);
            let factor =
                Se3Between { variables: [from, to], measurement, translation_weight, rotation_weight };
            problem.add_factor(factor, loss).ok()
        };
        for (submap, node, z) in &self.intra {
            add(submaps[*submap], nodes[*node], *z, (500.0, 1600.0), Loss::None);
        }
        for (submap, node, z) in &self.inter {
            add(submaps[*submap], nodes[*node], *z, (1.1e4, 1e5), Loss::Huber(10.0));
        }
        for i in 1..nodes.len() {
            let z = self.nodes[i - 1].inverse() * self.nodes[i];
            add(nodes[i - 1], nodes[i], z, (1e5, 1e5), Loss::None);
        }
        problem
    }
}
