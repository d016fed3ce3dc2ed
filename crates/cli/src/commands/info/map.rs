//! Summarises maps.

use std::fmt::{self, Write as _};
use std::io::{self, BufWriter, Write as _};
use std::path::Path;

use portolan_config::Options;
use portolan_geometry::Time;
use portolan_input::Forward;
use portolan_mapfile::{Extent, MapInfo, TrajectoryInfo, info};
use portolan_pbstream::{MapReader, PbstreamReader, ReadLimits};
use serde::Serialize;

use super::describe::{duration, size, utc};
use crate::error::CliError;
use crate::output::counted;

/// Summary of a map file.
#[derive(Serialize)]
pub struct MapReport {
    path: String,
    /// Size of the file, bytes.
    size: u64,
    /// Engine that matched the scans; none if the map does not contain it, as those of other programs.
    engine: Option<String>,
    #[serde(flatten)]
    info: MapInfo,
}

/// Reads and summarises a map.
pub fn read(path: &Path, input: Forward) -> Result<MapReport, CliError> {
    let failed = |error| CliError::in_file(path, format!("{error}; see `portolan check`"));
    let length = input.length();
    let mut reader =
        MapReader::from_source_for_summary(input, length, ReadLimits::default()).map_err(failed)?;
    let info = info(&mut reader).map_err(failed)?;
    let configuration = Options::from_json(reader.configuration()).ok();
    let engine = configuration.map(|configuration| configuration.options.engine().to_string());
    Ok(MapReport { path: path.display().to_string(), size: reader.bytes_read(), engine, info })
}

/// Prints every message as protobuf text.
pub fn print_messages(path: &Path) -> Result<(), CliError> {
    let failed = |error| CliError::in_file(path, error);
    let mut reader = PbstreamReader::open(path).map_err(failed)?;
    let mut out = Stdout { out: BufWriter::new(std::io::stdout().lock()), error: None };
    while let Some(message) = reader.next_message().map_err(failed)? {
        let kind = message.kind().name();
        let written = writeln!(out, "# message {} at byte {}: {kind}", message.index, message.offset)
            .and_then(|()| message.write_text(&mut out));
        if written.is_err() {
            break;
        }
    }
    match out.error {
        Some(error) => Err(error.into()),
        None => Ok(out.out.flush()?),
    }
}

/// Adapter from [`fmt::Write`] to stdout; it stores the I/O error, which [`fmt::Error`] cannot carry.
struct Stdout<W: io::Write> {
    out: BufWriter<W>,
    error: Option<io::Error>,
}

impl<W: io::Write> fmt::Write for Stdout<W> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.out.write_all(text.as_bytes()).map_err(|error| {
            self.error = Some(error);
            fmt::Error
        })
    }
}

impl MapReport {
    /// Whether a part of the file could not be read.
    pub fn lost_data(&self) -> bool {
        self.info.damage.is_some()
    }

    /// Summary as text; lines that Cartographer's tool also prints have the same wording.
    pub fn text(&self, with_options: bool) -> String {
        let info = &self.info;
        let mut text = format!("{}: map, {}, {}\n", self.path, grids(info), size(self.size));
        text.push_str(&format!("Header: format_version: {}\n", info.format_version));
        if let Some(engine) = &self.engine {
            text.push_str(&format!("Engine: {engine}\n"));
        }
        for (trajectory, line) in info.trajectories.iter().zip(info.trajectory_lines()) {
            text.push_str(&format!("{line}\n{}", trajectory_text(trajectory)));
            if with_options {
                text.push_str("  options\n");
                trajectory.options.lines().for_each(|line| text.push_str(&format!("    {line}\n")));
            }
        }
        let constraints = info.constraints;
        text.push_str(&format!(
            "Constraints: {} of nodes in their own submaps, {} loop closures, {} between trajectories\n",
            constraints.intra_submap, constraints.inter_submap, constraints.inter_trajectory
        ));
        if info.landmarks > 0 {
            text.push_str(&format!("Landmarks: {}\n", info.landmarks));
        }
        text.push_str(&extent("Nodes", info.bounding_box.as_ref()));
        text.push_str(&extent("Mapped", info.mapped_extent.as_ref()));
        text.push_str(&memory(info));
        info.counter_lines().for_each(|line| text.push_str(&format!("{line}\n")));
        let ignored = info.ignored;
        let count = ignored.pose_graphs + ignored.options + ignored.unknown;
        if count > 0 {
            text.push_str(&format!("{count} messages were left out; see `portolan check`\n"));
        }
        if let Some(damage) = &info.damage {
            text.push_str(&format!("lost: {damage}; `portolan check` says more\n"));
        }
        text
    }
}

