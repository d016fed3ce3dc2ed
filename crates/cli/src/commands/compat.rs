//! `portolan compat`: emulates Cartographer's programs, for scripts that call them.

mod ground_truth;
mod log;
mod mapping;

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use portolan_compat::{Completeness, Console};

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{print, print_summary};

/// Run as one of Cartographer's programs, with its name, flags and messages.
///
/// The same happens if this program is called through a link of such a name; --links creates these links.
/// Flags are given as for Cartographer: -flag value, --flag=value, --noflag.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan compat cartographer_pbstream info house.pbstream\n  \
    portolan compat cartographer_pbstream_to_ros_map -pbstream_filename house.pbstream -map_filestem house\n  \
    portolan compat --links ~/.local/bin")]
pub struct CompatArgs {
    /// Create links of all names in this folder.
    #[arg(long, value_name = "FOLDER")]
    links: Option<PathBuf>,
    /// List the supported programs.
    #[arg(long)]
    list: bool,
    /// Name and arguments of the program.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "PROGRAM ARGUMENTS")]
    command: Vec<String>,
}

/// Implementation of a program.
enum Run {
    /// Implemented in `portolan_compat`.
    Alone(portolan_compat::Run),
    /// Implemented by another verb of `portolan`.
    ByVerb(fn(&[String], &GlobalArgs) -> Result<Outcome, CliError>),
}

use Run::{Alone, ByVerb};

/// Supported programs: name, description and implementation.
const PROGRAMS: [(&str, &str, Run); 10] = [
    ("cartographer_pbstream", "info on maps and their migration", Alone(portolan_compat::pbstream)),
    (
        "cartographer_autogenerate_ground_truth",
        "relations from the loop closures of a map",
        ByVerb(ground_truth::run),
    ),
    (
        "cartographer_compute_relations_metrics",
        "errors of a map against relations",
        Alone(portolan_compat::compute_relations_metrics),
    ),
    (
        "cartographer_print_configuration",
        "a configuration with all its includes",
        Alone(portolan_compat::print_configuration),
    ),
    (
        "cartographer_pbstream_to_ros_map",
        "a map as .pgm and .yaml",
        Alone(portolan_compat::pbstream_to_ros_map),
    ),
    ("cartographer_rosbag_validate", "faults of a bag", Alone(portolan_compat::rosbag_validate)),
    (
        "cartographer_assets_writer",
        "clouds, X-rays and grids of the points of bags, placed by a map",
        Alone(portolan_compat::assets_writer),
    ),
    ("cartographer_offline_node", "the map of a bag", ByVerb(mapping::run)),
    (
        "cartographer_dev_pbstream_trajectories_to_rosbag",
        "the trajectories of a map as transforms in a bag",
        Alone(portolan_compat::pbstream_trajectories_to_rosbag),
    ),
    (
        "cartographer_dev_trajectory_comparison",
        "a map compared with the transforms of a bag",
        Alone(portolan_compat::trajectory_comparison),
    ),
];

/// Console that prints results on stdout, and messages in the format of Cartographer's log.
struct Terminal;

impl Console for Terminal {
    fn print(&mut self, text: &str) -> std::io::Result<()> {
        match print(text) {
            Err(CliError::Output(error)) => Err(error),
            Err(other) => Err(std::io::Error::other(other.to_string())),
            Ok(()) => Ok(()),
        }
    }

    fn info(&mut self, text: &str) {
        log::info(text);
    }

    fn warning(&mut self, text: &str) {
        log::warning(text);
    }
}

/// Programs that need a running ROS system or server, with the alternative.
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
    match PROGRAMS.iter().find(|(known, ..)| *known == name) {
        Some((_, _, ByVerb(run))) => return run(rest, global),
        Some((_, _, Alone(run))) => {
            return Ok(match run(rest, &mut Terminal)? {
                Completeness::Complete => Outcome::Done,
                Completeness::WithLoss => Outcome::DataLost,
            });
        }
        None => {}
    }
    match ELSEWHERE.iter().find(|(known, _)| *known == name) {
        Some((_, advice)) => Err(CliError::Usage(format!("{name} needs a running ROS or server; {advice}"))),
        None => Err(CliError::Usage(format!(
            "{name} is none of the known programs; see `portolan compat --list`"
        ))),
    }
}

/// The command line, rewritten to `portolan compat NAME …` if the program was called through a link with one of the
/// names.
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

/// Name of a program without folders and `.exe`.
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

/// Links to the program (copies it where there are no symbolic links). On Unix an existing file of that name is kept and
/// is an error, unless it is already this link.
fn link_to(program: &Path, link: &Path) -> std::io::Result<()> {
    if std::fs::read_link(link).is_ok_and(|target| target == program) {
        return Ok(());
    }
    #[cfg(unix)]
    return std::os::unix::fs::symlink(program, link);
    #[cfg(not(unix))]
    return std::fs::copy(program, link.with_extension("exe")).map(drop);
}
