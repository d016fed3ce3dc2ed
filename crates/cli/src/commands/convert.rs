//! `portolan convert`: converts trajectories, pose graphs and maps.

mod format;
mod graph;
mod trajectories;

use std::path::PathBuf;

use portolan_atomic_file::require_room_for;
use portolan_geometry::GeodeticPosition;

use super::argument;
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::input::open_forward;
use format::Format;

/// Convert trajectories, pose graphs and maps into one another.
///
/// Trajectories: TUM (.tum), KITTI poses (.kitti, with a file of times beside it), tables (.csv), GeoJSON
/// (.geojson), and those of maps (.pbstream). Pose graphs: g2o (.g2o) and the constraints of maps. The input
/// format is recognised by the content, the output format is chosen by the ending.
///
/// With `--into MAP -o NEW.pbstream`, the poses of a trajectory, for example a refined one, or of a g2o file
/// made from this map are written into the map.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan convert house.pbstream -o house.tum\n  \
    portolan convert house.pbstream -o house.geojson --origin 48.137,11.575,520\n  \
    portolan convert poses.txt --times times.txt -o poses.csv\n  \
    portolan convert house.pbstream -o house.g2o\n  \
    portolan convert house_optimised.g2o --into house.pbstream -o house_new.pbstream")]
pub struct ConvertArgs {
    /// Trajectory, pose graph or map.
    input: PathBuf,
    /// File to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Format to write, if the ending of the output does not determine it.
    #[arg(long, value_enum, value_name = "FORMAT")]
    to: Option<Format>,
    /// Use only this trajectory of a map or file; required if the output can hold only one. With --into:
    /// trajectory of the map that gets the poses, default 0.
    #[arg(long, value_name = "ID")]
    trajectory: Option<i32>,
    /// Times of KITTI poses, one per line.
    #[arg(long, value_name = "FILE")]
    times: Option<PathBuf>,
    /// Map that the poses are written into.
    #[arg(long, value_name = "MAP")]
    into: Option<PathBuf>,
    /// Position of the origin of the map on the Earth (WGS 84), degrees and metres; x points east. For
    /// GeoJSON.
    #[arg(long, value_name = "LAT,LON[,ALT]", value_parser = origin, allow_hyphen_values = true)]
    origin: Option<GeodeticPosition>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

fn origin(text: &str) -> Result<GeodeticPosition, String> {
    let with_altitude = if text.split(',').count() == 2 { format!("{text},0") } else { text.to_owned() };
    let [latitude_degrees, longitude_degrees, altitude] =
        argument::numbers::<3>(&with_altitude, "LAT,LON[,ALT]")?;
    let origin = GeodeticPosition { latitude_degrees, longitude_degrees, altitude };
    if origin.is_valid() && altitude.abs() < 1e6 {
        Ok(origin)
    } else {
        Err(format!("{text} is not a place on Earth"))
    }
}

pub fn run(args: &ConvertArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let to = match args.to {
        Some(to) => to,
        None => Format::of_name(&args.output)?,
    };
    refuse_unused(args, to)?;
    // A map with replaced poses is about as large as before; other outputs may be small.
    let map = args.into.as_deref().and_then(|map| std::fs::metadata(map).ok());
    require_room_for(&args.output, (1 << 12) + map.map_or(0, |map| map.len() / 2))?;
    let mut input = open_forward(&args.input)?;
    match (Format::of_content(&mut input, &args.input)?, to) {
        (Format::G2o, Format::Map) | (Format::Map, Format::G2o) if args.trajectory.is_some() => {
            Err(CliError::Usage(
                "--trajectory: a g2o file holds all trajectories of a map; `portolan edit --keep` makes a map of one"
                    .to_owned(),
            ))
        }
        (Format::G2o, Format::Map) => graph::into_map(args, input, global),
        (Format::Map, Format::G2o) => graph::of_map(args),
        (Format::G2o, _) => Err(CliError::Usage(
            "a g2o file has no times: it can be put into its map (--into MAP -o NEW.pbstream), nothing else"
                .to_owned(),
        )),
        (_, Format::G2o) => graph::of_trajectory(args, input, global),
        (_, Format::Map) => trajectories::into_map(args, input, global),
        _ => trajectories::run(args, input, to, global),
    }
}

/// Refuses options that would be silently ignored.
fn refuse_unused(args: &ConvertArgs, to: Format) -> Result<(), CliError> {
    match args.into {
        Some(_) if to != Format::Map => {
            Err(CliError::Usage("--into MAP writes a map: name one with -o NEW.pbstream".to_owned()))
        }
        _ => Ok(()),
    }
}
