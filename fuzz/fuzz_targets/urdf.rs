//! See `portolan_fuzz_bodies::urdf`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| portolan_fuzz_bodies::urdf(bytes));
