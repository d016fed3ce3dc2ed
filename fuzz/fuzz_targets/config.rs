//! See `portolan_fuzz_bodies::config`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| portolan_fuzz_bodies::config(bytes));
