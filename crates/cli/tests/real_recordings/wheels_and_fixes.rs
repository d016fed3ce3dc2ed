//! Odometry and satellite fixes beside real scans: right, and wrong.

use portolan_evaluation::{TimedPose, Trajectory};
use portolan_geometry::{Duration, Rigid3, Time, TransformBuffer};
use portolan_recording::{Header, Message, NavSatFix, Odometry, Pose, RecordedMessage};
use portolan_testing::is_fast;

use super::{error_of, map, read, rewritten};
use crate::common::{portolan_with_code, real, text};

/// Odometry in the frame of a lidar that turns ten times a second, twice a turn.
fn odometry_of(
    scan: &RecordedMessage,
    odom_from_lidar: &impl Fn(Time) -> Option<Rigid3>,
) -> Vec<RecordedMessage> {
    let header = scan.message.header().unwrap();
    let at = |seconds: f64| {
        let stamp = header.stamp + Duration::from_seconds(seconds);
        let pose = odom_from_lidar(stamp)?;
        let [x, y, z, w] = pose.rotation.coords.into();
        let odometry = Odometry {
            header: Header { stamp, frame_id: "odom".into() },
            child_frame_id: header.frame_id.clone(),
            pose: Pose { position: pose.translation.vector.into(), orientation_xyzw: [x, y, z, w] },
            pose_covariance: vec![0.0; 36],
            linear_velocity: [0.0; 3],
            angular_velocity: [0.0; 3],
            twist_covariance: vec![0.0; 36],
        };
        let message = Message::Odometry(odometry);
        Some(RecordedMessage { topic: "/odom".into(), log_time: scan.log_time, message })
    };
    [0.0, 0.05].into_iter().filter_map(at).collect()
}

/// Odometry that says that it stands.
pub(super) fn odometry_that_stands(scan: &RecordedMessage) -> Vec<RecordedMessage> {
    odometry_of(scan, &|_| Some(Rigid3::identity()))
}

/// Error and report of a drive whose odometry measures this in place of the truth.
fn with_odometry(reported: impl Fn(Rigid3) -> Rigid3) -> Option<(f64, String)> {
    let recording = real("lidar3d/kitti_0001.bag")?;
    let truth = read(&real("lidar3d/kitti_0001.truth.tum")?);
    let truth_from_lidar = Rigid3::translation(0.81, -0.32, 0.80);
    let lidar = |pose: &TimedPose| (pose.time, pose.map_from_tracking * truth_from_lidar);
    let poses: TransformBuffer = truth.poses().iter().map(lidar).collect();
    let folder = tempfile::tempdir().unwrap();
    let with_wheels = folder.path().join("wheels.bag");
    rewritten(&recording, &with_wheels, |_, sweep| {
        let odometry = odometry_of(&sweep, &|time| Some(reported(poses.lookup(time)?)));
        odometry.into_iter().chain([sweep]).collect()
    });
    map(&text(&with_wheels), folder.path(), &[]);
    let report = std::fs::read_to_string(folder.path().join("report.json")).unwrap();
    let of_lidar = |(time, pose): (Time, Rigid3)| TimedPose { time, map_from_tracking: pose };
    let truth = Trajectory::new(truth.poses().iter().map(lidar).map(of_lidar)).0;
    Some((error_of(&truth, &read(&text(&folder.path().join("trajectory.tum")))), report))
}

#[test]
fn in_3d_wheels_that_never_move_are_not_used() {
    let Some((error, report)) = with_odometry(|_| Rigid3::identity()) else { return };
    assert!(error <= 1.3 * 0.036, "{error} m");
    assert!(report.contains("odometry_overruled"), "{report}");
}

#[test]
fn in_3d_wheels_of_another_size_are_corrected() {
    if is_fast() {
        return;
    }
    let smaller = |pose: Rigid3| Rigid3::from_parts((0.9 * pose.translation.vector).into(), pose.rotation);
    let Some((error, report)) = with_odometry(smaller) else { return };
    assert!(error <= 1.3 * 0.040, "{error} m");
    assert!(
        report.contains("measures 0.90 times the distance")
            || report.contains("measures 0.91 times the distance"),
        "{report}"
    );
}

/// A fix where the map has the scanner, turned by a quarter, and off by these metres.
fn fix_at(stamp: Time, place: &Rigid3, off: [f64; 2]) -> RecordedMessage {
    const METRES_PER_DEGREE: f64 = 111_132.0;
    let (north, east) = (place.translation.x + off[0], -place.translation.y + off[1]);
    let latitude_degrees = 48.0 + north / METRES_PER_DEGREE;
    let fix = NavSatFix {
        header: Header { stamp, frame_id: "gps".into() },
        status: 0,
        service: 1,
        latitude_degrees,
        longitude_degrees: 11.0 + east / (METRES_PER_DEGREE * 48_f64.to_radians().cos()),
        altitude: 500.0,
        position_covariance: [0.0; 9],
        position_covariance_type: 0,
    };
    RecordedMessage { topic: "/fix".into(), log_time: stamp, message: Message::NavSatFix(fix) }
}

#[test]
fn satellite_fixes_never_make_a_map_worse() {
    if is_fast() {
        return;
    }
    let Some(aces) = real("lidar2d/aces/aces.bag") else { return };
    let folder = tempfile::tempdir().unwrap();
    // Half of the log.
    let some = ["--duration", "600"];
    map(&aces, folder.path(), &[&some[..], &["--all-poses"]].concat());
    let without = read(&text(&folder.path().join("all_poses.tum")));
    let poses: TransformBuffer = without.poses().iter().map(|p| (p.time, p.map_from_tracking)).collect();
    let error = |off: &dyn Fn(usize) -> [f64; 2]| {
        let with_fixes = folder.path().join("fixes.bag");
        let mut scans = 0;
        rewritten(&aces, &with_fixes, |_, message| {
            let scan = match &message.message {
                Message::LaserScan(scan) => Some(scan.header.stamp),
                _ => None,
            };
            scans += usize::from(scan.is_some());
            let fix = scan.and_then(|stamp| Some(fix_at(stamp, &poses.lookup(stamp)?, off(scans))));
            std::iter::once(message).chain(fix).collect()
        });
        let output = folder.path().join("fixes");
        let more = [&some[..], &["--all-poses", "--gnss", "--no-xray", "-q", "--force"]].concat();
        portolan_with_code(0, &[&["map", &text(&with_fixes), "-o", &text(&output)], &more[..]].concat());
        error_of(&without, &read(&text(&output.join("all_poses.tum"))))
    };
    let exact = error(&|_| [0.0; 2]);
    assert!(exact < 0.05, "{exact} m");
    let reflected = error(&|scan| if (1000..1500).contains(&scan) { [3.0, -3.0] } else { [0.0; 2] });
    assert!(reflected < 0.05, "{reflected} m");
    let drifting = error(&|scan| [0.1 * scan as f64, 0.0]);
    assert!(drifting < 0.05, "{drifting} m");
}
