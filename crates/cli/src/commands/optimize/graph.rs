//! Optimisation of g2o files.

use portolan_input::Forward;
use portolan_solver::g2o::{G2oRepairs, Graph, Report, optimize_graph, read_g2o, write_g2o};

use super::OptimizeArgs;
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{counted, print_json, print_summary, write_file};
use crate::progress::say;

pub fn run(args: &OptimizeArgs, input: Forward, global: &GlobalArgs) -> Result<Outcome, CliError> {
    if !args.set.is_empty() {
        return Err(CliError::Usage("--set is for maps; a g2o file has no options".to_owned()));
    }
    let (mut graph, repairs) = read_g2o(input).map_err(|error| CliError::in_file(&args.input, error))?;
    let notes = notes(&repairs);
    if !global.quiet {
        notes.iter().for_each(|note| say(&format!("{}: {note}", args.input.display())));
    }
    let report = optimize_graph(&mut graph, &args.graph_options())
        .map_err(|error| CliError::in_file(&args.input, error))?;
    write_file(&args.output, |out| write_g2o(&graph, out))?;
    if args.json {
        print_json(&json(args, &graph, &report, &notes))?;
    } else {
        print_summary(&(text(&graph, &report) + &args.output.display().to_string()));
    }
    let lost = repairs.unusable_vertices
        + repairs.unusable_edges
        + repairs.duplicate_vertices
        + repairs.ignored_tags.values().sum::<usize>();
    Ok(if lost > 0 { Outcome::DataLost } else { Outcome::Done })
}

/// What was not as it should be, in words.
pub fn notes(repairs: &G2oRepairs) -> Vec<String> {
    let mut notes: Vec<String> = repairs
        .ignored_tags
        .iter()
        .map(|(tag, n)| {
            format!("{} with the unknown tag {tag}: left out", counted(*n as u64, "line", "lines"))
        })
        .collect();
    let counts = [
        (repairs.duplicate_vertices, "vertices given again: the first counts"),
        (repairs.unusable_vertices, "vertices with numbers that are no pose"),
        (repairs.created_vertices, "vertices that only edges name: placed by following measurements"),
        (repairs.unusable_edges, "edges with numbers that are no measurement: left out"),
        (repairs.self_edges, "edges from a vertex to itself: left out"),
        (repairs.normalized_quaternions, "quaternions normalised"),
        (repairs.unknown_fixed, "FIX lines for vertices that do not exist"),
    ];
    notes.extend(counts.into_iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")));
    notes
}

fn text(graph: &Graph, report: &Report) -> String {
    let dimension = if matches!(graph, Graph::Planar(_)) { "in 2D" } else { "in 3D" };
    let mut text = format!(
        "{} poses {dimension}, {} edges, {}\n",
        graph.vertex_count(),
        graph.edge_count(),
        counted(report.components as u64, "part", "parts")
    );
    text += &format!("chi2 of the file     {:.6}\n", report.chi2_before);
    text += &format!("chi2 at the start    {:.6} ({:?})\n", report.chi2_initialized, report.initialization);
    text += &format!("chi2 after           {:.6} (redundancy {})\n", report.chi2_after, report.redundancy());
    text += &format!("{} iterations, {:?}\n", report.iterations, report.termination);
    if report.repaired_information > 0 {
        text += &format!(
            "{} information matrices were indefinite: negative eigenvalues taken as zero\n",
            report.repaired_information
        );
    }
    if let Some(condition) = report.condition {
        text += &format!("condition            {condition:.3e}\n");
    }
    if report.components > 1 {
        let held: Vec<String> = report.anchored.iter().take(10).map(ToString::to_string).collect();
        text += &format!("the graph is not connected; held in its parts: {}\n", held.join(", "));
    }
    if !report.worst_edges.is_empty() {
        text += "edges that fit worst\n";
    }
    for edge in &report.worst_edges {
        text += &format!("  {} -> {}  chi2 {:.6}\n", edge.from, edge.to, edge.chi2);
    }
    text
}

fn json(args: &OptimizeArgs, graph: &Graph, report: &Report, notes: &[String]) -> serde_json::Value {
    let edges: Vec<_> = report
        .worst_edges
        .iter()
        .map(|e| serde_json::json!({ "edge": e.edge, "from": e.from, "to": e.to, "chi2": e.chi2 }))
        .collect();
    let trials: Vec<_> = report
        .trials
        .iter()
        .map(|(how, cost)| serde_json::json!({ "start": format!("{how:?}"), "cost": cost }))
        .collect();
    serde_json::json!({
        "output": args.output.display().to_string(),
        "dimension": if matches!(graph, Graph::Planar(_)) { 2 } else { 3 },
        "vertices": graph.vertex_count(),
        "edges": graph.edge_count(),
        "components": report.components,
        "anchored": report.anchored,
        "chi2_before": report.chi2_before,
        "chi2_initialized": report.chi2_initialized,
        "chi2_after": report.chi2_after,
        "redundancy": report.redundancy(),
        "iterations": report.iterations,
        "termination": format!("{:?}", report.termination),
        "initialization": format!("{:?}", report.initialization),
        "trials": trials,
        "repaired_information": report.repaired_information,
        "condition": report.condition.filter(|c| c.is_finite()),
        "worst_edges": edges,
        "notes": notes,
    })
}
