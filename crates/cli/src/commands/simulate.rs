//! `portolan simulate`: recordings of buildings that do not exist, with exact truth.

mod scenario;

use std::path::{Path, PathBuf};

use portolan_recording::{Recording, RecordingFormat, RecordingWriter, create};
use portolan_simulator::Simulation;

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::interrupt;
use crate::output::{print, write_file};
use crate::progress::{Progress, say};
use scenario::ScenarioArgs;

/// Simulate a robot that tours a building, and write the recording with its truth.
///
/// Beside the recording NAME.bag the files NAME.truth.tum (true poses of base_link) and NAME.walls.csv
/// (all fixed surfaces) are written. The same options give the same bytes.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan simulate -o office.bag\n  \
    portolan simulate warehouse -o night.mcap --seed 7 --minutes 10 --people 0\n  \
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
    /// True poses per second.
    #[arg(long, value_name = "HZ", default_value_t = 100.0)]
    truth_rate: f64,
    /// File for the walls instead of NAME.walls.csv.
    #[arg(long, value_name = "FILE.csv")]
    walls: Option<PathBuf>,
}

pub fn run(args: &SimulateArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    if !(1e-3..=1e4).contains(&args.truth_rate) {
        let text = format!("--truth-rate must be from 0.001 to 10000, but is {}", args.truth_rate);
        return Err(CliError::Usage(text));
    }
    let format = RecordingFormat::from_path(&args.output).map_err(|e| CliError::Usage(e.to_string()))?;
    let simulation =
        Simulation::new(args.scenario.options()).map_err(|error| CliError::Usage(error.to_string()))?;
    interrupt::watch();
    let count = write_recording(&simulation, &args.output, format, global.quiet)?;
    let truth = beside(args.truth.as_deref(), &args.output, "truth.tum");
    write_file(&truth, |out| simulation.write_truth_tum(out, args.truth_rate))?;
    let walls = beside(args.walls.as_deref(), &args.output, "walls.csv");
    write_file(&walls, |out| simulation.write_walls_csv(out))?;
    if !global.quiet {
        say(&simulation.format());
    }
    print(&format!(
        "{}: {count} messages, {:.1} s, {:.1} m\n{}\n{}",
        args.output.display(),
        simulation.duration(),
        path_length(&simulation),
        truth.display(),
        walls.display()
    ))?;
    Ok(Outcome::Done)
}

/// The file asked for, or the recording's name with another ending.
fn beside(asked: Option<&Path>, recording: &Path, ending: &str) -> PathBuf {
    asked.map_or_else(|| recording.with_extension(ending), Path::to_owned)
}

/// Writes all messages; how many. Interrupted, nothing remains.
fn write_recording(
    simulation: &Simulation,
    path: &Path,
    format: RecordingFormat,
    quiet: bool,
) -> Result<u64, CliError> {
    let mut writer: Box<dyn RecordingWriter> = create(path, Some(format))?;
    let mut reader = simulation.read(&|_| true)?;
    let total = simulation.size_bytes();
    let mut progress = Progress::start("simulate", total, quiet);
    let mut count = 0;
    while let Some(message) = reader.next_message()? {
        writer.write(&message)?;
        count += 1;
        if interrupt::interrupted() {
            return Err(CliError::Failed(format!("interrupted; {} was not written", path.display())));
        }
        if progress.is_due() {
            let seconds = message.log_time.seconds_since(simulation.start_time());
            progress.update(reader.position_bytes(), total, format!("{seconds:.0} s recorded"));
        }
    }
    writer.finish()?;
    progress.finish();
    Ok(count)
}

/// Metres that the robot goes.
fn path_length(simulation: &Simulation) -> f64 {
    let mut positions = simulation.truth(20.0).map(|(_, pose)| pose.translation.vector);
    let Some(mut last) = positions.next() else { return 0.0 };
    positions.map(|position| (position - std::mem::replace(&mut last, position)).norm()).sum()
}
