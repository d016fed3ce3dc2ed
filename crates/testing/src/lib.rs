//! Helpers for the tests of all crates.
//!
//! - [`real_data`]: paths of real recordings and maps; tests that are skipped without them are listed.
//! - [`is_fast`]: whether long tests are skipped.
//! - [`Program`]: runs the built program, and simulates recordings with it once for all tests.
//! - [`Fingerprints`]: compares results byte for byte with a table that is updated on demand.
//! - [`damage`]: makes damaged files.
//! - [`clouds`]: reproducible random points.
//! - [`Stopwatch`]: measures computing time, for benchmarks.
//! - [`assert_files_are_modules`]: checks that every test file is run.
//!
//! Of the workspace it depends on `portolan-geometry` alone, so that every crate above it may use it in its tests.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)] // in tests this is how errors are shown

pub mod clouds;
pub mod damage;
mod fingerprints;
mod folders;
mod left_out;
mod program;
mod real_data;
mod stopwatch;
mod test_files;

pub use fingerprints::Fingerprints;
pub use left_out::{is_fast, left_out};
pub use program::{Program, Run};
pub use real_data::{real_data, real_maps, spec_data};
pub use stopwatch::Stopwatch;
pub use test_files::assert_files_are_modules;
