//! See `portolan_fuzz_bodies::cloud`.
#![no_main]

libfuzzer_sys::fuzz_target!(
    init: portolan_fuzz_bodies::ignore_caught_panics(),
    |bytes: &[u8]| portolan_fuzz_bodies::cloud(bytes)
);
