use portolan_ingest::IngestOptions;
use portolan_issue::Severity;
use portolan_recording::{MemoryRecording, Message, MultiEchoLaserScan, RecordedMessage};

use super::*;
use crate::test_messages::{cloud, fixed, imu, moving, named, odometry, scan};

fn checked(messages: Vec<RecordedMessage>) -> Vec<Finding> {
    check(&MemoryRecording::new(messages), &IngestOptions::default(), &mut |_| {}).unwrap().findings
}

fn robot(messages: impl IntoIterator<Item = RecordedMessage>) -> Vec<RecordedMessage> {
    let transforms =
        fixed(&[("base_link", "laser", [0.5, 0.0, 0.2], 0.0), ("base_link", "imu_link", [0.0; 3], 0.0)]);
    let mut all = vec![named("/tf_static", 0.0, Message::Tf(transforms))];
    all.extend(messages);
    all
}

fn find<'a>(findings: &'a [Finding], part: &str) -> &'a Finding {
    findings
        .iter()
        .find(|f| f.text.contains(part))
        .unwrap_or_else(|| panic!("{part}: {}", findings_to_text(findings)))
}

/// Scans at 20 Hz whose ranges differ a little, as real ones do.
fn scans(
    count: usize,
    mut change: impl FnMut(usize, &mut portolan_recording::LaserScan),
) -> Vec<RecordedMessage> {
    (0..count)
        .map(|i| {
            let t = 0.05 * i as f64;
            let Message::LaserScan(mut message) = scan(t, "laser") else { panic!() };
            message.ranges[0] += 1e-3 * i as f32;
            change(i, &mut message);
            named("/scan", t, Message::LaserScan(message))
        })
        .collect()
}

#[test]
fn a_good_recording_has_no_warnings() {
    let mut messages = robot(scans(100, |_, _| {}));
    messages.extend((0..500).map(|i| {
        let t = 0.01 * f64::from(i);
        named("/imu", t, imu(t, [0.1, 0.0, 9.8]))
    }));
    messages
        .extend((0..100).map(|i| {
            named("/odom", 0.05 * f64::from(i), odometry(0.05 * f64::from(i), 0.01 * f64::from(i)))
        }));
    let findings = checked(messages);
    assert!(findings.iter().all(|f| f.severity == Severity::Info), "{}", findings_to_text(&findings));
}

#[test]
fn scans_outside_the_time_of_the_imu_are_an_error() {
    let recording = |seconds: f64| {
        let mut messages = robot(vec![]);
        messages.extend((0..10).map(|i| {
            let t = 0.01 * f64::from(i);
            named("/imu", t, imu(t, [0.1, 0.0, 9.8]))
        }));
        messages.push(named("/points", seconds, cloud(seconds, "laser")));
        messages
    };
    let findings = checked(recording(0.2));
    let found = find(&findings, "the only scan begins before /imu does, or ends after it");
    assert_eq!(found.severity, Severity::Error);
    let findings = checked(recording(0.03));
    assert!(findings.iter().all(|f| !f.text.contains("the only scan")), "{}", findings_to_text(&findings));
}

#[test]
fn clouds_in_millimetres_are_reported() {
    let clouds = |unit: f32| {
        let mut messages = robot(vec![]);
        messages.extend((0..20).map(|i| {
            let t = 0.1 * f64::from(i);
            let Message::PointCloud2(mut cloud) = cloud(t, "laser") else { panic!() };
            for point in cloud.data.chunks_exact_mut(cloud.point_step as usize) {
                for value in point[..12].as_chunks_mut::<4>().0 {
                    *value = (f32::from_le_bytes(*value) * unit).to_le_bytes();
                }
            }
            named("/points", t, Message::PointCloud2(cloud))
        }));
        checked(messages)
    };
    let findings = clouds(1e3);
    assert_eq!(find(&findings, "in millimetres").count, 20);
    assert!(clouds(1.0).iter().all(|f| !f.text.contains("millimetres")));
}

