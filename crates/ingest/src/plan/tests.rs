use std::f64::consts::PI;

use portolan_recording::{Header, Imu, MemoryRecording, Message, Odometry, RecordedMessage, TfMessage};

use super::*;
use crate::options::ConfiguredSensors;
use crate::test_messages::{cloud, fixed, imu, moving, named, odometry, scan};

/// A second of messages of every topic, at 20 Hz.
fn recording(topics: &[(&str, &dyn Fn(f64) -> Message)]) -> MemoryRecording {
    let mut messages: Vec<RecordedMessage> = Vec::new();
    for i in 0..60 {
        let time = 0.05 * f64::from(i);
        messages.extend(topics.iter().map(|(topic, message)| named(topic, time, message(time))));
    }
    MemoryRecording::new(messages)
}

fn planned(recording: &MemoryRecording, options: &IngestOptions) -> Result<SensorPlan, PlanError> {
    plan(&Inventory::of(recording, options).unwrap(), options)
}

fn topics(plan: &SensorPlan) -> Vec<&str> {
    plan.range.iter().map(|r| &*r.source.topic).collect()
}

#[test]
fn two_connected_scanners_and_odometry_are_used_together() {
    let recording = recording(&[
        ("/front", &|t| scan(t, "front_laser")),
        ("/rear", &|t| scan(t, "rear_laser")),
        ("/front_filtered", &|t| scan(t, "front_laser")),
        ("/vertical", &|t| scan(t, "vertical_laser")),
        ("/tilting", &|t| scan(t, "tilting_laser")),
        ("/panning", &|t| scan(t, "panning_laser")),
        ("/tf", &|t| {
            Message::Tf(turned("base_link", "tilting_laser", t, [0.0, (0.3 * (3.0 * t).sin()).sin(), 0.0]))
        }),
        ("/tf_of_pan", &|t| {
            Message::Tf(turned("base_link", "panning_laser", t, [0.0, 0.0, (0.3 * t).sin()]))
        }),
        ("/lost", &|t| scan(t, "nowhere")),
        ("/odom", &|t| odometry(t, t)),
        ("/odometry/filtered", &|t| odometry(t, t)),
        ("/tf_static", &|_| {
            Message::Tf(fixed(&[
                ("base_link", "front_laser", [0.3, 0.0, 0.0], 0.0),
                ("base_link", "rear_laser", [-0.3, 0.0, 0.0], PI),
                ("base_link", "vertical_laser", [0.0, 0.0, PI / 2.0], 99.0),
            ]))
        }),
    ]);
    let plan = planned(&recording, &IngestOptions::default()).unwrap();
    assert_eq!(
        (topics(&plan), plan.tracking_frame.as_str()),
        (vec!["/front", "/panning", "/rear"], "base_link")
    );
    assert_eq!(plan.dimension, Dimension::TwoD);
    assert!(matches!(&plan.odometry, Some(o) if o.name() == "/odom"));
    let text: String = plan.notices.iter().map(|n| format!("{} [{}]\n", n.text, n.change)).collect();
    for expected in [
        "/front_filtered is not used",
        "/vertical is not used: its plane leans 90°",
        "/tilting is not used: its plane leans 34°",
        "/lost is not used",
        "--odom /odometry/filtered",
    ] {
        assert!(text.contains(expected), "{expected}: {text}");
    }
    let options = IngestOptions { range_topics: vec!["lost".into()], ..IngestOptions::default() };
    assert_eq!(planned(&recording, &options).unwrap().tracking_frame, "nowhere");
    let options = IngestOptions { range_topics: vec!["/odom".into()], ..IngestOptions::default() };
    assert!(planned(&recording, &options).unwrap_err().to_string().contains("nav_msgs/Odometry"));
    let options = IngestOptions { range_topics: vec!["/none".into()], ..IngestOptions::default() };
    assert!(planned(&recording, &options).unwrap_err().to_string().contains("/front, /front_filtered"));
    let options = IngestOptions { tracking_frame: Some("wheel".into()), ..IngestOptions::default() };
    assert!(planned(&recording, &options).unwrap_err().to_string().contains("rear_laser"));
}

