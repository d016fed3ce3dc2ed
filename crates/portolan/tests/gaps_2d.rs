//! 2D recordings in which scans are missing for a while.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::Path;

use portolan::geometry::nalgebra::Quaternion as Numbers;
use portolan::geometry::{Duration, Quaternion, Rigid3, Time, Vector3};
use portolan::job::{MapRequest, map, unobserved};
use portolan::recording::{
    Message, Pose, RecordedMessage, RecordingError, RecordingWriter, create, open_all,
};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

/// Leaves out scans between two times, while the wheels stall if that is wanted.
struct Gap {
    inner: Box<dyn RecordingWriter>,
    between: [Time; 2],
    /// The last pose of odometry before the gap and in it, if its wheels stall.
    stalled: Option<[Rigid3; 2]>,
}

fn rigid(pose: &Pose) -> Rigid3 {
    let [x, y, z, w] = pose.orientation_xyzw;
    let rotation = Quaternion::from_quaternion(Numbers::new(w, x, y, z));
    Rigid3::from_parts(Vector3::from(pose.position).into(), rotation)
}

impl RecordingWriter for Gap {
    fn write(&mut self, message: &RecordedMessage) -> Result<(), RecordingError> {
        let mut message = message.clone();
        let is_after = |time: Time| message.log_time >= time;
        let [begun, ended] = self.between.map(is_after);
        match (&mut message.message, &mut self.stalled) {
            (Message::LaserScan(_), _) if begun && !ended => return Ok(()),
            (Message::Odometry(odometry), Some([before, within])) => {
                let pose = rigid(&odometry.pose);
                if !begun {
                    *before = pose;
                }
                if !ended {
                    *within = pose;
                }
                let shown = *before * within.inverse() * pose;
                odometry.pose.position = shown.translation.vector.into();
                odometry.pose.orientation_xyzw = shown.rotation.coords.into();
            }
            _ => {}
        }
        self.inner.write(&message)
    }

    fn finish(self: Box<Self>) -> Result<(), RecordingError> {
        self.inner.finish()
    }
}

/// Maps so many seconds of a drive through an office without the scans of eight seconds in the middle. Gives what is
/// reported of that, and the largest error of a pose, metres, as seen from the first one.
fn mapped(seconds: f64, stalls: bool, folder: &Path) -> (serde_json::Value, f64) {
    let options = ScenarioOptions { duration: Some(seconds), ..ScenarioOptions::new(Scene::Office, 3) };
    let drive = Simulation::new(options).unwrap();
    let bag = folder.join("drive.bag");
    let at = |seconds| drive.start_time() + Duration::from_seconds(seconds);
    let mut writer = Gap {
        inner: create(&bag, None).unwrap(),
        between: [at(seconds / 2.0 - 4.0), at(seconds / 2.0 + 4.0)],
        stalled: stalls.then(|| [Rigid3::identity(); 2]),
    };
    drive.write_messages(&mut writer).unwrap();
    Box::new(writer).finish().unwrap();
    let recording = open_all(&[bag]).unwrap();
    let mut request = MapRequest::new(folder);
    request.cloud.file = Some("cloud.ply".into());
    map(recording.as_ref(), request, &mut unobserved).unwrap();
    let report = std::fs::read(folder.join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    // What was seen after the gap is in the cloud, too.
    let [points, left_out] =
        ["points", "outside_trajectory"].map(|key| report["cloud"]["unwound"][key].as_f64().unwrap());
    assert!(left_out < 0.02 * points, "{}", report["cloud"]);
    let trajectory = std::fs::read_to_string(folder.join("trajectory.tum")).unwrap();
    let poses = trajectory.lines().map(|line| {
        let n: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
        let rotation = Quaternion::from_quaternion(Numbers::new(n[7], n[4], n[5], n[6]));
        (Time::from_unix_seconds(n[0]), Rigid3::from_parts(Vector3::new(n[1], n[2], n[3]).into(), rotation))
    });
    let poses: Vec<_> = poses.collect();
    let world_from_map = drive.truth_at(poses[0].0).unwrap() * poses[0].1.inverse();
    let error = |(time, pose): &(Time, Rigid3)| {
        let truth = drive.truth_at(*time)?;
        Some((truth.translation.vector - (world_from_map * pose).translation.vector).norm())
    };
    let lost = report["lost"].as_array().unwrap();
    assert!(lost.len() == 1 && lost[0]["is_gap_without_scans"] == true, "{lost:?}");
    (lost[0].clone(), poses.iter().filter_map(error).fold(0.0, f64::max))
}

#[test]
fn what_follows_a_gap_is_tied_by_scans_whether_the_wheels_stalled_or_not() {
    for stalls in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let (lost, error) = mapped(150.0, stalls, folder.path());
        println!("{lost} {error}");
        assert!(lost["is_connected"] == true && lost["is_tied_by_odometry_alone"] == false, "{lost}");
        assert!(error < 0.12, "{stalls}: {error}");
    }
}
