//! IMUs in other units, with other signs, and mounted differently from the transforms, as rotations of lidars
//! show.
#![allow(clippy::unwrap_used, clippy::panic)]

use portolan::geometry::{Vector3, quaternion_from_angle_axis};
use portolan::ingest::{IngestOptions, PlannedImu};
use portolan::recording::{Imu, Message, RecordedMessage, RecordingError, RecordingWriter, create, open_all};
use portolan::simulator::{Scenario3dOptions, ScenarioOptions, Simulation, Simulation3d};
use portolan::worlds::three_d::Scene3d;
use portolan::worlds::two_d::Scene;

/// Writes other samples of the IMU.
struct Changed {
    inner: Box<dyn RecordingWriter>,
    change: fn(&mut Imu),
}

impl RecordingWriter for Changed {
    fn write(&mut self, message: &RecordedMessage) -> Result<(), RecordingError> {
        let mut message = message.clone();
        if let Message::Imu(imu) = &mut message.message {
            (self.change)(imu);
        }
        self.inner.write(&message)
    }

    fn finish(self: Box<Self>) -> Result<(), RecordingError> {
        self.inner.finish()
    }
}

enum World {
    Office,
    Tunnel,
    Museum,
}

/// The IMU as it is used, and what is said, where its samples are changed so.
fn planned(world: &World, change: fn(&mut Imu)) -> (Option<PlannedImu>, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("drive.bag");
    let mut writer = Changed { inner: create(&bag, None).unwrap(), change };
    let in_3d = |scene| {
        let mut options = Scenario3dOptions::new(scene, 1, 1);
        options.duration = Some(20.0);
        options.lidars.iter_mut().for_each(|lidar| lidar.beams.columns = 450);
        Simulation3d::new(options).unwrap()
    };
    let written = match world {
        World::Office => {
            let options = ScenarioOptions { duration: Some(60.0), ..ScenarioOptions::new(Scene::Office, 3) };
            Simulation::new(options).unwrap().write_messages(&mut writer)
        }
        World::Tunnel => in_3d(Scene3d::Tunnel).write_messages(&mut writer),
        World::Museum => in_3d(Scene3d::Museum).write_messages(&mut writer),
    };
    written.unwrap();
    Box::new(writer).finish().unwrap();
    let recording = open_all(&[bag]).unwrap();
    let plan = portolan::pipeline::prepare(recording.as_ref(), &IngestOptions::default(), None).unwrap().plan;
    (plan.imu, plan.notices.into_iter().map(|notice| notice.text).collect())
}

fn scale(imu: &mut Imu, factor: f64) {
    imu.angular_velocity.iter_mut().for_each(|rate| *rate *= factor);
}

/// Ones that turn so gently that their values could be radians.
#[test]
fn a_gyroscope_in_degrees_is_detected_by_rotations_of_the_lidar() {
    for world in [World::Tunnel, World::Office] {
        let (imu, notices) = planned(&world, |imu| scale(imu, 1f64.to_degrees()));
        assert_eq!(imu.unwrap().scale.angular_velocity, 1f64.to_radians(), "{notices:?}");
        assert!(notices.iter().any(|what| what.contains("in degrees per second")), "{notices:?}");
        let (imu, notices) = planned(&world, |_| {});
        assert_eq!(imu.unwrap().scale.angular_velocity, 1.0);
        assert!(!notices.iter().any(|what| what.contains("times as fast")), "{notices:?}");
    }
}

#[test]
fn a_gyroscope_with_the_opposite_sign_of_planar_scans_is_left_out() {
    let (imu, notices) = planned(&World::Office, |imu| scale(imu, -1.0));
    assert!(imu.is_none() && notices.iter().any(|what| what.contains("rotates opposite to")), "{notices:?}");
}

#[test]
fn an_imu_that_is_mounted_askew_is_turned_as_the_lidar_shows() {
    let (imu, notices) = planned(&World::Museum, |imu| {
        let askew = quaternion_from_angle_axis(&(Vector3::x() * 8f64.to_radians()));
        for vector in [&mut imu.angular_velocity, &mut imu.linear_acceleration] {
            *vector = (askew * Vector3::from(*vector)).into();
        }
    });
    let left =
        imu.unwrap().correction.inverse() * quaternion_from_angle_axis(&(Vector3::x() * -8f64.to_radians()));
    assert!(left.angle().to_degrees() < 1.0, "{}: {notices:?}", left.angle().to_degrees());
    assert!(
        notices.iter().any(|what| what.contains("against its mounting in the transforms")),
        "{notices:?}"
    );
    let (imu, notices) = planned(&World::Museum, |_| {});
    assert_eq!(imu.unwrap().correction.angle(), 0.0, "{notices:?}");
}
