//! Text logs of real robots, and text that is none.

#![allow(clippy::unwrap_used, clippy::panic)] // failures of tests are panics

use std::io::Write;
use std::path::Path;

use portolan_issue::Issue;
use portolan_recording::{Message, RecordedMessage, Recording, open_text_log, open_text_log_bytes};
use portolan_testing::real_data;
use proptest::prelude::*;

fn read_all(recording: &dyn Recording) -> (Vec<RecordedMessage>, Vec<Issue>) {
    let mut reader = recording.read(&|_| true).unwrap();
    let mut messages = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        messages.push(message);
    }
    assert!(messages.windows(2).all(|w| w[0].log_time <= w[1].log_time));
    (messages, reader.issues())
}

fn count(messages: &[RecordedMessage], topic: &str) -> usize {
    messages.iter().filter(|m| *m.topic == *topic).count()
}

#[test]
fn aces_as_a_carmen_log() {
    let Some(path) = real_data("lidar2d/aces/aces.clf.bz2") else { return };
    let log = open_text_log(&path).unwrap().unwrap();
    assert_eq!(log.format(), "CARMEN log (bzip2)");
    let (messages, issues) = read_all(&*log);
    assert_eq!(count(&messages, "/scan"), 7374);
    assert_eq!(count(&messages, "/odom"), 7374);
    assert_eq!(count(&messages, "/tf_static"), 1);
    assert!(issues.iter().all(|r| !r.lost_data()), "{issues:?}");
    let Message::LaserScan(scan) = &messages[2].message else { panic!() };
    assert_eq!((scan.angle_min, scan.angle_max), (-1.570_796_4, 1.553_343));
    assert_eq!(
        (scan.angle_increment, scan.range_max, &*scan.header.frame_id),
        (0.017_453_292, 80.0, "laser")
    );
    assert_eq!(scan.header.stamp.to_ros(), (1_000_000_070, 289_899_900));
}

#[test]
fn the_scanner_pose_is_read_from_fr079() {
    let Some(path) = real_data("lidar2d/fr079/fr079.clf.bz2") else { return };
    let log = open_text_log(&path).unwrap().unwrap();
    let (messages, _) = read_all(&*log);
    assert_eq!((count(&messages, "/scan"), count(&messages, "/odom")), (4934, 8951));
    let Message::Tf(tf) = &messages[0].message else { panic!() };
    assert_eq!(tf.transforms[0].transform.position, [-0.04, 0.0, 0.0]);
}

#[test]
fn scans_of_one_time_repeat_only_if_their_readings_do() {
    let scan = |x: f64, time: f64| format!("FLASER 3 1.0 2.0 {x} 0 0 0 0 0 0 {time} host {time}\n");
    let text: String = [(3.0, 5.0), (3.1, 5.0), (3.1, 5.0), (3.2, 6.0)].map(|(x, t)| scan(x, t)).concat();
    let log = open_text_log_bytes(Path::new("a.clf"), text.as_bytes()).unwrap().unwrap();
    let (messages, issues) = read_all(&*log);
    assert_eq!(count(&messages, "/scan"), 3);
    assert!(
        issues.iter().any(|issue| issue.kind == portolan_issue::IssueKind::RepeatedMessage),
        "{issues:?}"
    );
}

#[test]
fn coreslam_logs() {
    for (name, scans) in [("exp1", 756), ("exp2", 641)] {
        let Some(path) = real_data(&format!("lidar2d/coreslam/{name}.dat")) else { return };
        let log = open_text_log(&path).unwrap().unwrap();
        let (messages, issues) = read_all(&*log);
        assert_eq!((count(&messages, "/scan"), count(&messages, "/odom")), (scans, scans));
        assert!(issues.is_empty(), "{issues:?}");
    }
}

#[test]
fn other_text_is_no_log() {
    let directory = tempfile::tempdir().unwrap();
    for text in ["", "hello\n", "1 2 3\n4 5 6\n", "ODOM\n", "\u{1f}\u{8b}\u{8}"] {
        let path = directory.path().join("a.log");
        std::fs::write(&path, text).unwrap();
        assert!(open_text_log(&path).unwrap().is_none(), "{text:?}");
    }
}

/// Tokens as they occur in logs, and others.
fn token() -> impl Strategy<Value = String> {
    prop_oneof![
        4 => "-?[0-9]{1,4}(\\.[0-9]{1,6})?",
        2 => prop::sample::select(vec![
            "FLASER", "RLASER", "ODOM", "ROBOTLASER1", "RAWLASER3", "PARAM", "SYNC", "#", "robot_frontlaser_offset",
            "nan", "inf", "1e400", "180", "3", "0", "-1", "4294967296", "1071078718.462310", "host",
        ]).prop_map(str::to_owned),
        1 => "\\PC{0,8}",
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn random_carmen_text_never_panics(
        lines in prop::collection::vec(prop::collection::vec(token(), 0..30), 0..30),
        gzip in any::<bool>(),
        cut in 0.0..1.0f64,
    ) {
        let mut text = String::from("# CARMEN Logfile\n");
        text.push_str("FLASER 2 1.0 2.0 0 0 0 0 0 0 5.5 host 1.0\n");
        for line in lines {
            text.push_str(&(line.join(" ") + "\n"));
        }
        let mut bytes = text.into_bytes();
        if gzip {
            let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
            encoder.write_all(&bytes).unwrap();
            bytes = encoder.finish().unwrap();
            bytes.truncate((bytes.len() as f64 * cut) as usize);
        }
        if let Ok(Some(log)) = open_text_log_bytes(Path::new("a.clf"), &bytes) {
            read_all(&*log);
        }
    }
}

#[test]
fn a_truncated_log_gives_its_remaining_messages_and_reports_the_loss() {
    let Some(path) = real_data("lidar2d/fr079/fr079.clf.bz2") else { return };
    let bytes = std::fs::read(path).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("cut.clf.bz2");
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let (messages, issues) = read_all(&*open_text_log(&path).unwrap().unwrap());
    let scans = count(&messages, "/scan");
    assert!(scans > 1000 && scans < 4000, "{scans}");
    assert!(issues.iter().any(|r| r.lost_data() && r.text().contains("cut off")), "{issues:?}");
}
