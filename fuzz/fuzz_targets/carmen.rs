//! CARMEN logs, compressed or not, read to the end.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use portolan_recording::open_text_log_bytes;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(Some(log)) = open_text_log_bytes(Path::new("fuzz.clf"), bytes)
        && let Ok(mut reader) = log.read(&|_| true)
    {
        while let Ok(Some(_)) = reader.next_message() {}
    }
});
