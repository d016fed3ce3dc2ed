//! ROS 1 bags, read to the end.
#![no_main]

use libfuzzer_sys::fuzz_target;
use portolan_recording::open_bytes;

fuzz_target!(|bytes: &[u8]| {
    let bag = [b"#ROSBAG V2.0\n", bytes].concat();
    if let Ok(recording) = open_bytes("fuzz.bag", bag.into())
        && let Ok(mut reader) = recording.read(&|_| true)
    {
        while let Ok(Some(_)) = reader.next_message() {}
    }
});
