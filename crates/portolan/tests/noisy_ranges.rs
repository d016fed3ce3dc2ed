//! A planar scanner whose readings are noisy, or broken by dust.
#![allow(clippy::unwrap_used, clippy::panic)]

use portolan::ingest::{IngestOptions, Ingestion, RangeNoise};
use portolan::numeric::SplitMix64;
use portolan::recording::{Message, RecordedMessage, RecordingError, RecordingWriter, create, open_all};
use portolan::sensor::Measurement;
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

/// What becomes of readings.
#[derive(Clone, Copy)]
enum Fault {
    None,
    /// Noise with this standard deviation, metres.
    Noise(f64),
    /// This share of the readings ends before the wall.
    Dust(f64),
}

struct Spoiling {
    inner: Box<dyn RecordingWriter>,
    fault: Fault,
    random: SplitMix64,
}

impl Spoiling {
    fn spoilt(&mut self, range: f32) -> f32 {
        let mut uniform = || self.random.uniform();
        match self.fault {
            Fault::Noise(sigma) => range + (sigma * ((0..12).map(|_| uniform()).sum::<f64>() - 6.0)) as f32,
            Fault::Dust(share) if uniform() < share => (0.2 + uniform()) as f32,
            Fault::None | Fault::Dust(_) => range,
        }
    }
}

impl RecordingWriter for Spoiling {
    fn write(&mut self, message: &RecordedMessage) -> Result<(), RecordingError> {
        let mut message = message.clone();
        if let Message::LaserScan(scan) = &mut message.message {
            scan.range_min = 0.0;
            for range in scan.ranges.iter_mut().filter(|range| range.is_finite()) {
                *range = self.spoilt(*range).max(0.1);
            }
        }
        self.inner.write(&message)
    }

    fn finish(self: Box<Self>) -> Result<(), RecordingError> {
        self.inner.finish()
    }
}

/// The noise that readings are smoothed for, metres, and the distances of all points from the scanner.
fn ingested(fault: Fault, range_noise: RangeNoise) -> (Option<f64>, Vec<Vec<f64>>) {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("drive.bag");
    let options = ScenarioOptions { duration: Some(20.0), ..ScenarioOptions::new(Scene::Office, 3) };
    let inner = create(&bag, None).unwrap();
    let mut writer = Spoiling { inner, fault, random: SplitMix64::new(5) };
    Simulation::new(options).unwrap().write_messages(&mut writer).unwrap();
    Box::new(writer).finish().unwrap();
    let recording = open_all(&[bag]).unwrap();
    let ingest = IngestOptions { range_noise, ..IngestOptions::default() };
    let prepared = portolan::pipeline::prepare(recording.as_ref(), &ingest, None).unwrap();
    let plan = prepared.plan.clone();
    let noise = plan.range.first().unwrap().range_noise;
    let is_noted = plan.notices.iter().any(|notice| notice.text.contains("smoothed along walls"));
    assert_eq!(is_noted, noise.is_some() && range_noise == RangeNoise::Auto);
    let mut ingestion =
        Ingestion::with_plan(recording.as_ref(), prepared.inventory(), plan, &ingest).unwrap();
    let mut scans = Vec::new();
    while let Some(measurement) = ingestion.next_measurement().unwrap() {
        if let Measurement::Range(data) = measurement.1 {
            let distance =
                |p: &portolan::sensor::TimedPoint| f64::from((p.position - data.origin_in_tracking).norm());
            scans.push(data.points_in_tracking.iter().map(distance).collect());
        }
    }
    (noise, scans)
}

/// Median of the absolute differences of distances, metres.
fn difference(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    let same = a.iter().zip(b).filter(|(a, b)| a.len() == b.len());
    let mut differences: Vec<f64> =
        same.flat_map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).abs())).collect();
    assert!(differences.len() > 10_000);
    portolan::numeric::median(&mut differences).unwrap()
}

#[test]
fn noisy_readings_are_smoothed_and_others_are_not() {
    let (noise, right) = ingested(Fault::None, RangeNoise::Auto);
    assert_eq!(noise, None);
    assert_eq!(ingested(Fault::Dust(0.2), RangeNoise::Auto).0, None);
    let (noise, smoothed) = ingested(Fault::Noise(0.1), RangeNoise::Auto);
    let noise = noise.unwrap();
    assert!((0.09..0.13).contains(&noise), "{noise}");
    let (_, noisy) = ingested(Fault::Noise(0.1), RangeNoise::Fixed(0.0));
    let (before, after) = (difference(&noisy, &right), difference(&smoothed, &right));
    assert!((before - 0.067).abs() < 0.01 && after < 0.6 * before, "{before} {after}");
}
