//! Converts pose graphs.

use portolan_geometry::Rigid3;
use portolan_input::Forward;
use portolan_mapfile::MapDraft;
use portolan_pbstream::ReadLimits;
use portolan_solver::g2o::{Edge, Graph, GraphPose, PoseGraph, Vertex, read_g2o, write_g2o};

use super::ConvertArgs;
use super::trajectories::{NO_POSES, read_one};
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{counted, outcome_of_map, print_json, print_summary, write_file};
use crate::progress::print_line;

/// Writes the constraints of a map as a pose graph.
pub fn of_map(args: &ConvertArgs) -> Result<Outcome, CliError> {
    let draft = MapDraft::open(&args.input, ReadLimits::default())?;
    let graph = draft.to_graph()?;
    let outcome = write(args, &graph)?;
    let lost = draft.pose_graph().constraint.len().saturating_sub(graph.edge_count());
    if lost == 0 {
        return Ok(outcome);
    }
    let lost = counted(lost as u64, "constraint", "constraints");
    print_line(&format!(
        "{}: {lost} to missing parts, or with impossible values, were left out",
        args.input.display()
    ));
    Ok(Outcome::DataLost)
}

/// Writes a trajectory as a pose graph: a chain of poses with unit information matrices.
pub fn of_trajectory(args: &ConvertArgs, input: Forward, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let (trajectory, _) = read_one(args, input, global)?;
    let poses: Vec<Rigid3> = trajectory.poses().iter().map(|p| p.map_from_tracking).collect();
    let unit: Vec<f64> = (0..6).flat_map(|r| (r..6).map(move |c| if r == c { 1.0 } else { 0.0 })).collect();
    let information = Rigid3::information_from_upper(&unit)
        .ok_or_else(|| CliError::Failed("the unit matrix is not an information matrix".to_owned()))?;
    let vertices = poses
        .iter()
        .enumerate()
        .map(|(i, pose)| Vertex { id: i as i64, pose: *pose, fixed: i == 0 })
        .collect();
    let edges = poses.windows(2).zip(0..).map(|(pair, i)| Edge {
        from: i,
        to: i + 1,
        measurement: pair[0].inverse() * pair[1],
        information,
    });
    write(args, &Graph::ThreeD(PoseGraph { vertices, edges: edges.collect() }))
}

fn write(args: &ConvertArgs, graph: &Graph) -> Result<Outcome, CliError> {
    if graph.vertex_count() == 0 {
        return Err(CliError::in_file(&args.input, NO_POSES));
    }
    write_file(&args.output, |out| write_g2o(graph, std::io::BufWriter::new(out)))?;
    let (vertices, edges) = (graph.vertex_count(), graph.edge_count());
    let output = args.output.display().to_string();
    if args.json {
        print_json(&serde_json::json!({ "output": output, "vertices": vertices, "edges": edges }))?;
    } else {
        print_summary(&format!(
            "{}, {}\n{output}",
            counted(vertices as u64, "vertex", "vertices"),
            counted(edges as u64, "edge", "edges")
        ));
    }
    Ok(Outcome::Done)
}

/// Writes the poses of a g2o file back into the map from which it was made.
pub fn into_map(args: &ConvertArgs, input: Forward, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let Some(map) = &args.into else {
        return Err(CliError::Usage("say with --into MAP which map gets the poses".to_owned()));
    };
    let (graph, repairs) = read_g2o(input).map_err(|error| CliError::in_file(&args.input, error))?;
    if !global.quiet {
        repairs.notes().iter().for_each(|note| print_line(&format!("{}: {note}", args.input.display())));
    }
    let mut draft = MapDraft::open(map, ReadLimits::default())?;
    draft.take_graph_poses(&graph)?;
    let written = draft.write(&args.output)?;
    let output = args.output.display().to_string();
    if args.json {
        let vertices = graph.vertex_count();
        print_json(
            &serde_json::json!({ "output": output, "poses": vertices, "messages": written.messages }),
        )?;
    } else {
        print_summary(&format!(
            "{} replaced\n{output}",
            counted(graph.vertex_count() as u64, "pose", "poses")
        ));
    }
    Ok(outcome_of_map(&args.output, &written.damage))
}
