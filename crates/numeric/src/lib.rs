#![doc = include_str!("../README.md")]

mod covariance_matching;
mod histogram;
mod latency;
mod print;
mod random;
mod statistics;

pub use covariance_matching::CovarianceMatching;
pub use histogram::{Histogram, HistogramBins};
pub use latency::LatencyHistogram;
pub use print::{counted, format_general};
pub use random::{Lcg64, SplitMix64, scramble, splitmix64};
pub use statistics::{mean, median, percentile, probabilities, quantile, rms};
