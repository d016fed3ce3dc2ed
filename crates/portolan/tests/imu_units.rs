//! Gyroscopes in degrees a second that turn so gently that their values could be radians.
#![allow(clippy::unwrap_used, clippy::panic)]

use portolan::ingest::IngestOptions;
use portolan::recording::{Message, RecordedMessage, RecordingError, RecordingWriter, create, open_all};
use portolan::simulator::{Scenario3dOptions, Simulation3d};
use portolan::worlds::three_d::Scene3d;

/// Writes rates of the gyroscope that are so many times as large.
struct Scaled {
    inner: Box<dyn RecordingWriter>,
    factor: f64,
}

impl RecordingWriter for Scaled {
    fn write(&mut self, message: &RecordedMessage) -> Result<(), RecordingError> {
        let mut message = message.clone();
        if let Message::Imu(imu) = &mut message.message {
            imu.angular_velocity.iter_mut().for_each(|rate| *rate *= self.factor);
        }
        self.inner.write(&message)
    }

    fn finish(self: Box<Self>) -> Result<(), RecordingError> {
        self.inner.finish()
    }
}

/// Whether the IMU is used, and what is said of it, where its rates are so many times as large.
fn planned(factor: f64) -> (bool, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("drive.bag");
    let mut options = Scenario3dOptions::new(Scene3d::Tunnel, 1, 1);
    options.duration = Some(20.0);
    for lidar in &mut options.lidars {
        lidar.beams.columns = 450;
    }
    let mut writer = Scaled { inner: create(&bag, None).unwrap(), factor };
    Simulation3d::new(options).unwrap().write_messages(&mut writer).unwrap();
    Box::new(writer).finish().unwrap();
    let recording = open_all(&[bag]).unwrap();
    let plan = portolan::pipeline::prepare(recording.as_ref(), &IngestOptions::default(), None).unwrap().plan;
    (plan.imu.is_some(), plan.notices.into_iter().map(|notice| notice.what).collect())
}

#[test]
fn a_gyroscope_in_degrees_is_told_by_sweeps() {
    let (is_used, said) = planned(1f64.to_degrees());
    assert!(!is_used && said.iter().any(|what| what.contains("57.30 times as fast")), "{said:?}");
    let (is_used, said) = planned(1.0);
    assert!(is_used && !said.iter().any(|what| what.contains("times as fast")), "{said:?}");
}
