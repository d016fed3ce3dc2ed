//! `portolan render`: draws maps as pictures.

use std::io::Read;
use std::path::{Path, PathBuf};

use portolan_export::{
    MapContent, PictureOptions, constraint_lines, draw_map, extent, trajectory_lines, write_grey_map,
    write_picture,
};
use portolan_mapfile::{
    ImageName, MapArea, MapTextures, PaintOptions, is_ros_map_yaml_of, load_textures, sum_evidence,
    write_ros_map,
};
use portolan_pbstream::proto::mapping::PoseGraph;
use portolan_pbstream::{IdInFile, MapReader};
use serde::Serialize;

use super::argument;
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{counted, print_json, print_summary};
use crate::progress::print_line;

/// Draw a map (.pbstream): a picture, or an image with description for ROS.
///
/// `.png` gives a picture with trajectories and a scale, `.pgm` the map for ROS navigation with its `.yaml`
/// beside it: the same pixels as Cartographer's converter. 3D maps are seen from above, as X-rays. Exit code
/// 3 if some submaps could not be drawn.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan render house.pbstream -o house.png --constraints\n  \
    portolan render house.pbstream -o house.pgm --resolution 0.05\n  \
    portolan render house.pbstream -o corner.png --crop=-5,-5,5,5 --submap 0,3 --submap 0,4")]
pub struct RenderArgs {
    /// The map.
    map: PathBuf,
    /// Picture to write; its ending (.png, .pgm) determines the kind.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Size of a pixel. Default: 0.05 for .pgm and --grey, otherwise chosen to suit the map.
    #[arg(long, value_name = "METRES", value_parser = argument::positive_metres)]
    resolution: Option<f64>,
    /// Draw only this rectangle of the map, metres.
    #[arg(long, value_name = "X1,Y1,X2,Y2", value_parser = argument::area, allow_hyphen_values = true)]
    crop: Option<MapArea>,
    /// Draw only this submap; may be given several times.
    #[arg(long, value_name = "TRAJECTORY,INDEX", value_parser = argument::id)]
    submap: Vec<IdInFile>,
    /// Draw only this trajectory and its submaps; may be given several times.
    #[arg(long, value_name = "ID")]
    trajectory: Vec<i32>,
    /// Do not draw trajectories.
    #[arg(long)]
    no_trajectories: bool,
    /// Draw loop closures as lines from submap to node.
    #[arg(long)]
    constraints: bool,
    /// Write the grey values of the .pgm as .png, with nothing drawn over them.
    #[arg(long, conflicts_with = "constraints")]
    grey: bool,
    /// Largest edge of a picture, pixels.
    #[arg(long, value_name = "PIXELS", default_value_t = 2400)]
    max_edge: usize,
    /// Overwrite a .yaml beside the .pgm that was not written with it.
    #[arg(long)]
    force: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    files: Vec<String>,
    width: usize,
    height: usize,
    /// Metres per pixel.
    resolution: f64,
    /// Map position of the lower left corner, metres.
    lower_left: [f64; 2],
    submaps: usize,
    skipped: Vec<Skipped>,
}

#[derive(Serialize)]
struct Skipped {
    submap: IdInFile,
    reason: String,
}

/// Default edge of a pixel of ROS and grey maps, metres.
const ROS_RESOLUTION: f64 = 0.05;

pub fn run(args: &RenderArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let kind = Kind::of(&args.output, args.grey)?;
    if kind == Kind::Ros && !args.force {
        refuse_foreign_description(&args.output)?;
    }
    let failed = |error| CliError::in_file(&args.map, error);
    let mut reader = MapReader::open(&args.map).map_err(failed)?;
    let graph = reader.pose_graph().clone();
    let mut loaded = load_textures(&mut reader).map_err(failed)?;
    choose(args, &mut loaded, &graph)?;
    refuse_empty_crop(args, &loaded)?;
    let mut report = match kind {
        Kind::Picture => draw(args, &loaded, &graph)?,
        Kind::Grey | Kind::Ros => paint_map(args, &loaded, kind)?,
    };
    for (submap, reason) in loaded.skipped {
        if !global.quiet {
            print_line(&format!("submap {},{} is not drawn: {reason}", submap.0, submap.1));
        }
        report.skipped.push(Skipped { submap, reason: reason.to_string() });
    }
    let outcome = if report.skipped.is_empty() { Outcome::Done } else { Outcome::DataLost };
    if args.json {
        print_json(&report)?;
    } else {
        print_summary(&format!(
            "{} x {} pixels of {:.4} m, {}\n{}",
            report.width,
            report.height,
            report.resolution,
            counted(report.submaps as u64, "submap", "submaps"),
            report.files.join("\n")
        ));
    }
    Ok(outcome)
}

/// Refuses to overwrite a `.yaml` that was not written with the image: its path is not given by the user, so that a
/// foreign file could be lost.
fn refuse_foreign_description(image: &Path) -> Result<(), CliError> {
    let path = image.with_extension("yaml");
    let Ok(file) = std::fs::File::open(&path) else { return Ok(()) };
    let mut text = Vec::new();
    // Descriptions of ROS maps have only a few lines.
    let read = file.take(1 << 16).read_to_end(&mut text);
    if read.is_ok() && is_ros_map_yaml_of(&String::from_utf8_lossy(&text), image) {
        return Ok(());
    }
    Err(CliError::in_file(
        &path,
        "would be overwritten, and was not written with the image, or was changed since: take another name, or \
         move it and say --force",
    ))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Picture,
    Grey,
    Ros,
}

