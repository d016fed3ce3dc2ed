//! What a planar scanner on a vehicle sees: slices of real 3D drives; and gaps in them.

use std::f32::consts::{PI, TAU};
use std::ops::Range;
use std::path::Path;

use portolan_geometry::Duration;
use portolan_recording::{LaserScan, Message, RecordedMessage};

use super::wheels_and_fixes::odometry_that_stands;
use super::{error_of, map, read, rewritten};
use crate::common::{portolan_with_code, real, text};

/// The planar scanner that a 3D lidar contains: the nearest points at the height of the lidar. KITTI's turns are clockwise from
/// behind, with the stamp in their middle.
fn scan_2d(message: RecordedMessage) -> Option<RecordedMessage> {
    const BEAMS: usize = 720;
    const PERIOD: f32 = 0.1036;
    let RecordedMessage { log_time, message: Message::PointCloud2(cloud), .. } = message else { return None };
    let at = |name: &str| cloud.fields.iter().find(|field| field.name == name).unwrap().offset as usize;
    let offsets = [at("x"), at("y"), at("z")];
    let step = TAU / BEAMS as f32;
    let mut ranges = vec![f32::INFINITY; BEAMS];
    for point in cloud.data.chunks_exact(cloud.point_step as usize) {
        let [x, y, z] = offsets.map(|at| f32::from_le_bytes(point[at..at + 4].try_into().unwrap()));
        let range = x.hypot(y);
        let beam = ((PI - y.atan2(x)) / step) as usize % BEAMS;
        if (1.0..80.0).contains(&range) && (z / range).abs() < 0.25_f32.to_radians().tan() {
            ranges[beam] = ranges[beam].min(range);
        }
    }
    let mut header = cloud.header;
    header.stamp -= Duration::from_seconds(0.5 * f64::from(PERIOD));
    let scan = LaserScan {
        header,
        angle_min: PI - 0.5 * step,
        angle_max: 0.5 * step - PI,
        angle_increment: -step,
        time_increment: PERIOD / BEAMS as f32,
        scan_time: PERIOD,
        range_min: 0.5,
        range_max: 80.0,
        ranges,
        intensities: Vec::new(),
    };
    Some(RecordedMessage { topic: "/scan".into(), log_time, message: Message::LaserScan(scan) })
}

/// Drives that begin at 4 or 13 m/s are followed by what is made of each scan of their planar slices.
fn assert_followed(made_of: impl Fn(RecordedMessage) -> Vec<RecordedMessage>) {
    for (name, measured) in [("kitti_0005", 0.107), ("kitti_0001", 0.088)] {
        let Some(recording) = real(&format!("lidar3d/{name}.bag")) else { return };
        let truth = read(&real(&format!("lidar3d/{name}.truth.tum")).unwrap());
        let folder = tempfile::tempdir().unwrap();
        let planar = folder.path().join("planar.bag");
        rewritten(&recording, &planar, |_, message| scan_2d(message).map(&made_of).unwrap_or_default());
        map(&text(&planar), folder.path(), &[]);
        let error = error_of(&truth, &read(&text(&folder.path().join("trajectory.tum"))));
        assert!(error <= 1.3 * measured, "{name}: {error} m");
    }
}

#[test]
fn a_start_at_speed_is_found_by_a_planar_scanner() {
    assert_followed(|scan| vec![scan]);
}

#[test]
fn wheels_that_never_move_are_not_used() {
    assert_followed(|scan| odometry_that_stands(&scan).into_iter().chain([scan]).collect());
}

/// What is left of a recording without the sweeps of a gap and those from an end on, of a planar scanner or of the lidar itself.
fn with_gap(recording: &str, is_planar: bool, gap: &Range<usize>, end: usize, output: &Path) {
    let mut sweeps = 0..;
    rewritten(recording, output, |_, message| {
        let Message::PointCloud2(_) = &message.message else { return Vec::new() };
        let is_kept = sweeps.next().is_some_and(|sweep| sweep < end && !gap.contains(&sweep));
        let message = is_kept.then_some(message);
        if is_planar { message.and_then(scan_2d) } else { message }.into_iter().collect()
    });
}

/// 2.3 s at 4.5 m/s.
#[test]
fn tracking_by_a_planar_scanner_continues_after_a_gap() {
    let Some(recording) = real("lidar3d/kitti_0005.bag") else { return };
    let truth = read(&real("lidar3d/kitti_0005.truth.tum").unwrap());
    let folder = tempfile::tempdir().unwrap();
    let cut = folder.path().join("cut.bag");
    with_gap(&recording, true, &(20..43), 49, &cut);
    let output = text(&folder.path().join("out"));
    portolan_with_code(0, &["map", &text(&cut), "-o", &output, "-q", "--no-xray"]);
    let error = error_of(&truth, &read(&text(&Path::new(&output).join("trajectory.tum"))));
    assert!(error <= 1.3 * 0.186, "{error} m");
}

/// After 2.5 s at 13 m/s, or after ten seconds of a walk in 3D (simulated), scans fit nothing until the recording ends half a second
/// later.
#[test]
fn a_recording_that_ends_lost_is_reported() {
    for (name, is_planar, gap, end) in [("kitti_0001", true, 20..45, 51), ("walk", false, 100..200, 206)] {
        let Some(recording) = real(&format!("lidar3d/{name}.bag")) else { return };
        let folder = tempfile::tempdir().unwrap();
        let cut = folder.path().join("cut.bag");
        with_gap(&recording, is_planar, &gap, end, &cut);
        let output = text(&folder.path().join("out"));
        let run = portolan_with_code(3, &["map", &text(&cut), "-o", &output, "--no-xray"]);
        assert!(
            run.stdout.contains("have no pose; the trajectory ends there"),
            "{name}: {}{}",
            run.stdout,
            run.stderr
        );
        let report = std::fs::read(Path::new(&output).join("report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
        let lost = report["lost"].as_array().unwrap();
        assert!(matches!(&lost[..], [lost] if lost["trajectory"].is_null()), "{name}: {lost:?}");
        assert!(lost[0]["scans_without_pose"].as_u64() > Some(0), "{name}: {lost:?}");
        let last = read(&text(&Path::new(&output).join("trajectory.tum"))).poses().last().unwrap().time;
        assert!(last.unix_seconds() < lost[0]["from"].as_f64().unwrap(), "{name}: {lost:?}, {last}");
    }
}