#[test]
fn faults_of_stamps() {
    let mut messages = robot(scans(100, |i, message| match i {
        20 => message.header.stamp -= portolan_geometry::Duration::from_seconds(0.5),
        40 => message.header.stamp -= portolan_geometry::Duration::from_seconds(0.05),
        50 => message.header.stamp = portolan_geometry::Time::from_ros(0, 0),
        80 => message.header.stamp += portolan_geometry::Duration::from_seconds(1e8),
        _ => {}
    }));
    messages.retain(|m| {
        m.log_time.unix_seconds() < 1_700_000_003.0 || m.log_time.unix_seconds() > 1_700_000_003.5
    });
    messages.extend((0..100).map(|i| {
        let t = 0.05 * f64::from(i);
        named("/odom", t, odometry(t - 0.7, 0.01 * f64::from(i)))
    }));
    let findings = checked(messages);
    for (part, severity) in [
        ("not strictly increasing", Severity::Error),
        ("have no stamp", Severity::Error),
        ("jumps by", Severity::Error),
        ("two messages", Severity::Warning),
        ("large gap", Severity::Warning),
        ("is not sequential in time", Severity::Error),
    ] {
        assert_eq!(find(&findings, part).severity, severity, "{part}");
    }
    let late = findings.iter().find(|f| f.topic == "/odom" && f.text.contains("differ by 0.700 s")).unwrap();
    assert_eq!(late.severity, Severity::Error);
}

#[test]
fn a_clock_that_was_set_while_recording_is_named() {
    let jump = portolan_geometry::Duration::from_seconds(80_000_000.0);
    let mut messages = robot(scans(100, |_, _| {}));
    messages
        .extend((0..100).map(|i| {
            named("/odom", 0.05 * f64::from(i), odometry(0.05 * f64::from(i), 0.01 * f64::from(i)))
        }));
    messages.sort_by_key(|m| m.log_time);
    for message in messages.iter_mut().filter(|m| m.log_time.unix_seconds() > 1_700_000_002.5) {
        message.log_time += jump;
        match &mut message.message {
            Message::LaserScan(scan) => scan.header.stamp += jump,
            Message::Odometry(odometry) => odometry.header.stamp += jump,
            _ => {}
        }
    }
    let findings = checked(messages);
    let found = find(&findings, "the clock of the recording jumps by 3 years at message 1");
    assert_eq!((found.severity, found.count), (Severity::Warning, 1));
}

#[test]
fn faults_of_scans() {
    let findings = checked(robot(scans(30, |i, message| {
        (message.angle_min, message.angle_max, message.angle_increment) = (-90.0, 90.0, 180.0 / 89.0);
        message.ranges.iter_mut().for_each(|r| *r *= 1000.0);
        message.range_max = if i == 3 { -1.0 } else { 60_000.0 };
        message.time_increment = if i == 4 { -1.0 } else { 0.001 };
        message.ranges[5] = f32::NAN;
        if i == 7 {
            message.ranges.fill(f32::INFINITY);
        }
        if i > 10 {
            message.ranges[0] = 1.0;
        }
    })));
    for part in [
        "millimetres",
        "range_min 0.1 and range_max -1",
        "time_increment is -1",
        "exactly the same",
        "without a single distance",
        "measurements overlap in time",
        "longest overlap",
        "not a number",
    ] {
        find(&findings, part);
    }
    assert_eq!(find(&findings, "make 28.6 revolutions").severity, Severity::Error);
}

#[test]
fn scans_without_any_return_are_an_error() {
    let is_error = |messages| {
        let findings = checked(robot(messages));
        let found = findings.iter().find(|f| f.text.contains("there is not one scan with a point"));
        found.is_some_and(|found| found.severity == Severity::Error)
    };
    for range in [f32::INFINITY, f32::NAN, 0.0] {
        assert!(is_error(scans(30, |_, message| message.ranges.fill(range))), "{range}");
    }
    assert!(is_error(scans(30, |_, message| message.ranges.clear())));
    assert!(!is_error(scans(30, |i, message| {
        if i > 0 {
            message.ranges.fill(f32::INFINITY);
        }
    })));
    let echoes = |change: fn(&mut Vec<Vec<f32>>)| {
        let messages = scans(30, |_, _| {}).into_iter().map(|mut recorded| {
            let Message::LaserScan(scan) = &recorded.message else { panic!() };
            let mut ranges = scan.ranges.iter().map(|r| vec![*r]).collect();
            change(&mut ranges);
            recorded.message = Message::MultiEchoLaserScan(MultiEchoLaserScan {
                header: scan.header.clone(),
                angle_min: scan.angle_min,
                angle_max: scan.angle_max,
                angle_increment: scan.angle_increment,
                time_increment: scan.time_increment,
                scan_time: scan.scan_time,
                range_min: scan.range_min,
                range_max: scan.range_max,
                ranges,
                intensities: Vec::new(),
            });
            recorded
        });
        is_error(messages.collect())
    };
    assert!(!echoes(|_| {}));
    assert!(echoes(|ranges| ranges.iter_mut().for_each(Vec::clear)));
}

