//! Network captures and the packets in them, from container to measurements.
#![no_main]

use std::sync::Arc;

use libfuzzer_sys::fuzz_target;
use portolan_recording::open_bytes;

fuzz_target!(|bytes: &[u8]| {
    let bytes: Arc<[u8]> = bytes.into();
    if let Ok(recording) = open_bytes("fuzz.pcap", bytes)
        && let Ok(mut reader) = recording.read(&|_| true)
    {
        while let Ok(Some(_)) = reader.next_message() {}
    }
});
