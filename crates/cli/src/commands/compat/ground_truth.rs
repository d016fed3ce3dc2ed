//! `cartographer_autogenerate_ground_truth`: makes relations from the loop closures of a map.

use portolan_compat::{Flags, KnownFlags};
use portolan_evaluation::{GenerateOptions, generate_relations, write_binary_relations};

use super::log;
use crate::GlobalArgs;
use crate::commands::evaluate::generate::read_map_graph;
use crate::error::{CliError, Outcome};
use crate::output::write_file;

/// Writes relations from the loop closures of a map.
pub fn run(arguments: &[String], _: &GlobalArgs) -> Result<Outcome, CliError> {
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
