//! Checks whether other programs can read and use a map file.

use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{Rigid3, Time, is_on_earth};
use serde::Serialize;

use crate::error::{PbstreamError, RecordError};
use crate::message::{Message, MessageKind, RawMessage};
use crate::pose::{IdInFile, pose_from_proto};
use crate::proto::mapping::PoseGraph;
use crate::proto::mapping::serialized_data::Data;
use crate::proto::transform::Rigid3d;
use crate::reader::PbstreamReader;

/// Maximum number of findings of one kind that are reported; further ones are only counted.
const MAX_FINDINGS_OF_A_KIND: u64 = 20;

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Unusual, but no data are lost.
    Warning,
    /// Data are lost, or other programs may reject the map.
    Error,
}

/// Subject of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FindingKind {
    /// The file is cut off or its bytes are damaged.
    Damage,
    /// Header missing or of an unknown version.
    Header,
    /// Messages missing, repeated or in the wrong place.
    Order,
    /// A message of an unknown kind.
    UnknownMessage,
    /// Options and trajectories do not agree.
    Options,
    /// A repeated or negative id.
    DuplicateId,
    /// A node or submap without its counterpart in the pose graph, or the reverse.
    MissingPart,
    /// A pose that is missing, not finite or not a rotation.
    Pose,
    /// A constraint to a missing node or submap, or with invalid weights.
    Constraint,
    /// A grid with invalid sizes or cells.
    Grid,
    /// A point cloud that cannot be decompressed.
    PointCloud,
    /// A histogram missing or not finite.
    Histogram,
    /// Times that do not ascend or contradict each other.
    Time,
    /// 3D: a trajectory whose IMU data do not reach back to its first node.
    Imu,
    /// A trajectory without any constraint on its nodes.
    Unconstrained,
    /// A position farther from the origin than anything on Earth.
    FarAway,
}

impl FindingKind {
    /// What `repair` of `portolan-mapfile` does about it; none where nothing needs to be done or nothing can
    /// be.
    pub fn repair(self) -> Option<&'static str> {
        match self {
            Self::Damage => Some("keeps the complete records"),
            Self::Header => Some("creates a header"),
            Self::Order => Some("creates missing messages, drops repeated ones"),
            Self::UnknownMessage | Self::Unconstrained | Self::FarAway => None,
            Self::Imu => Some("adds samples that agree with the poses"),
            Self::Options => Some("creates empty options, removes impossible starts"),
            Self::DuplicateId => Some("keeps the first"),
            Self::MissingPart => Some("leaves out parts without their counterpart, and their constraints"),
            Self::Pose => Some("normalises rotations, leaves out parts without a pose"),
            Self::Constraint => Some("leaves the constraint out"),
            Self::Grid => Some("sets impossible cells to unknown, leaves out submaps with wrong sizes"),
            Self::PointCloud => Some("keeps the node without the cloud"),
            Self::Histogram => Some("keeps the part without the histogram"),
            Self::Time => Some("leaves out data that are not in order of time"),
        }
    }
}

/// A problem of a map.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Severity.
    pub severity: Severity,
    /// Subject.
    pub kind: FindingKind,
    /// Number of the message; the header is 0.
    pub message: Option<u64>,
    /// Position of the message in the file.
    pub offset: Option<u64>,
    /// Number of findings that it stands for.
    pub count: u64,
    /// Description in one sentence.
    pub text: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let severity = match self.severity {
            Severity::Warning => "warning",
            Severity::Error => "error",
        };
        match self.message {
            Some(message) => write!(f, "{severity}: message {message}: {}", self.text),
            None => write!(f, "{severity}: {}", self.text),
        }
    }
}

