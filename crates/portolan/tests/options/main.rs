//! Every option has its documented effect: with another value the observed quantity changes in the stated
//! direction.
//!
//! The tables are in the files of this folder, one line per option. The test at the end of this file holds
//! them complete: every option of the catalogue is in a table, or is documented to have no effect.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

mod absurd;
mod effect;
mod graph;
mod graph_3d;
mod in_worlds;
mod lifelong;
mod local_2d;
mod local_3d;
mod matching_3d;
mod optimization;
mod prediction;
mod run;
mod search_3d;
mod sensors;
mod world;

use std::collections::BTreeSet;

use portolan::config::catalogue;

/// Options whose effect is a line in the log; `tests/options_logs.rs` observes it.
const LOGS: [&str; 3] = [
    "map_builder.pose_graph.constraint_builder.log_matches",
    "map_builder.pose_graph.log_residual_histograms",
    "map_builder.pose_graph.optimization_problem.log_solver_summary",
];

fn observed() -> BTreeSet<String> {
    let in_3d = [local_3d::table(), prediction::table(), matching_3d::table(), search_3d::table()];
    let tables = [local_2d::table(), graph::table(), optimization::table(), sensors::table()];
    let tables = tables.into_iter().chain(in_3d);
    let paths = tables.flatten().map(|effect| effect.path());
    paths.chain(LOGS.map(str::to_owned)).collect()
}

#[test]
fn every_option_is_observed_or_documented_to_have_no_effect() {
    let observed = observed();
    let leaves = || catalogue().iter().filter(|doc| !doc.is_table);
    let forgotten: Vec<&str> = leaves()
        .filter(|doc| doc.without_effect.is_none() && !observed.contains(&doc.path))
        .map(|doc| doc.path.as_str())
        .collect();
    assert!(forgotten.is_empty(), "neither in a table nor without effect:\n{}", forgotten.join("\n"));
    let contradicted: Vec<&str> = leaves()
        .filter(|doc| doc.without_effect.is_some() && observed.contains(&doc.path))
        .map(|doc| doc.path.as_str())
        .collect();
    assert!(contradicted.is_empty(), "said to have no effect, and observed: {contradicted:?}");
}
