//! How fast is a pose graph optimised? A made-up city with one loop closure per pose and full information
//! matrices, from dead reckoning.

#![allow(missing_docs, clippy::unwrap_used)]

use portolan_solver::g2o::{GraphPose, Initialization, OptimizeOptions, PoseGraph, optimize_pose_graph};
use portolan_testing::Stopwatch;

#[path = "support/city.rs"]
mod city;

fn measure<P: GraphPose>(
    watch: &Stopwatch,
    name: &str,
    graph: &PoseGraph<P>,
    initialization: Initialization,
) {
    let options = OptimizeOptions { initialization, ..Default::default() };
    watch.time_on(name, || graph.clone(), |graph| optimize_pose_graph(graph, &options).unwrap());
}

fn pose_graphs(watch: &Stopwatch) {
    use Initialization::{Automatic, FromFile, RotationsFirst};
    let city_2d = city::city_2d(3500, 0.5);
    measure(watch, "2d_3500_from_dead_reckoning", &city_2d, FromFile);
    measure(watch, "2d_3500_automatic", &city_2d, Automatic);
    let city_3d = city::city_3d(2500, 1.0);
    measure(watch, "3d_2500_from_dead_reckoning", &city_3d, FromFile);
    measure(watch, "3d_2500_rotations_first", &city_3d, RotationsFirst);
    measure(watch, "3d_2500_automatic", &city_3d, Automatic);
    measure(watch, "3d_10000_from_dead_reckoning", &city::city_3d(10_000, 1.0), FromFile);
}

fn main() {
    let watch = Stopwatch::of_arguments();
    pose_graphs(&watch);
}
