//! The tests of this crate in one program, which is compiled and linked once.

mod check;
mod common;
mod edit;
mod every_message;
mod every_tool_on_damage;
mod info;
mod map_3d;
mod map_in_memory;
mod map_of_mapper;
mod migrate;
mod paint;
mod texture_vectors;

/// Files with a program of their own in Cargo.toml: they change something of the whole process.
const OWN_PROGRAM: [&str; 1] = ["failing_disk"];

#[test]
fn every_file_is_run() {
    portolan_testing::assert_files_are_modules(
        env!("CARGO_MANIFEST_DIR"),
        include_str!("all.rs"),
        &OWN_PROGRAM,
    );
}
