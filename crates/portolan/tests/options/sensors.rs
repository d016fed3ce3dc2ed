//! What options say of the sensors of a recording.

use portolan::RequestedOptions;
use portolan::config::Options;
use portolan::geometry::{Dimension, Time};
use portolan::ingest::{IngestOptions, Ingestion};
use portolan::pipeline::prepare;
use portolan::recording::{
    FieldType, Header, Imu, LandmarkEntry, LandmarkList, LaserScan, MemoryRecording, Message,
    MultiEchoLaserScan, NavSatFix, Odometry, PointCloud2, PointField, Pose, RecordedMessage, Recording,
    TfMessage, TransformStamped,
};
use portolan::sensor::{Measurement, SensorKind};

use crate::effect::{Effect, check, effects};

const NOWHERE: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn at(seconds: f64) -> Time {
    Time::from_ros(1_700_000_000, 0) + portolan::geometry::Duration::from_seconds(seconds)
}

fn header(seconds: f64, frame: &str) -> Header {
    Header { stamp: at(seconds), frame_id: frame.into() }
}

fn laser_scan(seconds: f64) -> Message {
    Message::LaserScan(LaserScan {
        header: header(seconds, "laser"),
        angle_min: -1.5,
        angle_max: 1.5,
        angle_increment: 0.05,
        time_increment: 1e-3,
        scan_time: 0.06,
        range_min: 0.1,
        range_max: 30.0,
        ranges: vec![2.0; 61],
        intensities: vec![7.0; 61],
    })
}

fn echoes(seconds: f64) -> Message {
    Message::MultiEchoLaserScan(MultiEchoLaserScan {
        header: header(seconds, "laser"),
        angle_min: -1.5,
        angle_max: 1.5,
        angle_increment: 0.05,
        time_increment: 1e-3,
        scan_time: 0.06,
        range_min: 0.1,
        range_max: 30.0,
        ranges: vec![vec![2.0, 3.0]; 61],
        intensities: Vec::new(),
    })
}

fn cloud(seconds: f64) -> Message {
    // No two clouds are the same.
    let range = |a: f32| 4.0 + 1e-4 * (100.0 * seconds as f32 + a).sin();
    let points: Vec<[f32; 4]> = (0..90)
        .map(|i| 0.07 * i as f32)
        .flat_map(|a| [-0.5, 0.0, 0.5].map(|z| [range(a) * a.cos(), range(a) * a.sin(), z, 10.0 + a]))
        .collect();
    let field = |(i, name): (u32, &str)| PointField {
        name: name.to_owned(),
        offset: 4 * i,
        field_type: Some(FieldType::Float32),
        count: 1,
    };
    Message::PointCloud2(PointCloud2 {
        header: header(seconds, "laser"),
        height: 1,
        width: points.len() as u32,
        fields: (0..).zip(["x", "y", "z", "intensity"]).map(field).collect(),
        is_bigendian: false,
        point_step: 16,
        row_step: 16 * points.len() as u32,
        data: points.iter().flatten().flat_map(|v| v.to_le_bytes()).collect(),
        is_dense: true,
    })
}

fn imu(seconds: f64) -> Message {
    Message::Imu(Imu {
        header: header(seconds, "base_link"),
        orientation_xyzw: NOWHERE,
        orientation_covariance: [0.0; 9],
        angular_velocity: [0.0; 3],
        angular_velocity_covariance: [0.0; 9],
        linear_acceleration: [0.0, 0.0, 9.8],
        linear_acceleration_covariance: [0.0; 9],
    })
}

fn odometry(seconds: f64) -> Message {
    Message::Odometry(Odometry {
        header: header(seconds, "odom"),
        child_frame_id: "base_link".into(),
        pose: Pose { position: [0.1 * seconds, 0.0, 0.0], orientation_xyzw: NOWHERE },
        pose_covariance: Vec::new(),
        linear_velocity: [0.0; 3],
        angular_velocity: [0.0; 3],
        twist_covariance: Vec::new(),
    })
}

fn fix(seconds: f64) -> Message {
    Message::NavSatFix(NavSatFix {
        header: header(seconds, "base_link"),
        status: 0,
        service: 1,
        latitude_degrees: 50.0,
        longitude_degrees: 10.0,
        altitude: 100.0,
        position_covariance: [0.0; 9],
        position_covariance_type: 0,
    })
}

fn landmark(seconds: f64) -> Message {
    let tracking_from_landmark = Pose { position: [1.0, 0.0, 0.0], orientation_xyzw: NOWHERE };
    let entry = LandmarkEntry {
        id: "door".to_owned(),
        tracking_from_landmark,
        translation_weight: 1.0,
        rotation_weight: 1.0,
    };
    Message::LandmarkList(LandmarkList { header: header(seconds, "base_link"), landmarks: vec![entry] })
}

