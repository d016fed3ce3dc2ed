//! `portolan compat`: Cartographer's own commands, for scripts that call them.

mod assets;
mod bags;
mod configuration;
mod ground_truth;
mod log;
mod mapping;
mod pbstream;
mod ros_map;
mod trajectories;

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{print, print_summary};

/// Run under the names, flags and messages of Cartographer's programs.
///
/// Also when this program is called through a link of one of these names, which --links makes. Flags are
/// given as there: -flag value, --flag=value, --noflag.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan compat cartographer_pbstream info house.pbstream\n  \
    portolan compat cartographer_pbstream_to_ros_map -pbstream_filename house.pbstream -map_filestem house\n  \
    portolan compat --links ~/.local/bin")]
pub struct CompatArgs {
    /// Make links of all names in this folder.
    #[arg(long, value_name = "FOLDER")]
    links: Option<PathBuf>,
    /// List the names.
    #[arg(long)]
    list: bool,
    /// Name and arguments of the program.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "PROGRAM ARGUMENTS")]
    command: Vec<String>,
}

/// How a program ended that did not do its work: its message was already printed.
type Run = fn(&[String], &GlobalArgs) -> Result<Outcome, CliError>;

/// The programs, and what each does.
const PROGRAMS: [(&str, &str, Run); 10] = [
    ("cartographer_pbstream", "info on maps and their migration", pbstream::run),
    (
        "cartographer_autogenerate_ground_truth",
        "relations from the loop closures of a map",
        ground_truth::generate,
    ),
    ("cartographer_compute_relations_metrics", "a map judged by relations", ground_truth::metrics),
    ("cartographer_print_configuration", "a configuration with all its includes", configuration::run),
    ("cartographer_pbstream_to_ros_map", "a map as .pgm and .yaml", ros_map::run),
    ("cartographer_rosbag_validate", "what is wrong with a bag", bags::run),
    (
        "cartographer_assets_writer",
        "clouds, X-rays and grids of the points of bags, placed by a map",
        assets::run,
    ),
    ("cartographer_offline_node", "the map of a bag", mapping::run),
    (
        "cartographer_dev_pbstream_trajectories_to_rosbag",
        "the trajectories of a map as transforms in a bag",
        trajectories::run,
    ),
    ("cartographer_dev_trajectory_comparison", "a map compared with the transforms of a bag", bags::compare),
];

/// Programs that only make sense in a running ROS system or as part of one, and where to turn.
const ELSEWHERE: [(&str, &str); 7] = [
    ("cartographer_node", "map a recording with `portolan map`"),
    ("cartographer_occupancy_grid_node", "make the map with `portolan render MAP -o map.pgm`"),
    (
        "cartographer_pbstream_map_publisher",
        "make the map with `portolan render MAP -o map.pgm` and load it with map_server",
    ),
    ("cartographer_dev_rosbag_publisher", "play the bag with rosbag"),
    ("cartographer_grpc_server", "maps are made in one process: `portolan map`"),
    ("cartographer_grpc_node", "map a recording with `portolan map`"),
    ("cartographer_grpc_offline_node", "use cartographer_offline_node"),
];

pub fn run(args: &CompatArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    if let Some(folder) = &args.links {
        return make_links(folder);
    }
    let Some((name, rest)) = args.command.split_first().filter(|_| !args.list) else {
        let lines = PROGRAMS.iter().map(|(name, what, _)| format!("{name:42}  {what}\n"));
        print(&lines.collect::<String>())?;
        return if args.list { Ok(Outcome::Done) } else { Err(CliError::Usage("which program?".to_owned())) };
    };
    let name = program_name(name);
    if let Some((_, _, run)) = PROGRAMS.iter().find(|(known, ..)| *known == name) {
        return run(rest, global);
    }
    match ELSEWHERE.iter().find(|(known, _)| *known == name) {
        Some((_, advice)) => Err(CliError::Usage(format!("{name} needs a running ROS or server; {advice}"))),
        None => Err(CliError::Usage(format!(
            "{name} is none of the known programs; see `portolan compat --list`"
        ))),
    }
}

/// The command line, rewritten if the program was called under one of the names.
pub fn arguments(given: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let given: Vec<OsString> = given.collect();
    let called = given.first().map(|path| program_name(&path.to_string_lossy()));
    match called {
        Some(name) if PROGRAMS.iter().any(|(known, ..)| *known == name) => {
            let start = ["portolan".into(), "compat".into(), name.into()];
            start.into_iter().chain(given.into_iter().skip(1)).collect()
        }
        _ => given,
    }
}

/// The name without folders and `.exe`.
fn program_name(path: &str) -> String {
    let name = Path::new(path).file_name().map(|n| n.to_string_lossy().into_owned());
    let name = name.unwrap_or_else(|| path.to_owned());
    name.strip_suffix(".exe").map(str::to_owned).unwrap_or(name)
}

fn make_links(folder: &Path) -> Result<Outcome, CliError> {
    let program = std::env::current_exe()?;
    for (name, ..) in PROGRAMS {
        let link = folder.join(name);
        let made = link_to(&program, &link);
        made.map_err(|source| CliError::File { path: link.clone(), source })?;
        print_summary(&link.display().to_string());
    }
    Ok(Outcome::Done)
}

/// What is there under that name stays, unless it is such a link.
fn link_to(program: &Path, link: &Path) -> std::io::Result<()> {
    if std::fs::read_link(link).is_ok_and(|target| target == program) {
        return Ok(());
    }
    #[cfg(unix)]
    return std::os::unix::fs::symlink(program, link);
    #[cfg(not(unix))]
    return std::fs::copy(program, link.with_extension("exe")).map(drop);
}
