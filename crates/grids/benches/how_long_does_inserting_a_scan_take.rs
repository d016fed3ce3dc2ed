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

use criterion::{Criterion, criterion_group, criterion_main};
use portolan_grids::{ProbabilityGrid, Tsdf2d, TsdfInserter, TsdfInserterOptions};

fn insert(c: &mut Criterion) {
    let mut group = c.benchmark_group("insert");
    let inserter = common::default_inserter();
    for beams in [180, 360, 1000] {
        let scan = common::room(beams, 1.5, 0.7);
        let mut grid = ProbabilityGrid::new(common::room_limits());
        group.bench_function(format!("room of 10 m by 8 m, {beams} beams"), |b| {
            b.iter(|| inserter.insert(&scan, &mut grid).unwrap());
        });
        let mut tsdf = Tsdf2d::new(common::room_limits(), 0.3, 10.0).unwrap();
        let tsdf_inserter = TsdfInserter::new(&TsdfInserterOptions::default()).unwrap();
        group.bench_function(format!("room of 10 m by 8 m, {beams} beams, distance field"), |b| {
            b.iter(|| tsdf_inserter.insert(&scan, &mut tsdf).unwrap());
        });
    }
    if let Some(scans) = recording::posed_scans("fr079") {
        let mut grid = recording::submap(&scans[700..790], &inserter);
        let scan = scans[745].range_data_in_map();
        group.bench_function(format!("corridor (fr079), {} returns", scan.returns.len()), |b| {
            b.iter(|| inserter.insert(&scan, &mut grid).unwrap());
        });
        group.bench_function("the first scan of a submap, which makes it grow (fr079)", |b| {
            b.iter(|| recording::submap(&scans[700..701], &inserter));
        });
    }
    for points in [5_000, 20_000] {
        let mut submaps = [(); 2].map(|()| hall::HallSubmap::of_walk(20.0, 150));
        let pose = hall::walk(10.1);
        let mut sweep = hall::sweep(&pose, points / 32, &mut common::Lcg::new(5));
        sweep.points.truncate(points);
        let scan = hall::range_data(&pose, &sweep);
        group.bench_function(format!("hall of 30 m by 20 m, {points} returns, two submaps in 3D"), |b| {
            b.iter(|| submaps.iter_mut().for_each(|s| s.insert_range_data(&scan)));
        });
    }
    group.finish();
}

criterion_group!(benches, insert);
criterion_main!(benches);
