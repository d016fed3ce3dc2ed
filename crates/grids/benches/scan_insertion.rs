//! Drawing one scan into a submap, as a scan is drawn into two submaps during mapping.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]

#[path = "../tests/common/mod.rs"]
#[allow(dead_code)]
mod common;
#[path = "../tests/common/hall.rs"]
#[allow(dead_code)]
mod hall;
#[path = "../tests/common/recording.rs"]
#[allow(dead_code)]
mod recording;

use portolan_grids::{ProbabilityGrid, Tsdf2d, TsdfInserter, TsdfInserterOptions};
use portolan_testing::Stopwatch;

fn insert(watch: &Stopwatch) {
    let inserter = common::default_inserter();
    for beams in [180, 360, 1000] {
        let scan = common::room(beams, 1.5, 0.7);
        let mut grid = ProbabilityGrid::new(common::room_limits());
        watch.time(&format!("room of 10 m by 8 m, {beams} beams"), || {
            inserter.insert(&scan, &mut grid).unwrap()
        });
        let mut tsdf = Tsdf2d::new(common::room_limits(), 0.3, 10.0).unwrap();
        let tsdf_inserter = TsdfInserter::new(&TsdfInserterOptions::default()).unwrap();
        watch.time(&format!("room of 10 m by 8 m, {beams} beams, distance field"), || {
            tsdf_inserter.insert(&scan, &mut tsdf).unwrap()
        });
    }
    if let Some(scans) = recording::posed_scans("fr079") {
        let mut grid = recording::submap(&scans[700..790], &inserter);
        let scan = scans[745].range_data_in_map();
        watch.time(&format!("corridor (fr079), {} returns", scan.returns.len()), || {
            inserter.insert(&scan, &mut grid).unwrap()
        });
        watch.time("the first scan of a submap, which makes it grow (fr079)", || {
            recording::submap(&scans[700..701], &inserter)
        });
    }
    for points in [5_000, 20_000] {
        let mut submaps = [(); 2].map(|()| hall::HallSubmap::of_walk(20.0, 150));
        let pose = hall::walk(10.1);
        let mut sweep = hall::sweep(&pose, points / 32, &mut common::Lcg::new(5));
        sweep.points.truncate(points);
        let scan = hall::range_data(&pose, &sweep);
        watch.time(&format!("hall of 30 m by 20 m, {points} returns, two submaps in 3D"), || {
            submaps.iter_mut().for_each(|s| s.insert_range_data(&scan))
        });
    }
}

fn main() {
    let watch = Stopwatch::of_arguments();
    insert(&watch);
}
