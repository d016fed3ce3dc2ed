//! Scans whose stamps jitter.
#![allow(clippy::unwrap_used, clippy::panic)]

use portolan::geometry::Duration;
use portolan::ingest::{IngestOptions, StampPolicy};
use portolan::recording::{Message, RecordedMessage, RecordingError, RecordingWriter, create, open_all};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

/// Writes scans with stamps that are off.
struct Jittery {
    inner: Box<dyn RecordingWriter>,
    /// Standard deviation, seconds.
    jitter: f64,
    random: u64,
}

impl RecordingWriter for Jittery {
    fn write(&mut self, message: &RecordedMessage) -> Result<(), RecordingError> {
        let mut message = message.clone();
        if let Message::LaserScan(scan) = &mut message.message {
            // Marsaglia 2003, Xorshift RNGs: spread evenly from -1 to 1.
            self.random ^= self.random << 13;
            self.random ^= self.random >> 7;
            self.random ^= self.random << 17;
            let off = (self.random % 2001) as f64 / 1000.0 - 1.0;
            scan.header.stamp += Duration::from_seconds(3f64.sqrt() * self.jitter * off);
        }
        self.inner.write(&message)
    }

    fn finish(self: Box<Self>) -> Result<(), RecordingError> {
        self.inner.finish()
    }
}

/// The standard deviation that is planned for stamps of scans that are off by so much, seconds.
fn planned(jitter: f64, stamps: StampPolicy) -> Option<f64> {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("drive.bag");
    let options = ScenarioOptions { duration: Some(90.0), ..ScenarioOptions::new(Scene::Office, 3) };
    let drive = Simulation::new(options).unwrap();
    let mut writer = Jittery { inner: create(&bag, None).unwrap(), jitter, random: 1 };
    drive.write_messages(&mut writer).unwrap();
    Box::new(writer).finish().unwrap();
    let recording = open_all(&[bag]).unwrap();
    let ingest = IngestOptions { stamps, ..IngestOptions::default() };
    let plan = portolan::pipeline::prepare(recording.as_ref(), &ingest, None).unwrap().plan;
    let is_noted = plan.notices.iter().any(|notice| notice.text.contains("stamps of /scan jitter"));
    let jitter = plan.range.first().unwrap().source.jitter;
    assert_eq!(is_noted, jitter.is_some());
    jitter.map(|jitter| jitter.noise.of_stamps)
}

#[test]
fn jitter_is_found_by_how_scans_move() {
    assert_eq!(planned(0.0, StampPolicy::Auto), None);
    let found = planned(0.02, StampPolicy::Auto).unwrap();
    assert!((found - 0.02).abs() < 0.003, "{found}");
    assert_eq!(planned(0.02, StampPolicy::AsIs), None);
}