/// Reads a whole map and reports all problems in file order. Of each kind of finding the first twenty are
/// reported and the rest are counted. An empty result means that the map is good.
pub fn validate(reader: &mut PbstreamReader) -> Vec<Finding> {
    let mut check = Check::default();
    loop {
        match reader.next_message() {
            Ok(Some(raw)) => check.message(&raw),
            Ok(None) => break,
            Err(PbstreamError::Record { index, offset, problem }) => {
                check.at = Some((index, offset));
                check.damage(&problem);
                check.last_index = check.last_index.max(Some(index));
            }
            Err(error) => check.find(Severity::Error, FindingKind::Damage, error.to_string()),
        }
    }
    check.finish()
}

/// Reports the problems of a pose graph before it is written, as [`validate`] does for one in a file: poses,
/// times, ids and constraints.
pub fn validate_pose_graph(graph: &PoseGraph) -> Vec<Finding> {
    let mut check = Check::default();
    check.pose_graph(graph);
    check.counted()
}

/// State of the check: the parts of the map that were read so far.
#[derive(Default)]
pub(crate) struct Check {
    findings: Vec<Finding>,
    counts: BTreeMap<(FindingKind, Severity), u64>,
    /// Index and offset of the message that is being checked.
    at: Option<(u64, u64)>,
    last_index: Option<u64>,
    version: Option<u32>,
    options: Option<usize>,
    /// Trajectory to which the start of each trajectory is relative.
    starts: Vec<Option<i32>>,
    graph: Option<GraphIds>,
    pub(crate) nodes_seen: BTreeSet<IdInFile>,
    pub(crate) submaps_seen: BTreeSet<IdInFile>,
    last_times: BTreeMap<(i32, u32), i64>,
    /// Times of the first IMU sample of each trajectory.
    pub(crate) first_imu: BTreeMap<i32, i64>,
    pub(crate) is_3d: bool,
}

/// Ids in the pose graph.
#[derive(Default)]
pub(crate) struct GraphIds {
    pub trajectories: BTreeSet<i32>,
    /// In the order of the file.
    pub order: Vec<i32>,
    pub submaps: BTreeSet<IdInFile>,
    /// With their times.
    pub nodes: BTreeMap<IdInFile, i64>,
    /// Trajectories whose nodes have constraints.
    pub constrained: BTreeSet<i32>,
}

impl Check {
    pub(crate) fn find(&mut self, severity: Severity, kind: FindingKind, text: impl Into<String>) {
        let count = self.counts.entry((kind, severity)).or_default();
        *count += 1;
        if *count <= MAX_FINDINGS_OF_A_KIND {
            let (message, offset) = self.at.unzip();
            let (count, text) = (1, text.into());
            self.findings.push(Finding { severity, kind, message, offset, count, text });
        }
    }

    pub(crate) fn error(&mut self, kind: FindingKind, text: impl Into<String>) {
        self.find(Severity::Error, kind, text);
    }

    pub(crate) fn warn(&mut self, kind: FindingKind, text: impl Into<String>) {
        self.find(Severity::Warning, kind, text);
    }

    fn damage(&mut self, problem: &RecordError) {
        self.error(FindingKind::Damage, problem.to_string());
    }

    /// Version of the format, if the header could be read.
    pub(crate) fn version(&self) -> Option<u32> {
        self.version
    }

    /// Ids of the pose graph, if it could be read.
    pub(crate) fn graph(&self) -> Option<&GraphIds> {
        self.graph.as_ref()
    }

    fn message(&mut self, raw: &RawMessage) {
        self.at = Some((raw.index, raw.offset));
        self.last_index = Some(raw.index);
        match raw.decode() {
            Ok(message) => self.decoded(raw.index, &message),
            Err(error) => self.damage(&error),
        }
    }

