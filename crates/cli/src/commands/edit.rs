//! `portolan edit`: edits a map (removes, merges, corrects, moves and optimises parts).

mod steps;
mod values;

use std::path::PathBuf;

use portolan_geometry::Rigid3;
use portolan_mapfile::MapArea;
use portolan_pbstream::IdInFile;

use super::argument;
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use values::{LoopToAdd, Rotation};

/// Change a map (.pbstream): remove parts, merge, correct, move and optimise it.
///
/// Steps are applied in the order of this page, regardless of their order on the command line. Positions,
/// times and ids refer to the map before it is moved. Submaps and nodes are copied unchanged, with all their
/// content.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan edit house.pbstream -o straight.pbstream --rotate walls\n  \
    portolan edit house.pbstream -o ground.pbstream --keep 0 --inside=-10,-5,30,20\n  \
    portolan edit east.pbstream -o both.pbstream --merge west.pbstream\n  \
    portolan edit east.pbstream -o both.pbstream --merge west.pbstream --place 12.5,0,90\n  \
    portolan edit house.pbstream -o better.pbstream --drop-loops-beyond 0.5 --add-loop 0,3:0,812 --optimize\n  \
    portolan edit house.pbstream -o house.pbstream --after +60 --before +600")]
pub struct EditArgs {
    /// The map.
    map: PathBuf,
    /// Map to write; may be the same file.
    #[arg(short, long, value_name = "MAP")]
    output: PathBuf,
    #[command(flatten)]
    parts: PartArgs,
    #[command(flatten)]
    loops: LoopArgs,
    #[command(flatten)]
    place: PlaceArgs,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Parts of the map.
#[derive(clap::Args)]
#[command(next_help_heading = "Parts")]
struct PartArgs {
    /// Add another map; its trajectories get the next free ids. Without --place its pose in this map is
    /// searched: its scans must agree on it, then loops between the maps are closed and all poses are
    /// optimised. If no pose is found, nothing is written (exit code 4). May be given several times.
    #[arg(long, value_name = "MAP")]
    merge: Vec<PathBuf>,
    /// Pose of the added map in this one, metres and degrees: one for each --merge, in the same order.
    /// `0,0,0` if both have the same origin.
    #[arg(long, value_name = "X,Y,YAW", value_parser = argument::pose_2d, allow_hyphen_values = true)]
    place: Vec<Rigid3>,
    /// Keep only this trajectory; may be given several times.
    #[arg(long, value_name = "ID", conflicts_with = "delete")]
    keep: Vec<i32>,
    /// Remove this trajectory; may be given several times.
    #[arg(long, value_name = "ID")]
    delete: Vec<i32>,
    /// Renumber a trajectory; may be given several times.
    #[arg(long, value_name = "OLD=NEW", value_parser = values::rename)]
    rename: Vec<(i32, i32)>,
    /// Remove nodes before this time, and submaps that lose more than half of theirs: Unix seconds, or
    /// +SECONDS after the first node.
    #[arg(long, value_name = "TIME")]
    after: Option<String>,
    /// Remove nodes after this time, likewise.
    #[arg(long, value_name = "TIME")]
    before: Option<String>,
    /// Keep only submaps and nodes in this rectangle, metres.
    #[arg(long, value_name = "X1,Y1,X2,Y2", value_parser = argument::area, allow_hyphen_values = true)]
    inside: Option<MapArea>,
    /// Remove submaps and nodes in this rectangle, metres, and clear the cells there in the submaps that
    /// stay.
    #[arg(long, value_name = "X1,Y1,X2,Y2", value_parser = argument::area, allow_hyphen_values = true)]
    outside: Option<MapArea>,
}

/// Loop closures.
#[derive(clap::Args)]
#[command(next_help_heading = "Loop closures")]
struct LoopArgs {
    /// Remove the loop closure between a submap and a node; may be given several times.
    #[arg(long, value_name = "SUBMAP:NODE", value_parser = values::pair)]
    drop_loop: Vec<(IdInFile, IdInFile)>,
    /// Remove loop closures that differ from the poses of the map by more than this.
    #[arg(long, value_name = "METRES", value_parser = argument::positive_metres)]
    drop_loops_beyond: Option<f64>,
    /// Add a loop closure: `0,3:0,812` matches node 812 to submap 3; `0,3:0,812=1.5,0.2,90` gives the pose of
    /// the node in the submap (x, y, yaw, or x, y, z, roll, pitch, yaw; metres and degrees).
    #[arg(long, value_name = "SUBMAP:NODE[=POSE]", value_parser = values::loop_to_add, allow_hyphen_values = true)]
    add_loop: Vec<LoopToAdd>,
    /// Optimise all poses.
    #[arg(long)]
    optimize: bool,
    /// Change an option of the loop search and the optimisation: `--set
    /// pose_graph.optimization_problem.huber_scale=5`.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// List this number of loop closures that differ most from the poses of the map.
    #[arg(long, value_name = "N", default_value_t = 0)]
    worst: usize,
}

/// Position of the map.
#[derive(clap::Args)]
#[command(next_help_heading = "Position (the origin is moved first, then the map is rotated, then moved)")]
struct PlaceArgs {
    /// Make this point of the map the origin, metres.
    #[arg(long, value_name = "X,Y[,Z]", value_parser = values::point, allow_hyphen_values = true)]
    origin: Option<portolan_geometry::Vector3>,
    /// Rotate the map about its origin by an angle, degrees, or so that its walls are parallel to the axes
    /// (`walls`).
    #[arg(long, value_name = "DEGREES|walls", value_parser = values::rotation, allow_hyphen_values = true)]
    rotate: Option<Rotation>,
    /// Move the map, metres.
    #[arg(long = "move", value_name = "X,Y[,Z]", value_parser = values::point, allow_hyphen_values = true)]
    shift: Option<portolan_geometry::Vector3>,
}

pub fn run(args: &EditArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    if !args.parts.place.is_empty() && args.parts.place.len() != args.parts.merge.len() {
        return Err(CliError::Usage(
            "give --place X,Y,YAW for each --merge, or for none: then the pose of each map in the first one is searched"
                .to_owned(),
        ));
    }
    steps::run(args, global)
}
