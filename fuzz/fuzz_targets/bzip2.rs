//! See `portolan_fuzz_bodies::bzip2`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| portolan_fuzz_bodies::bzip2(bytes));
