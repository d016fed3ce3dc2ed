//! What is measured while a job runs, in rows of a few minutes of the recording.

use std::error::Error;
use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use portolan::export::{PlotLabels, PlotLine, line_plot};
use portolan::job::{Event, Observer, resident_and_peak_bytes};
use portolan::mapping::BackendProgress;

/// Rows of an hour.
const ROWS_AN_HOUR: f64 = 12.0;
const HEADER: &str = "hours,wall_s,cpu_s,memory_mb,most_mb,latency_median_ms,latency_p99_ms,latency_most_ms,nodes,submaps,constraints";
/// It is flat if the end is at most so many times the first hour.
const FLAT: f64 = 1.05;

/// One row.
#[derive(Clone, Copy, Default)]
struct Row {
    hours: f64,
    wall: f64,
    cpu: f64,
    memory: f64,
    most: f64,
    /// Milliseconds from one measurement to the next, with what the simulator takes to make them: median, 99 %, most.
    latency: [f64; 3],
    graph: [usize; 3],
}

impl Row {
    fn text(&self) -> String {
        let Self { hours, wall, cpu, memory, most, latency: [median, p99, longest], graph: [a, b, c] } = self;
        format!(
            "{hours:.4},{wall:.1},{cpu:.1},{memory:.1},{most:.1},{median:.3},{p99:.3},{longest:.1},{a},{b},{c}"
        )
    }
}

/// Rows so far.
pub struct Rows {
    folder: PathBuf,
    csv: File,
    begin: Instant,
    last: Instant,
    hours: f64,
    milliseconds: Vec<f64>,
    rows: Vec<Row>,
}

impl Rows {
    /// Nothing of so many hours.
    pub fn begin(folder: &Path, hours: f64) -> std::io::Result<Self> {
        let mut csv = File::create(folder.join("soak.csv"))?;
        writeln!(csv, "{HEADER}")?;
        let now = Instant::now();
        let folder = folder.to_owned();
        Ok(Self { folder, csv, begin: now, last: now, hours, milliseconds: Vec::new(), rows: Vec::new() })
    }

    /// A measurement was used, at this share of the recording.
    fn add(&mut self, share: f64, graph: [usize; 3]) -> std::io::Result<()> {
        self.milliseconds.push(1e3 * self.last.elapsed().as_secs_f64());
        let hours = self.hours * share;
        if hours * ROWS_AN_HOUR >= (self.rows.len() + 1) as f64 {
            self.write(hours, graph)?;
        }
        self.last = Instant::now();
        Ok(())
    }

    fn write(&mut self, hours: f64, graph: [usize; 3]) -> std::io::Result<()> {
        self.milliseconds.sort_by(f64::total_cmp);
        let latency = [0.5, 0.99, 1.0].map(|share| at(&self.milliseconds, share));
        self.milliseconds.clear();
        let (now, most) = resident_and_peak_bytes().unwrap_or_default();
        let [memory, most] = [now, most].map(|bytes| bytes as f64 / 1e6);
        let (wall, cpu) = (self.begin.elapsed().as_secs_f64(), cpu_seconds().unwrap_or(0.0));
        let row = Row { hours, wall, cpu, memory, most, latency, graph };
        self.rows.push(row);
        writeln!(self.csv, "{}", row.text())?;
        std::fs::write(self.folder.join("soak.svg"), self.plot())
    }