    fn decoded(&mut self, index: u64, message: &Message) {
        match (index, message.kind()) {
            (1, kind) if kind != MessageKind::PoseGraph => {
                self.error(FindingKind::Order, format!("expected the pose graph, found {}", kind.name()));
            }
            (2, kind) if kind != MessageKind::Options => {
                self.error(FindingKind::Order, format!("expected the options, found {}", kind.name()));
            }
            _ => {}
        }
        match message {
            Message::Header(header) => {
                self.version = Some(header.format_version);
                if !matches!(header.format_version, 1 | 2) {
                    let text = format!("format version {} is not known", header.format_version);
                    self.error(FindingKind::Header, text);
                }
            }
            Message::Unknown(tag) => {
                self.warn(FindingKind::UnknownMessage, format!("unknown message, field tag {tag}"));
            }
            Message::Data(data) => self.data(data),
        }
    }

    fn data(&mut self, data: &Data) {
        match data {
            Data::PoseGraph(_) if self.graph.is_some() => {
                self.warn(FindingKind::Order, "a second pose graph; readers ignore it");
            }
            Data::PoseGraph(graph) => {
                let ids = self.pose_graph(graph);
                self.graph = Some(ids);
            }
            Data::AllTrajectoryBuilderOptions(_) if self.options.is_some() => {
                self.warn(FindingKind::Order, "a second options message; readers ignore it");
            }
            Data::AllTrajectoryBuilderOptions(options) => {
                self.options = Some(options.options_with_sensor_ids.len());
                self.starts = options.options_with_sensor_ids.iter().map(start_of).collect();
            }
            Data::Submap(submap) => self.submap(submap),
            Data::Node(node) => self.node(node),
            Data::TrajectoryData(data) => self.trajectory_data(data),
            Data::ImuData(_)
            | Data::OdometryData(_)
            | Data::FixedFramePoseData(_)
            | Data::LandmarkData(_) => {
                self.sensor_data(data);
            }
        }
    }

    /// Checks that a pose is present and valid.
    pub(crate) fn pose(&mut self, what: &str, pose: Option<&Rigid3d>) -> Option<Rigid3> {
        let valid = pose_from_proto(pose);
        if valid.is_none() {
            let problem =
                if pose.is_some_and(|p| p.rotation.is_some()) { "is not valid" } else { "is missing" };
            self.error(FindingKind::Pose, format!("the pose of {what} {problem}"));
        }
        if let Some(place) = valid.map(|pose| pose.translation.vector).filter(|place| !is_on_earth(place)) {
            let metres = place.norm();
            self.warn(FindingKind::FarAway, format!("{what} is {metres:.1e} m from the origin of its frame"));
        }
        valid
    }

    /// Checks that times ascend, separately for each trajectory and `stream`.
    pub(crate) fn ascending(&mut self, trajectory: i32, stream: u32, time: i64, what: &str) {
        let last = self.last_times.insert((trajectory, stream), time);
        if let Some(last) = last.filter(|last| time <= *last) {
            let (a, b) = (Time::from_ticks(last).unix_decimal(), Time::from_ticks(time).unix_decimal());
            self.error(
                FindingKind::Time,
                format!("{what} of trajectory {trajectory} at {b} comes after the one at {a}"),
            );
        }
    }

    fn finish(mut self) -> Vec<Finding> {
        self.at = None;
        if self.version.is_none() {
            self.error(FindingKind::Header, "there is no header");
        }
        match self.graph.take() {
            None => self.error(FindingKind::Order, "there is no pose graph"),
            Some(graph) => self.whole_map(&graph),
        }
        self.counted()
    }

    /// All findings; those of a kind beyond the first twenty are combined into one.
    fn counted(mut self) -> Vec<Finding> {
        for ((kind, severity), count) in std::mem::take(&mut self.counts) {
            if let Some(more) = count.checked_sub(MAX_FINDINGS_OF_A_KIND).filter(|m| *m > 0) {
                let text = format!("{more} more findings of this kind ({kind:?})");
                let (message, offset) = (None, None);
                self.findings.push(Finding { severity, kind, message, offset, count: more, text });
            }
        }
        self.findings
    }

