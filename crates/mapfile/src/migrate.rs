//! Migrates maps from format version 1 to 2 (`formats.md §2.3`).
//!
//! Version 2 added to 3D submaps the histogram for rotational matching. It is computed here as the sum of the
//! histograms of their nodes. Unlike Cartographer, this also migrates 2D maps, where the versions differ only
//! in the header.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use portolan_geometry::{Quaternion, yaw};
use portolan_matching::rotate_histogram;
use prost::Message as _;
use serde::Serialize;

use portolan_pbstream::MapReader;
use portolan_pbstream::PbstreamError;
use portolan_pbstream::proto::mapping::pose_graph::constraint::Tag;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::mapping::{
    AllTrajectoryBuilderOptions, Node, PoseGraph, SerializedData, Submap, Submap3D,
};
use portolan_pbstream::proto::transform::Quaterniond;
use portolan_pbstream::{FORMAT_VERSION, Finding, PbstreamWriter};
use portolan_pbstream::{IdInFile, node_id, pose_from_proto, submap_id};
use portolan_pbstream::{MessageKind, RawMessage, decode_data};
use portolan_pbstream::{PbstreamReader, ReadLimits, must_be_a_file};

use crate::written::damage_of;

/// Options of a migration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MigrateOptions {
    /// Whether unfinished submaps are kept.
    pub include_unfinished_submaps: bool,
    /// Limits of reading.
    pub limits: ReadLimits,
}

impl Default for MigrateOptions {
    fn default() -> Self {
        Self { include_unfinished_submaps: true, limits: ReadLimits::default() }
    }
}

/// Report of a migration.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MigrateReport {
    /// Version of the input.
    pub from_version: u32,
    /// Submaps that got a histogram.
    pub histograms: u64,
    /// Submaps left out because they are unfinished.
    pub unfinished_submaps: u64,
    /// Messages written.
    pub messages: u64,
    /// Errors of the written map, taken over from the source file.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub damage: Vec<Finding>,
}

/// Why a map cannot be migrated.
#[derive(Debug, thiserror::Error)]
pub enum MigrateError {
    /// Reading or writing failed.
    #[error(transparent)]
    File(#[from] PbstreamError),
    /// Trajectory ids are not 0, 1, 2, … in this order.
    #[error("trajectory number {index} of the map has the id {id}; `repair` or `edit` the map first")]
    TrajectoryId {
        /// Index in the file.
        index: usize,
        /// Id at this index.
        id: i32,
    },
    /// 2D and 3D submaps in one map.
    #[error("submap ({}, {}) is 2D in a 3D map: Converting to the new submap format only makes sense for 3D.",
        .0.0, .0.1)]
    MixedDimensions(IdInFile),
    /// A rotation is missing or not valid.
    #[error("a pose of {what} ({}, {}) is missing or not valid; `repair` the map first", id.0, id.1)]
    Pose {
        /// Node or submap.
        what: &'static str,
        /// Its id.
        id: IdInFile,
    },
}

/// Writes `input` in format version 2 to `output`. Messages that need no change are copied byte for byte.
///
/// # Errors
/// If reading or writing fails, or if the map has ids, poses or submaps that version 2 cannot hold.
pub fn migrate(input: &Path, output: &Path, options: MigrateOptions) -> Result<MigrateReport, MigrateError> {
    let plan = Plan::make(input, options)?;
    let mut report = MigrateReport { from_version: plan.from_version, ..MigrateReport::default() };
    let mut reader = PbstreamReader::open_with(input, options.limits)?;
    let mut writer = PbstreamWriter::create(output)?;
    while let Some(raw) = reader.next_message()? {
        match raw.kind() {
            MessageKind::Header => writer.write_header(FORMAT_VERSION)?,
            MessageKind::Options => writer.write_bytes(plan.options(raw))?,
            MessageKind::PoseGraph if !plan.unfinished.is_empty() => {
                writer.write_bytes(without_submaps(raw, &plan.unfinished))?;
            }
            MessageKind::Submap => {
                if let Some(bytes) = plan.submap(raw, &mut report) {
                    writer.write_bytes(bytes)?;
                }
            }
            _ => writer.write_bytes(raw.bytes)?,
        }
    }
    report.messages = writer.messages();
    writer.finish()?;
    report.damage = damage_of(output, options.limits);
    Ok(report)
}

