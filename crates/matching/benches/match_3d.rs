//! Matching one sweep of two lidars while mapping in 3D: gradient and correlative, in a hall of 30 m by
//! 20 m.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]

#[path = "../tests/common/mod.rs"]
#[allow(dead_code)]
mod common;
#[path = "../../grids/tests/common/hall.rs"]
#[allow(dead_code)]
mod hall;

use portolan_geometry::{Rigid3, rotation_from_roll_pitch_yaw};
use portolan_matching::{
    CloudInGrid, GradientMatcher3d, GradientMatcherOptions3d, RealTimeCorrelativeMatcher3d,
    RealTimeCorrelativeOptions,
};
use portolan_testing::Stopwatch;

fn matches(watch: &Stopwatch) {
    let submap = hall::HallSubmap::of_walk(20.0, 600);
    let truth = hall::walk(20.3);
    let sweep = hall::sweep(&truth, 600, &mut common::Lcg::new(99));
    let [high, low] = hall::matching_clouds(&sweep);
    let error =
        Rigid3::from_parts([0.06, -0.04, 0.03].into(), rotation_from_roll_pitch_yaw(0.005, -0.004, 0.015));
    let initial = truth * error;
    let gradient = GradientMatcher3d::new(&GradientMatcherOptions3d::default(), 2).unwrap();
    let clouds = [
        CloudInGrid { cloud: &high, grid: &submap.high, intensities: None },
        CloudInGrid { cloud: &low, grid: &submap.low, intensities: None },
    ];
    let found = gradient.match_scan(initial.translation.vector, &initial, &clouds);
    let left = found.pose.inverse() * truth;
    eprintln!("gradient: {:.4} m, {:.4} rad left", left.translation.vector.norm(), left.rotation.angle());
    let name =
        format!("gradient, {} + {} points, {} iterations", high.len(), low.len(), found.summary.iterations);
    watch.time(&name, || gradient.match_scan(initial.translation.vector, &initial, &clouds));
    for (linear, degrees) in [(0.15, 1.0f64), (0.25, 2.0)] {
        let options = RealTimeCorrelativeOptions {
            linear_search_window: linear,
            angular_search_window: degrees.to_radians(),
            ..Default::default()
        };
        let matcher = RealTimeCorrelativeMatcher3d::new(&options).unwrap();
        watch.time(&format!("correlative, {linear} m, {degrees}°, {} points", high.len()), || {
            matcher.match_scan(&initial, &high, &submap.high)
        });
    }
}

fn main() {
    let watch = Stopwatch::of_arguments();
    matches(&watch);
}
