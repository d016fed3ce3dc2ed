//! Writes a map as a file that other programs of this format load (`formats.md` §2).

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use portolan_config::Options;
use portolan_mapping::{
    EndedTrajectory, Map, Node, NodeData, NodeId, PoseGraph, Space2d, SubmapEntry, SubmapId, TrajectoryId,
};
use rayon::prelude::*;

use super::MapConversionError;
use super::grid::MapFileSpace;
use super::pose_graph::{Selection, pose_graph_to_proto};
use super::sensors::write_sensors;
use super::trajectory_options::trajectory_options_to_proto;
use super::values::{cloud_to_proto, id_for_errors, node_id_to_proto, rotation_to_proto, submap_id_to_proto};
use portolan_pbstream::pose_to_proto;
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::{FORMAT_VERSION, Finding, PbstreamWriter, validate_pose_graph};

/// Numbers of submaps and of nodes that are converted to messages together, on all cores.
const SUBMAP_BATCH: usize = 8;
const NODE_BATCH: usize = 256;

/// Report of a written map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriteReport {
    /// Number of messages, including the header.
    pub messages: u64,
    /// Submaps without a grid, and unfinished ones that were not requested.
    pub submaps_left_out: u64,
    /// Constraints to those submaps, or to missing nodes.
    pub constraints_left_out: u64,
    /// Points of nodes that are not finite or beyond the range of files, 8388 m.
    pub points_left_out: u64,
    /// Observations of landmarks by trajectories that were deleted.
    pub landmark_sightings_left_out: u64,
}

/// Writes a 2D map; see [`write_map`].
///
/// # Errors
/// As for [`write_map`].
pub fn write_map_2d(
    map: &Map<Space2d>,
    path: impl AsRef<Path>,
    include_unfinished: bool,
) -> Result<WriteReport, MapConversionError> {
    write_map(map, path, include_unfinished)
}

/// Writes a map in format version 2. The file appears only when it is complete. The same map gives the same
/// bytes on any number of threads. Without `include_unfinished`, submaps that are still being filled are left
/// out, with the constraints to them.
///
/// # Errors
/// If the file cannot be written, or a number does not fit the format.
pub fn write_map<S: MapFileSpace>(
    map: &Map<S>,
    path: impl AsRef<Path>,
    include_unfinished: bool,
) -> Result<WriteReport, MapConversionError> {
    write_graph(&map.graph, &map.trajectories, &map.options, path, include_unfinished)
}

/// Like [`write_map`], for a pose graph that may still be growing. `options` are those of the map; its
/// `trajectory_builder` applies to trajectories that are not in `trajectories`.
///
/// # Errors
/// As for [`write_map`].
pub fn write_graph<S: MapFileSpace>(
    graph: &PoseGraph<S>,
    trajectories: &BTreeMap<TrajectoryId, EndedTrajectory>,
    options: &Options,
    path: impl AsRef<Path>,
    include_unfinished: bool,
) -> Result<WriteReport, MapConversionError> {
    (S::file_work().write)(graph, trajectories, options, path.as_ref(), include_unfinished)
}

pub(super) fn write_graph_here<S: MapFileSpace>(
    graph: &PoseGraph<S>,
    trajectories: &BTreeMap<TrajectoryId, EndedTrajectory>,
    options: &Options,
    path: &Path,
    include_unfinished: bool,
) -> Result<WriteReport, MapConversionError> {
    let mut writer = PbstreamWriter::create(path)?;
    let mut report = WriteReport::default();
    let selection = Selection::new(graph.state(), include_unfinished);
    writer.write_header(FORMAT_VERSION)?;
    writer.write(Data::PoseGraph(pose_graph_to_proto(graph, &selection, &mut report)?))?;
    let all_options = all_options_to_proto(graph, &selection, trajectories, options)?;
    writer.write(Data::AllTrajectoryBuilderOptions(all_options))?;
    write_submaps(graph, &selection, &mut writer)?;
    write_nodes(graph, &mut writer, &mut report)?;
    let on_earth = |id: &TrajectoryId| trajectories.get(id).and_then(|ended| ended.fixed_frame_on_earth);
    let chosen: Vec<_> = selection.trajectories.iter().map(|id| (*id, on_earth(id))).collect();
    write_sensors(graph, &chosen, &mut |data| writer.write(data), &mut report)?;
    report.messages = writer.messages();
    writer.finish()?;
    Ok(report)
}

