//! A second recording localised in the map of a first one, which stays as it is.
//!
//! `cargo run --release -p portolan --example 04_localise_in_a_map`

use std::error::Error;
use std::io::Write;

use portolan::job::{Job, KnownMaps, Localisation, MapRequest, map, unobserved};
use portolan::mapfile::FrozenTrajectories;
use portolan::mapping::Space2d;
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

/// What `cargo run` and the test of the examples call.
pub fn main() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let first_day = folder.path().join("first_day");
    let recording = simulate(1, 60.0)?;
    map(&recording, MapRequest::new(&first_day), &mut unobserved)?;
    // The map begins where the robot was on the first day.
    let world_from_map = recording.truth_at(recording.start_time()).ok_or("the simulation has no start")?;

    let known = KnownMaps {
        files: vec![first_day.join("map.pbstream")],
        frozen: FrozenTrajectories::All,
        // Without a start the whole map is searched, which may take some metres of path.
        start: None,
    };
    let second_day = simulate(2, 20.0)?;
    let request = MapRequest { known, ..MapRequest::new(folder.path().join("second_day")) };
    // The steps of `job::map`, to look at the map between them.
    let job = Job::prepare(&second_day, request, &mut unobserved)?;
    let known = job.load_known::<Space2d>(&mut unobserved)?;
    let mapped = job.map(known, &mut unobserved)?;

    let mut out = std::io::stdout();
    let found = Localisation::of(&mapped).ok_or("there is no known map")?;
    writeln!(out, "{} loop closures with the known map", found.loop_closures)?;
    if let Some(seconds) = found.first_found_after_seconds {
        writeln!(out, "found in it after {seconds:.1} s")?;
    }
    for (time, map_from_tracking) in mapped.trajectory().iter().step_by(50) {
        let Some(world_from_tracking) = second_day.truth_at(*time) else { continue };
        let at = map_from_tracking.translation.vector;
        let error = (world_from_map.inverse() * world_from_tracking).translation.vector - at;
        writeln!(
            out,
            "{:.1} s: {:.2}, {:.2} m, off by {:.2} m",
            time.unix_seconds(),
            at.x,
            at.y,
            error.norm()
        )?;
    }
    Ok(())
}

/// A drive through the same office, on another day.
fn simulate(day: u64, seconds: f64) -> Result<Simulation, Box<dyn Error>> {
    let options = ScenarioOptions {
        building_seed: Some(1),
        duration: Some(seconds),
        ..ScenarioOptions::new(Scene::Office, day)
    };
    Ok(Simulation::new(options)?)
}