/// Changes to make, collected in a first pass over the map.
struct Plan {
    from_version: u32,
    /// Portolan's own configuration, which older files have in the header; empty if there is none.
    configuration: String,
    histograms: BTreeMap<IdInFile, Vec<f32>>,
    unfinished: BTreeSet<IdInFile>,
}

/// Data of a node for the histograms of its submaps.
struct NodeTurn {
    histogram: Vec<f32>,
    /// Rotation of the node's gravity-aligned frame in the local map.
    local_from_gravity_aligned: Quaternion,
}

impl NodeTurn {
    /// None if the node has no histogram.
    fn of(node: Node, id: IdInFile) -> Result<Option<Self>, MigrateError> {
        let data = node.node_data.filter(|data| !data.rotational_scan_matcher_histogram.is_empty());
        let Some(data) = data else { return Ok(None) };
        let pose = pose_from_proto(data.local_pose.as_ref());
        let (Some(pose), Some(gravity)) = (pose, rotation(data.gravity_alignment)) else {
            return Err(MigrateError::Pose { what: "node", id });
        };
        Ok(Some(Self {
            histogram: data.rotational_scan_matcher_histogram,
            local_from_gravity_aligned: pose.rotation * gravity.inverse(),
        }))
    }
}

impl Plan {
    fn make(input: &Path, options: MigrateOptions) -> Result<Self, MigrateError> {
        must_be_a_file(input)?;
        let mut reader = MapReader::open_with(input, options.limits)?;
        for (index, trajectory) in reader.pose_graph().trajectory.iter().enumerate() {
            if usize::try_from(trajectory.trajectory_id) != Ok(index) {
                return Err(MigrateError::TrajectoryId { index, id: trajectory.trajectory_id });
            }
        }
        let from_version = reader.header().format_version;
        let configuration = reader.header().portolan_configuration.clone();
        let mut submaps: BTreeMap<IdInFile, Quaternion> = BTreeMap::new();
        let mut nodes: BTreeMap<IdInFile, NodeTurn> = BTreeMap::new();
        let (mut unfinished, mut first_2d) = (BTreeSet::new(), None);
        while let Some(message) = reader.next_message()? {
            match message.data {
                Data::Submap(submap) => {
                    let id = submap_id(submap.submap_id.as_ref());
                    let finished = submap.submap_2d.as_ref().map(|s| s.finished);
                    if finished.is_some() {
                        first_2d.get_or_insert(id);
                    }
                    if !finished.or(submap.submap_3d.as_ref().map(|s| s.finished)).unwrap_or(true) {
                        unfinished.insert(id);
                    }
                    if let Some(submap) = submap.submap_3d {
                        let pose = pose_from_proto(submap.local_pose.as_ref());
                        let pose = pose.ok_or(MigrateError::Pose { what: "submap", id })?;
                        submaps.insert(id, pose.rotation);
                    }
                }
                Data::Node(node) if from_version == 1 => {
                    let id = node_id(node.node_id.as_ref());
                    nodes.extend(NodeTurn::of(node, id)?.map(|turn| (id, turn)));
                }
                _ => {}
            }
        }
        if let Some(id) = first_2d.filter(|_| !submaps.is_empty()) {
            return Err(MigrateError::MixedDimensions(id));
        }
        if options.include_unfinished_submaps {
            unfinished.clear();
        }
        let histograms = if from_version == 1 && !submaps.is_empty() {
            sum_histograms(reader.pose_graph(), &submaps, &nodes)
        } else {
            BTreeMap::new()
        };
        Ok(Self { from_version, configuration, histograms, unfinished })
    }

