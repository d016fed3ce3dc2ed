//! Bags of ROS 1 and ROS 2: round trips, other people's files, damage.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)] // failures of tests are panics

mod damage;
mod database;
mod foreign_mcap;
mod real_recordings;
mod round_trip;
mod sample;
