//! See `portolan_fuzz_bodies::ros1_bag`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| portolan_fuzz_bodies::ros1_bag(bytes));
