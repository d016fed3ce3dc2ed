//! What several integration tests need.
#![allow(dead_code, clippy::unwrap_used, clippy::panic)]

pub mod small_map;
