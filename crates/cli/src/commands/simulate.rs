//! `portolan simulate`: recordings of simulated buildings with exact ground truth.

mod scenario;
mod simulated;

use std::path::{Path, PathBuf};

use portolan_atomic_file::require_room_for;
use portolan_recording::{RecordingFormat, RecordingWriter, create};
use portolan_simulator::{Simulation, Simulation3d, SimulatorError};

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{print_summary, write_file};
use crate::progress::{Progress, print_line};
use scenario::{AnyScenario, ScenarioArgs};
use simulated::Simulated;

/// Simulate a tour of a building, in 2D or in 3D, and write the recording with its truth.
///
/// Beside the recording NAME.bag, NAME.truth.tum (true poses of base_link) is written, and all fixed
/// surfaces: NAME.walls.csv in 2D, NAME.surfaces.json (exact) and NAME.surfaces.ply (a mesh) in 3D. The same
/// options give the same bytes.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan simulate -o office.bag\n  \
    portolan simulate warehouse -o night.mcap --seed 7 --minutes 10 --people 0\n  \
    portolan simulate museum -o museum.mcap --minutes 3 --lidars 2\n  \
    portolan simulate garage -o garage.bag --lidar os1-64 --beams 512\n  \
    portolan simulate office -o faulty.bag --fault gap:scan:20:25 --fault duplicate:imu:100\n  \
    portolan map office.bag && portolan evaluate trajectory office_map/trajectory.tum office.truth.tum")]
pub struct SimulateArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Recording to write: .bag (ROS 1) or .mcap (ROS 2).
    #[arg(short, long, value_name = "FILE.bag|FILE.mcap")]
    output: PathBuf,
    /// File for the true trajectory instead of NAME.truth.tum.
    #[arg(long, value_name = "FILE.tum")]
    truth: Option<PathBuf>,
    /// Rate of the true poses. Default 100, in 3D 200.
    #[arg(long, value_name = "HZ")]
    truth_rate: Option<f64>,
    /// File for the surfaces instead of NAME.walls.csv or NAME.surfaces.json.
    #[arg(long, alias = "surfaces", value_name = "FILE")]
    walls: Option<PathBuf>,
}

pub fn run(args: &SimulateArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let format = RecordingFormat::from_path(&args.output).map_err(|e| CliError::Usage(e.to_string()))?;
    let usage = |error: SimulatorError| CliError::Usage(error.to_string());
    let scenario = args.scenario.scenario().map_err(CliError::Usage)?;
    // Sweeps are simulated in parallel; the result does not depend on the number of threads.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(global.thread_count())
        .build()
        .map_err(|error| CliError::Failed(format!("cannot start threads: {error}")))?;
    pool.install(|| match scenario {
        AnyScenario::TwoD(options) => {
            write_all(&Simulation::new(*options).map_err(usage)?, args, format, global)
        }
        AnyScenario::ThreeD(options) => {
            write_all(&Simulation3d::new(*options).map_err(usage)?, args, format, global)
        }
    })
}

fn write_all(
    simulation: &dyn Simulated,
    args: &SimulateArgs,
    format: RecordingFormat,
    global: &GlobalArgs,
) -> Result<Outcome, CliError> {
    let rate = args.truth_rate.unwrap_or(simulation.usual_truth_rate());
    if !(1e-3..=1e4).contains(&rate) {
        return Err(CliError::Usage(format!("--truth-rate must be from 0.001 to 10000, but is {rate}")));
    }
    let surfaces = simulation.surfaces();
    let mut written = vec![beside(args.truth.as_deref(), &args.output, "truth.tum")];
    for (ending, _) in &surfaces {
        let asked = args.walls.as_deref().filter(|_| written.len() == 1);
        written.push(beside(asked, &args.output, ending));
    }
    refuse_equal(std::iter::once(&args.output).chain(&written))?;
    // A twentieth, because some formats compress.
    require_room_for(&args.output, (1 << 16) + simulation.size_bytes() / 20)?;
    let count = write_recording(simulation, &args.output, format, global.quiet)?;
    write_file(&written[0], |out| simulation.write_truth(out, rate))?;
    for (path, (_, write)) in written[1..].iter().zip(surfaces) {
        write_file(path, |out| write(out))?;
    }
    if !global.quiet {
        print_line(&simulation.format());
    }
    let (seconds, metres) = simulation.extent();
    let mut text = format!("{}: {count} messages, {seconds:.1} s, {metres:.1} m", args.output.display());
    for path in written {
        text.push_str(&format!("\n{}", path.display()));
    }
    print_summary(&text);
    Ok(Outcome::Done)
}

/// The path given by the user, else the path of the recording with another ending.
fn beside(asked: Option<&Path>, recording: &Path, ending: &str) -> PathBuf {
    asked.map_or_else(|| recording.with_extension(ending), Path::to_owned)
}

/// Refuses output files that would overwrite each other.
fn refuse_equal<'a>(paths: impl Iterator<Item = &'a PathBuf>) -> Result<(), CliError> {
    // Compares canonical paths; the path as given if its folder does not exist.
    let place = |path: &Path| {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new(".")).canonicalize().ok()?;
        Some(folder.join(path.file_name()?))
    };
    let mut places = std::collections::HashSet::new();
    for path in paths {
        if !places.insert(place(path).unwrap_or_else(|| path.clone())) {
            let text =
                format!("{} would be written twice: -o, --truth and --walls must differ", path.display());
            return Err(CliError::Usage(text));
        }
    }
    Ok(())
}

/// Writes all messages; returns their number.
pub(super) fn write_recording(
    simulation: &dyn Simulated,
    path: &Path,
    format: RecordingFormat,
    quiet: bool,
) -> Result<u64, CliError> {
    let mut writer: Box<dyn RecordingWriter> = create(path, Some(format))?;
    let mut reader = simulation.read(&|_| true)?;
    let total = simulation.size_bytes();
    let mut progress = Progress::start("simulate", total, quiet);
    let mut count = 0;
    let start = simulation.time_range().map(|(start, _)| start);
    while let Some(message) = reader.next_message()? {
        writer.write(&message)?;
        count += 1;
        if progress.is_due() {
            let seconds = start.map_or(0.0, |start| message.log_time.seconds_since(start));
            progress.update(reader.position_bytes(), total, format!("{seconds:.0} s recorded"));
        }
    }
    writer.finish()?;
    progress.finish();
    Ok(count)
}
