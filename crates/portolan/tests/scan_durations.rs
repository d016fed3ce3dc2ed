//! Scans that take as long as a turn of the scanner but do not say so.
#![allow(clippy::unwrap_used, clippy::panic)]

use portolan::ingest::IngestOptions;
use portolan::recording::{Message, RecordedMessage, RecordingError, RecordingWriter, create, open_all};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

/// Writes scans without the times of their beams.
struct Silent {
    inner: Box<dyn RecordingWriter>,
    is_silent: bool,
}

impl RecordingWriter for Silent {
    fn write(&mut self, message: &RecordedMessage) -> Result<(), RecordingError> {
        let mut message = message.clone();
        if let (Message::LaserScan(scan), true) = (&mut message.message, self.is_silent) {
            scan.time_increment = 0.0;
        }
        self.inner.write(&message)
    }

    fn finish(self: Box<Self>) -> Result<(), RecordingError> {
        self.inner.finish()
    }
}

/// How long scans are taken to last that take 0.1 s, if not as long as they say.
fn planned(is_silent: bool, ingest: &IngestOptions) -> Option<f64> {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("drive.bag");
    let options = ScenarioOptions { duration: Some(90.0), ..ScenarioOptions::new(Scene::Office, 3) };
    let drive = Simulation::new(options).unwrap();
    let mut writer = Silent { inner: create(&bag, None).unwrap(), is_silent };
    drive.write_messages(&mut writer).unwrap();
    Box::new(writer).finish().unwrap();
    let recording = open_all(&[bag]).unwrap();
    let plan = portolan::pipeline::prepare(recording.as_ref(), ingest, None).unwrap().plan;
    let is_noted = plan.notices.iter().any(|notice| notice.text.contains("scans of /scan are taken to last"));
    let duration = plan.range.first().unwrap().scan_duration;
    assert_eq!(is_noted, duration.is_some_and(|seconds| seconds > 0.0));
    duration
}

#[test]
fn beam_times_follow_from_rotations() {
    let free = IngestOptions::default();
    assert_eq!(planned(false, &free), None);
    let found = planned(true, &free).unwrap();
    assert!((found - 0.1).abs() < 0.015, "{found}");
    let recorded = IngestOptions { azimuth_times: portolan::ingest::AzimuthTimes::Recorded, ..free.clone() };
    assert_eq!(planned(true, &recorded), None);
    let off = IngestOptions { azimuth_times: portolan::ingest::AzimuthTimes::Off, ..free };
    assert_eq!(planned(false, &off), Some(0.0));
}