/// A frame turned by a quaternion with this vector part.
fn turned(parent: &str, child: &str, seconds: f64, [x, y, z]: [f64; 3]) -> TfMessage {
    let mut message = moving(parent, child, seconds, [0.0; 3]);
    for turned in &mut message.transforms {
        turned.transform.orientation_xyzw = [x, y, z, (1.0 - x * x - y * y - z * z).sqrt()];
    }
    message
}

fn odometry_of(child: &str, time: f64) -> Message {
    match odometry(time, time) {
        Message::Odometry(odometry) => {
            Message::Odometry(Odometry { child_frame_id: child.into(), ..odometry })
        }
        other => other,
    }
}

fn imu_of(frame: &str, time: f64) -> Message {
    match imu(time, [0.0, 0.0, 9.8]) {
        Message::Imu(imu) => {
            let header = Header { frame_id: frame.into(), ..imu.header.clone() };
            Message::Imu(Imu { header, ..imu })
        }
        other => other,
    }
}

#[test]
fn one_of_two_robots_in_a_recording_is_mapped() {
    let recording = recording(&[
        ("/r1/scan", &|t| scan(t, "r1/laser")),
        ("/r2/scan", &|t| scan(t, "r2/laser")),
        ("/r1/odom", &|t| odometry_of("r1/base_link", t)),
        ("/r2/odom", &|t| odometry_of("r2/base_link", t)),
        ("/r2/imu", &|t| imu_of("r2/base_link", t)),
        ("/tf", &|t| Message::Tf(moving("r1/odom", "r1/base_link", t, [t, 0.0, 0.0]))),
        ("/r2_tf", &|t| Message::Tf(moving("r2_odom", "r2/base_link", t, [t, 0.0, 0.0]))),
        ("/tf_static", &|_| {
            Message::Tf(fixed(&[
                ("world", "r1/odom", [0.0; 3], 0.0),
                ("world", "r2_odom", [5.0, 0.0, 0.0], 0.0),
                ("r1/base_link", "r1/laser", [0.3, 0.0, 0.0], 0.0),
                ("r2/base_link", "r2/laser", [0.3, 0.0, 0.0], 0.0),
            ]))
        }),
    ]);
    let of = |topics_wanted: &[&str]| {
        let range_topics = topics_wanted.iter().map(|t| (*t).to_owned()).collect();
        let plan = planned(&recording, &IngestOptions { range_topics, ..IngestOptions::default() }).unwrap();
        let odometry = match &plan.odometry {
            Some(odometry) => odometry.name(),
            _ => String::new(),
        };
        let sensors: Vec<String> = topics(&plan).iter().map(|t| (*t).to_owned()).collect();
        (sensors, odometry, plan.tracking_frame.clone(), plan.imu.is_some(), plan.notices)
    };
    let (sensors, odometry, tracking, has_imu, notices) = of(&["/r1/scan"]);
    assert_eq!(
        (sensors.concat(), odometry, tracking),
        ("/r1/scan".into(), "/r1/odom".into(), "r1/base_link".into())
    );
    assert!(!has_imu, "that of the other robot: {notices:?}");
    let (sensors, odometry, tracking, has_imu, _) = of(&["/r2/scan"]);
    assert_eq!(
        (sensors.concat(), odometry, tracking),
        ("/r2/scan".into(), "/r2/odom".into(), "r2/base_link".into())
    );
    assert!(has_imu);
    let (sensors, odometry, tracking, _, notices) = of(&[]);
    assert_eq!(
        (sensors.concat(), odometry, tracking),
        ("/r2/scan".into(), "/r2/odom".into(), "r2/base_link".into())
    );
    let text: String = notices.iter().map(|n| format!("{} [{}]\n", n.text, n.change)).collect();
    assert!(text.contains("only by \"r1/odom\": it is on another robot [--scan /r1/scan]"), "{text}");
}

