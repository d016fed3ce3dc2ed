//! A made-up city: a walk along the streets of a grid, with loop closures to places visited before.

use std::collections::HashMap;

use portolan_geometry::{Quaternion, Rigid2, Rigid3, Vector3, project_2d, quaternion_from_angle_axis};
use portolan_numeric::Lcg64;
use portolan_solver::g2o::{Edge, GraphPose, InformationMatrix, PoseGraph, Vertex};

/// A generator of random numbers that is the same everywhere.
struct Random(Lcg64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0.uniform()
    }

    fn gaussian(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }

    fn vector(&mut self, sigma: f64) -> Vector3 {
        Vector3::new(self.gaussian(), self.gaussian(), self.gaussian()) * sigma
    }
}

const TRANSLATION_SIGMA: f64 = 0.05;
const ROTATION_SIGMA: f64 = 0.01;

/// `poses` poses in 3D, about one closure per pose, measurements with noise that the information matrices
/// describe; initial poses from dead reckoning.
pub fn city_3d(poses: usize, closures_per_pose: f64) -> PoseGraph<Rigid3> {
    let mut random = Random(Lcg64::new(42));
    let truth = walk(poses, &mut random);
    let mut information = nalgebra::Matrix6::identity() / (TRANSLATION_SIGMA * TRANSLATION_SIGMA);
    for k in 3..6 {
        information[(k, k)] = 1.0 / (ROTATION_SIGMA * ROTATION_SIGMA);
    }
    let information = InformationMatrix(information);
    let mut edges = Vec::new();
    for (from, to) in pairs(&truth, closures_per_pose, &mut random) {
        let turn = quaternion_from_angle_axis(&random.vector(ROTATION_SIGMA));
        let noise = Rigid3::from_parts(random.vector(TRANSLATION_SIGMA).into(), turn);
        let measurement = truth[from].inverse() * truth[to] * noise;
        edges.push(Edge { from: from as u32, to: to as u32, measurement, information });
    }
    finish(truth[0], edges, poses)
}

/// The same walk in 2D.
#[allow(dead_code)]
pub fn city_2d(poses: usize, closures_per_pose: f64) -> PoseGraph<Rigid2> {
    let graph = city_3d(poses, closures_per_pose);
    let t = 1.0 / (TRANSLATION_SIGMA * TRANSLATION_SIGMA);
    let r = 1.0 / (ROTATION_SIGMA * ROTATION_SIGMA);
    let information = InformationMatrix(nalgebra::Matrix3::from_diagonal(&[t, t, r].into()));
    let edges = graph
        .edges
        .iter()
        .map(|e| Edge { from: e.from, to: e.to, measurement: project_2d(&e.measurement), information })
        .collect();
    finish(Rigid2::identity(), edges, poses)
}

/// One metre a step, a turn left or right at some crossings (every five metres).
fn walk(poses: usize, random: &mut Random) -> Vec<Rigid3> {
    let side = (poses as f64).sqrt() * 0.6;
    let mut truth: Vec<Rigid3> = vec![Rigid3::identity()];
    let mut heading = 0.0;
    while truth.len() < poses {
        let last = truth[truth.len() - 1];
        let position = last.translation.vector;
        if truth.len().is_multiple_of(5) {
            let outside = position.x.abs().max(position.y.abs()) > side;
            if outside || random.uniform() < 0.4 {
                let sign = if random.uniform() < 0.5 { 1.0 } else { -1.0 };
                heading += sign * std::f64::consts::FRAC_PI_2;
                let ahead = position + 5.0 * Vector3::new(f64::cos(heading), f64::sin(heading), 0.0);
                if outside && ahead.norm() > position.norm() {
                    heading += std::f64::consts::PI;
                }
            }
        }
        let step = Vector3::new(heading.cos(), heading.sin(), 0.0);
        let up = Vector3::new(0.0, 0.0, 0.3 * (position.x * 0.05).sin() - position.z * 0.1);
        let turn = Quaternion::from_axis_angle(&Vector3::z_axis(), heading)
            * quaternion_from_angle_axis(&Vector3::new(0.1 * (position.y * 0.1).sin(), 0.05, 0.0));
        truth.push(Rigid3::from_parts((position + step + up).into(), turn));
    }
    truth
}

/// The chain, and closures to poses visited before within two metres.
fn pairs(truth: &[Rigid3], closures_per_pose: f64, random: &mut Random) -> Vec<(usize, usize)> {
    let cell = |pose: &Rigid3| {
        let p = pose.translation.vector;
        ((p.x / 2.0).round() as i64, (p.y / 2.0).round() as i64)
    };
    let mut pairs: Vec<(usize, usize)> = (1..truth.len()).map(|i| (i - 1, i)).collect();
    let mut visited: HashMap<(i64, i64), Vec<usize>> = HashMap::new();
    let mut owed = 0.0;
    for (i, pose) in truth.iter().enumerate() {
        owed += closures_per_pose;
        let entry = visited.entry(cell(pose)).or_default();
        let old = entry.iter().filter(|j| i - **j > 10).count();
        while owed >= 1.0 && old > 0 {
            let pick = entry[(random.uniform() * old as f64) as usize % old];
            pairs.push((pick, i));
            owed -= 1.0;
        }
        entry.push(i);
    }
    pairs
}

fn finish<P: GraphPose>(first: P, edges: Vec<Edge<P>>, poses: usize) -> PoseGraph<P> {
    let mut vertices = vec![Vertex { id: 0, pose: first, fixed: true }];
    for (i, edge) in edges.iter().take(poses - 1).enumerate() {
        let pose = vertices[i].pose * edge.measurement;
        vertices.push(Vertex { id: i as i64 + 1, pose, fixed: false });
    }
    PoseGraph { vertices, edges }
}
