//! What is measured while a job runs, in rows of a few minutes of the recording.

use std::fs::File;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use portolan::job::{Event, Observer, resident_and_peak_bytes};
use portolan::mapping::BackendProgress;

use crate::summary::{plots, verdict};

/// Rows of an hour.
pub const ROWS_AN_HOUR: f64 = 12.0;
const HEADER: &str = "hours,wall_s,cpu_s,memory_mb,most_mb,p50_ms,p99_ms,most_ms,cpu_p50_ms,cpu_p99_ms,cpu_most_ms,\
    nodes,submaps,constraints";

/// One row.
#[derive(Clone, Copy, Default)]
pub struct Row {
    /// Of the recording.
    pub hours: f64,
    wall_seconds: f64,
    /// Processor time so far.
    pub cpu_seconds: f64,
    /// In use, megabytes.
    pub memory: f64,
    most_memory: f64,
    /// Milliseconds from one measurement to the next, with what the simulator takes to make them: median, 99 %, most.
    pub latency: [f64; 3],
    /// The processor time of that: what other programs do does not count.
    pub cpu_latency: [f64; 3],
    /// Nodes, submaps and constraints.
    pub graph: [usize; 3],
}

impl Row {
    fn text(&self) -> String {
        let Self { hours, wall_seconds, cpu_seconds, memory, most_memory, latency, cpu_latency, graph } =
            self;
        let milliseconds: Vec<String> =
            latency.iter().chain(cpu_latency).map(|v| format!("{v:.3}")).collect();
        let graph: Vec<String> = graph.iter().map(usize::to_string).collect();
        let (milliseconds, graph) = (milliseconds.join(","), graph.join(","));
        format!(
            "{hours:.4},{wall_seconds:.1},{cpu_seconds:.1},{memory:.1},{most_memory:.1},{milliseconds},{graph}"
        )
    }
}

/// Rows so far.
pub struct Rows {
    folder: PathBuf,
    csv: File,
    begin: Instant,
    last: Clocks,
    hours: f64,
    /// Since the last row: milliseconds by the clock, and of the processor.
    milliseconds: [Vec<f64>; 2],
    rows: Vec<Row>,
}

/// Seconds by the clock, and of the processor.
#[derive(Clone, Copy)]
struct Clocks(Instant, f64);

impl Clocks {
    fn read() -> Self {
        Self(Instant::now(), cpu_seconds().unwrap_or(0.0))
    }
}

impl Rows {
    /// Nothing of so many hours.
    pub fn begin(folder: &Path, hours: f64) -> std::io::Result<Self> {
        let mut csv = File::create(folder.join("soak.csv"))?;
        writeln!(csv, "{HEADER}")?;
        let (folder, last) = (folder.to_owned(), Clocks::read());
        Ok(Self {
            folder,
            csv,
            begin: last.0,
            last,
            hours,
            milliseconds: Default::default(),
            rows: Vec::new(),
        })
    }

    /// A measurement was used, at this share of the recording.
    fn add(&mut self, share: f64, graph: [usize; 3]) -> std::io::Result<()> {
        let now = Clocks::read();
        self.milliseconds[0].push(1e3 * (now.0 - self.last.0).as_secs_f64());
        self.milliseconds[1].push(1e3 * (now.1 - self.last.1));
        let hours = self.hours * share;
        if hours * ROWS_AN_HOUR >= (self.rows.len() + 1) as f64 {
            self.write(hours, graph)?;
        }
        self.last = Clocks::read();
        Ok(())
    }

    fn write(&mut self, hours: f64, graph: [usize; 3]) -> std::io::Result<()> {
        let [latency, cpu_latency] = std::mem::take(&mut self.milliseconds).map(|mut milliseconds| {
            milliseconds.sort_by(f64::total_cmp);
            [0.5, 0.99, 1.0].map(|share| at(&milliseconds, share))
        });
        let (now, most) = resident_and_peak_bytes().unwrap_or_default();
        let [memory, most_memory] = [now, most].map(|bytes| bytes as f64 / 1e6);
        let (wall_seconds, cpu_seconds) = (self.begin.elapsed().as_secs_f64(), cpu_seconds().unwrap_or(0.0));
        let row = Row { hours, wall_seconds, cpu_seconds, memory, most_memory, latency, cpu_latency, graph };
        self.rows.push(row);
        writeln!(self.csv, "{}", row.text())?;
        std::fs::write(self.folder.join("soak.svg"), plots(&self.rows))
    }

    /// Whether the end is as the first hour was.
    pub fn end(self) -> String {
        verdict(&self.rows)
    }
}

/// A quantile of sorted values; 0 if there are none.
pub fn at(sorted: &[f64], share: f64) -> f64 {
    sorted.get((share * (sorted.len().max(1) - 1) as f64) as usize).copied().unwrap_or(0.0)
}

/// Processor time of the threads of this program so far, where the system reports it.
fn cpu_seconds() -> Option<f64> {
    let threads = std::fs::read_dir("/proc/self/task").ok()?;
    let of_thread = |thread: std::fs::DirEntry| -> Option<f64> {
        let text = std::fs::read_to_string(thread.path().join("schedstat")).ok()?;
        Some(1e-9 * text.split_whitespace().next()?.parse::<f64>().ok()?)
    };
    Some(threads.filter_map(|thread| of_thread(thread.ok()?)).sum())
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