    fn plot(&self) -> String {
        let line = |name, colour, value: &dyn Fn(&Row) -> f64| PlotLine {
            name,
            colour,
            points: self.rows.iter().map(|row| [row.hours, value(row)]).collect(),
        };
        let draw =
            |title, y, lines: &[PlotLine]| line_plot(PlotLabels { title, x: "recording, h", y }, lines);
        let steps = self.per_row(|row| row.cpu);
        let per_minute = |row: &Row| {
            let index = self.rows.iter().position(|other| other.hours == row.hours).unwrap_or(0);
            steps.get(index).copied().unwrap_or(0.0) * ROWS_AN_HOUR / 60.0
        };
        let plots = [
            draw("Memory", "MB", &[line("in use", "#1f77b4", &|row| row.memory)]),
            draw("Processor time", "s a minute of recording", &[line("processor", "#d62728", &per_minute)]),
            draw(
                "From one measurement to the next",
                "ms",
                &[
                    line("median", "#2ca02c", &|row| row.latency[0]),
                    line("99 %", "#9467bd", &|row| row.latency[1]),
                ],
            ),
            draw(
                "Pose graph",
                "",
                &[
                    line("nodes", "#1f77b4", &|row| row.graph[0] as f64),
                    line("submaps", "#ff7f0e", &|row| row.graph[1] as f64),
                    line("constraints", "#8c564b", &|row| row.graph[2] as f64),
                ],
            ),
        ];
        let mut svg = "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"780\" height=\"1100\">".to_owned();
        for (i, plot) in plots.iter().enumerate() {
            let _ = write!(svg, "<g transform=\"translate(10 {})\">{plot}</g>", 10 + 270 * i);
        }
        svg + "</svg>"
    }

    /// By how much something grew from row to row.
    fn per_row(&self, value: impl Fn(&Row) -> f64) -> Vec<f64> {
        let mut last = 0.0;
        self.rows.iter().map(|row| value(row) - std::mem::replace(&mut last, value(row))).collect()
    }

    /// Whether the end is as the first hour was: the medians of half an hour each, of shorter runs of a third.
    pub fn end(self) -> Result<String, Box<dyn Error>> {
        let window = (ROWS_AN_HOUR as usize / 2).min(self.rows.len() / 3).max(1);
        let first_end = (ROWS_AN_HOUR as usize).clamp(window, (self.rows.len() / 2).max(window));
        let ends = |value: &dyn Fn(&Row) -> f64| {
            let median = |rows: &[Row]| {
                let mut values: Vec<f64> = rows.iter().map(value).collect();
                values.sort_by(f64::total_cmp);
                at(&values, 0.5)
            };
            let first = self.rows.get(first_end - window..first_end).map_or(0.0, median);
            (first, median(&self.rows[self.rows.len().saturating_sub(window)..]))
        };
        let mut text = String::new();
        for (name, unit, (first, end)) in [
            ("memory", "MB", ends(&|row| row.memory)),
            ("latency, 99 %", "ms", ends(&|row| row.latency[1])),
            ("latency, median", "ms", ends(&|row| row.latency[0])),
        ] {
            let ratio = end / first;
            let verdict = if ratio <= FLAT { "flat" } else { "NOT flat" };
            let _ = writeln!(
                text,
                "{name}: {first:.2} {unit} after the first hour, {end:.2} at the end: {ratio:.3}, {verdict}"
            );
        }
        let last = self.rows.last().copied().unwrap_or_default();
        let speed = last.hours * 60.0 / last.cpu;
        let _ =
            write!(text, "{:.2} h in {:.0} s of processor time: {speed:.3} h a minute", last.hours, last.cpu);
        Ok(text)
    }
}

fn at(sorted: &[f64], share: f64) -> f64 {
    sorted.get((share * (sorted.len().max(1) - 1) as f64) as usize).copied().unwrap_or(0.0)
}

/// Processor time of this program so far, where the system tells.
fn cpu_seconds() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/stat").ok()?;
    let fields: Vec<&str> = status.rsplit(')').next()?.split_whitespace().collect();
    let ticks: f64 = [11, 12].iter().map(|i| fields.get(*i)?.parse::<f64>().ok()).sum::<Option<f64>>()?;
    Some(ticks / 100.0)
}

/// Adds each measurement to the rows.
pub fn observer(rows: &mut Rows) -> Box<Observer<'_>> {
    Box::new(move |event| {
        let share = |position: u64, total: u64| position as f64 / total.max(1) as f64;
        let added = match event {
            Event::Mapping(progress) => {
                let BackendProgress { nodes, submaps, constraints, .. } = progress.backend;
                rows.add(share(progress.position_bytes, progress.total_bytes), [nodes, submaps, constraints])
            }
            Event::Localizing { position_bytes, total_bytes, .. } => {
                rows.add(share(*position_bytes, *total_bytes), [0; 3])
            }
            _ => Ok(()),
        };
        if added.is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    })
}
