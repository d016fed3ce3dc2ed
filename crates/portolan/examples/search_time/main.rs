//! How long a search of a whole map takes, and its loading: `search_time MAP.pbstream RECORDING [SECONDS]`, on one core.
//!
//! A search is what makes a scan take longest while no place is known. Maps of many submaps for this are made by
//! `scripts/tiled_map.py`. `cargo run --profile quick -p portolan --example search_time -- MAP RECORDING`

use std::error::Error;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

use portolan::geometry::Dimension;
use portolan::ingest::{IngestOptions, Ingestion};
use portolan::localization::{KnownMap, KnownMap2d, KnownMap3d, Localizer, LocalizerSettings};
use portolan::mapfile::{MapLoadSettings, read_map};
use portolan::mapping::{Space2d, Space3d};
use portolan::pipeline::{Preparation, prepare};
use portolan::recording::{Recording, open};

/// Scans that take less than this hold no search, seconds.
const SHORTEST: f64 = 0.02;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, recording, rest @ ..] = arguments.as_slice() else {
        return Err("expected MAP.pbstream RECORDING [SECONDS]".into());
    };
    let seconds = rest.first().map_or(Ok(10.0), |text| text.parse::<f64>())?;
    let recording = open(recording)?;
    let preparation = prepare(recording.as_ref(), &IngestOptions::default(), None)?;
    let begin = Instant::now();
    match preparation.dimension {
        Dimension::TwoD => {
            let graph = read_map::<Space2d>(Path::new(map), &MapLoadSettings::default())?.graph;
            let read = begin.elapsed().as_secs_f64();
            let map = KnownMap2d::new(graph.state())?;
            print_time(graph.state().submaps.len(), read, &begin)?;
            drop(graph);
            search(map, recording.as_ref(), &preparation, seconds)
        }
        Dimension::ThreeD => {
            let graph = read_map::<Space3d>(Path::new(map), &MapLoadSettings::default())?.graph;
            let read = begin.elapsed().as_secs_f64();
            let map = KnownMap3d::new(graph.state())?;
            print_time(graph.state().submaps.len(), read, &begin)?;
            drop(graph);
            search(map, recording.as_ref(), &preparation, seconds)
        }
    }
}

fn print_time(submaps: usize, read: f64, begin: &Instant) -> Result<(), Box<dyn Error>> {
    let made = begin.elapsed().as_secs_f64() - read;
    let mut out = std::io::stdout();
    Ok(writeln!(out, "{submaps} submaps, read in {read:.1} s, made ready for localisation in {made:.1} s")?)
}

/// Localises so many seconds of a recording and lists the scans that took longest.
fn search<M: KnownMap>(
    map: M,
    recording: &dyn Recording,
    preparation: &Preparation,
    seconds: f64,
) -> Result<(), Box<dyn Error>> {
    let ingest = IngestOptions::default();
    let mut ingestion =
        Ingestion::with_plan(recording, preparation.inventory(), preparation.plan.clone(), &ingest)?;
    let sensors = ingestion.sensors().into_iter().collect();
    let settings = LocalizerSettings { threads: 1, ..LocalizerSettings::default() };
    let mut localizer = Localizer::new(map, &preparation.options, &sensors, &settings)?;
    let (mut first, mut took) = (None, Vec::new());
    while let Some((sensor, measurement)) = ingestion.next_measurement()? {
        let time = measurement.time();
        let begin = Instant::now();
        let estimates = localizer.add(&sensor, measurement);
        took.push((begin.elapsed().as_secs_f64(), estimates.last().map(|estimate| estimate.state)));
        if time.seconds_since(*first.get_or_insert(time)) > seconds {
            break;
        }
    }
    took.retain(|(seconds, _)| *seconds > SHORTEST);
    took.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut out = std::io::stdout();
    let longest: Vec<String> = took.iter().take(12).map(|(seconds, _)| format!("{seconds:.2}")).collect();
    let last = took.iter().find_map(|(_, state)| *state);
    Ok(writeln!(out, "longest scans, seconds: {} ({last:?})", longest.join(" "))?)
}
