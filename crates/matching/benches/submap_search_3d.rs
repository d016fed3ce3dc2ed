//! Loop closure in 3D: a sweep of two lidars near a guess and anywhere in a finished submap of a hall of
//! 30 m by 20 m.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]

#[path = "../tests/common/mod.rs"]
#[allow(dead_code)]
mod common;
#[path = "../../grids/tests/common/hall.rs"]
#[allow(dead_code)]
mod hall;

use portolan_geometry::{Quaternion, Rigid3, rotation_from_roll_pitch_yaw};
use portolan_matching::{
    FastCorrelativeMatcher3d, FastCorrelativeOptions3d, NodeToFind, SubmapToSearch, rotational_histogram,
};
use portolan_testing::Stopwatch;

fn search(watch: &Stopwatch) {
    let submap = hall::HallSubmap::of_walk(40.0, 300);
    let sizes =
        [submap.high.num_cells(), submap.high.compacted().memory_bytes(), common::stored_bytes(&submap.high)];
    let truth = hall::walk(20.3);
    let sweep = hall::sweep(&truth, 600, &mut common::Lcg::new(99));
    let [high, low] = hall::matching_clouds(&sweep);
    let level = Rigid3::from_parts(Default::default(), truth.rotation);
    let in_map = hall::range_data(&truth, &sweep).returns;
    let aligned = hall::range_data(&level, &sweep).returns;
    let histograms = [rotational_histogram(&in_map, 120), rotational_histogram(&aligned, 120)];
    let node = NodeToFind {
        high_resolution_cloud: &high,
        low_resolution_cloud: &low,
        rotational_histogram: &histograms[1],
        gravity_alignment: truth.rotation,
    };
    let target = SubmapToSearch { low_resolution_grid: &submap.low, rotational_histogram: &histograms[0] };
    let options = FastCorrelativeOptions3d::default();
    let all_yaws = FastCorrelativeOptions3d { min_rotational_score: 0.0, ..options.clone() };
    let matcher = FastCorrelativeMatcher3d::new(&submap.high, &options).unwrap();
    eprintln!("cells, bytes, bytes in a file: {sizes:?}; matcher {} bytes", matcher.memory_bytes());
    watch.time("prepare", || FastCorrelativeMatcher3d::new(&submap.high, &options).unwrap());
    let error = Rigid3::from_parts([1.5, -2.0, 0.3].into(), rotation_from_roll_pitch_yaw(0.0, 0.0, 0.1));
    let (guess, identity) = (truth * error, Rigid3::identity());
    for (name, options) in [("default", &options), ("any direction of walls", &all_yaws)] {
        let matcher = FastCorrelativeMatcher3d::new(&submap.high, options).unwrap();
        for min_score in [0.55, 0.3] {
            let local = || matcher.match_local(&guess, &identity, &node, &target, min_score);
            let full =
                || matcher.match_full(&truth.rotation, &Quaternion::identity(), &node, &target, min_score);
            for (what, found) in [("local", local()), ("full", full())] {
                let left = found
                    .map(|f| (f.found.score, (f.found.pose.inverse() * truth).translation.vector.norm()));
                eprintln!("{name} {what} {min_score}: score and metres left {left:?}, {found:?}");
            }
            watch.time(&format!("local, {name}, {} points, above {min_score}", high.len()), local);
            watch.time(&format!("full, {name}, {} points, above {min_score}", high.len()), full);
        }
        let elsewhere = guess * Rigid3::translation(8.0, 0.0, 0.0);
        watch.time(&format!("local where the node is not, {name}, above 0.55"), || {
            matcher.match_local(&elsewhere, &identity, &node, &target, 0.55)
        });
    }
}

fn main() {
    let watch = Stopwatch::of_arguments();
    search(&watch);
}
