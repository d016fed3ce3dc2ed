//! See `portolan_fuzz_bodies::relations`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| portolan_fuzz_bodies::relations(bytes));
