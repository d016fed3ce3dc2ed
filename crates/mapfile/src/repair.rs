//! Repairs a damaged map: saves all messages that are intact.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, Read as _};
use std::path::Path;

use portolan_geometry::Time;
use prost::Message as _;
use serde::Serialize;

use crate::convert::imu_state_from_proto;
use crate::derived_imu::DerivedImu;
use crate::mend::{Mended, SensorTimes, mend, trajectory_of};
use crate::mend_graph::{Parts, mend_pose_graph};
use crate::salvage::Salvage;
use portolan_pbstream::MAGIC;
use portolan_pbstream::PbstreamError;
use portolan_pbstream::ReadLimits;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::mapping::{self, AllTrajectoryBuilderOptions, PoseGraph, SerializationHeader};
use portolan_pbstream::{FORMAT_VERSION, PbstreamWriter};
use portolan_pbstream::{IdInFile, node_id, submap_id};
use portolan_pbstream::{Message, RawMessage};

/// A kind of repair.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Repair {
    /// Records, or bytes between records, that could not be read.
    DamagedRecords,
    /// The header was missing or damaged; a new one was written.
    HeaderMade,
    /// The pose graph was lost; a new one was built from the local poses. Loop closures and constraints are
    /// lost.
    PoseGraphMade,
    /// Options were missing for some trajectories; they have empty options now.
    OptionsMade,
    /// The start of a trajectory that was relative to a missing trajectory or, in a cycle, to itself.
    StartDropped,
    /// A message that cannot be decoded or occurs a second time.
    MessageDropped,
    /// A trajectory that occurs a second time.
    TrajectoryDropped,
    /// A submap whose grid or pose cannot be used, or that is missing in the pose graph.
    SubmapDropped,
    /// A node whose content cannot be used, or that is missing in the pose graph.
    NodeDropped,
    /// A pose in the pose graph that is not valid or whose submap is missing.
    SubmapPoseDropped,
    /// A pose in the pose graph that is not valid, not in order of time, or whose node is missing.
    NodePoseDropped,
    /// A constraint that is not valid or refers to a missing submap or node.
    ConstraintDropped,
    /// A landmark without a valid pose.
    LandmarkDropped,
    /// Sensor data that are not valid, belong to no trajectory or are not in order of time.
    SensorDataDropped,
    /// A point cloud that cannot be unpacked; the node is kept without it.
    PointCloudDropped,
    /// A histogram that is not finite; the node or submap is kept without it.
    HistogramDropped,
    /// Cells with impossible values were set to unknown.
    CellsMended,
    /// A quaternion was normalised.
    QuaternionNormalised,
    /// IMU samples derived from the poses were added to a 3D trajectory where it had none.
    ImuDerived,
}

impl Repair {
    /// Whether this repair loses data.
    pub fn loses_data(self) -> bool {
        !matches!(self, Self::HeaderMade | Self::QuaternionNormalised | Self::ImuDerived)
    }
}

/// Report of a repaired map.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RepairReport {
    /// Messages written.
    pub messages: u64,
    /// Bytes of the input that could not be used.
    pub lost_bytes: u64,
    /// Number of repairs by kind; empty if the map was good.
    pub repairs: BTreeMap<Repair, u64>,
}

impl RepairReport {
    fn add(&mut self, repair: Repair) {
        *self.repairs.entry(repair).or_default() += 1;
    }

    /// Whether any repair lost data.
    pub fn loses_data(&self) -> bool {
        self.repairs.keys().any(|r| r.loses_data())
    }
}

