//! Trajectories and relations in every format.
#![no_main]

use libfuzzer_sys::fuzz_target;
use portolan_evaluation::{
    read_binary_relations, read_csv, read_geojson, read_kitti_poses, read_kitti_times, read_text_relations,
    read_tum, write_csv, write_kitti, write_tum,
};

fuzz_target!(|bytes: &[u8]| {
    for (trajectory, _) in [read_tum(bytes), read_csv(bytes)].into_iter().flatten() {
        trajectory.covered_distances();
        let mut out = Vec::new();
        write_tum(&trajectory, &mut out).expect("memory takes everything");
        write_csv(&trajectory, &mut out).expect("memory takes everything");
        write_kitti(&trajectory, &mut out).expect("memory takes everything");
    }
    let _ = read_geojson(bytes, None);
    let _ = read_kitti_poses(bytes);
    let _ = read_kitti_times(bytes);
    let _ = read_text_relations(bytes);
    let _ = read_binary_relations(bytes);
});
