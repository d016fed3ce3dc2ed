//! CoreSLAM logs: a good line first, so that the rest is taken for one.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use portolan_recording::open_text_log_bytes;

fuzz_target!(|bytes: &[u8]| {
    let mut log = format!("1 2{}\n", " 3".repeat(705)).into_bytes();
    log.extend_from_slice(bytes);
    if let Ok(Some(log)) = open_text_log_bytes(Path::new("fuzz.dat"), &log)
        && let Ok(mut reader) = log.read(&|_| true)
    {
        while let Ok(Some(_)) = reader.next_message() {}
    }
});
