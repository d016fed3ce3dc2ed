//! See `portolan_fuzz_bodies::db3`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| portolan_fuzz_bodies::db3(bytes));
