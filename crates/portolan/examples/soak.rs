//! Hours of simulated drives through one office, mapped and localised at full speed: memory and latency over time.
//!
//! `cargo run --release -p portolan --example soak -- HOURS`, a third of an hour unless told. Each row is of the same number of measurements of lidar and wheels;
//! latencies are those from one measurement to the next, with what the simulator takes to make them.

use std::error::Error;
use std::io::{Stdout, Write, stdout};
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use portolan::RequestedOptions;
use portolan::ingest::IngestOptions;
use portolan::job::{
    Event, LocalizeRequest, MapRequest, Observer, localize, map, resident_and_peak_bytes, unobserved,
};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

/// Measurements of one row.
const ROW: usize = 5000;
/// Seconds of the drive whose map is localised in.
const KNOWN_SECONDS: f64 = 240.0;

/// What `cargo run` calls.
pub fn main() -> Result<(), Box<dyn Error>> {
    let hours: f64 = std::env::args().nth(1).map_or(Ok(1.0 / 3.0), |text| text.parse())?;
    let folder = tempfile::tempdir()?;
    let known = folder.path().join("known");
    map(&drive(1, KNOWN_SECONDS)?, MapRequest::new(&known), &mut unobserved)?;
    let long = drive(2, 3600.0 * hours)?;
    let mut rows = Rows::begin("localise")?;
    localize(&long, &request(&known.join("map.pbstream")), &mut observer(&mut rows))?;
    rows.end()?;
    let mut rows = Rows::begin("map")?;
    map(&long, MapRequest::new(folder.path().join("mapped")), &mut observer(&mut rows))?;
    rows.end()
}

fn drive(day: u64, seconds: f64) -> Result<Simulation, Box<dyn Error>> {
    let options = ScenarioOptions {
        building_seed: Some(1),
        duration: Some(seconds),
        people: Some(2),
        ..ScenarioOptions::new(Scene::Office, day)
    };
    Ok(Simulation::new(options)?)
}

fn request(map: &Path) -> LocalizeRequest {
    LocalizeRequest {
        map: map.to_owned(),
        folder: map.with_extension("localised"),
        ingest: IngestOptions::default(),
        requested: RequestedOptions::default(),
        start: None,
        jumps: None,
        save_map: None,
        threads: 1,
    }
}

/// Gaps between measurements, row by row.
struct Rows {
    out: Stdout,
    begin: Instant,
    last: Instant,
    total: usize,
    milliseconds: Vec<f64>,
}

impl Rows {
    fn begin(what: &str) -> std::io::Result<Self> {
        let mut out = stdout();
        writeln!(out, "{what}: measurements, wall s, memory MB, most MB, latency ms: median, 99 %, most")?;
        Ok(Self { out, begin: Instant::now(), last: Instant::now(), total: 0, milliseconds: Vec::new() })
    }

    fn add(&mut self) -> std::io::Result<()> {
        self.milliseconds.push(1e3 * self.last.elapsed().as_secs_f64());
        self.total += 1;
        if self.milliseconds.len() == ROW {
            self.write()?;
        }
        self.last = Instant::now();
        Ok(())
    }

    fn write(&mut self) -> std::io::Result<()> {
        let mut sorted = std::mem::take(&mut self.milliseconds);
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| {
            sorted.get((share * (sorted.len().max(1) - 1) as f64) as usize).copied().unwrap_or(0.0)
        };
        let (now, most) = resident_and_peak_bytes().unwrap_or_default();
        let megabytes = |bytes: u64| bytes as f64 / 1e6;
        let seconds = self.begin.elapsed().as_secs_f64();
        write!(self.out, "{:8} {seconds:8.1} {:8.1} {:8.1}", self.total, megabytes(now), megabytes(most))?;
        writeln!(self.out, " {:8.2} {:8.2} {:8.2}", at(0.5), at(0.99), at(1.0))
    }

    fn end(mut self) -> Result<(), Box<dyn Error>> {
        if !self.milliseconds.is_empty() {
            self.write()?;
        }
        Ok(())
    }
}

fn observer(rows: &mut Rows) -> Box<Observer<'_>> {
    Box::new(move |event| {
        let is_measurement = matches!(event, Event::Localizing { .. } | Event::Mapping(_));
        if is_measurement && rows.add().is_err() {
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    })
}