/// One entry for each trajectory of the pose graph message, in its order.
fn all_options_to_proto<S: MapFileSpace>(
    graph: &PoseGraph<S>,
    selection: &Selection,
    trajectories: &BTreeMap<TrajectoryId, EndedTrajectory>,
    options: &Options,
) -> Result<m::AllTrajectoryBuilderOptions, MapConversionError> {
    let no_sensors = BTreeSet::new();
    let entry = |id: &TrajectoryId| {
        let ended = trajectories.get(id);
        let initial_pose = graph.state().trajectories.get(id).and_then(|t| t.initial_pose.as_ref());
        trajectory_options_to_proto(
            ended.map_or(&options.trajectory_builder, |e| &e.options),
            ended.map_or(&no_sensors, |e| &e.sensors),
            initial_pose,
        )
    };
    let options_with_sensor_ids = selection.trajectories.iter().map(entry).collect::<Result<_, _>>()?;
    Ok(m::AllTrajectoryBuilderOptions { options_with_sensor_ids, portolan_configuration: options.to_json() })
}

/// Errors that the file of this pose graph would have, found by [`validate_pose_graph`].
///
/// # Errors
/// If a number does not fit the format.
pub fn check_graph<S: MapFileSpace>(graph: &PoseGraph<S>) -> Result<Vec<Finding>, MapConversionError> {
    (S::file_work().check)(graph)
}

pub(super) fn check_graph_here<S: MapFileSpace>(
    graph: &PoseGraph<S>,
) -> Result<Vec<Finding>, MapConversionError> {
    let selection = Selection::new(graph.state(), true);
    Ok(validate_pose_graph(&pose_graph_to_proto(graph, &selection, &mut WriteReport::default())?))
}

fn write_submaps<S: MapFileSpace>(
    graph: &PoseGraph<S>,
    selection: &Selection,
    writer: &mut PbstreamWriter,
) -> Result<(), MapConversionError> {
    let chosen: Vec<(&SubmapId, &SubmapEntry<S>)> =
        graph.state().submaps.iter().filter(|(id, _)| selection.submaps.contains(id)).collect();
    for batch in chosen.chunks(SUBMAP_BATCH) {
        let message = |(id, entry): &(&SubmapId, &SubmapEntry<S>)| submap_to_proto::<S>(**id, entry);
        let messages: Vec<_> = batch.par_iter().map(message).collect::<Result<_, _>>()?;
        for submap in messages {
            writer.write(Data::Submap(submap))?;
        }
    }
    Ok(())
}

fn submap_to_proto<S: MapFileSpace>(
    id: SubmapId,
    entry: &SubmapEntry<S>,
) -> Result<m::Submap, MapConversionError> {
    let mut message = m::Submap { submap_id: Some(submap_id_to_proto(id)?), ..Default::default() };
    if let Some(submap) = &entry.submap {
        S::submap_to_proto(submap, entry.insertion_finished, &mut message);
    }
    Ok(message)
}

fn write_nodes<S: MapFileSpace>(
    graph: &PoseGraph<S>,
    writer: &mut PbstreamWriter,
    report: &mut WriteReport,
) -> Result<(), MapConversionError> {
    let nodes: Vec<(&NodeId, &Node)> = graph.state().nodes.iter().collect();
    for batch in nodes.chunks(NODE_BATCH) {
        let message = |(id, node): &(&NodeId, &Node)| node_to_proto(**id, &node.data);
        let messages: Vec<_> = batch.par_iter().map(message).collect::<Result<_, _>>()?;
        for (node, left_out) in messages {
            report.points_left_out += left_out as u64;
            writer.write(Data::Node(node))?;
        }
    }
    Ok(())
}

/// A node as a message (`formats.md` §4.2), and the number of points that could not be stored.
fn node_to_proto(id: NodeId, data: &NodeData) -> Result<(m::Node, usize), MapConversionError> {
    let node = id_for_errors(id.trajectory_id, id.index);
    let cloud =
        |cloud| cloud_to_proto(cloud).map_err(|source| MapConversionError::PointCloud { node, source });
    let (filtered, left_out_0) = cloud(&data.filtered_gravity_aligned_point_cloud)?;
    let (high_resolution, left_out_1) = cloud(&data.high_resolution_point_cloud)?;
    let (low_resolution, left_out_2) = cloud(&data.low_resolution_point_cloud)?;
    let node_data = m::TrajectoryNodeData {
        timestamp: data.time.ticks(),
        gravity_alignment: Some(rotation_to_proto(&data.gravity_alignment)),
        filtered_gravity_aligned_point_cloud: Some(filtered),
        high_resolution_point_cloud: Some(high_resolution),
        low_resolution_point_cloud: Some(low_resolution),
        rotational_scan_matcher_histogram: data.rotational_scan_matcher_histogram.clone(),
        local_pose: Some(pose_to_proto(&data.local_from_tracking)),
    };
    let message = m::Node { node_id: Some(node_id_to_proto(id)?), node_data: Some(node_data) };
    Ok((message, left_out_0 + left_out_1 + left_out_2))
}
