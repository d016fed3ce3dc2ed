//! Hours of simulated drives through one closed building, mapped or localised at full speed: memory, processor time and
//! latency over time.
//!
//! `cargo run --release -p portolan --example soak -- map 2d 24 FOLDER`; `localize` for the other half, `3d` for the other
//! space, a number behind the folder for other than the usual four newest submaps of a place, 0 to keep all. In FOLDER it leaves `soak.csv`, `soak.svg`
//! and the results of the job. A mapping that was cut off goes on from its journal when it is started again.

mod drive;
mod rows;
mod summary;

use std::error::Error;
use std::io::{Write, stdout};
use std::path::{Path, PathBuf};

use portolan::evaluation::{TimedPose, Trajectory};
use portolan::geometry::Dimension;
use portolan::ingest::IngestOptions;
use portolan::job::{JOURNAL, LocalizeRequest, MapRequest, localize, map, unobserved};
use portolan::trajectory_file::TrajectoryFile;
use portolan::{LIFELONG, RequestedOptions};

use drive::Drive;
use rows::{Rows, observer};

/// What is done with the drive.
enum Work {
    /// It is mapped with this setting.
    Map(String),
    Localize,
}

struct Command {
    work: Work,
    dimension: Dimension,
    hours: f64,
    folder: PathBuf,
}

const USAGE: &str = "soak map|localize 2d|3d HOURS FOLDER [SUBMAPS_PER_PLACE]";

fn command() -> Option<Command> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let (work, dimension, hours, folder) = match words[..] {
        ["map", dimension, hours, folder] => (Work::Map(LIFELONG.to_owned()), dimension, hours, folder),
        ["map", dimension, hours, folder, count] => {
            (Work::Map(format!("portolan.submaps_per_place={count}")), dimension, hours, folder)
        }
        ["localize", dimension, hours, folder] => (Work::Localize, dimension, hours, folder),
        _ => return None,
    };
    let dimension = match dimension {
        "2d" => Dimension::TwoD,
        "3d" => Dimension::ThreeD,
        _ => return None,
    };
    Some(Command { work, dimension, hours: hours.parse().ok()?, folder: folder.into() })
}

/// What `cargo run` calls.
pub fn main() -> Result<(), Box<dyn Error>> {
    let Command { work, dimension, hours, folder } = command().ok_or(USAGE)?;
    std::fs::create_dir_all(&folder)?;
    let drive = Drive::new(dimension, 2, Some(3600.0 * hours))?;
    let mut rows = Rows::begin(&folder, hours)?;
    let poses = match work {
        Work::Map(setting) => mapped(&drive, setting, &folder, &mut rows)?,
        Work::Localize => localised(&drive, dimension, &folder, &mut rows)?,
    };
    let verdict = rows.end();
    writeln!(stdout(), "{verdict}\n{}", drive.errors(&poses)?)?;
    Ok(())
}

fn mapped(
    drive: &Drive,
    setting: String,
    folder: &Path,
    rows: &mut Rows,
) -> Result<Trajectory, Box<dyn Error>> {
    let results = folder.join("mapped");
    let mut request = MapRequest { threads: 1, force: true, ..MapRequest::new(&results) };
    request.resume = results.join(JOURNAL).is_file();
    request.requested.settings.push(setting);
    request.cloud.with_xrays = false;
    map(drive.recording(), request, &mut observer(rows))?;
    let path = results.join("trajectory.tum");
    Ok(TrajectoryFile { path: &path, trajectory_id: None, times: None }.read()?.trajectory)
}

fn localised(
    drive: &Drive,
    dimension: Dimension,
    folder: &Path,
    rows: &mut Rows,
) -> Result<Trajectory, Box<dyn Error>> {
    let known = folder.join("known");
    if !known.join("map.pbstream").is_file() {
        let tour = Drive::new(dimension, 1, None)?;
        map(tour.recording(), MapRequest { force: true, ..MapRequest::new(&known) }, &mut unobserved)?;
    }
    let results = folder.join("localised");
    std::fs::create_dir_all(&results)?;
    let request = LocalizeRequest {
        map: known.join("map.pbstream"),
        folder: results,
        ingest: IngestOptions::default(),
        requested: RequestedOptions::default(),
        start: None,
        jumps: None,
        save_map: None,
        threads: 1,
    };
    let found = localize(drive.recording(), &request, &mut observer(rows))?;
    writeln!(stdout(), "found {}: {:?}", found.found().name(), found.state_counts())?;
    let poses = found.poses().into_iter();
    Ok(Trajectory::new(poses.map(|(time, map_from_tracking)| TimedPose { time, map_from_tracking })).0)
}
