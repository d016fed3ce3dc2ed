//! `cartographer_autogenerate_ground_truth` and `cartographer_compute_relations_metrics`.

use std::path::PathBuf;

use portolan::trajectory_file::{nodes, read_pose_graph};
use portolan_config::flags::{Flags, KnownFlags};
use portolan_evaluation::{
    GenerateOptions, Trajectory, generate_relations, read_binary_relations, read_text_relations,
    relation_errors, write_binary_relations,
};

use super::log;
use crate::GlobalArgs;
use crate::commands::evaluate::generate::read_map_graph;
use crate::error::{CliError, Outcome};
use crate::input::read_bytes;
use crate::output::write_file;

/// Relations from the loop closures of a map.
pub fn generate(arguments: &[String], _: &GlobalArgs) -> Result<Outcome, CliError> {
    let flags = Flags::parse(
        arguments,
        &KnownFlags {
            values: &[
                ("pose_graph_filename", ""),
                ("output_filename", ""),
                ("min_covered_distance", "100"),
                ("outlier_threshold_meters", "0.15"),
                ("outlier_threshold_radians", "0.02"),
            ],
            switches: &[],
            usage: "usage: cartographer_autogenerate_ground_truth -pose_graph_filename MAP -output_filename \
                    RELATIONS",
        },
    )?;
    let (map, output) = (flags.path("pose_graph_filename")?, flags.path("output_filename")?);
    let options = GenerateOptions {
        min_covered_distance: flags.number("min_covered_distance")?,
        outlier_threshold_meters: flags.number("outlier_threshold_meters")?,
        outlier_threshold_radians: flags.number("outlier_threshold_radians")?,
    };
    log::info(&format!("Reading pose graph from '{}'...", map.display()));
    let graph = read_map_graph(&map)?;
    log::info("Autogenerating ground truth relations...");
    let generated = generate_relations(&graph, &options).map_err(|error| CliError::in_file(&map, error))?;
    log::info(&generated.summary());
    log::info(&format!("Writing {} relations to '{}'.", generated.relations.len(), output.display()));
    write_file(&output, |out| write_binary_relations(&generated.relations, out))?;
    Ok(Outcome::Done)
}

/// A map judged by relations.
pub fn metrics(arguments: &[String], _: &GlobalArgs) -> Result<Outcome, CliError> {
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
    log::info(&format!("Reading pose graph from '{}'...", map.display()));
    let graph = read_pose_graph(&map)?;
    let trajectory = Trajectory::new(nodes(&map, &graph, 0)?).0;
    log::info(&format!("Reading relations from '{}'...", relations.display()));
    let bytes = read_bytes(&relations)?;
    let read = if flags.is_on("read_text_file_with_unix_timestamps") {
        read_text_relations(&*bytes)
    } else {
        read_binary_relations(&bytes)
    };
    let list = read.map_err(|error| CliError::in_file(&relations, error))?;
    let report = relation_errors(&trajectory, &list)?;
    if flags.is_on("write_relation_metrics") {
        let csv = PathBuf::from(format!("{}.relation_metrics.csv", map.display()));
        log::info(&format!("Writing relation metrics to '{}'...", csv.display()));
        write_file(&csv, |out| report.write_csv(out))?;
    }
    log::info(&format!("Result:\n{report}"));
    Ok(Outcome::Done)
}