#[test]
fn a_lidar_with_an_imu_in_g() {
    let recording = recording(&[
        ("/points", &|t| cloud(t, "lidar")),
        ("/camera/scan", &|t| scan(t, "camera")),
        ("/imu/data", &|t| imu(t, [0.0, 0.0, 1.0])),
        ("/broken_imu", &|t| imu(t, [0.0, 0.0, 0.01])),
        ("/tf_static", &|_| {
            Message::Tf(fixed(&[
                ("imu_link", "lidar", [0.0, 0.0, 0.2], 0.0),
                ("lidar", "camera", [0.0; 3], 0.0),
            ]))
        }),
    ]);
    let plan = planned(&recording, &IngestOptions::default()).unwrap();
    assert_eq!((topics(&plan), plan.tracking_frame.as_str()), (vec!["/points"], "imu_link"));
    assert_eq!(plan.dimension, Dimension::ThreeD);
    assert_eq!(plan.imu.as_ref().unwrap().scale, ImuScale { acceleration: 9.80665, angular_velocity: 1.0 });
    let point_time = plan.range[0].point_time.unwrap();
    assert_eq!(point_time.unit, 1.0);
    let flat =
        IngestOptions { dimension: Some(Dimension::TwoD), use_imu: Some(false), ..IngestOptions::default() };
    let plan = planned(&recording, &flat).unwrap();
    assert_eq!((topics(&plan), plan.imu.is_some()), (vec!["/camera/scan"], false));
}

#[test]
fn a_gyroscope_in_degrees() {
    let recording = recording(&[
        ("/points", &|t| cloud(t, "imu_link")),
        ("/imu/data", &|t| {
            let Message::Imu(mut sample) = imu(t, [0.0, 0.0, 9.8]) else { panic!() };
            sample.angular_velocity = [0.0, 40.0 * (5.0 * t).sin(), 0.0];
            Message::Imu(sample)
        }),
    ]);
    let plan = planned(&recording, &IngestOptions::default()).unwrap();
    let scale = plan.imu.as_ref().unwrap().scale;
    assert_eq!(scale, ImuScale { acceleration: 1.0, angular_velocity: PI / 180.0 });
    assert!(plan.notices.iter().any(|n| n.text.contains("in degrees per second")));
}

#[test]
fn names_of_a_configuration_are_found_or_remapped() {
    let recording = recording(&[
        ("/base_scan", &|t| scan(t, "laser")),
        ("/robot/odom", &|t| odometry(t, t)),
        ("/tf", &|t| Message::Tf(moving("base_link", "laser", t, [0.1, 0.0, 0.0]))),
    ]);
    let configured =
        ConfiguredSensors { num_laser_scans: 1, use_odometry: Some(true), ..ConfiguredSensors::default() };
    let mut options = IngestOptions { configured: Some(configured), ..IngestOptions::default() };
    let plan = planned(&recording, &options).unwrap();
    assert_eq!(topics(&plan), ["/base_scan"]);
    assert_eq!(&*plan.range[0].source.sensor.id, "scan");
    assert!(plan.notices.iter().any(|n| n.text.contains("expects \"scan\"")));
    assert!(plan.odometry.is_some());
    options.remappings = vec![("scan".into(), "base_scan".into()), ("odom".into(), "/robot/odom".into())];
    let plan = planned(&recording, &options).unwrap();
    let names: Vec<_> = plan.sensors().iter().map(|s| s.id.to_string()).collect();
    assert_eq!(names, ["odom", "scan"]);
    assert!(plan.notices.is_empty(), "{:?}", plan.notices);
    options.remappings[0].1 = "/nothing".into();
    assert!(planned(&recording, &options).is_err());
    options = IngestOptions { configured: Some(ConfiguredSensors::default()), ..IngestOptions::default() };
    assert!(planned(&recording, &options).unwrap_err().to_string().contains("num_laser_scans"));
}

#[test]
fn odometry_in_transforms_and_results_of_mapping() {
    let recording = recording(&[
        ("/scan", &|t| scan(t, "laser")),
        ("/tf", &|t| Message::Tf(moving("odom", "base_link", t, [t, 0.0, 0.0]))),
        ("/tf2", &|t| Message::Tf(moving("map", "odom", t, [t, 0.0, 0.0]))),
        ("/tf_static", &|_| Message::Tf(fixed(&[("base_link", "laser", [0.1, 0.0, 0.0], 0.0)]))),
    ]);
    let inventory = Inventory::of(&recording, &IngestOptions::default()).unwrap();
    assert!(inventory.moving_issues.iter().any(|r| r.text().contains("output of a mapping program")));
    let plan = plan(&inventory, &IngestOptions::default()).unwrap();
    assert!(matches!(&plan.odometry, Some(o) if o.topic().is_none() && &*o.source.frame == "base_link"));
    assert!((plan.odometry_interval.unwrap() - 0.05).abs() < 1e-6);
}

