//! `portolan repair`: saves the intact parts of a damaged map.

use std::path::PathBuf;

use portolan_mapfile::{Repair, RepairError, RepairReport, repair};
use portolan_pbstream::ReadLimits;
use serde::Serialize;

use crate::error::{CliError, Outcome};
use crate::output::{counted, print_json, print_summary};

/// Save the intact parts of a damaged map (.pbstream).
///
/// Finds intact records in any file, even where sizes or bytes between them are damaged, and writes a map in
/// which every referenced id exists, every pose is valid and every size is correct. Intact records are copied
/// byte for byte. Exit code 3 if data were lost.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan check broken.pbstream\n  \
    portolan repair broken.pbstream -o mended.pbstream")]
pub struct RepairArgs {
    /// The damaged map.
    map: PathBuf,
    /// File to write; may be the map itself.
    #[arg(short, long, value_name = "MAP")]
    output: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report<'a> {
    output: String,
    #[serde(flatten)]
    report: &'a RepairReport,
    lost_data: bool,
}

pub fn run(args: &RepairArgs) -> Result<Outcome, CliError> {
    let report = repair(&args.map, &args.output, ReadLimits::default()).map_err(|error| match error {
        RepairError::Write(error) => CliError::Failed(error.to_string()),
        other => CliError::in_file(&args.map, other),
    })?;
    let lost_data = report.loses_data();
    if args.json {
        print_json(&Report { output: args.output.display().to_string(), report: &report, lost_data })?;
    } else {
        print_summary(&(text(&report) + &args.output.display().to_string()));
    }
    Ok(if lost_data { Outcome::DataLost } else { Outcome::Done })
}

fn text(report: &RepairReport) -> String {
    let mut text = counted(report.messages, "message", "messages") + " written\n";
    if report.repairs.is_empty() {
        text += "nothing had to be repaired\n";
    }
    if report.lost_bytes > 0 {
        text += &format!("{} could not be read\n", counted(report.lost_bytes, "byte", "bytes"));
    }
    for (repair, count) in &report.repairs {
        let verdict = if repair.loses_data() { "lost" } else { "repaired" };
        text += &format!("{verdict}: {} ({count}x)\n", in_words(*repair));
    }
    text
}

fn in_words(repair: Repair) -> &'static str {
    match repair {
        Repair::DamagedRecords => "part of the file that cannot be read",
        Repair::HeaderMade => "the header was missing; a new one was made",
        Repair::PoseGraphMade => {
            "the pose graph; a new one was made of the local maps, without loop closures"
        }
        Repair::OptionsMade => "options of a trajectory; empty ones were made",
        Repair::StartDropped => "start of a trajectory relative to a missing one",
        Repair::MessageDropped => "message that is not valid, or occurs a second time",
        Repair::TrajectoryDropped => "trajectory whose id occurs twice or is negative",
        Repair::SubmapDropped => "submap that cannot be used",
        Repair::NodeDropped => "node that cannot be used",
        Repair::SubmapPoseDropped => "pose of a missing submap",
        Repair::NodePoseDropped => "pose of a node that is missing or out of order",
        Repair::ConstraintDropped => "constraint to a missing node or submap",
        Repair::LandmarkDropped => "landmark without a valid pose",
        Repair::SensorDataDropped => "sensor message that is not valid or out of order",
        Repair::PointCloudDropped => "point cloud of a node",
        Repair::HistogramDropped => "histogram that is not finite",
        Repair::CellsMended => "cells of a grid with impossible values, now unknown",
        Repair::QuaternionNormalised => "rotation normalised to length 1",
        Repair::ImuDerived => "IMU sample added that agrees with the poses",
    }
}