fn transform(seconds: f64, parent: &str, child: &str, x: f64, is_static: bool) -> Message {
    let transform = Pose { position: [x, 0.0, 0.0], orientation_xyzw: NOWHERE };
    let stamped =
        TransformStamped { header: header(seconds, parent), child_frame_id: child.into(), transform };
    Message::Tf(TfMessage { is_static, transforms: vec![stamped] })
}

/// Three seconds of every kind of sensor, several of some. One odometry pose comes too late.
fn recording(with_odometry_topic: bool) -> MemoryRecording {
    let mut messages = Vec::new();
    let mut add = |topic: &str, seconds: f64, message: Message| {
        messages.push(RecordedMessage { topic: topic.into(), log_time: at(seconds), message });
    };
    add("/tf_static", 0.0, transform(0.0, "base_link", "laser", 0.3, true));
    for step in 0..30 {
        let seconds = 0.1 * f64::from(step);
        for name in ["/scan", "/scan_1", "/scan_2"] {
            add(name, seconds + 0.06, laser_scan(seconds));
        }
        for name in ["/echoes", "/echoes_1", "/echoes_2"] {
            add(name, seconds + 0.06, echoes(seconds));
        }
        for name in ["/points2", "/points2_1", "/points2_2"] {
            add(name, seconds, cloud(seconds));
        }
        add("/imu", seconds, imu(seconds));
        add("/fix", seconds, fix(seconds));
        add("/landmark", seconds, landmark(seconds));
        if with_odometry_topic {
            let late = if step == 10 { 0.25 } else { 0.0 };
            add("/odom", seconds, odometry(seconds - late));
        } else {
            add("/tf", seconds, transform(seconds, "odom", "base_link", 0.1 * seconds, false));
        }
    }
    MemoryRecording::new(messages)
}

fn base() -> Options {
    let mut options = Options::for_2d();
    options.trajectory_builder.trajectory_builder_2d.use_imu_data = false;
    options
}

fn ingest(requested: &RequestedOptions) -> IngestOptions {
    let mut ingest = IngestOptions::default();
    requested.configure(&mut ingest).unwrap();
    ingest
}

fn requested(options: &Options) -> RequestedOptions {
    RequestedOptions { configuration: Some(options.clone()), settings: Vec::new() }
}

/// All measurements, and messages that are reported as lost.
fn read(recording: &dyn Recording, requested: &RequestedOptions) -> (Vec<Measurement>, u64) {
    let mut ingestion = Ingestion::new(recording, &ingest(requested)).unwrap();
    let mut measurements = Vec::new();
    while let Some((_, measurement)) = ingestion.next_measurement().unwrap() {
        measurements.push(measurement);
    }
    let lost = ingestion.issues().iter().filter(|r| r.lost_data()).map(|r| r.count).sum();
    (measurements, lost)
}

fn count_of(measurements: &[Measurement], kind: SensorKind) -> f64 {
    measurements.iter().filter(|m| m.kind() == kind).count() as f64
}

fn ranges(options: &Options) -> f64 {
    count_of(&read(&recording(true), &requested(options)).0, SensorKind::Range)
}

fn odometry_poses(options: &Options) -> f64 {
    count_of(&read(&recording(true), &requested(options)).0, SensorKind::Odometry)
}

fn imu_samples(options: &Options) -> f64 {
    count_of(&read(&recording(true), &requested(options)).0, SensorKind::Imu)
}

fn fixes(options: &Options) -> f64 {
    count_of(&read(&recording(true), &requested(options)).0, SensorKind::FixedFramePose)
}

fn landmarks(options: &Options) -> f64 {
    count_of(&read(&recording(true), &requested(options)).0, SensorKind::Landmark)
}

fn lost(options: &Options) -> f64 {
    read(&recording(true), &requested(options)).1 as f64
}

/// Odometry that is found in transforms.
fn poses_from_transforms(options: &Options) -> f64 {
    count_of(&read(&recording(false), &requested(options)).0, SensorKind::Odometry)
}

fn origin_of_scans(options: &Options) -> f64 {
    let measurements = read(&recording(true), &requested(options)).0;
    let origin = |m: &Measurement| match m {
        Measurement::Range(data) => Some(f64::from(data.origin_in_tracking.x)),
        _ => None,
    };
    measurements.iter().find_map(origin).unwrap()
}

/// Points that come with how bright they are.
fn bright_points(options: &Options) -> f64 {
    let measurements = read(&recording(true), &requested(options)).0;
    let bright = |m: &Measurement| match m {
        Measurement::Range(data) => data.intensities.iter().filter(|i| **i > 0.0).count(),
        _ => 0,
    };
    measurements.iter().map(bright).sum::<usize>() as f64
}

/// Dimension in which the recording would be mapped; 0 if that is not clear.
fn dimension(options: &Options) -> f64 {
    match prepare(&recording(true), &ingest(&requested(options)), Some(options.clone())) {
        Ok(preparation) if preparation.dimension == Dimension::TwoD => 2.0,
        Ok(_) => 3.0,
        Err(_) => 0.0,
    }
}

