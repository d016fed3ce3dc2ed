//! The tests of this crate in one program, which is compiled and linked once.

mod inertial;
mod lidar;
mod motion;
mod recording;
mod simulation_3d;
mod truth;

#[test]
fn every_file_is_run() {
    portolan_testing::assert_files_are_modules(env!("CARGO_MANIFEST_DIR"), include_str!("all.rs"), &[]);
}
