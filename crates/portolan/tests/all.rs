//! The tests of the public API in one program: it is linked once, and a long test of one file
//! ends while another runs. What changes something of the whole process has a program of its own.

mod examples;
mod gaps_2d;
mod held_odometry;
mod imu_units;
mod issues;
mod known;
mod living_map;
mod living_map_3d;
mod localization;
mod localization_3d;
mod localization_fixes;
mod lost_3d;
mod noisy_ranges;
mod odometry_frames;
mod scan_durations;
mod stamp_jitter;

/// Files with a program of their own in Cargo.toml.
const OWN_PROGRAM: [&str; 1] = ["options_logs"];

#[test]
fn every_file_is_run() {
    portolan_testing::assert_files_are_modules(
        env!("CARGO_MANIFEST_DIR"),
        include_str!("all.rs"),
        &OWN_PROGRAM,
    );
}
