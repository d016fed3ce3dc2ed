//! Folders of uos scans: points, pose and frames of one scan.
#![no_main]

use libfuzzer_sys::fuzz_target;
use portolan_pointcloud::{PointCloud, open};

fuzz_target!(|input: (&str, &str, &str)| {
    let (points, pose, frames) = input;
    let Ok(folder) = tempfile::tempdir() else { return };
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).is_ok();
    if !write("scan000.3d", points) || !write("scan000.pose", pose) || !write("scan000.frames", frames) {
        return;
    }
    let Ok(mut reader) = open(folder.path()) else { return };
    let mut batch = PointCloud::default();
    while let Ok(true) = reader.next_batch(&mut batch) {}
});
