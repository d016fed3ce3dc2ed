//! Configurations: Lua text from start to options, and JSON.
#![no_main]

use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use portolan_config::lua::{Limits, evaluate_text, print_configuration};
use portolan_config::Options;

/// So short that the fuzzer does not take an endless loop for a fault.
const LIMITS: Limits = Limits { time: Duration::from_millis(300), memory: 32 << 20 };

fuzz_target!(|input: (bool, &str)| {
    let (is_json, text) = input;
    if is_json {
        let _ = Options::from_json(text);
        return;
    }
    if let Ok(evaluation) = evaluate_text("fuzz.lua", text, &[], LIMITS) {
        let _ = print_configuration(&evaluation.table, None);
        let _ = Options::from_lua("fuzz.lua", text);
    }
});
