//! A recording as messages, and as measurements in one frame.
//!
//! `cargo run --release -p portolan --example 05_read_a_recording`

use std::error::Error;
use std::io::Write;
use std::path::Path;

use portolan::ingest::{IngestOptions, Ingestion};
use portolan::recording::{Message, create, open};
use portolan::sensor::Measurement;
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

/// What `cargo run` and the test of the examples call.
pub fn main() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("office.mcap");
    simulate(&file)?;

    // The format is recognised by the content: bags, MCAP, packets, KITTI, CARMEN …
    let mut out = std::io::stdout();
    let recording = open(&file)?;
    writeln!(out, "{}", recording.format())?;
    for topic in recording.topics() {
        writeln!(out, "{} ({}): {:?} messages", topic.topic, topic.type_name, topic.count)?;
    }

    // Messages as they were recorded; topics that are not wanted are not decoded.
    let mut reader = recording.read(&|topic| &*topic.type_name == "sensor_msgs/LaserScan")?;
    let mut beams = 0;
    while let Some(message) = reader.next_message()? {
        if let Message::LaserScan(scan) = message.message {
            beams += scan.ranges.len();
        }
    }
    writeln!(out, "{beams} beams")?;
    // Damage is no error as long as something can be read: it is repaired and counted.
    for issue in reader.issues() {
        writeln!(out, "{issue} ({} times)", issue.count)?;
    }

    // What the messages mean: points with times, in metres, in the tracking frame.
    let ingestion = Ingestion::new(recording.as_ref(), &IngestOptions::default())?;
    for notice in &ingestion.plan().notices {
        writeln!(out, "{}", notice.text)?;
    }
    let mut points = 0;
    for measurement in ingestion {
        let (_sensor, measurement) = measurement?;
        if let Measurement::Range(sweep) = measurement {
            points += sweep.points_in_tracking.len();
        }
    }
    writeln!(out, "{points} points")?;
    Ok(())
}

/// An office that a robot with a planar lidar and wheels drives through.
fn simulate(file: &Path) -> Result<(), Box<dyn Error>> {
    let options = ScenarioOptions { duration: Some(10.0), ..ScenarioOptions::new(Scene::Office, 1) };
    let mut writer = create(file, None)?;
    Simulation::new(options)?.write_messages(&mut *writer)?;
    Ok(writer.finish()?)
}
