//! The numbered examples run.
#![allow(clippy::unwrap_used)]

#[path = "../examples/02_local_slam_live.rs"]
mod local_slam_live;
#[path = "../examples/04_localise_in_a_map.rs"]
mod localise_in_a_map;
#[path = "../examples/01_map_a_recording.rs"]
mod map_a_recording;
#[path = "../examples/06_own_format.rs"]
mod own_format;
#[path = "../examples/05_read_a_recording.rs"]
mod read_a_recording;
#[path = "../examples/03_refine.rs"]
mod refine;

#[test]
fn a_recording_is_mapped() {
    map_a_recording::main().unwrap();
}

#[test]
fn local_slam_runs_live() {
    local_slam_live::main().unwrap();
}

#[test]
fn a_trajectory_is_refined() {
    refine::main().unwrap();
}

#[test]
fn a_recording_is_localised_in_a_map() {
    localise_in_a_map::main().unwrap();
}

#[test]
fn a_recording_is_read() {
    read_a_recording::main().unwrap();
}

#[test]
fn a_custom_format_is_mapped() {
    own_format::main().unwrap();
}
