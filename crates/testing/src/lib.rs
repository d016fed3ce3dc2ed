//! What the tests of all crates share.
//!
//! - [`real_data`]: where real recordings and maps are; what is left out without them is listed.
//! - [`is_fast`]: whether long tests are left out.
//! - [`Program`]: the built program, and recordings simulated with it once for all tests.
//! - [`Fingerprints`]: results byte for byte, in a table that is written anew on demand.
//! - [`damage`]: damaged files.
//! - [`clouds`]: random points, the same every time.
//! - [`Stopwatch`]: how long work takes, for benchmarks.
//! - [`assert_files_are_modules`]: no file of tests is forgotten.
//!
//! It depends on `portolan-geometry` alone, so that every crate above may use it in its tests.
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
