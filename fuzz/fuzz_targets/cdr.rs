//! Serialised messages of every type, CDR or ROS 1, as the only message of an MCAP file.
#![no_main]

use libfuzzer_sys::fuzz_target;
use portolan_recording::open_bytes;

const TYPES: [&str; 9] = [
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/MultiEchoLaserScan",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/Imu",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/NavSatFix",
    "tf2_msgs/msg/TFMessage",
    "geometry_msgs/msg/PoseStamped",
    "cartographer_ros_msgs/msg/LandmarkList",
];

fn record(file: &mut Vec<u8>, op: u8, content: &[u8]) {
    file.push(op);
    file.extend((content.len() as u64).to_le_bytes());
    file.extend(content);
}

fn string(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

fuzz_target!(|input: (u8, bool, &[u8])| {
    let (kind, is_cdr, payload) = input;
    let name = TYPES[usize::from(kind) % TYPES.len()];
    let mut file = b"\x89MCAP0\r\n".to_vec();
    record(&mut file, 3, &[&[1, 0], string(name).as_slice(), &string(""), &string("")].concat());
    let encoding = if is_cdr { "cdr" } else { "ros1" };
    record(&mut file, 4, &[&[0, 0, 1, 0], string("/tf").as_slice(), &string(encoding), &string("")].concat());
    record(&mut file, 5, &[&[0; 22], payload].concat());
    if let Ok(recording) = open_bytes("fuzz.mcap", file.into())
        && let Ok(mut reader) = recording.read(&|_| true)
    {
        while let Ok(Some(_)) = reader.next_message() {}
    }
});
