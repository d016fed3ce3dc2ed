//! Recordings whose points have the times of other points, or the same time for all points.

#![allow(clippy::unwrap_used, clippy::panic)] // failures of tests are panics

use std::path::Path;

use portolan_ingest::{AzimuthTimes, IngestOptions, Inventory, PlannedRange, plan};
use portolan_recording::{FieldType, MemoryRecording, Message, PointCloud2, RecordedMessage, open};
use portolan_testing::real_data;

/// So many sweeps are looked at.
const SWEEPS: usize = 100;

/// The first sweeps of a recording, and nothing else.
fn sweeps(path: &Path) -> Vec<RecordedMessage> {
    let recording = open(path).unwrap();
    let mut reader = recording.read(&|topic| &*topic.type_name == "sensor_msgs/PointCloud2").unwrap();
    std::iter::from_fn(|| reader.next_message().unwrap()).take(SWEEPS).collect()
}

/// A cloud with other times of its points.
fn retimed(cloud: &mut PointCloud2, change: Change) {
    let field = cloud.fields.iter().find(|f| &*f.name == "time").unwrap();
    assert_eq!(field.field_type, Some(FieldType::Float32));
    let (offset, step) = (field.offset as usize, cloud.point_step as usize);
    let bytes = |point: &[u8]| <[u8; 4]>::try_from(&point[offset..offset + 4]).unwrap();
    let mut times: Vec<f32> =
        cloud.data.chunks_exact(step).map(|point| f32::from_le_bytes(bytes(point))).collect();
    change(&mut times);
    for (point, time) in cloud.data.chunks_exact_mut(step).zip(&times) {
        point[offset..offset + 4].copy_from_slice(&time.to_le_bytes());
    }
}

/// What is done to the times of a sweep.
type Change<'a> = &'a dyn Fn(&mut [f32]);

/// The lidar as it is planned if the times of its points are changed like this.
fn planned(sweeps: &[RecordedMessage], change: Change) -> PlannedRange {
    let changed = sweeps.iter().cloned().map(|mut message| {
        if let Message::PointCloud2(cloud) = &mut message.message {
            retimed(cloud, change);
        }
        message
    });
    let recording: MemoryRecording = changed.collect();
    let options = IngestOptions::default();
    let inventory = Inventory::of(&recording, &options).unwrap();
    plan(&inventory, &options).unwrap().range.swap_remove(0)
}

/// The first and the last time.
fn span(times: &[f32]) -> (f32, f32) {
    let ends = (f32::INFINITY, f32::NEG_INFINITY);
    times.iter().fold(ends, |(first, last), time| (first.min(*time), last.max(*time)))
}

/// Turns begin such a part of a turn elsewhere.
fn elsewhere(part: f32) -> impl Fn(&mut [f32]) {
    move |times| {
        let (first, last) = span(times);
        let seconds = last - first;
        times.iter_mut().for_each(|time| *time = first + (*time - first + part * seconds) % seconds);
    }
}

/// Those of other points.
fn mixed(times: &mut [f32]) {
    for index in 0..times.len() {
        times.swap(index, index * 7919 % times.len());
    }
}

/// Shares of the sweep.
fn shares(times: &mut [f32]) {
    let (first, last) = span(times);
    times.iter_mut().for_each(|time| *time = (*time - first) / (last - first));
}

#[test]
fn times_of_other_points_are_replaced_by_those_of_the_azimuth() {
    let (path, begin_degrees) = ("lidar3d/walk.bag", 0.0_f32);
    let Some(file) = real_data(path) else { return };
    let sweeps = sweeps(&file);
    let right = planned(&sweeps, &|_| {});
    assert!(right.point_time.is_some() && right.azimuth_times == AzimuthTimes::Off, "{path}: {right:?}");
    let changes: [(&str, Change); 4] = [
        ("half a turn", &elsewhere(0.5)),
        ("a quarter", &elsewhere(0.25)),
        ("mixed", &mixed),
        ("all alike", &|times| times.fill(0.0)),
    ];
    for (name, change) in changes {
        let range = planned(&sweeps, change);
        assert!(range.point_time.is_none() && !range.times_are_uncertain, "{path} {name}: {range:?}");
        assert_eq!(range.azimuth_times, AzimuthTimes::FromStamp, "{path} {name}");
        let turn = range.turn.unwrap();
        let off = (turn.begin_radians.to_degrees() - begin_degrees + 180.0).rem_euclid(360.0) - 180.0;
        assert!(turn.is_clockwise && off.abs() <= 15.0, "{path} {name}: {turn:?}");
    }
}

#[test]
fn times_in_an_unknown_unit_are_scaled_to_the_time_between_clouds() {
    let Some(file) = real_data("lidar3d/walk.bag") else { return };
    let range = planned(&sweeps(&file), &shares);
    let times = range.point_time.unwrap();
    assert!(!range.times_are_uncertain && (times.unit - 0.1).abs() < 0.002, "{times:?}");
}
