//! `cartographer_rosbag_validate` checks a bag; `cartographer_dev_trajectory_comparison` compares a map with the
//! transforms of a bag.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use portolan::trajectory_file::{nodes, read_pose_graph};
use portolan_diagnose::{Severity, check, findings_to_text};
use portolan_geometry::{Rigid3, Time, rotation_angle};
use portolan_ingest::{IngestOptions, TfInput, TfTree};
use portolan_recording::{Message, Recording, open};

use crate::flags::{Flags, KnownFlags};
use crate::{CompatError, Completeness, Console, write_file};

/// Prints the faults of a bag.
///
/// # Errors
/// If flags are wrong, the bag cannot be read or has errors, or a table cannot be written.
pub fn rosbag_validate(arguments: &[String], console: &mut dyn Console) -> Result<Completeness, CompatError> {
    let flags = Flags::parse(
        arguments,
        &KnownFlags {
            values: &[("bag_filename", "")],
            switches: &[("dump_timing", false)],
            usage: "usage: cartographer_rosbag_validate -bag_filename BAG",
        },
    )?;
    let recording = open(&flags.path("bag_filename")?)?;
    if flags.is_on("dump_timing") {
        dump_timing(recording.as_ref(), console)?;
    }
    let report = check(recording.as_ref(), &IngestOptions::default(), &mut |_| {})?;
    console.print(&findings_to_text(&report.findings))?;
    report.histograms.iter().for_each(|text| console.info(text));
    match report.findings.iter().any(|f| f.severity == Severity::Error) {
        true => Err(CompatError::Failed("the bag has errors".to_owned())),
        false => Ok(Completeness::Complete),
    }
}

/// Writes `timing_<frame>.csv` for every frame: number of each message, its time of recording and its header stamp,
/// Unix nanoseconds.
fn dump_timing(recording: &dyn Recording, console: &mut dyn Console) -> Result<(), CompatError> {
    let mut tables: BTreeMap<Arc<str>, Vec<[i64; 2]>> = BTreeMap::new();
    let mut reader = recording.read(&|_| true)?;
    while let Some(recorded) = reader.next_message()? {
        let is_meant = matches!(
            recorded.message,
            Message::LaserScan(_)
                | Message::MultiEchoLaserScan(_)
                | Message::PointCloud2(_)
                | Message::Imu(_)
                | Message::Odometry(_)
        );
        if let (true, Some(header)) = (is_meant, recorded.message.header()) {
            let times = [recorded.log_time, header.stamp].map(|time| time.unix_nanoseconds());
            tables.entry(header.frame_id.clone()).or_default().push(times);
        }
    }
    for (frame, rows) in tables {
        // The name of a frame must not contain a path to another folder.
        let path = PathBuf::from(format!("timing_{}.csv", frame.replace(['/', '\\'], "_")));
        write_file(&path, |out| {
            writeln!(out, "# packet index\tbag time, ns\theader stamp, ns")?;
            (1_u64..).zip(&rows).try_for_each(|(i, [bag, stamp])| writeln!(out, "{i}\t{bag}\t{stamp}"))
        })?;
        console.info(&format!("Wrote {} lines to '{}'.", rows.len(), path.display()));
    }
    Ok(())
}

/// Prints the distributions of translation and rotation between the last trajectory of a map and the transforms of a
/// bag.
///
/// # Errors
/// If flags are wrong, map or bag cannot be read, or the bag has no such transforms.
pub fn trajectory_comparison(
    arguments: &[String],
    console: &mut dyn Console,
) -> Result<Completeness, CompatError> {
    let flags = Flags::parse(
        arguments,
        &KnownFlags {
            values: &[
                ("bag_filename", ""),
                ("tf_parent_frame", "map"),
                ("tf_child_frame", "base_link"),
                ("pbstream_filename", ""),
            ],
            switches: &[],
            usage: "usage: cartographer_dev_trajectory_comparison -bag_filename BAG -pbstream_filename MAP",
        },
    )?;
    let map = flags.path("pbstream_filename")?;
    let graph = read_pose_graph(&map)?;
    let last = graph.trajectory.last().map_or(0, |t| t.trajectory_id);
    let trajectory = portolan_evaluation::Trajectory::new(nodes(&map, &graph, last)?).0;
    let poses = tf_poses(&flags.path("bag_filename")?, &flags)?;
    if poses.is_empty() {
        return Err(CompatError::Failed("the bag has no such transforms".to_owned()));
    }
    let errors: Vec<(f64, f64)> = poses
        .iter()
        .map(|(time, pose)| match trajectory.lookup(*time) {
            Some(found) => {
                let error = found.inverse() * pose;
                (error.translation.vector.norm(), rotation_angle(&error))
            }
            None => (f64::MAX, f64::MAX),
        })
        .collect();
    let translations = errors.iter().map(|e| e.0).collect();
    let rotations = errors.iter().map(|e| e.1).collect();
    console.print(&format!(
        "Distribution of translation difference:\n{}Distribution of rotation difference:\n{}",
        deciles(translations),
        deciles(rotations)
    ))?;
    for limit in [1.0, 0.1, 0.05, 0.01] {
        let share = errors.iter().filter(|e| e.0 < limit).count() as f64 / errors.len() as f64;
        console.print(&format!("Fraction of translation difference smaller than {limit} m: {share}"))?;
    }
    Ok(Completeness::Complete)
}

fn deciles(mut values: Vec<f64>) -> String {
    values.sort_by(f64::total_cmp);
    let at = |p: usize| values.get(p * values.len().saturating_sub(1) / 10).copied().unwrap_or(f64::NAN);
    (0..=10).map(|p| format!("  {}%: {}\n", 10 * p, at(p))).collect()
}

/// Pose of the child frame in the parent frame, at each stamp of a transform to the child frame.
fn tf_poses(path: &PathBuf, flags: &Flags) -> Result<Vec<(Time, Rigid3)>, CompatError> {
    let (parent, child) = (flags.value("tf_parent_frame"), flags.value("tf_child_frame"));
    let recording = open(path)?;
    let (mut tree, mut input) = (TfTree::new(), TfInput::new(""));
    let mut stamps = Vec::new();
    let mut reader = recording.read(&|_| true)?;
    while let Some(recorded) = reader.next_message()? {
        if let Message::Tf(message) = &recorded.message {
            stamps.extend(
                message
                    .transforms
                    .iter()
                    .filter(|t| t.child_frame_id.as_ref() == child)
                    .map(|t| t.header.stamp),
            );
            input.insert(&mut tree, message);
        }
    }
    stamps.sort_unstable();
    stamps.dedup();
    let looked_up = stamps.into_iter().filter_map(|t| Some((t, tree.lookup(parent, child, t).ok()?)));
    Ok(looked_up.collect())
}