fn grids(info: &MapInfo) -> String {
    let grids = &info.grids;
    let kinds = [
        (grids.probability_grids, "probability grid", "probability grids"),
        (grids.tsdfs, "TSDF grid", "TSDF grids"),
        (grids.hybrid_grids, "pair of hybrid grids", "pairs of hybrid grids"),
    ];
    let mut parts: Vec<String> =
        kinds.iter().filter(|kind| kind.0 > 0).map(|(n, one, several)| counted(*n, one, several)).collect();
    if parts.is_empty() {
        parts.push("no grids".to_owned());
    }
    let resolutions: Vec<&str> = grids.resolutions.keys().map(String::as_str).collect();
    if !resolutions.is_empty() {
        parts.push(format!("cells of {} m", resolutions.join(" and ")));
    }
    parts.join(", ")
}

/// Decompressed size of the messages in total, and of the four largest kinds.
fn memory(info: &MapInfo) -> String {
    let mut kinds: Vec<(&String, u64)> = info.unpacked_bytes.iter().map(|(k, v)| (k, *v)).collect();
    kinds.sort_by_key(|(name, bytes)| (std::cmp::Reverse(*bytes), *name));
    let total = kinds.iter().map(|(_, bytes)| bytes).sum();
    let parts: Vec<String> =
        kinds.iter().take(4).map(|(name, bytes)| format!("{name} {}", size(*bytes))).collect();
    format!("Unpacked: {} ({}), {} cells\n", size(total), parts.join(", "), info.grids.cells)
}

fn trajectory_text(trajectory: &TrajectoryInfo) -> String {
    let mut lines = Vec::new();
    if let Some(start) = &trajectory.start_time {
        let date = Time::from_unix_decimal(start).map(utc).unwrap_or_default();
        lines.push(format!("start     {date} UTC ({start})"));
    }
    lines.push(format!("duration  {}", duration(trajectory.duration)));
    lines.push(format!("path      {:.2} m", trajectory.path_length));
    lines.push(format!("finished  {} of {} submaps", trajectory.finished_submaps, trajectory.submaps));
    let sensors: Vec<String> = trajectory.sensors.iter().map(|s| format!("{} ({})", s.id, s.kind)).collect();
    if !sensors.is_empty() {
        lines.push(format!("sensors   {}", sensors.join(", ")));
    }
    let kept: Vec<String> = trajectory.sensor_data.iter().map(|(kind, n)| format!("{n} {kind}")).collect();
    if !kept.is_empty() {
        lines.push(format!("kept      {}", kept.join(", ")));
    }
    if let Some(gravity) = trajectory.gravity_constant {
        lines.push(format!("gravity   {gravity:.4} m/s^2"));
    }
    if trajectory.has_fixed_frame {
        let where_it_is = match trajectory.fixed_frame_on_earth {
            Some([latitude, longitude, _]) => format!("; it begins at {latitude:.6}, {longitude:.6}"),
            None => String::new(),
        };
        lines.push(format!("fixed frame (GNSS) placed in the map{where_it_is}"));
    }
    lines.iter().map(|line| format!("  {line}\n")).collect()
}

fn extent(what: &str, extent: Option<&Extent>) -> String {
    let Some(Extent { min, max }) = extent else { return String::new() };
    let axes: Vec<String> = ["x", "y", "z"]
        .iter()
        .zip(min.iter().zip(max))
        .map(|(axis, (min, max))| format!("{axis} {min:.2} to {max:.2}"))
        .collect();
    format!("{what}: {} m\n", axes.join(", "))
}
