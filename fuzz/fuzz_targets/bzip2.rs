//! Chunks of bzip2, unpacked twice with the same memory.
#![no_main]

use libfuzzer_sys::fuzz_target;
use portolan_bunzip2::Unpacker;

const LIMIT: usize = 1 << 24;

fuzz_target!(|packed: &[u8]| {
    let (mut unpacker, mut first, mut second) = (Unpacker::default(), Vec::new(), Vec::new());
    let _ = unpacker.unpack(packed, LIMIT, &mut first);
    let _ = unpacker.unpack(packed, LIMIT, &mut second);
    assert!(first == second && first.len() <= LIMIT);
});
