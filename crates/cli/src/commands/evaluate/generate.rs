//! `portolan evaluate generate`: makes relations from the loop closures of a map.

use std::path::{Path, PathBuf};

use portolan::trajectory_file::{damaged_behind_poses, nodes, whole_pose_graph_from};
use portolan_evaluation::{
    GenerateOptions, IdInMap, MapConstraint, MapGraph, generate_relations, write_binary_relations,
    write_text_relations,
};
use portolan_pbstream::proto::mapping::pose_graph::{Constraint, constraint::Tag};
use portolan_pbstream::{IdInFile, node_id, pose_from_proto, submap_id};

use crate::GlobalArgs;
use crate::commands::argument::not_negative;
use crate::error::{CliError, Outcome};
use crate::input::open_forward;
use crate::output::{print_json, print_summary, write_file};
use crate::progress::print_line;

/// Make relations from the loop closures of a map, to evaluate other maps of the same recording.
///
/// Works like cartographer_autogenerate_ground_truth: loop closures that span enough of the trajectory and
/// agree with the optimised map are taken as true. The relations are only as accurate as the map.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  \
    portolan evaluate generate good.pbstream -o good.relations --min-covered-distance 20\n  \
    portolan evaluate relations new.pbstream good.relations")]
pub struct GenerateArgs {
    /// Map (.pbstream) of one trajectory.
    map: PathBuf,
    /// File to write the relations to.
    #[arg(short, long, value_name = "RELATIONS")]
    output: PathBuf,
    /// Minimum length of the path between both ends of a relation.
    #[arg(long, value_name = "METRES", default_value_t = 100.0, value_parser = not_negative)]
    min_covered_distance: f64,
    /// Leave out loop closures whose translation differs from the optimised map by more than this.
    #[arg(long, value_name = "METRES", default_value_t = 0.15, value_parser = not_negative)]
    outlier_threshold_meters: f64,
    /// Leave out loop closures whose rotation differs from the optimised map by more than this.
    #[arg(long, value_name = "RADIANS", default_value_t = 0.02, value_parser = not_negative)]
    outlier_threshold_radians: f64,
    /// Write text, `time1 time2 x y z roll pitch yaw`, instead of Cartographer's binary form.
    #[arg(long)]
    text: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &GenerateArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let options = GenerateOptions {
        min_covered_distance: args.min_covered_distance,
        outlier_threshold_meters: args.outlier_threshold_meters,
        outlier_threshold_radians: args.outlier_threshold_radians,
    };
    let map = read_map_graph(&args.map)?;
    let generated =
        generate_relations(&map, &options).map_err(|error| CliError::in_file(&args.map, error))?;
    if !global.quiet {
        print_line(&format!(
            "Writing {} relations to '{}'.",
            generated.relations.len(),
            args.output.display()
        ));
    }
    if generated.relations.is_empty() {
        tracing::warn!(
            "no loop closure of the map spans {} m of the path and agrees with it; a smaller \
             --min-covered-distance takes shorter ones",
            args.min_covered_distance
        );
    }
    write_file(&args.output, |out| match args.text {
        true => write_text_relations(&generated.relations, out),
        false => write_binary_relations(&generated.relations, out),
    })?;
    if args.json {
        let (relations, outliers) = (generated.relations.len(), generated.outliers);
        let output = args.output.display().to_string();
        print_json(&serde_json::json!({ "output": output, "relations": relations, "outliers": outliers }))?;
    } else {
        print_summary(&generated.summary());
    }
    Ok(Outcome::Done)
}

/// Reads the pose graph of a map: nodes, submaps and constraints, from which relations are made.
pub fn read_map_graph(path: &Path) -> Result<MapGraph, CliError> {
    let (pose_graph, damage) = whole_pose_graph_from(open_forward(path)?, path)?;
    if let Some(damage) = damage {
        print_line(&format!("{}: {}", path.display(), damaged_behind_poses(&damage)));
    }
    let mut map = MapGraph::default();
    for trajectory in &pose_graph.trajectory {
        let id = |index: i32| id_in_map(path, (trajectory.trajectory_id, index));
        let poses = nodes(path, &pose_graph, trajectory.trajectory_id)?;
        for (node, pose) in trajectory.node.iter().zip(poses) {
            map.nodes.insert(id(node.node_index)?, pose);
        }
        for submap in &trajectory.submap {
            let missing =
                || CliError::in_file(path, format!("submap {} has no valid pose", submap.submap_index));
            let pose = pose_from_proto(submap.pose.as_ref()).ok_or_else(missing)?;
            map.map_from_submap.insert(id(submap.submap_index)?, pose);
        }
    }
    let constraints = pose_graph.constraint.iter().map(|constraint| map_constraint(path, constraint));
    map.constraints = constraints.collect::<Result<_, _>>()?;
    Ok(map)
}

fn id_in_map(path: &Path, id: IdInFile) -> Result<IdInMap, CliError> {
    match (u32::try_from(id.0), u32::try_from(id.1)) {
        (Ok(trajectory), Ok(index)) => Ok((trajectory, index)),
        _ => Err(CliError::in_file(path, format!("{id:?} is a negative id"))),
    }
}

fn map_constraint(path: &Path, constraint: &Constraint) -> Result<MapConstraint, CliError> {
    let (submap, node) = (submap_id(constraint.submap_id.as_ref()), node_id(constraint.node_id.as_ref()));
    let bad = |what: &str| {
        CliError::in_file(path, format!("the constraint of submap {submap:?} and node {node:?} has {what}"))
    };
    Ok(MapConstraint {
        submap: id_in_map(path, submap)?,
        node: id_in_map(path, node)?,
        is_intra: constraint.tag() == Tag::IntraSubmap,
        submap_from_node: pose_from_proto(constraint.relative_pose.as_ref())
            .ok_or_else(|| bad("no valid pose"))?,
    })
}
