#![doc = include_str!("../README.md")]

mod error;
mod random;
pub mod three_d;
pub mod two_d;

pub use error::WorldError;
pub use random::Random;
