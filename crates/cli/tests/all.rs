//! The tests of the program in one program: it is linked once, and a long test of one file
//! ends while another runs. What changes something of the whole process has a program of its own.

mod check;
mod clocks;
mod clouds;
mod common;
mod compat;
mod config;
mod continue_map;
mod degenerate;
mod documents;
mod evaluate;
mod far;
mod faults_3d;
mod fingerprints;
mod foreign_files;
mod hostile;
mod info;
mod map;
mod maps;
mod pipes;
mod real_recordings;
mod resume;
mod sensors_3d;
mod simulate;
mod untrusted;
mod words;

#[test]
fn every_file_is_run() {
    portolan_testing::assert_files_are_modules(env!("CARGO_MANIFEST_DIR"), include_str!("all.rs"), &[]);
}
