//! A recording to a folder with map, trajectory, pictures and report, as `portolan map` makes it.
//!
//! `cargo run --release -p portolan --example 01_map_a_recording`

use std::error::Error;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;

use portolan::job::{Event, MapRequest, map};
use portolan::recording::{create, open};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

/// What `cargo run` and the test of the examples call.
pub fn main() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("office.bag");
    simulate(&file)?;

    let mut out = std::io::stdout();
    let recording = open(&file)?;
    // Sensors and options are found out; the fields of the request say what is to be different.
    let request = MapRequest::new(folder.path().join("office_map"));
    let mut seconds = 0.0;
    let finished = map(recording.as_ref(), request, &mut |event| {
        match event {
            Event::Mapping(progress) => seconds = progress.recording_seconds,
            // The same words as the program's; a remark that cannot be printed is no reason to stop.
            Event::Remark(remark) => drop(writeln!(out, "{remark}")),
            _ => {}
        }
        // `Break` ends the run cleanly, and what was mapped is written.
        ControlFlow::Continue(())
    })?;

    writeln!(out, "{seconds:.0} s mapped; data lost: {}", finished.summary.lost_data)?;
    for file in &finished.files {
        writeln!(out, "{}: {} bytes", file.display(), std::fs::metadata(file)?.len())?;
    }
    Ok(())
}

/// An office that a robot with a planar lidar and wheels drives through.
fn simulate(file: &Path) -> Result<(), Box<dyn Error>> {
    let options = ScenarioOptions { duration: Some(20.0), ..ScenarioOptions::new(Scene::Office, 1) };
    let mut writer = create(file, None)?;
    Simulation::new(options)?.write_messages(&mut *writer)?;
    Ok(writer.finish()?)
}
