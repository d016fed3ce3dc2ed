//! Odometry in other units or of another frame than said, before anything is mapped.
#![allow(clippy::unwrap_used, clippy::panic)]

use portolan::geometry::{Rigid2, Rigid3, embed_3d, pose_from_xyz_quaternion, project_2d};
use portolan::ingest::IngestOptions;
use portolan::recording::{
    Message, Pose, RecordedMessage, RecordingError, RecordingWriter, create, open_all,
};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

/// Writes odometry with its poses changed.
struct DistortedOdometry {
    inner: Box<dyn RecordingWriter>,
    distort: fn(Rigid2) -> Rigid2,
}

fn rigid(pose: &Pose) -> Rigid3 {
    pose_from_xyz_quaternion(pose.position, pose.orientation_xyzw).unwrap()
}

impl RecordingWriter for DistortedOdometry {
    fn write(&mut self, message: &RecordedMessage) -> Result<(), RecordingError> {
        let mut message = message.clone();
        if let Message::Odometry(odometry) = &mut message.message {
            let pose = embed_3d(&(self.distort)(project_2d(&rigid(&odometry.pose))));
            odometry.pose.position = pose.translation.vector.into();
            odometry.pose.orientation_xyzw = pose.rotation.coords.into();
        }
        self.inner.write(&message)
    }

    fn finish(self: Box<Self>) -> Result<(), RecordingError> {
        self.inner.finish()
    }
}

/// What is said of odometry before a drive through an office is mapped, and whether it is used.
fn notices_of(distort: fn(Rigid2) -> Rigid2, ingest: &IngestOptions) -> (String, bool) {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("drive.bag");
    let options = ScenarioOptions { duration: Some(90.0), ..ScenarioOptions::new(Scene::Office, 3) };
    let drive = Simulation::new(options).unwrap();
    let mut writer = DistortedOdometry { inner: create(&bag, None).unwrap(), distort };
    drive.write_messages(&mut writer).unwrap();
    Box::new(writer).finish().unwrap();
    let recording = open_all(&[bag]).unwrap();
    let plan = portolan::pipeline::prepare(recording.as_ref(), ingest, None).unwrap().plan;
    let notices =
        plan.notices.iter().map(|notice| notice.text.as_str()).filter(|what| what.contains("scans"));
    (notices.collect::<Vec<_>>().join("\n"), plan.odometry.is_some())
}

/// The same motions as seen from a frame that is turned by a quarter.
fn turned(pose: Rigid2) -> Rigid2 {
    let quarter = Rigid2::new(0.0, 0.0, std::f64::consts::FRAC_PI_2);
    quarter.inverse() * pose * quarter
}

#[test]
fn odometry_that_contradicts_scans_is_reported_and_left_out() {
    let free = IngestOptions::default();
    assert_eq!(notices_of(|pose| pose, &free), (String::new(), true));
    for (distort, words) in [
        (turned as fn(Rigid2) -> Rigid2, "times the distance of scans, 90° to the right of them"),
        (
            |pose| Rigid2::new(pose.translation.x, -pose.translation.y, -pose.angle),
            "rotates opposite to scans",
        ),
        (|_| Rigid2::identity(), "does not move while scans do: it is left out"),
        (
            |pose| Rigid2 { translation: pose.translation * 100.0, ..pose },
            "times the distance of scans: it is left out",
        ),
    ] {
        let (notices, is_used) = notices_of(distort, &free);
        assert!(notices.contains(words) && !is_used, "{words}: {notices}");
    }
    let wanted = IngestOptions { odometry_topic: Some("/odom".to_owned()), ..free };
    let (notices, is_used) = notices_of(turned, &wanted);
    assert!(notices.contains("it is used all the same") && is_used, "{notices}");
}