impl Kind {
    fn of(path: &Path, grey: bool) -> Result<Self, CliError> {
        let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        match (ending.as_deref(), grey) {
            (Some("png"), false) => Ok(Self::Picture),
            (Some("png"), true) => Ok(Self::Grey),
            (Some("pgm"), _) => Ok(Self::Ros),
            _ => Err(CliError::Usage(format!("{}: pictures are .png or .pgm", path.display()))),
        }
    }
}

/// Keeps only the submaps selected by the user.
fn choose(args: &RenderArgs, loaded: &mut MapTextures, graph: &PoseGraph) -> Result<(), CliError> {
    let wanted = |id: &IdInFile| {
        (args.trajectory.is_empty() || args.trajectory.contains(&id.0))
            && (args.submap.is_empty() || args.submap.contains(id))
    };
    for id in &args.trajectory {
        if !graph.trajectory.iter().any(|t| t.trajectory_id == *id) {
            return Err(CliError::in_file(&args.map, format!("there is no trajectory {id} in this map")));
        }
    }
    for id in &args.submap {
        let known = loaded
            .textures
            .iter()
            .map(|t| &t.id)
            .chain(loaded.skipped.iter().map(|(id, _)| id))
            .any(|i| i == id);
        if !known {
            return Err(CliError::in_file(
                &args.map,
                format!("there is no submap {},{} in this map", id.0, id.1),
            ));
        }
    }
    loaded.textures.retain(|t| wanted(&t.id));
    loaded.skipped.retain(|(id, _)| wanted(id));
    Ok(())
}

/// Refuses a rectangle that does not overlap the map: the picture would be empty.
fn refuse_empty_crop(args: &RenderArgs, loaded: &MapTextures) -> Result<(), CliError> {
    let content = MapContent { textures: &loaded.textures, trajectories: &[], constraints: &[] };
    let (Some(crop), Ok(map)) = (&args.crop, extent(&content)) else { return Ok(()) };
    let is_apart =
        crop.max_x < map.min_x || crop.min_x > map.max_x || crop.max_y < map.min_y || crop.min_y > map.max_y;
    if !is_apart {
        return Ok(());
    }
    let MapArea { min_x, min_y, max_x, max_y } = map;
    Err(CliError::Usage(format!(
        "nothing of the map lies in the rectangle of --crop; the map reaches from {min_x:.1},{min_y:.1} to {max_x:.1},{max_y:.1} m"
    )))
}

fn draw(args: &RenderArgs, loaded: &MapTextures, graph: &PoseGraph) -> Result<Report, CliError> {
    let mut graph = graph.clone();
    if !args.trajectory.is_empty() {
        graph.trajectory.retain(|t| args.trajectory.contains(&t.trajectory_id));
    }
    let trajectories = trajectory_lines(&graph);
    let constraints = if args.constraints { constraint_lines(&graph) } else { Vec::new() };
    let with_lines = !args.no_trajectories && args.submap.is_empty();
    let content = MapContent {
        textures: &loaded.textures,
        trajectories: if with_lines { &trajectories } else { &[] },
        constraints: &constraints,
    };
    let options = PictureOptions {
        resolution: args.resolution,
        max_edge: args.max_edge,
        crop: args.crop,
        ..PictureOptions::default()
    };
    let picture = draw_map(&content, &options).map_err(|error| CliError::in_file(&args.map, error))?;
    write_picture(&args.output, &picture)?;
    let frame = &picture.frame;
    let [left, top] = frame.upper_left;
    Ok(Report {
        files: vec![args.output.display().to_string()],
        width: frame.width,
        height: frame.height,
        resolution: frame.resolution,
        lower_left: [left, top - frame.height as f64 * frame.resolution],
        submaps: loaded.textures.len(),
        skipped: Vec::new(),
    })
}

fn paint_map(args: &RenderArgs, loaded: &MapTextures, kind: Kind) -> Result<Report, CliError> {
    let options = PaintOptions {
        resolution: args.resolution.unwrap_or(ROS_RESOLUTION),
        crop: args.crop,
        ..PaintOptions::default()
    };
    let evidence =
        sum_evidence(&loaded.textures, &options).map_err(|error| CliError::in_file(&args.map, error))?;
    let painted = evidence.painted();
    let files = if kind == Kind::Grey {
        write_grey_map(&args.output, &painted)?;
        vec![args.output.clone()]
    } else {
        let (image, description) =
            write_ros_map(&args.output.with_extension(""), &painted, ImageName::Beside)?;
        vec![image, description]
    };
    Ok(Report {
        files: files.iter().map(|f| f.display().to_string()).collect(),
        width: painted.width,
        height: painted.height,
        resolution: painted.resolution,
        lower_left: painted.lower_left(),
        submaps: loaded.textures.len(),
        skipped: Vec::new(),
    })
}