#[test]
fn the_raw_cloud_is_mapped_and_not_processed_ones() {
    let timeless = |t: f64| timeless(t, 0.0);
    let half = |t: f64| {
        let Message::PointCloud2(mut message) = timeless(t) else { panic!() };
        message.width /= 2;
        let length = message.data.len() / 2;
        message.data.truncate(length);
        Message::PointCloud2(message)
    };
    // Shorter names and alphabetical order do not matter.
    let clouds = recording(&[("/cropped", &half), ("/velodyne_points", &timeless)]);
    let plan = planned(&clouds, &IngestOptions::default()).unwrap();
    assert_eq!(topics(&plan), ["/velodyne_points"]);
    let with_times = recording(&[("/driver/points_raw", &|t| cloud(t, "lidar")), ("/points", &timeless)]);
    let plan = planned(&with_times, &IngestOptions::default()).unwrap();
    assert_eq!(topics(&plan), ["/driver/points_raw"]);
    // A cloud that a mapping program published in its own frame.
    let registered =
        recording(&[("/cloud_registered", &|t| cloud(t, "robot/camera_init")), ("/points", &timeless)]);
    let plan = planned(&registered, &IngestOptions::default()).unwrap();
    assert_eq!((topics(&plan), plan.tracking_frame.as_str()), (vec!["/points"], "lidar"));
    assert!(plan.notices.iter().any(|n| n.text.contains("is that of a map")), "{:?}", plan.notices);
}

#[test]
fn a_lone_scanner_and_an_empty_recording() {
    let lone = recording(&[("/scan", &|t| scan(t, "laser")), ("/odom", &|t| odometry(t, t))]);
    let plan = planned(&lone, &IngestOptions::default()).unwrap();
    assert_eq!((plan.tracking_frame.as_str(), plan.odometry.is_some()), ("laser", false));
    assert!(
        plan.notices
            .iter()
            .any(|n| n.text.contains("odometry /odom is not used") && n.change.contains("--urdf"))
    );
    let empty = recording(&[("/odom", &|t| odometry(t, t))]);
    let error = planned(&empty, &IngestOptions::default()).unwrap_err().to_string();
    assert!(error.contains("/odom (nav_msgs/Odometry)"), "{error}");
    let unnamed = recording(&[("/scan", &|t| scan(t, ""))]);
    assert_eq!(planned(&unnamed, &IngestOptions::default()).unwrap().tracking_frame, "base_link");
}

#[test]
fn clocks_that_are_far_apart_are_joined() {
    let recording = recording(&[
        ("/scan", &|t| scan(t, "laser")),
        ("/odom", &|t| odometry(t - 3600.0, t)),
        ("/tf_static", &|_| Message::Tf(fixed(&[("base_link", "laser", [0.1, 0.0, 0.0], 0.0)]))),
    ]);
    let plan = planned(&recording, &IngestOptions::default()).unwrap();
    let Some(PlannedOdometry { source: odometry, .. }) = &plan.odometry else { panic!() };
    assert!((odometry.clock_shift.seconds() - 3600.0).abs() < 1e-3);
}

#[test]
fn stamps_are_moved_by_given_time_offsets() {
    let recording = recording(&[("/points", &|t| cloud(t, "lidar")), ("/other", &|t| cloud(t, "lidar"))]);
    let options = |topic: &str| IngestOptions {
        range_topics: vec!["/points".into()],
        time_offsets: vec![(topic.into(), Duration::from_seconds(-0.05))],
        ..IngestOptions::default()
    };
    for name in ["/points", "points"] {
        let plan = planned(&recording, &options(name)).unwrap();
        assert_eq!(plan.range[0].source.clock_shift, Duration::from_seconds(-0.05));
    }
    let error = planned(&recording, &options("/other")).unwrap_err().to_string();
    assert!(error.contains("--time-offset") && error.contains("/points"), "{error}");
}

