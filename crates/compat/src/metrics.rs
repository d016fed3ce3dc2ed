//! `cartographer_compute_relations_metrics`: compares trajectory 0 of a map with relations.

use std::path::PathBuf;

use portolan::trajectory_file::{nodes, read_pose_graph};
use portolan_evaluation::{Trajectory, read_binary_relations, read_text_relations, relation_errors};
use portolan_input::read_all;

use crate::flags::{Flags, KnownFlags};
use crate::{CompatError, Completeness, Console, write_file};

/// Maximum size of a file of relations, bytes.
const LARGEST: u64 = 1 << 30;

/// Prints the errors of a map against relations.
///
/// # Errors
/// If flags are wrong, map or relations cannot be read, or the table cannot be written.
pub fn compute_relations_metrics(
    arguments: &[String],
    console: &mut dyn Console,
) -> Result<Completeness, CompatError> {
    let flags = Flags::parse(
        arguments,
        &KnownFlags {
            values: &[("pose_graph_filename", ""), ("relations_filename", "")],
            switches: &[("read_text_file_with_unix_timestamps", false), ("write_relation_metrics", false)],
            usage: "usage: cartographer_compute_relations_metrics -pose_graph_filename MAP -relations_filename \
                    RELATIONS",
        },
    )?;
    let (map, relations) = (flags.path("pose_graph_filename")?, flags.path("relations_filename")?);
    console.info(&format!("Reading pose graph from '{}'...", map.display()));
    let graph = read_pose_graph(&map)?;
    let trajectory = Trajectory::new(nodes(&map, &graph, 0)?).0;
    console.info(&format!("Reading relations from '{}'...", relations.display()));
    let bytes = read_all(&relations, LARGEST)
        .map_err(|source| CompatError::File { path: relations.clone(), source })?;
    let read = if flags.is_on("read_text_file_with_unix_timestamps") {
        read_text_relations(&*bytes)
    } else {
        read_binary_relations(&bytes)
    };
    let list = read.map_err(|error| CompatError::in_file(&relations, error))?;
    let report = relation_errors(&trajectory, &list)?;
    if flags.is_on("write_relation_metrics") {
        let csv = PathBuf::from(format!("{}.relation_metrics.csv", map.display()));
        console.info(&format!("Writing relation metrics to '{}'...", csv.display()));
        write_file(&csv, |out| report.write_csv(out))?;
    }
    console.info(&format!("Result:\n{report}"));
    Ok(Completeness::Complete)
}
