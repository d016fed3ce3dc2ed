//! How fast is a small fit? A 2D pose from 500 noisy pairs of points, in the shape of scan matching.

#![allow(missing_docs)]

use nalgebra::{Vector2, Vector3};
use portolan_geometry::Rigid2;
use portolan_solver::{DenseProblem, NormalEquations, SolverOptions, solve_dense};
use portolan_testing::Stopwatch;

struct Alignment {
    pairs: Vec<(Vector2<f64>, Vector2<f64>)>,
}

impl DenseProblem<3> for Alignment {
    type State = Rigid2;

    fn evaluate(&mut self, pose: &Rigid2, normal: Option<&mut NormalEquations<3>>) -> Option<f64> {
        let (s, c) = pose.angle.sin_cos();
        let mut cost = 0.0;
        let mut sums = NormalEquations::new();
        for (point, target) in &self.pairs {
            let turned = Vector2::new(c * point.x - s * point.y, s * point.x + c * point.y);
            let r = turned + pose.translation - target;
            cost += 0.5 * r.norm_squared();
            sums.add(r.x, &Vector3::new(1.0, 0.0, -turned.y));
            sums.add(r.y, &Vector3::new(0.0, 1.0, turned.x));
        }
        if let Some(normal) = normal {
            normal.merge(&sums);
        }
        Some(cost)
    }

    fn plus(&self, pose: &Rigid2, delta: &Vector3<f64>) -> Rigid2 {
        Rigid2::new(pose.translation.x + delta.x, pose.translation.y + delta.y, pose.angle + delta.z)
    }
}

fn small_fit(watch: &Stopwatch) {
    let truth = Rigid2::new(0.3, -0.2, 0.15);
    let pair = |i: usize| {
        let k = i as f64;
        let point = Vector2::new(5.0 * (0.37 * k).sin(), 4.0 * (0.23 * k).cos());
        let noise = Vector2::new((7.0 * k).sin(), (11.0 * k).cos()) * 0.02;
        (point, truth.transform_point(&point) + noise)
    };
    let mut problem = Alignment { pairs: (0..500).map(pair).collect() };
    watch.time("fit_500_points", || solve_dense(&mut problem, Rigid2::identity(), &SolverOptions::default()));
}

fn main() {
    let watch = Stopwatch::of_arguments();
    small_fit(&watch);
}
