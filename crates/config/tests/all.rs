//! The tests of this crate in one program, which is compiled and linked once.

mod dictionary;
mod interpreter;
mod loading;
mod random;
mod setting;
mod shipped;
mod wild;

#[test]
fn every_file_is_run() {
    portolan_testing::assert_files_are_modules(env!("CARGO_MANIFEST_DIR"), include_str!("all.rs"), &[]);
}
