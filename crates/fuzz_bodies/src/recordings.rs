//! Fuzz targets for recordings, which are read to the end.

use std::path::Path;

use portolan_recording::{Recording, RecordingError, open, open_bytes, open_text_log_bytes};

use crate::parts;

fn read_to_the_end(recording: Result<Box<dyn Recording>, RecordingError>) {
    if let Ok(recording) = recording
        && let Ok(mut reader) = recording.read(&|_| true)
    {
        while let Ok(Some(_)) = reader.next_message() {}
    }
}

/// Prepends the magic bytes of a format unless the input begins with them.
fn with_magic(magic: &[u8], bytes: &[u8]) -> Vec<u8> {
    if bytes.starts_with(magic) { bytes.to_vec() } else { [magic, bytes].concat() }
}

/// ROS 1 bags.
pub fn ros1_bag(bytes: &[u8]) {
    read_to_the_end(open_bytes("fuzz.bag", with_magic(b"#ROSBAG V2.0\n", bytes).into()));
}

/// MCAP files.
pub fn mcap(bytes: &[u8]) {
    read_to_the_end(open_bytes("fuzz.mcap", with_magic(b"\x89MCAP0\r\n", bytes).into()));
}

/// SQLite databases of ROS 2.
pub fn db3(bytes: &[u8]) {
    read_to_the_end(open_bytes("fuzz.db3", with_magic(b"SQLite format 3\0", bytes).into()));
}

/// Network captures and the packets in them.
pub fn pcap(bytes: &[u8]) {
    read_to_the_end(open_bytes("fuzz.pcap", bytes.into()));
}

/// CARMEN logs, compressed or not.
pub fn carmen(bytes: &[u8]) {
    text_log("fuzz.clf", bytes);
}

/// CoreSLAM logs. A valid line is prepended, so that the format is recognised.
pub fn coreslam(bytes: &[u8]) {
    let line = format!("1 2{}\n", " 3".repeat(705));
    text_log("fuzz.dat", &[line.as_bytes(), bytes].concat());
}

fn text_log(name: &str, bytes: &[u8]) {
    if let Ok(Some(log)) = open_text_log_bytes(Path::new(name), bytes)
        && let Ok(mut reader) = log.read(&|_| true)
    {
        while let Ok(Some(_)) = reader.next_message() {}
    }
}

/// Raw KITTI drives: times of sweeps, times of the INS, one INS reading, and one sweep; reading and sweep are used
/// twice. The parts of the input are separated by form feeds.
pub fn kitti(bytes: &[u8]) {
    let Ok(folder) = tempfile::tempdir() else { return };
    let [times, ins_times, reading, sweep] = parts(bytes);
    let files = [
        ("velodyne_points/timestamps.txt", times),
        ("velodyne_points/timestamps_start.txt", times),
        ("velodyne_points/timestamps_end.txt", times),
        ("velodyne_points/data/0000000000.bin", sweep),
        ("velodyne_points/data/0000000001.bin", sweep),
        ("oxts/timestamps.txt", ins_times),
        ("oxts/data/0000000000.txt", reading),
        ("oxts/data/0000000001.txt", reading),
    ];
    for (name, content) in files {
        let path = folder.path().join(name);
        let made = path.parent().map(std::fs::create_dir_all);
        if !matches!(made, Some(Ok(()))) || std::fs::write(&path, content).is_err() {
            return;
        }
    }
    read_to_the_end(open(folder.path()));
}
