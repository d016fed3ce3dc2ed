//! Every body over sound files and thousands of damaged ones: no panic, no endless loop.
//!
//! For a time instead of a number of files, and how many there were then:
//!
//! ```sh
//! PORTOLAN_BODIES=seconds=60,seed=7 cargo test --profile quick -p portolan-fuzz-bodies -- --nocapture --test-threads 1
//! ```
//!
//! With `PORTOLAN_BODIES=corpus=FOLDER` the sound files are written to `FOLDER/BODY`, a first corpus for libFuzzer.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

mod samples;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use portolan_fuzz_bodies::{BODIES, ignore_caught_panics};
use portolan_testing::damage::{Random, damaged};
use portolan_testing::is_fast;

use samples::{Sample, samples_of};

/// Damaged files for each body. Those that write files or optimise take longer, so that there are fewer of them.
fn count(body: &str) -> u64 {
    match body {
        "pbstream" => 150,
        "g2o" | "db3" => 1500,
        "kitti" | "cloud" => 1500,
        "config" => 3000,
        _ => 10_000,
    }
}

/// In the fast profile there are so many times fewer.
const FAST: u64 = 25;

/// How much is done with each body. Damage follows from the seed and the number of a case alone, so that it can be seen
/// again.
struct Amount {
    seed: u64,
    cases: u64,
    at_most: Duration,
    corpus: Option<PathBuf>,
}

impl Amount {
    /// What `PORTOLAN_BODIES` and `PORTOLAN_TESTS` say.
    fn of(body: &str) -> Self {
        let mut amount = Self { seed: 1, cases: count(body), at_most: Duration::MAX, corpus: None };
        if std::env::var("PORTOLAN_TESTS").is_ok_and(|tests| tests == "fast") {
            amount.cases /= FAST;
        }
        let text = std::env::var("PORTOLAN_BODIES").unwrap_or_default();
        for part in text.split(',').filter(|part| !part.is_empty()) {
            match part.split_once('=') {
                Some(("seed", value)) => amount.seed = value.parse().unwrap(),
                Some(("seconds", value)) => {
                    (amount.cases, amount.at_most) = (u64::MAX, Duration::from_secs(value.parse().unwrap()));
                }
                Some(("corpus", value)) => amount.corpus = Some(PathBuf::from(value).join(body)),
                _ => {
                    panic!("PORTOLAN_BODIES knows seconds=NUMBER, seed=NUMBER and corpus=FOLDER, not {part}")
                }
            }
        }
        amount
    }
}

fn input(sample: &Sample, bytes: &[u8]) -> Vec<u8> {
    [&sample.prefix, bytes].concat()
}

fn write_corpus(folder: &Path, samples: &[Sample]) {
    std::fs::create_dir_all(folder).unwrap();
    for (number, sample) in samples.iter().enumerate() {
        std::fs::write(folder.join(format!("sound_{number}")), input(sample, &sample.bytes)).unwrap();
    }
}

fn run(name: &str) {
    let (_, body) = BODIES.iter().find(|(known, _)| *known == name).unwrap();
    let samples = samples_of(name);
    assert!(!samples.is_empty(), "{name}: nothing to begin with");
    ignore_caught_panics();
    let start = Instant::now();
    samples.iter().for_each(|sample| body(&input(sample, &sample.bytes)));
    body(&[]);
    let (amount, mut cases) = (Amount::of(name), 0);
    if let Some(folder) = &amount.corpus {
        write_corpus(folder, &samples);
    }
    while cases < amount.cases && start.elapsed() < amount.at_most {
        let number = cases;
        let mut random = Random::new(amount.seed, number);
        let sample = random.choose(&samples);
        let bytes = input(sample, &damaged(&sample.bytes, sample.layout, &mut random));
        if catch_unwind(AssertUnwindSafe(|| body(&bytes))).is_err() {
            let path = std::env::temp_dir().join(format!("portolan-{name}-{number}"));
            std::fs::write(&path, &bytes).unwrap();
            panic!("{name}: case {number} fails; its bytes are in {}", path.display());
        }
        cases += 1;
    }
    eprintln!(
        "{name}: {} sound files, {cases} damaged, {:.1} s",
        samples.len(),
        start.elapsed().as_secs_f64()
    );
}

/// A test for each body.
macro_rules! tests {
    ($($name:ident)*) => {
        $(#[test]
        fn $name() {
            run(stringify!($name));
        })*

        #[test]
        fn every_body_has_a_test() {
            let tested = [$(stringify!($name)),*];
            assert_eq!(BODIES.map(|(name, _)| name), tested);
            // Says in the fast profile that less was done.
            is_fast();
        }
    };
}

tests! {
    bzip2 carmen cdr cloud config coreslam db3 g2o kitti mcap packets pbstream pcap pointcloud2 relations ros1_bag
    surfaces trajectory uos urdf
}