    /// The options with the configuration from the header. A protobuf message appended to another one is
    /// merged into it.
    fn options(&self, raw: RawMessage) -> Vec<u8> {
        let mut bytes = raw.bytes;
        if !self.configuration.is_empty() {
            let options = AllTrajectoryBuilderOptions {
                portolan_configuration: self.configuration.clone(),
                ..AllTrajectoryBuilderOptions::default()
            };
            let data = Some(Data::AllTrajectoryBuilderOptions(options));
            bytes.extend(SerializedData { data }.encode_to_vec());
        }
        bytes
    }

    fn submap(&self, raw: RawMessage, report: &mut MigrateReport) -> Option<Vec<u8>> {
        let mut message = SerializedData::decode(&*raw.bytes).ok()?;
        let typed_is_all = message.encode_to_vec() == raw.bytes;
        let Some(Data::Submap(submap)) = &mut message.data else { return Some(raw.bytes) };
        let id = submap_id(submap.submap_id.as_ref());
        if self.unfinished.contains(&id) {
            report.unfinished_submaps += 1;
            return None;
        }
        let (Some(histogram), Some(submap)) = (self.histograms.get(&id), &mut submap.submap_3d) else {
            return Some(raw.bytes);
        };
        report.histograms += 1;
        if typed_is_all {
            submap.rotational_scan_matcher_histogram.clone_from(histogram);
            return Some(message.encode_to_vec());
        }
        // The message has unknown fields. A protobuf message appended to another one is merged into it, so
        // that they survive.
        let addition =
            Submap3D { rotational_scan_matcher_histogram: histogram.clone(), ..Submap3D::default() };
        let addition = Submap { submap_3d: Some(addition), ..Submap::default() };
        let mut bytes = raw.bytes;
        bytes.extend(SerializedData { data: Some(Data::Submap(addition)) }.encode_to_vec());
        Some(bytes)
    }
}

fn rotation(q: Option<Quaterniond>) -> Option<Quaternion> {
    let pose = portolan_pbstream::proto::transform::Rigid3d { translation: None, rotation: q };
    pose_from_proto(Some(&pose)).map(|p| p.rotation)
}

/// The pose graph without some submaps and their constraints.
fn without_submaps(raw: RawMessage, left_out: &BTreeSet<IdInFile>) -> Vec<u8> {
    let Ok(Some(Data::PoseGraph(mut graph))) = decode_data(&raw.bytes) else {
        return raw.bytes;
    };
    for trajectory in &mut graph.trajectory {
        let t = trajectory.trajectory_id;
        trajectory.submap.retain(|s| !left_out.contains(&(t, s.submap_index)));
    }
    graph.constraint.retain(|c| !left_out.contains(&submap_id(c.submap_id.as_ref())));
    SerializedData { data: Some(Data::PoseGraph(graph)) }.encode_to_vec()
}

/// For each submap the sum of the histograms of its nodes, each rotated into the submap frame.
fn sum_histograms(
    graph: &PoseGraph,
    submaps: &BTreeMap<IdInFile, Quaternion>,
    nodes: &BTreeMap<IdInFile, NodeTurn>,
) -> BTreeMap<IdInFile, Vec<f32>> {
    let mut sums: BTreeMap<IdInFile, Vec<f32>> = BTreeMap::new();
    for constraint in graph.constraint.iter().filter(|c| c.tag() == Tag::IntraSubmap) {
        let submap = submap_id(constraint.submap_id.as_ref());
        let (Some(local_from_submap), Some(node)) =
            (submaps.get(&submap), nodes.get(&node_id(constraint.node_id.as_ref())))
        else {
            continue;
        };
        let submap_from_node = local_from_submap.inverse() * node.local_from_gravity_aligned;
        let turned = rotate_histogram(&node.histogram, yaw(&submap_from_node) as f32);
        let sum = sums.entry(submap).or_default();
        if sum.len() < turned.len() {
            sum.resize(turned.len(), 0.0);
        }
        sum.iter_mut().zip(turned).for_each(|(s, t)| *s += t);
    }
    sums
}
