//! `portolan info`: summarises recordings and maps.

mod describe;
mod map;
mod recording;

pub use describe::utc_parts;

use std::path::PathBuf;

use serde::Serialize;

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::input::{must_be_a_file, open_map};
use crate::output::{print, print_json};

/// Show the contents of recordings and maps.
///
/// Of a recording: topics with types, counts, rates and frames, properties of the sensors, duration, the tree
/// of transforms, and what mapping would use. Of a map (.pbstream): trajectories with nodes, submaps, path
/// length and duration, constraints, grids and extent. The kind of a file is recognised by its content. Exit
/// code 3 if parts of a file could not be read.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan info walk.bag\n  portolan info old.pbstream --options\n  \
    portolan info *.mcap --json\n  portolan info old.pbstream --all | less")]
pub struct InfoArgs {
    /// Recordings and maps.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Print every message of a map as protobuf text.
    #[arg(long, conflicts_with = "json")]
    all: bool,
    /// Also print the options that a map was made with.
    #[arg(long, conflicts_with = "json")]
    options: bool,
    /// Print JSON: an array with one object for each path.
    #[arg(long)]
    json: bool,
}

/// Summary of one path.
#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Info {
    Map(map::MapReport),
    Recording(recording::RecordingReport),
}

pub fn run(args: &InfoArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let mut reports = Vec::new();
    let mut outcome = Outcome::Done;
    for (index, path) in args.paths.iter().enumerate() {
        if args.all {
            must_be_a_file(path)?;
        }
        let info = match open_map(path)? {
            Some(input) => Info::Map(map::read(path, input)?),
            None => Info::Recording(recording::read(path, global.quiet)?),
        };
        let lost_data = match &info {
            Info::Map(report) => report.lost_data(),
            Info::Recording(report) => report.lost_data(),
        };
        if lost_data {
            outcome = Outcome::DataLost;
        }
        if args.json {
            reports.push(info);
            continue;
        }
        if index > 0 {
            print("\n")?;
        }
        match &info {
            Info::Map(report) => {
                print(&report.text(args.options))?;
                if args.all {
                    map::print_messages(path)?;
                }
            }
            Info::Recording(report) => print(&report.text())?,
        }
    }
    if args.json {
        print_json(&reports)?;
    }
    Ok(outcome)
}