/// Why a map cannot be repaired.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// The input could not be read.
    #[error("cannot read the map: {0}")]
    Read(#[from] io::Error),
    /// The file has no part of a map.
    #[error("there is no whole submap and no whole node in the file: nothing can be saved")]
    Nothing,
    /// The file is of another kind.
    #[error("this is {0}: nothing can be saved")]
    OtherKind(&'static str),
    /// The output could not be written.
    #[error(transparent)]
    Write(#[from] PbstreamError),
}

/// Writes all intact parts of `input` to `output`: a map in which every id refers to an existing part, every
/// pose is valid and every stated size is correct. Good messages are copied byte for byte.
///
/// The input is read twice; memory grows with the pose graph, not with grids or point clouds. Input and
/// output may be the same file.
///
/// # Errors
/// If the input cannot be read, is not a map or has no intact node or submap, or if the output cannot be
/// written.
pub fn repair(input: &Path, output: &Path, limits: ReadLimits) -> Result<RepairReport, RepairError> {
    let mut report = RepairReport::default();
    let survey = Survey::take(input, limits, &mut report)?;
    if survey.parts.nodes.is_empty() && survey.parts.submaps.is_empty() {
        return Err(other_kind(input).map_or(RepairError::Nothing, RepairError::OtherKind));
    }
    let start = survey.start(&mut report);
    let mut writer = PbstreamWriter::create(output)?;
    start.messages.iter().try_for_each(|m| writer.write_bytes(m.clone()))?;
    let mut salvage = Salvage::open(input, limits)?;
    let mut rest = Rest::new(&start.graph, survey.is_3d);
    while let Some(raw) = salvage.next_message()? {
        let message = rest.message(raw, &mut report);
        rest.derived_before.drain(..).try_for_each(|data| writer.write(data))?;
        if let Some(bytes) = message {
            writer.write_bytes(bytes)?;
        }
    }
    rest.derived_at_end(&mut report).into_iter().try_for_each(|data| writer.write(data))?;
    report.messages = writer.messages();
    writer.finish()?;
    Ok(report)
}

/// Kind of a file without any part of a map, if it can be identified.
fn other_kind(input: &Path) -> Option<&'static str> {
    let mut start = Vec::new();
    File::open(input).ok()?.take(64).read_to_end(&mut start).ok()?;
    portolan_input::kind_of(&start).filter(|_| !start.starts_with(&MAGIC))
}

/// Parts of a map found in a damaged file.
#[derive(Default)]
struct Survey {
    header: Option<SerializationHeader>,
    graph: Option<(PoseGraph, Vec<u8>)>,
    options: Option<(AllTrajectoryBuilderOptions, Vec<u8>)>,
    parts: Parts,
    is_3d: bool,
}

/// The first three messages of the repaired map.
struct Start {
    graph: PoseGraph,
    messages: [Vec<u8>; 3],
}

impl Survey {
    fn take(input: &Path, limits: ReadLimits, report: &mut RepairReport) -> Result<Self, RepairError> {
        let mut survey = Self::default();
        let mut salvage = Salvage::open(input, limits)?;
        while let Some(raw) = salvage.next_message()? {
            if let Some(header) = header(&raw) {
                survey.header.get_or_insert(header);
            } else if let Some(data) = decode(&raw) {
                survey.data(data, raw.bytes);
            }
        }
        report.lost_bytes = salvage.lost_bytes;
        if salvage.damaged > 0 {
            report.repairs.insert(Repair::DamagedRecords, salvage.damaged);
        }
        Ok(survey)
    }

    fn data(&mut self, mut data: Data, bytes: Vec<u8>) {
        if matches!(data, Data::Submap(_) | Data::Node(_)) {
            if !matches!(mend(&mut data), Mended::Dropped(_)) {
                self.part(&data);
            }
            return;
        }
        match data {
            Data::PoseGraph(graph) if self.graph.is_none() => self.graph = Some((graph, bytes)),
            Data::AllTrajectoryBuilderOptions(options) if self.options.is_none() => {
                self.options = Some((options, bytes));
            }
            _ => {}
        }
    }

    fn part(&mut self, data: &Data) {
        match data {
            Data::Submap(submap) => {
                self.is_3d |= submap.submap_3d.is_some();
                let pose = submap.submap_2d.as_ref().map(|s| s.local_pose);
                let pose = pose.or(submap.submap_3d.as_ref().map(|s| s.local_pose)).flatten();
                self.parts.submaps.entry(submap_id(submap.submap_id.as_ref())).or_insert(pose);
            }
            Data::Node(node) => {
                let node_data = node.node_data.as_ref();
                let value = node_data.map_or((0, None), |d| (d.timestamp, d.local_pose));
                self.parts.nodes.entry(node_id(node.node_id.as_ref())).or_insert(value);
            }
            _ => {}
        }
    }

    fn start(&self, report: &mut RepairReport) -> Start {
        let header = self.header.clone().unwrap_or_else(|| {
            report.add(Repair::HeaderMade);
            SerializationHeader { format_version: FORMAT_VERSION, ..SerializationHeader::default() }
        });
        let graph = self.graph.clone().filter(|(graph, _)| !graph.trajectory.is_empty());
        let (before, graph_bytes) = graph.unwrap_or_else(|| {
            report.add(Repair::PoseGraphMade);
            (self.parts.pose_graph(), Vec::new())
        });
        let (options_before, options_bytes) = self.options.clone().unwrap_or_default();
        let (mut graph, mut options) = (before.clone(), options_before.clone());
        let mut repairs = Vec::new();
        mend_pose_graph(&mut graph, &mut options, &self.parts, &mut repairs);
        repairs.into_iter().for_each(|r| report.add(r));
        // A message that needs no repair keeps its bytes, including unknown fields.
        let unless_same = |same: bool, bytes: Vec<u8>, data: Data| {
            if same && !bytes.is_empty() { bytes } else { encode(data) }
        };
        let messages = [
            header.encode_to_vec(),
            unless_same(graph == before, graph_bytes, Data::PoseGraph(graph.clone())),
            unless_same(options == options_before, options_bytes, Data::AllTrajectoryBuilderOptions(options)),
        ];
        Start { graph, messages }
    }
}

/// State while copying the messages after the first three.
struct Rest {
    trajectories: BTreeSet<i32>,
    nodes: BTreeSet<IdInFile>,
    submaps: BTreeSet<IdInFile>,
    times: SensorTimes,
    /// 3D: derived IMU samples by trajectory, and those that are written before the current message.
    derived: BTreeMap<i32, DerivedImu>,
    derived_before: Vec<Data>,
    has_graph: bool,
    has_options: bool,
    has_header: bool,
}

impl Rest {
    fn new(graph: &PoseGraph, is_3d: bool) -> Self {
        let of = |t: &portolan_pbstream::proto::mapping::Trajectory| t.trajectory_id;
        let nodes = graph.trajectory.iter().flat_map(|t| t.node.iter().map(move |n| (of(t), n.node_index)));
        let submaps =
            graph.trajectory.iter().flat_map(|t| t.submap.iter().map(move |s| (of(t), s.submap_index)));
        Self {
            trajectories: graph.trajectory.iter().map(of).collect(),
            nodes: nodes.collect(),
            submaps: submaps.collect(),
            times: SensorTimes::default(),
            derived: graph.trajectory.iter().filter(|_| is_3d).map(|t| (of(t), DerivedImu::of(t))).collect(),
            derived_before: Vec::new(),
            has_graph: false,
            has_options: false,
            has_header: false,
        }
    }

    /// Bytes to write for a message; none if it is dropped.
    fn message(&mut self, raw: RawMessage, report: &mut RepairReport) -> Option<Vec<u8>> {
        if header(&raw).is_some() {
            if std::mem::replace(&mut self.has_header, true) {
                report.add(Repair::MessageDropped);
            }
            return None;
        }
        let Some(mut data) = decode(&raw) else {
            // A message of an unknown kind is kept; bytes that are not a message are dropped.
            if matches!(numbered(&raw).decode(), Ok(Message::Unknown(_))) {
                return Some(raw.bytes);
            }
            report.add(Repair::MessageDropped);
            return None;
        };
        match mend(&mut data) {
            Mended::Unchanged => self.keep(&data, report).then_some(raw.bytes),
            Mended::Changed(repairs) => self.keep(&data, report).then(|| {
                repairs.into_iter().for_each(|r| report.add(r));
                encode(data)
            }),
            Mended::Dropped(repair) => {
                report.add(repair);
                None
            }
        }
    }

    fn keep(&mut self, data: &Data, report: &mut RepairReport) -> bool {
        let dropped = match data {
            Data::PoseGraph(_) => {
                let second = std::mem::replace(&mut self.has_graph, true);
                if second {
                    report.add(Repair::MessageDropped);
                }
                return false;
            }
            Data::AllTrajectoryBuilderOptions(_) => {
                let second = std::mem::replace(&mut self.has_options, true);
                if second {
                    report.add(Repair::MessageDropped);
                }
                return false;
            }
            // Removed from the set, so that a second one of the same id is dropped.
            Data::Submap(s) => {
                (!self.submaps.remove(&submap_id(s.submap_id.as_ref()))).then_some(Repair::SubmapDropped)
            }
            Data::Node(n) => {
                (!self.nodes.remove(&node_id(n.node_id.as_ref()))).then_some(Repair::NodeDropped)
            }
            _ => {
                let known = trajectory_of(data).is_none_or(|t| self.trajectories.contains(&t));
                (!known || !self.times.is_next(data)).then_some(Repair::SensorDataDropped)
            }
        };
        let kept = dropped.inspect(|r| report.add(*r)).is_none();
        if kept {
            self.derive_before(data, report);
        }
        kept
    }

    fn derive_before(&mut self, data: &Data, report: &mut RepairReport) {
        match data {
            Data::TrajectoryData(data) => {
                if let (Some(derived), Some(state)) =
                    (self.derived.get_mut(&data.trajectory_id), imu_state_from_proto(data))
                {
                    derived.set_state(state);
                }
            }
            Data::ImuData(mapping::ImuData { trajectory_id, imu_data: Some(sample), .. }) => {
                let derived = self.derived.get_mut(trajectory_id);
                let before = derived.map(|d| d.before(Time::from_ticks(sample.timestamp)));
                self.derived_before.extend(before.unwrap_or_default().into_iter().map(Data::ImuData));
                (0..self.derived_before.len()).for_each(|_| report.add(Repair::ImuDerived));
            }
            _ => {}
        }
    }

    /// Derived samples after the last measured one.
    fn derived_at_end(&mut self, report: &mut RepairReport) -> Vec<Data> {
        let rest: Vec<Data> =
            self.derived.values_mut().flat_map(DerivedImu::rest).map(Data::ImuData).collect();
        rest.iter().for_each(|_| report.add(Repair::ImuDerived));
        rest
    }
}

fn encode(data: Data) -> Vec<u8> {
    portolan_pbstream::proto::mapping::SerializedData { data: Some(data) }.encode_to_vec()
}

/// The header is recognised by its content, because records before it may be lost.
fn header(raw: &RawMessage) -> Option<SerializationHeader> {
    let header = SerializationHeader::decode(&*raw.bytes).ok()?;
    (matches!(header.format_version, 1 | 2) && header.encoded_len() == raw.bytes.len()).then_some(header)
}

/// The message with an index after that of the header, so that it is not decoded as a header.
fn numbered(raw: &RawMessage) -> RawMessage {
    RawMessage { index: raw.index.max(1), ..raw.clone() }
}

fn decode(raw: &RawMessage) -> Option<Data> {
    portolan_pbstream::decode_data(&raw.bytes).ok()?
}
