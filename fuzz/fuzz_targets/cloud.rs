//! Files of point clouds of every format, read to the end.
//!
//! The first byte chooses the format, so that the fuzzer need not find its magic bytes.
#![no_main]

use libfuzzer_sys::fuzz_target;
use portolan_pointcloud::{PointCloud, open};

/// How files of a format begin: nothing chosen, PLY, LAS, E57, PCD.
const STARTS: [&[u8]; 5] = [b"", b"ply\nformat ", b"LASF", b"ASTM-E57", b"# .PCD v.7\nVERSION .7\nFIELDS x y z"];

fuzz_target!(|bytes: &[u8]| {
    let Some((first, rest)) = bytes.split_first() else { return };
    let start = STARTS[usize::from(*first) % STARTS.len()];
    let Ok(folder) = tempfile::tempdir() else { return };
    let path = folder.path().join("cloud");
    if std::fs::write(&path, [start, rest].concat()).is_err() {
        return;
    }
    let Ok(mut reader) = open(&path) else { return };
    let mut batch = PointCloud::default();
    // A file can stand for billions of points by repeating nothing.
    for _ in 0..64 {
        match reader.next_batch(&mut batch) {
            Ok(true) => {}
            _ => break,
        }
    }
    reader.issues();
});