#[test]
fn in_2d_an_imu_whose_axes_are_swapped_is_left_out() {
    let swapped = recording(&[
        ("/scan", &|t| scan(t, "laser")),
        ("/imu", &|t| imu(t, [0.3, 9.8, 0.1])),
        ("/tf_static", &|_| {
            Message::Tf(fixed(&[
                ("base_link", "laser", [0.3, 0.0, 0.0], 0.0),
                ("base_link", "imu_link", [0.0; 3], 0.0),
            ]))
        }),
    ]);
    let plan = planned(&swapped, &IngestOptions::default()).unwrap();
    assert!(plan.imu.is_none() && plan.dimension == Dimension::TwoD);
    let notice = plan.notices.iter().find(|n| n.text.contains("leaning 89°")).unwrap();
    assert_eq!(notice.change, "--imu /imu");
    let asked_for = IngestOptions { imu_topic: Some("/imu".into()), ..IngestOptions::default() };
    assert!(planned(&swapped, &asked_for).unwrap().imu.is_some());
    // A transform with the tilt corrects it.
    let tilt = PI / 2.0;
    let mounted = recording(&[
        ("/scan", &|t| scan(t, "laser")),
        ("/imu", &|t| imu(t, [-9.8, 0.1, 0.1])),
        ("/tf_static", &|_| {
            Message::Tf(fixed(&[
                ("base_link", "laser", [0.3, 0.0, 0.0], 0.0),
                ("base_link", "imu_link", [0.0, 0.0, tilt], 99.0),
            ]))
        }),
    ]);
    assert!(planned(&mounted, &IngestOptions::default()).unwrap().imu.is_some());
}

#[test]
fn in_3d_an_imu_tilted_against_the_robot_is_left_out_and_a_handheld_one_may_be_tilted() {
    let with = |acceleration: [f64; 3], robot: &'static str| {
        let recording = recording(&[
            ("/points", &|t| cloud(t, "lidar")),
            ("/imu", &|t| imu(t, acceleration)),
            ("/tf_static", &|_| {
                Message::Tf(fixed(&[
                    (robot, "lidar", [0.0, 0.0, 0.3], 0.0),
                    (robot, "imu_link", [0.0; 3], 0.0),
                ]))
            }),
        ]);
        planned(&recording, &IngestOptions::default()).unwrap()
    };
    let swapped = with([0.3, 9.8, 0.1], "base_link");
    assert!(swapped.imu.is_none() && swapped.dimension == Dimension::ThreeD);
    assert!(swapped.notices.iter().any(|n| n.text.contains("leaning 89°")));
    assert!(with([0.3, 0.1, -9.8], "base_link").imu.is_none());
    assert!(with([0.3, 0.1, -9.8], "robot_2/base_link").imu.is_none());
    assert!(with([4.0, 0.1, 9.0], "base_link").imu.is_some());
    assert!(with([0.3, 9.8, 0.1], "handle").imu.is_some());
}

/// A cloud of four rings all around without times, of a lidar at rest.
fn timeless(seconds: f64, lag: f64) -> Message {
    let Message::PointCloud2(mut message) = cloud(seconds - lag, "lidar") else { panic!() };
    message.fields.retain(|f| f.name != "time");
    Message::PointCloud2(message)
}

#[test]
fn clouds_without_times_get_them_from_the_azimuth_unless_disabled() {
    use AzimuthTimes::{Auto, FromStamp, Off, UntilStamp};
    for (lag, asked, expected) in
        [(0.06, Auto, FromStamp), (0.0, Auto, UntilStamp), (0.0, Off, Off), (0.06, UntilStamp, UntilStamp)]
    {
        let recording = recording(&[("/points", &|t| timeless(t, lag))]);
        let options = IngestOptions { azimuth_times: asked, ..IngestOptions::default() };
        let plan = planned(&recording, &options).unwrap();
        assert_eq!(plan.range[0].azimuth_times, expected, "{lag} {asked:?}");
        let is_noted = plan.notices.iter().any(|n| n.text.contains("from their azimuth"));
        assert_eq!(is_noted, asked == Auto, "{:?}", plan.notices);
    }
    let with_times = recording(&[("/points", &|t| cloud(t, "lidar"))]);
    let plan_of = |azimuth_times: AzimuthTimes| {
        planned(&with_times, &IngestOptions { azimuth_times, ..IngestOptions::default() }).unwrap()
    };
    let range = &plan_of(Auto).range[0];
    assert!(range.azimuth_times == Off && range.point_time.is_some());
    // A choice of the user is followed.
    for asked in [Off, FromStamp, UntilStamp] {
        let plan = plan_of(asked);
        assert_eq!((plan.range[0].azimuth_times, plan.range[0].point_time), (asked, None));
        assert!(plan.notices.iter().any(|n| n.text.contains("as asked for")), "{:?}", plan.notices);
    }
}
