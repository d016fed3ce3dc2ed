//! SQLite databases of ROS 2, read to the end. A corpus of real databases helps.
#![no_main]

use libfuzzer_sys::fuzz_target;
use portolan_recording::open_bytes;

fuzz_target!(|bytes: &[u8]| {
    let file = [b"SQLite format 3\0", bytes].concat();
    if let Ok(recording) = open_bytes("fuzz.db3", file.into())
        && let Ok(mut reader) = recording.read(&|_| true)
    {
        while let Ok(Some(_)) = reader.next_message() {}
    }
});
