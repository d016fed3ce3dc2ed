//! Loop closure: a scan somewhere in a submap, at any angle, and near a guess.
//!
//! Submaps and scans are of the recording `fr079`.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]

#[path = "../tests/common/mod.rs"]
#[allow(dead_code)]
mod common;
#[path = "../../grids/tests/common/recording.rs"]
#[allow(dead_code)]
mod recording;

use portolan_geometry::Rigid2;
use portolan_matching::{FastCorrelativeMatcher2d, FastCorrelativeOptions2d};
use portolan_testing::Stopwatch;

fn search(watch: &Stopwatch) {
    let Some(scans) = recording::posed_scans("fr079") else { return };
    let inserter = common::default_inserter();
    let options = FastCorrelativeOptions2d::default();
    let closures = (0..scans.len()).step_by(90).filter_map(|start| {
        recording::loop_closure(&scans, &inserter, start).map(|(grid, later)| (start, grid, later))
    });
    for (start, grid, later) in closures.take(4) {
        let (scan, truth) = (scans[later].filtered(), scans[later].map_from_laser);
        let matcher = FastCorrelativeMatcher2d::new(&grid, &options).unwrap();
        let (width, height) = (grid.limits().num_x_cells(), grid.limits().num_y_cells());
        let name = format!("{start}, {width}x{height} cells, {} points", scan.len());
        watch.time(&format!("prepare {name}"), || FastCorrelativeMatcher2d::new(&grid, &options).unwrap());
        let shift = nalgebra::Vector2::new(1.5, -2.0);
        let guess = Rigid2 { translation: truth.translation + shift, angle: truth.angle + 0.2 };
        for min_score in [0.55, 0.4] {
            eprintln!("{name}: {:?}, truth {truth:?}", matcher.match_full(&scan, min_score));
            watch.time(&format!("local {name}, above {min_score}"), || {
                matcher.match_local(&guess, &scan, min_score)
            });
            watch.time(&format!("full {name}, above {min_score}"), || matcher.match_full(&scan, min_score));
        }
    }
}

fn main() {
    let watch = Stopwatch::of_arguments();
    search(&watch);
}