pub fn table() -> Vec<Effect> {
    effects! {
        "use_trajectory_builder_2d", "false" => "true", Rises, dimension, ["use_trajectory_builder_3d=false"];
        "use_trajectory_builder_3d", "false" => "true", Rises, dimension, ["use_trajectory_builder_2d=false"];
        "map_frame", "map" => "odom", Falls, poses_from_transforms, ["use_odometry=true"];
        "tracking_frame", "base_link" => "laser", Falls, origin_of_scans;
        "use_odometry", "false" => "true", Rises, odometry_poses;
        "use_nav_sat", "false" => "true", Rises, fixes;
        "use_landmarks", "false" => "true", Rises, landmarks;
        "num_laser_scans", "1" => "2", Rises, ranges;
        "num_multi_echo_laser_scans", "0" => "2", Rises, ranges;
        "num_point_clouds", "0" => "1", Rises, ranges;
        "num_subdivisions_per_laser_scan", "1" => "5", Rises, ranges;
        "rangefinder_sampling_ratio", "0.5" => "1", Rises, ranges;
        "odometry_sampling_ratio", "0.5" => "1", Rises, odometry_poses, ["use_odometry=true"];
        "fixed_frame_pose_sampling_ratio", "0.5" => "1", Rises, fixes, ["use_nav_sat=true"];
        "imu_sampling_ratio", "0.5" => "1", Rises, imu_samples, ["trajectory_builder_2d.use_imu_data=true"];
        "landmarks_sampling_ratio", "0.5" => "1", Rises, landmarks, ["use_landmarks=true"];
        "ignore_out_of_order", "false" => "true", Falls, lost, ["use_odometry=true"];
        "use_intensities", "false" => "true", Rises, bright_points;
    }
}

#[test]
fn options_of_sensors_have_their_effects() {
    check(&base(), &table());
}

#[test]
fn single_settings_apply_without_a_configuration() {
    let measured = |settings: &[&str]| {
        let settings = settings.iter().map(|s| (*s).to_owned()).collect();
        read(&recording(true), &RequestedOptions { configuration: None, settings }).0
    };
    let count = |settings: &[&str], kind| count_of(&measured(settings), kind);
    let plain = count(&[], SensorKind::Range);
    assert!(plain > 0.0 && count(&[], SensorKind::Odometry) > 0.0 && count(&[], SensorKind::Imu) > 0.0);
    assert_eq!(count(&["rangefinder_sampling_ratio=0.5"], SensorKind::Range), plain / 2.0);
    assert_eq!(count(&["use_odometry=false"], SensorKind::Odometry), 0.0);
    assert_eq!(count(&["imu_sampling_ratio=0"], SensorKind::Imu), 0.0);
    assert!(count(&["use_nav_sat=true"], SensorKind::FixedFramePose) > 0.0);
    // One scanner, in five pieces; odometry and IMU are found as before.
    let scans = ["num_laser_scans=1", "num_subdivisions_per_laser_scan=5"];
    assert_eq!(count(&scans, SensorKind::Range), 150.0);
    assert!(count(&scans, SensorKind::Odometry) > 0.0 && count(&scans, SensorKind::Imu) > 0.0);
}

#[test]
fn a_single_setting_chooses_between_2d_and_3d() {
    for (setting, expected) in [
        ("use_trajectory_builder_2d=true", Dimension::TwoD),
        ("use_trajectory_builder_3d=true", Dimension::ThreeD),
    ] {
        let requested = RequestedOptions { configuration: None, settings: vec![setting.to_owned()] };
        let preparation = prepare(&recording(true), &ingest(&requested), None).unwrap();
        assert_eq!(preparation.dimension, expected);
        let mut options = preparation.options;
        options.set(setting).unwrap();
        assert_eq!(options.validate(), Ok(()));
    }
}

#[test]
fn the_command_line_overrides_settings_and_wrong_settings_are_errors() {
    let mut ingest = IngestOptions {
        use_odometry: Some(false),
        tracking_frame: Some("laser".to_owned()),
        ..IngestOptions::default()
    };
    let settings = ["use_odometry=true", "tracking_frame=base_link"].map(str::to_owned).to_vec();
    RequestedOptions { configuration: None, settings }.configure(&mut ingest).unwrap();
    assert_eq!((ingest.use_odometry, ingest.tracking_frame.as_deref()), (Some(false), Some("laser")));
    for wrong in ["use_odometri=true", "use_odometry=7", "use_odometry"] {
        let requested = RequestedOptions { configuration: None, settings: vec![wrong.to_owned()] };
        assert!(requested.configure(&mut ingest).is_err(), "{wrong}");
    }
    let threads = |settings: &[&str]| {
        let settings = settings.iter().map(|s| (*s).to_owned()).collect();
        RequestedOptions { configuration: None, settings }.background_threads()
    };
    assert_eq!(threads(&["num_background_threads=3"]), Some(3));
    assert_eq!(threads(&["use_odometry=true"]), None);
}
