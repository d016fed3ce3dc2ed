//! Optimises g2o files.

use portolan_input::Forward;
use portolan_solver::g2o::{Graph, Report, optimize_graph, read_g2o, write_g2o};

use super::OptimizeArgs;
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{print_json, print_summary, write_file};
use crate::progress::print_line;

pub fn run(args: &OptimizeArgs, input: Forward, global: &GlobalArgs) -> Result<Outcome, CliError> {
    if !args.set.is_empty() {
        return Err(CliError::Usage("--set is for maps; a g2o file has no options".to_owned()));
    }
    let (mut graph, repairs) = read_g2o(input).map_err(|error| CliError::in_file(&args.input, error))?;
    let notes = repairs.notes();
    if !global.quiet {
        notes.iter().for_each(|note| print_line(&format!("{}: {note}", args.input.display())));
    }
    let report = optimize_graph(&mut graph, &args.graph_options())
        .map_err(|error| CliError::in_file(&args.input, error))?;
    write_file(&args.output, |out| write_g2o(&graph, out))?;
    if args.json {
        print_json(&json(args, &graph, &report, &notes))?;
    } else {
        print_summary(&(report.text(&graph) + &args.output.display().to_string()));
    }
    let lost = repairs.unusable_vertices
        + repairs.unusable_edges
        + repairs.duplicate_vertices
        + repairs.ignored_tags.values().sum::<usize>();
    Ok(if lost > 0 { Outcome::DataLost } else { Outcome::Done })
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
        "dimension": if matches!(graph, Graph::TwoD(_)) { 2 } else { 3 },
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
