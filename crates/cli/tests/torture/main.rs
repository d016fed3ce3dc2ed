//! `portolan-torture`: files of every format, damaged with knowledge of their records, given to every verb that takes
//! them, under limits of time and memory. Whatever comes, the program ends by itself, with a code of its table, with a
//! sentence where it failed, and without a temporary file or half a result; and what it wrote is whole and readable.
//!
//! In CI a few hundred cases run. More, reproducible by seed:
//!
//! ```sh
//! PORTOLAN_TORTURE=cases=100000,seed=7 cargo test --release -p portolan-cli --test torture
//! PORTOLAN_TORTURE=only=4711,seed=7,keep=/tmp/found cargo test -p portolan-cli --test torture
//! PORTOLAN_TORTURE=kills=200,seed=7 cargo test --release -p portolan-cli --test torture kills
//! PORTOLAN_TORTURE=resumes=200,seed=7 cargo test --release -p portolan-cli --test torture resumed -- --nocapture
//! ```
#![cfg(unix)]
#![allow(clippy::unwrap_used, clippy::print_stderr, clippy::panic)]

#[path = "../common/mod.rs"]
mod common;

mod execution;
mod kills;
mod results;
mod resumes;
mod samples;
mod settings;
mod verbs;

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use portolan_testing::damage::{Random, damaged};

use execution::{Execution, Verdict};
use samples::Sample;
use settings::Settings;

/// After so many cases a line says how many there were.
const PROGRESS: u64 = 1000;

/// One case: which sample, how damaged, and for which verb follows from seed and number alone.
fn run_case(number: u64, samples: &[Sample], settings: &Settings) -> Verdict {
    let mut random = Random::new(settings.seed, number);
    let sample = random.choose(samples);
    let bytes = damaged(&sample.bytes, sample.layout, &mut random);
    let verb = random.choose(verbs::taking(sample.kind));
    Execution { number, sample, bytes: &bytes, verb }.judge(settings)
}

#[test]
fn kills_leave_complete_files_or_none() {
    let wrong = kills::kill_runs(&Settings::from_environment());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn maps_that_were_cut_off_and_resumed_are_the_same() {
    let seen = resumes::resume_runs(&Settings::from_environment());
    eprintln!("{} kills, {} journals", seen.kills, seen.journals);
    assert!(seen.wrong.is_empty(), "{}", seen.wrong.join("\n"));
    assert!(seen.journals > 0 || seen.kills < 20, "{seen:?}");
}

#[test]
fn damaged_files_give_correct_results_or_errors() {
    let settings = Settings::from_environment();
    let folder = tempfile::tempdir().unwrap();
    let samples = samples::make(folder.path());
    let (next, found) = (AtomicU64::new(settings.from), Mutex::new(Vec::new()));
    let start = Instant::now();
    let work = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let done = number - settings.from;
            if done >= settings.cases {
                return;
            }
            if done > 0 && done.is_multiple_of(PROGRESS) {
                eprintln!("{done} cases, {:.0} s", start.elapsed().as_secs_f64());
            }
            if let Verdict::Wrong(what) = run_case(number, &samples, &settings) {
                eprintln!("{what}\n");
                found.lock().unwrap().push(what);
            }
        }
    };
    std::thread::scope(|scope| {
        let cores = std::thread::available_parallelism().map_or(2, std::num::NonZero::get);
        (0..cores).for_each(|_| drop(scope.spawn(work)));
    });
    let found = found.into_inner().unwrap();
    assert!(
        found.is_empty(),
        "{} of {} cases went wrong:\n{}",
        found.len(),
        settings.cases,
        found.join("\n")
    );
}
