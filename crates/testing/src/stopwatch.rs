//! Measures computing time, for benchmarks.

use std::hint::black_box;
use std::time::{Duration, Instant};

/// Time for which each benchmark is repeated, with at least [`FEWEST`] and at most [`MOST`] runs.
const BUDGET: Duration = Duration::from_secs(2);
/// Minimum number of runs of a benchmark.
const FEWEST: usize = 5;
/// Maximum number of runs of a benchmark.
const MOST: usize = 100_000;

/// Times functions and prints the shortest and the median time. `cargo bench -- WORD…` times only those whose name
/// contains one of the words.
pub struct Stopwatch {
    words: Vec<String>,
}

impl Stopwatch {
    /// With the words of the command line as filter.
    pub fn of_arguments() -> Self {
        Self { words: std::env::args().skip(1).filter(|argument| !argument.starts_with('-')).collect() }
    }

    /// Times `work` after one warm-up run.
    pub fn time<R>(&self, name: &str, mut work: impl FnMut() -> R) {
        self.time_on(name, || (), |()| work());
    }

    /// Times `work` on an input that `make` creates for each run; the time of `make` is not included.
    pub fn time_on<T, R>(&self, name: &str, mut make: impl FnMut() -> T, mut work: impl FnMut(&mut T) -> R) {
        if !self.words.is_empty() && !self.words.iter().any(|word| name.contains(word.as_str())) {
            return;
        }
        let mut run = || {
            let mut input = make();
            let start = Instant::now();
            black_box(work(black_box(&mut input)));
            start.elapsed()
        };
        run();
        let (start, mut times) = (Instant::now(), Vec::new());
        while times.len() < FEWEST || (start.elapsed() < BUDGET && times.len() < MOST) {
            times.push(run());
        }
        times.sort_unstable();
        let at = |index: usize| times.get(index).copied().unwrap_or_default();
        println!("{name}: {:.2?}, median {:.2?} of {} runs", at(0), at(times.len() / 2), times.len());
    }
}
