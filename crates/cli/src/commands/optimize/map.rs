//! Optimises maps.

use portolan_config::Options;
use portolan_geometry::Dimension;
use portolan_mapfile::{LoopResidual, MapDraft, MapOptimization};
use portolan_pbstream::ReadLimits;
use serde::Serialize;

use super::{Init, OptimizeArgs};
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{counted, outcome_of_map, print_json, print_summary};
use portolan_solver::Loss;

#[derive(Serialize)]
struct Report {
    output: String,
    #[serde(flatten)]
    optimization: MapOptimization,
    worst_loops: Vec<LoopResidual>,
}

pub fn run(args: &OptimizeArgs, _: &GlobalArgs) -> Result<Outcome, CliError> {
    if !matches!(args.init, Init::Auto | Init::File) || args.loss != Loss::None || args.condition {
        return Err(CliError::Usage(
            "--init, --loss and --condition are for g2o files; convert the map with `portolan convert MAP -o \
             GRAPH.g2o`, or set pose_graph.optimization_problem.huber_scale"
                .to_owned(),
        ));
    }
    let mut draft = MapDraft::open(&args.input, ReadLimits::default())?;
    let optimization = optimize_draft(&mut draft, &args.set, args.iterations)?;
    let mut worst_loops = draft.loop_residuals();
    worst_loops.truncate(args.worst);
    let damage = draft.write(&args.output)?.damage;
    let report = Report { output: args.output.display().to_string(), optimization, worst_loops };
    if args.json {
        print_json(&report)?;
    } else {
        print_summary(&report.text());
    }
    Ok(outcome_of_map(&args.output, &damage))
}

/// Optimises a map with [`options`].
pub fn optimize_draft(
    draft: &mut MapDraft,
    settings: &[String],
    iterations: Option<u32>,
) -> Result<MapOptimization, CliError> {
    let options = options(draft, settings)?;
    let graph = &options.map_builder.pose_graph;
    let most = iterations.or(u32::try_from(graph.max_num_final_iterations).ok()).unwrap_or(200);
    Ok(draft.optimize(&options, most)?)
}

/// The options with which the map was made, or else the defaults of its dimension, changed by `settings`.
pub fn options(draft: &MapDraft, settings: &[String]) -> Result<Options, CliError> {
    let made_with = draft.options().unwrap_or_else(|error| {
        tracing::warn!("{error}: the defaults are taken instead");
        None
    });
    let mut options = made_with.unwrap_or_else(|| match draft.dimension() {
        Some(Dimension::ThreeD) => Options::for_3d(),
        _ => Options::for_2d(),
    });
    for setting in settings {
        options.set(setting).map_err(|error| CliError::Usage(error.to_string()))?;
    }
    Ok(options)
}

/// Summary of an optimisation, one line for the user.
pub fn summary(o: &MapOptimization) -> String {
    format!(
        "optimised {}, {}, {}: cost {:.6} to {:.6} in {} iterations{}; moved {:.3} m at most",
        counted(o.submaps, "submap", "submaps"),
        counted(o.nodes, "node", "nodes"),
        counted(o.constraints, "constraint", "constraints"),
        o.initial_cost,
        o.final_cost,
        o.iterations,
        if o.converged { "" } else { " (not converged)" },
        o.largest_move
    )
}

impl Report {
    fn text(&self) -> String {
        let mut text = summary(&self.optimization) + "\n";
        if !self.worst_loops.is_empty() {
            text += "loop closures that fit worst\n";
        }
        for l in &self.worst_loops {
            text += &loop_text(l);
        }
        text + &self.output
    }
}

/// Residual of a loop closure, one line for the user.
pub fn loop_text(l: &LoopResidual) -> String {
    format!(
        "  submap {},{} node {},{}: {:.3} m, {:.2} deg\n",
        l.submap.0,
        l.submap.1,
        l.node.0,
        l.node.1,
        l.translation,
        l.rotation.to_degrees()
    )
}
