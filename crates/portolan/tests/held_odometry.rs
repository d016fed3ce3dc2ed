//! Odometry that repeats its last pose while the robot moves.
#![allow(clippy::unwrap_used, clippy::panic)]

use portolan::ingest::IngestOptions;
use portolan::issue::IssueKind;
use portolan::recording::{
    Message, Odometry, RecordedMessage, RecordingError, RecordingWriter, create, open_all,
};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

/// Writes odometry whose pose is renewed every so many messages alone.
struct HoldingBack {
    inner: Box<dyn RecordingWriter>,
    messages: usize,
    count: usize,
    held: Option<Odometry>,
}

impl RecordingWriter for HoldingBack {
    fn write(&mut self, message: &RecordedMessage) -> Result<(), RecordingError> {
        let mut message = message.clone();
        if let Message::Odometry(odometry) = &mut message.message {
            if self.count.is_multiple_of(self.messages) {
                self.held = Some(odometry.clone());
            }
            self.count += 1;
            if let Some(held) = &self.held {
                odometry.pose = held.pose;
            }
        }
        self.inner.write(&message)
    }

    fn finish(self: Box<Self>) -> Result<(), RecordingError> {
        self.inner.finish()
    }
}

/// For how many seconds odometry is found to hold motions back if it renews its pose every so many messages, and how many were left
/// out of how many.
fn found(messages: usize, asked_for: Option<&str>) -> (Option<f64>, u64, usize) {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("drive.bag");
    let options = ScenarioOptions { duration: Some(60.0), ..ScenarioOptions::new(Scene::Office, 3) };
    let drive = Simulation::new(options).unwrap();
    let mut writer = HoldingBack { inner: create(&bag, None).unwrap(), messages, count: 0, held: None };
    drive.write_messages(&mut writer).unwrap();
    let written = writer.count;
    Box::new(writer).finish().unwrap();
    let recording = open_all(&[bag]).unwrap();
    let ingest = IngestOptions { odometry_topic: asked_for.map(str::to_owned), ..IngestOptions::default() };
    let prepared = portolan::pipeline::prepare(recording.as_ref(), &ingest, None).unwrap();
    let plan = prepared.plan.clone();
    let is_noted = plan.notices.iter().any(|notice| notice.text.contains("repeats its last pose"));
    assert_eq!(is_noted, messages > 1);
    let hold = plan.longest_odometry_hold;
    let mut ingestion =
        portolan::ingest::Ingestion::with_plan(recording.as_ref(), prepared.inventory(), plan, &ingest)
            .unwrap();
    while ingestion.next_measurement().unwrap().is_some() {}
    let issues = ingestion.issues();
    let repeats =
        issues.iter().filter(|issue| issue.kind == IssueKind::OdometryRepeats).map(|i| i.count).sum();
    (hold, repeats, written)
}

#[test]
fn repeated_odometry_is_ignored_while_scans_move() {
    let (hold, left_out, _) = found(1, None);
    assert_eq!((hold, left_out), (None, 0));
    // 50 messages a second.
    let (hold, left_out, written) = found(50, None);
    let (hold, left_out) = (hold.unwrap(), left_out as f64);
    assert!((hold - 1.0).abs() < 0.05, "{hold}");
    assert!((left_out / written as f64 - 0.98).abs() < 0.01, "{left_out} of {written}");
    let (hold, left_out, _) = found(50, Some("/odom"));
    assert_eq!((hold, left_out), (None, 0));
}