#[test]
fn faults_of_imus_and_odometry() {
    let mut messages = robot(scans(100, |_, _| {}));
    for i in 0..500 {
        let t = 0.01 * f64::from(i);
        let Message::Imu(mut upside_down) = imu(t, [0.0, 0.0, -9.8]) else { panic!() };
        upside_down.angular_velocity = [0.0, 0.0, 30.0];
        if i == 7 {
            upside_down.linear_acceleration = [90.0, 0.0, 0.0];
        }
        messages.push(named("/imu", t, Message::Imu(upside_down)));
        messages.push(named("/imu_g", t, imu(t, [0.0, 0.0, 1.0])));
        let Message::Imu(mut spiky) = imu(t, [0.0, 0.0, if i == 9 { 1e6 } else { 9.8 }]) else { panic!() };
        spiky.angular_velocity = [0.0, if i == 70 { 100.0 } else { 0.1 }, 0.0];
        messages.push(named("/imu_spiky", t, Message::Imu(spiky)));
        messages.push(named("/imu_weak", t, imu(t, [0.0, 0.0, 5.0])));
        let mut pose = odometry(t, if i > 250 { 100.0 } else { 0.0 });
        if let (Message::Odometry(o), true) = (&mut pose, i == 400) {
            o.pose.orientation_xyzw = [0.0; 4];
        }
        messages.push(named("/odom", t, pose));
    }
    let findings = checked(messages);
    for part in [
        "in g",
        "average IMU linear acceleration is 5",
        "expected is [3, 30]",
        "seem to be in degrees",
        "1.000e6 m/s² in one sample",
        "leans 179°",
        "Odometry pose is invalid",
        "the pose jumps by 100.00 m",
        "is sent on multiple topics: /imu, /imu_g, /imu_spiky, /imu_weak",
    ] {
        find(&findings, part);
    }
}

#[test]
fn a_tilted_imu_is_reported_on_a_robot_and_allowed_in_the_hand() {
    let with = |carrier: &'static str| {
        let transforms =
            fixed(&[(carrier, "lidar", [0.0, 0.0, 0.3], 0.0), (carrier, "imu_link", [0.0; 3], 0.0)]);
        let mut messages = vec![named("/tf_static", 0.0, Message::Tf(transforms))];
        messages.extend((0..20).map(|i| 0.1 * f64::from(i)).map(|t| named("/points", t, cloud(t, "lidar"))));
        messages
            .extend((0..200).map(|i| 0.01 * f64::from(i)).map(|t| named("/imu", t, imu(t, [0.3, 9.8, 0.1]))));
        checked(messages)
    };
    assert_eq!(find(&with("base_link"), "gravity lies along +y").severity, Severity::Error);
    for carried in ["handle", "imu_link"] {
        let text = findings_to_text(&with(carried));
        assert!(!text.contains("gravity lies along") && !text.contains("leans"), "{carried}: {text}");
    }
}

#[test]
fn an_imu_without_gravity_is_the_only_finding() {
    let mut messages = robot(scans(100, |_, _| {}));
    for i in 0..500 {
        let t = 0.01 * f64::from(i);
        // Mostly calm, with steps of 6 m/s² that cancel out except for a small sideways part.
        let step = if i % 10 == 0 { 6.0 * f64::from(i / 10 % 2 * 2 - 1) } else { 0.1 };
        messages.push(named("/imu", t, imu(t, [0.0, 0.3, step])));
    }
    let findings = checked(messages);
    assert_eq!(find(&findings, "gravity was removed").severity, Severity::Error);
    let text = findings_to_text(&findings);
    for wrong in ["in g", "axes are swapped", "leans"] {
        assert!(!text.contains(wrong), "{wrong}: {text}");
    }
}

