//! Matching one scan to the submap being drawn: by search in a small window, then by least squares.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]

#[path = "../tests/common/mod.rs"]
#[allow(dead_code)]
mod common;
#[path = "../../grids/tests/common/recording.rs"]
#[allow(dead_code)]
mod recording;

use portolan_geometry::Rigid2;
use portolan_grids::{Grid2d, Tsdf2d, TsdfInserter, TsdfInserterOptions};
use portolan_matching::{
    GradientMatcher2d, GradientMatcherOptions2d, RealTimeCorrelativeMatcher2d, RealTimeCorrelativeOptions,
};
use portolan_sensor::PointCloud;
use portolan_testing::Stopwatch;

fn matches(watch: &Stopwatch) {
    let mut scenes: Vec<(String, Grid2d, PointCloud, Rigid2)> = Vec::new();
    let mut tsdf = Tsdf2d::new(common::room_limits(), 0.3, 10.0).unwrap();
    let tsdf_inserter = TsdfInserter::new(&TsdfInserterOptions::default()).unwrap();
    (0..3).for_each(|_| assert!(tsdf_inserter.insert(&common::room1(), &mut tsdf).is_ok()));
    let scan = common::golden_scan();
    scenes.push(("room, 300 points".into(), common::grid_g().into(), scan.clone(), common::golden_initial()));
    scenes.push(("room, 300 points, distance field".into(), tsdf.into(), scan, common::golden_initial()));
    if let Some(scans) = recording::posed_scans("fr079") {
        let grid = recording::submap(&scans[700..745], &common::default_inserter());
        for (name, scan) in [("filtered", scans[746].filtered()), ("all", scans[746].points.clone())] {
            let truth = scans[746].map_from_laser;
            let initial = Rigid2 {
                translation: truth.translation + nalgebra::Vector2::new(0.04, -0.03),
                angle: truth.angle + 0.03,
            };
            let name = format!("fr079, {name}, {} points", scan.len());
            scenes.push((name, grid.clone().into(), scan, initial));
        }
    }
    let gradient = GradientMatcher2d::new(&GradientMatcherOptions2d::default()).unwrap();
    for (name, grid, scan, initial) in &scenes {
        for (window, linear, angular) in
            [("default", 0.1, 20f64), ("wide", 0.15, 35.0), ("very wide", 0.5, 35.0)]
        {
            let matcher = RealTimeCorrelativeMatcher2d::new(&RealTimeCorrelativeOptions {
                linear_search_window: linear,
                angular_search_window: angular.to_radians(),
                ..Default::default()
            })
            .unwrap();
            watch.time(&format!("correlative, {window} window, {name}"), || {
                matcher.match_scan(initial, scan, grid)
            });
        }
        let found = gradient.match_scan(initial.translation, initial, scan, grid);
        let name = format!("gradient, {name}, {} iterations", found.summary.iterations);
        watch.time(&name, || gradient.match_scan(initial.translation, initial, scan, grid));
    }
}

fn main() {
    let watch = Stopwatch::of_arguments();
    matches(&watch);
}