    fn whole_map(&mut self, graph: &GraphIds) {
        match self.options {
            None => self.error(FindingKind::Order, "there are no options"),
            Some(n) if n != graph.trajectories.len() => self.error(
                FindingKind::Options,
                format!("options for {n} trajectories, poses of {}", graph.trajectories.len()),
            ),
            Some(_) => {}
        }
        for problem in bad_starts(&graph.order, &self.starts) {
            self.error(FindingKind::Options, problem.1);
        }
        self.trajectories_of_other_programs(graph);
        let seen = std::mem::take(&mut self.submaps_seen);
        for (t, i) in graph.submaps.difference(&seen) {
            self.error(FindingKind::MissingPart, format!("submap ({t}, {i}) has a pose but no grid"));
        }
        let seen = std::mem::take(&mut self.nodes_seen);
        for (t, i) in graph.nodes.keys().filter(|id| !seen.contains(id)) {
            self.error(FindingKind::MissingPart, format!("node ({t}, {i}) has a pose but no data"));
        }
    }

    /// Checks the requirements of Cartographer for trajectories that are not frozen.
    fn trajectories_of_other_programs(&mut self, graph: &GraphIds) {
        let mut first_nodes: BTreeMap<i32, i64> = BTreeMap::new();
        for ((trajectory, _), time) in &graph.nodes {
            first_nodes.entry(*trajectory).and_modify(|t| *t = (*t).min(*time)).or_insert(*time);
        }
        for (trajectory, first_node) in first_nodes {
            if self.is_3d && self.first_imu.get(&trajectory).is_none_or(|first| *first > first_node) {
                let text = format!(
                    "trajectory {trajectory} has no IMU data at its first node: Cartographer terminates when it \
                     loads the map unfrozen and optimises it"
                );
                self.warn(FindingKind::Imu, text);
            }
            if !graph.constrained.contains(&trajectory) {
                let text = format!(
                    "trajectory {trajectory} has no constraints of its own: its nodes are not constrained when \
                     it is optimised"
                );
                self.warn(FindingKind::Unconstrained, text);
            }
        }
    }

    fn pose_graph(&mut self, graph: &PoseGraph) -> GraphIds {
        crate::check_graph::check_pose_graph(self, graph)
    }
}

/// The trajectory to which the start of a trajectory is relative.
pub fn start_of(options: &crate::proto::mapping::TrajectoryBuilderOptionsWithSensorIds) -> Option<i32> {
    let options = options.trajectory_builder_options.as_ref()?;
    options.initial_trajectory_pose.as_ref().map(|start| start.to_trajectory_id)
}

/// Trajectories (by their index in the file) whose start is relative to a missing trajectory, to themselves,
/// or part of a cycle, and a description of each problem.
pub fn bad_starts(ids: &[i32], starts: &[Option<i32>]) -> Vec<(usize, String)> {
    let place: BTreeMap<i32, usize> = ids.iter().enumerate().map(|(i, id)| (*id, i)).rev().collect();
    let next = |i: usize| starts.get(i).copied().flatten();
    let mut bad = Vec::new();
    // Index of the walk in which each trajectory was reached first; a walk that meets itself has found a
    // cycle.
    let mut reached = vec![usize::MAX; ids.len()];
    for (i, id) in ids.iter().enumerate() {
        if let Some(to) = next(i).filter(|to| !place.contains_key(to)) {
            let text =
                format!("the start of trajectory {id} is relative to trajectory {to}, which does not exist");
            bad.push((i, text));
        }
        let mut at = Some(i);
        while let Some(here) = at.filter(|here| reached.get(*here) == Some(&usize::MAX)) {
            if let Some(first) = reached.get_mut(here) {
                *first = i;
            }
            at = next(here).and_then(|to| place.get(&to)).copied();
        }
        if let Some(met) = at.filter(|met| reached.get(*met) == Some(&i)) {
            let id = ids.get(met).copied().unwrap_or_default();
            bad.push((met, format!("the start of trajectory {id} is relative to itself, through a cycle")));
        }
    }
    bad
}