#[test]
fn stamps_that_are_too_early_are_no_gaps() {
    let mut messages = robot(scans(100, |i, message| {
        if i % 9 == 5 {
            message.header.stamp -= portolan_geometry::Duration::from_seconds(0.5);
        }
    }));
    for i in 0..1000 {
        let t = 0.005 * f64::from(i);
        let stamp = if i % 50 == 7 { t - 0.2 } else { t };
        messages.push(named("/imu", t, imu(stamp, [0.0, 0.0, 9.8])));
    }
    let findings = checked(messages);
    assert_eq!(findings.iter().filter(|f| f.text.contains("not strictly increasing")).count(), 2);
    assert!(findings.iter().all(|f| !f.text.contains("gap")), "{}", findings_to_text(&findings));
}

/// Sweeps of 0.2 s that are recorded when they end, and transforms to a frame that is no robot's.
#[test]
fn sweeps_recorded_at_their_end_are_not_late() {
    let sweep = |i: i32| {
        let t = 0.2 * f64::from(i);
        let Message::PointCloud2(mut message) = cloud(t, "lidar") else { panic!() };
        let times = message.fields.iter().find(|f| f.name == "time").unwrap().offset as usize;
        let count = message.data.len() / message.point_step as usize;
        for (k, point) in message.data.chunks_exact_mut(message.point_step as usize).enumerate() {
            let time = 0.2 * k as f32 / count as f32;
            point[times..times + 4].copy_from_slice(&time.to_le_bytes());
        }
        named("/points", t + 0.2, Message::PointCloud2(message))
    };
    let mut messages: Vec<RecordedMessage> = (0..40).map(sweep).collect();
    let transforms = fixed(&[("imu_link", "lidar", [0.8, 0.0, 0.8], 0.0)]);
    messages.insert(0, named("/tf_static", 0.0, Message::Tf(transforms)));
    let findings = checked(messages);
    let text = findings_to_text(&findings);
    assert!(!text.contains("serialization time") && !text.contains("no transforms say"), "{text}");
    let found = find(&findings, "no frame of the recording has the usual name of a robot frame");
    assert!(found.severity == Severity::Info && found.advice.contains("imu_link"), "{text}");
}

#[test]
fn faults_of_clouds_and_transforms() {
    let mut messages = Vec::new();
    for i in 0..40 {
        let t = 0.1 * f64::from(i);
        let Message::PointCloud2(mut message) = cloud(t, "lidar") else { panic!() };
        message.data[4] ^= i as u8;
        if i == 5 {
            message.data.truncate(100);
        }
        if i == 6 {
            message.fields.clear();
        }
        messages.push(named("/points", t, Message::PointCloud2(message)));
        messages.push(named("/tf", t, Message::Tf(moving("map", "odom", t, [0.0; 3]))));
        messages.push(named("/tf", t, Message::Tf(moving("odom", "lidar", t, [0.0; 3]))));
        messages.push(named("/tf", t, Message::Tf(moving("lidar", "odom", t, [0.0; 3]))));
    }
    let findings = checked(messages);
    for part in [
        "relative time",
        "points more than it has",
        "without fields x, y and z",
        "output of a mapping program",
        "form a loop",
    ] {
        find(&findings, part);
    }
    assert!(findings.windows(2).all(|w| w[0].severity >= w[1].severity));
}

#[test]
fn a_recording_is_described_in_text_and_json() {
    let mut messages = robot(scans(50, |_, _| {}));
    messages.push(named("/odom", 1.0, odometry(1.0, 0.0)));
    let about = info(&MemoryRecording::new(messages), &IngestOptions::default(), &mut |_| {}).unwrap();
    let text = about.to_text();
    for part in [
        "sensor_msgs/LaserScan",
        "20.",
        "base_link\n",
        "laser (0.5 0 0.2 m)",
        "in 2D with /scan, odometry /odom",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let json = serde_json::to_value(&about).unwrap();
    assert_eq!(json["messages"], 52);
    assert_eq!(json["frames"], serde_json::json!(["base_link", "imu_link", "laser", "odom"]));
    assert_eq!(json["plan"]["tracking_frame"], "base_link");
    let empty = info(&MemoryRecording::new(Vec::new()), &IngestOptions::default(), &mut |_| {}).unwrap();
    assert!(empty.to_text().contains("no messages at all"));
}
