//! Damages files with knowledge of their records, reproducibly from a seed: for tests of readers.

mod mutation;
mod random;
mod records;

pub use mutation::damaged;
pub use random::Random;
pub use records::Layout;
