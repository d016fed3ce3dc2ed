//! MCAP files, read to the end.
#![no_main]

use libfuzzer_sys::fuzz_target;
use portolan_recording::open_bytes;

fuzz_target!(|bytes: &[u8]| {
    let file = [b"\x89MCAP0\r\n", bytes].concat();
    if let Ok(recording) = open_bytes("fuzz.mcap", file.into())
        && let Ok(mut reader) = recording.read(&|_| true)
    {
        while let Ok(Some(_)) = reader.next_message() {}
    }
});
