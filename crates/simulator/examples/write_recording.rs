//! Writes a simulated recording with its truth, and prints the time it took.
//!
//! ```text
//! cargo run --release -p portolan-simulator --example write_recording -- office 1 300 out/office.bag [FAULT ...]
//! ```
//! Beside `office.bag` (or `.mcap`) come `office.truth.tum`, `office.walls.csv`, `office.truth.pgm` and
//! `office.truth.yaml`. With `-` as the name nothing is written and only the making is timed.

use std::error::Error;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::time::Instant;

use portolan_recording::Recording;
use portolan_simulator::sensors::Fault;
use portolan_simulator::{ScenarioOptions, Simulation};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let argument = |i: usize, default: &'static str| arguments.get(i).map_or(default, String::as_str);
    let faults = arguments.iter().skip(4).map(|text| text.parse()).collect::<Result<Vec<Fault>, _>>()?;
    let options = ScenarioOptions {
        duration: Some(argument(2, "300").parse()?),
        faults,
        ..ScenarioOptions::new(argument(0, "office").parse()?, argument(1, "1").parse()?)
    };
    let begin = Instant::now();
    let simulation = Simulation::new(options)?;
    let planned = begin.elapsed();
    let name = argument(3, "-");
    let count = if name == "-" { make_all(&simulation)? } else { write_all(&simulation, Path::new(name))? };
    let metres = simulation.walk().state_2d(simulation.duration()).travelled;
    writeln!(
        std::io::stdout(),
        "{}: {:.0} s, {metres:.0} m, {count} messages; planned in {planned:.2?}, all in {:.2?}",
        simulation.format(),
        simulation.duration(),
        begin.elapsed()
    )?;
    Ok(())
}

fn make_all(simulation: &Simulation) -> Result<u64, Box<dyn Error>> {
    let mut reader = simulation.read(&|_| true)?;
    let mut count = 0;
    while reader.next_message()?.is_some() {
        count += 1;
    }
    Ok(count)
}

fn write_all(simulation: &Simulation, path: &Path) -> Result<u64, Box<dyn Error>> {
    let mut writer = portolan_recording::create(path, None)?;
    let count = simulation.write_messages(&mut *writer)?;
    writer.finish()?;
    let mut truth = BufWriter::new(File::create(path.with_extension("truth.tum"))?);
    simulation.write_truth_tum(&mut truth, 100.0)?;
    truth.flush()?;
    let mut walls = BufWriter::new(File::create(path.with_extension("walls.csv"))?);
    simulation.write_walls_csv(&mut walls)?;
    walls.flush()?;
    let picture = simulation.occupancy(0.05);
    let image = path.with_extension("truth.pgm");
    std::fs::write(&image, picture.to_pgm())?;
    let image_name = image.file_name().unwrap_or_default().to_string_lossy().into_owned();
    std::fs::write(path.with_extension("truth.yaml"), picture.to_yaml(&image_name))?;
    Ok(count)
}
