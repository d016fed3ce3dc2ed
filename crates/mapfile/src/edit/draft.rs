//! The map that is being edited.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use portolan_config::{ConfigError, Options};
use portolan_geometry::{Dimension, NearFrame, Rigid3, is_on_earth};
use portolan_optimization::ImuState;
use prost::Message as _;
use serde::Serialize;

use super::EditError;
use super::clear::ClearedArea;
use super::rest::Rest;
use super::unread::{TrajectoryOptions, Unread};
use portolan_pbstream::MapReader;
use portolan_pbstream::PbstreamWriter;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::mapping::{PoseGraph, Trajectory};
use portolan_pbstream::{Finding, ReadLimits, must_be_a_file};
use portolan_pbstream::{IdInFile, pose_from_proto};

use crate::written::damage_of;

/// Report of an edit.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct EditReport {
    /// Trajectories removed.
    pub trajectories_removed: u64,
    /// Submaps removed.
    pub submaps_removed: u64,
    /// Nodes removed.
    pub nodes_removed: u64,
    /// Constraints removed, including those to removed parts.
    pub constraints_removed: u64,
    /// Loop closures added.
    pub constraints_added: u64,
    /// Known cells set to unknown.
    pub cells_cleared: u64,
    /// Measurements removed.
    pub sensor_messages_removed: u64,
    /// Messages written.
    pub messages: u64,
    /// Errors of the written map, taken over from the source files.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub damage: Vec<Finding>,
}

/// A file with submaps, nodes and measurements of the draft.
pub(super) struct Source {
    pub path: PathBuf,
    /// Kept trajectories: from their numbers in the file to those in the draft.
    pub ids: BTreeMap<i32, i32>,
    /// Transform from the global map of the file to that of the draft.
    pub map_from_source: Rigid3,
}

/// Results of an optimisation for a trajectory, besides its poses.
#[derive(Clone, Copy, Default)]
pub(super) struct Estimate {
    /// Pose of the fixed frame in the global map of the draft.
    pub fixed_frame_origin: Option<Rigid3>,
    /// 3D: gravity and the mounting of the IMU.
    pub imu: Option<ImuState>,
}

/// A map that is being edited.
pub struct MapDraft {
    pub(super) version: u32,
    /// Configuration of the first file as JSON; empty unless Portolan made that map.
    configuration: String,
    pub(super) graph: PoseGraph,
    /// Parallel to `graph.trajectory`.
    pub(super) options: Vec<TrajectoryOptions>,
    /// Unread content of the first file.
    unread: Unread,
    pub(super) dimension: Option<Dimension>,
    pub(super) sources: Vec<Source>,
    /// First and last time of the measurements that are kept, for trajectories that were cut, ticks.
    pub(super) cuts: BTreeMap<i32, (i64, i64)>,
    /// Areas in which cells of submaps are cleared.
    pub(super) cleared: Vec<ClearedArea>,
    /// Replaces the estimates in the files.
    pub(super) estimates: BTreeMap<i32, Estimate>,
    pub(super) limits: ReadLimits,
    pub(super) report: EditReport,
}

impl MapDraft {
    /// Opens a map.
    ///
    /// # Errors
    /// If it cannot be read, or has poses that are not valid or ids that occur twice.
    pub fn open(path: impl AsRef<Path>, limits: ReadLimits) -> Result<Self, EditError> {
        let path = path.as_ref();
        let failed = |source| EditError::File { path: path.to_owned(), source };
        must_be_a_file(path).map_err(failed)?;
        let mut reader = MapReader::open_with(path, limits).map_err(failed)?;
        let graph = reader.pose_graph().clone();
        check(path, &graph)?;
        let (unread, options) = Unread::read(path, limits).map_err(failed)?;
        let (version, configuration) = (reader.header().format_version, reader.configuration().to_owned());
        let dimension = dimension(&mut reader).map_err(failed)?;
        let ids = graph.trajectory.iter().map(|t| (t.trajectory_id, t.trajectory_id)).collect();
        let source = Source { path: path.to_owned(), ids, map_from_source: Rigid3::identity() };
        Ok(Self {
            version,
            configuration,
            graph,
            options,
            unread,
            dimension,
            sources: vec![source],
            cuts: BTreeMap::new(),
            cleared: Vec::new(),
            estimates: BTreeMap::new(),
            limits,
            report: EditReport::default(),
        })
    }

    /// The options that the (first) map was made with; none if the file has none.
    ///
    /// # Errors
    /// If the options in the file cannot be read.
    pub fn options(&self) -> Result<Option<Options>, ConfigError> {
        if self.configuration.is_empty() {
            return Ok(None);
        }
        Options::from_json(&self.configuration).map(|c| Some(c.options))
    }

    /// Adds all of another map, placed by `map_from_other` in the global map of this one. Its trajectories
    /// get the next free numbers. Returns the map from their old numbers to the new ones.
    ///
    /// # Errors
    /// As for [`MapDraft::open`]; also if one map is 2D and the other 3D, or if their versions differ.
    pub fn append(
        &mut self,
        path: impl AsRef<Path>,
        map_from_other: &Rigid3,
    ) -> Result<BTreeMap<i32, i32>, EditError> {
        let mut other = Self::open(path, self.limits)?;
        if other.version != self.version {
            return Err(EditError::Versions(self.version, other.version));
        }
        if let (Some(a), Some(b)) = (self.dimension, other.dimension)
            && a != b
        {
            return Err(EditError::Dimension("a 2D and a 3D map cannot be merged"));
        }
        other.transform(map_from_other)?;
        let used: BTreeSet<i32> = self.trajectory_ids().collect();
        let first = used.last().map_or(0, |id| id.saturating_add(1));
        let free = (first..=i32::MAX).chain(0..first).filter(|id| !used.contains(id));
        let ids: BTreeMap<i32, i32> = other.trajectory_ids().zip(free).collect();
        other.rename_trajectories(&ids)?;
        self.dimension = self.dimension.or(other.dimension);
        self.graph.trajectory.append(&mut other.graph.trajectory);
        self.graph.constraint.append(&mut other.graph.constraint);
        let known: BTreeSet<String> =
            self.graph.landmark_poses.iter().map(|l| l.landmark_id.clone()).collect();
        let new = other.graph.landmark_poses.into_iter().filter(|l| !known.contains(&l.landmark_id));
        self.graph.landmark_poses.extend(new);
        self.options.append(&mut other.options);
        self.sources.append(&mut other.sources);
        self.estimates.append(&mut other.estimates);
        Ok(ids)
    }

    /// Global poses of submaps and nodes.
    fn all_poses(&self) -> impl Iterator<Item = Rigid3> {
        let poses = |trajectory: &Trajectory| {
            let submaps = trajectory.submap.iter().map(|submap| submap.pose);
            let nodes = trajectory.node.iter().map(|node| node.pose);
            submaps.chain(nodes).collect::<Vec<_>>()
        };
        self.graph.trajectory.iter().flat_map(poses).filter_map(|pose| pose_from_proto(pose.as_ref()))
    }

    /// A near frame of the map.
    pub(super) fn near_frame(&self) -> NearFrame {
        NearFrame::around(self.all_poses().map(|pose| pose.translation.vector))
    }

    /// Returns an error if a part of the map is at coordinates that are not possible on the Earth.
    pub(super) fn require_on_earth(&self) -> Result<(), EditError> {
        let mut places = self.all_poses().map(|pose| pose.translation.vector);
        match places.find(|place| !is_on_earth(place)) {
            Some(place) => Err(EditError::FarAway(place.norm())),
            None => Ok(()),
        }
    }

    /// Current global poses, constraints and landmarks.
    pub fn pose_graph(&self) -> &PoseGraph {
        &self.graph
    }

    /// Whether the map is 2D or 3D; none for a map without submaps.
    pub fn dimension(&self) -> Option<Dimension> {
        self.dimension
    }

    /// Numbers of the trajectories, ascending.
    pub fn trajectory_ids(&self) -> impl Iterator<Item = i32> + use<> {
        let ids: BTreeSet<i32> = self.graph.trajectory.iter().map(|t| t.trajectory_id).collect();
        ids.into_iter()
    }

    /// Report of all edits so far.
    pub fn report(&self) -> &EditReport {
        &self.report
    }

    /// Moves the whole map: a point at `p` in the old global map is at `new_from_old · p` afterwards.
    ///
    /// # Errors
    /// If a 2D map would leave its plane, or a part would get coordinates that are not possible on the Earth.
    pub fn transform(&mut self, new_from_old: &Rigid3) -> Result<(), EditError> {
        let leaves = |pose: Rigid3| {
            let moved = new_from_old * pose;
            is_on_earth(&pose.translation.vector) && !is_on_earth(&moved.translation.vector)
        };
        let is_too_far = self.all_poses().any(leaves);
        if is_too_far || !is_on_earth(&new_from_old.translation.vector) {
            return Err(EditError::TooFar);
        }
        let out_of_plane = {
            let up = new_from_old.rotation * nalgebra::Vector3::z();
            new_from_old.translation.z != 0.0 || (up - nalgebra::Vector3::z()).norm() > 1e-9
        };
        if out_of_plane && self.dimension != Some(Dimension::ThreeD) {
            return Err(EditError::Dimension("a 2D map can only be moved and rotated in its plane"));
        }
        super::poses::transform_graph(&mut self.graph, new_from_old);
        for source in &mut self.sources {
            source.map_from_source = new_from_old * source.map_from_source;
        }
        for origin in self.estimates.values_mut().filter_map(|e| e.fixed_frame_origin.as_mut()) {
            *origin = new_from_old * *origin;
        }
        Ok(())
    }

    /// Writes the map. The file appears when it is complete; it may be one of the source files of the draft.
    ///
    /// # Errors
    /// If reading or writing fails, or no trajectory is left.
    pub fn write(mut self, output: impl AsRef<Path>) -> Result<EditReport, EditError> {
        if self.graph.trajectory.is_empty() {
            return Err(EditError::Empty);
        }
        let output = output.as_ref();
        let failed = EditError::Output;
        self.sort_trajectories();
        let mut writer = PbstreamWriter::create(output).map_err(failed)?;
        writer.write_header(self.version).map_err(failed)?;
        let mut rest = Rest::new(&self.graph, &self.cuts, &self.estimates, self.dimension);
        rest.clear(&self.cleared);
        let graph = std::mem::take(&mut self.graph).encode_to_vec();
        writer.write_bytes(self.unread.pose_graph_message(graph)).map_err(failed)?;
        let options = self.unread.options_message(&self.options, &self.configuration);
        writer.write_bytes(options).map_err(failed)?;
        for source in &self.sources {
            rest.copy(source, self.limits, &mut |bytes| writer.write_bytes(bytes).map_err(failed))?;
        }
        rest.finish(&mut |bytes| writer.write_bytes(bytes).map_err(failed))?;
        self.report.cells_cleared += rest.cells_cleared;
        self.report.sensor_messages_removed += rest.sensor_messages_removed;
        self.report.messages = writer.messages();
        writer.finish().map_err(failed)?;
        self.report.damage = damage_of(output, self.limits);
        Ok(self.report)
    }

    /// Sorts trajectories by their numbers, with their options, as files require.
    fn sort_trajectories(&mut self) {
        let trajectories = std::mem::take(&mut self.graph.trajectory);
        let mut pairs: Vec<(Trajectory, TrajectoryOptions)> =
            trajectories.into_iter().zip(std::mem::take(&mut self.options)).collect();
        pairs.sort_by_key(|(t, _)| t.trajectory_id);
        (self.graph.trajectory, self.options) = pairs.into_iter().unzip();
    }
}

/// Dimension of the first submap of the file.
fn dimension(reader: &mut MapReader) -> Result<Option<Dimension>, portolan_pbstream::PbstreamError> {
    while let Some(message) = reader.next_message()? {
        if let Data::Submap(submap) = message.data {
            let is_3d = submap.submap_3d.is_some() && submap.submap_2d.is_none();
            return Ok(Some(if is_3d { Dimension::ThreeD } else { Dimension::TwoD }));
        }
    }
    Ok(None)
}

/// Checks that every pose is valid and every id occurs once.
fn check(path: &Path, graph: &PoseGraph) -> Result<(), EditError> {
    let broken = |reason: String| EditError::Broken { path: path.to_owned(), reason };
    let mut seen: BTreeSet<(i32, IdInFile)> = BTreeSet::new();
    let mut part = |what: &str, kind: i32, id: IdInFile, pose| {
        if id.0 < 0 || id.1 < 0 || !seen.insert((kind, id)) {
            return Err(broken(format!("the {what} {id:?} has a negative id or occurs twice")));
        }
        pose_from_proto(pose).map(drop).ok_or_else(|| broken(format!("the {what} {id:?} has no valid pose")))
    };
    let mut trajectories = BTreeSet::new();
    for trajectory in &graph.trajectory {
        let t = trajectory.trajectory_id;
        if t < 0 || !trajectories.insert(t) {
            return Err(broken(format!("trajectory {t} has a negative number or occurs twice")));
        }
        for submap in &trajectory.submap {
            part("submap", 0, (t, submap.submap_index), submap.pose.as_ref())?;
        }
        for node in &trajectory.node {
            part("node", 1, (t, node.node_index), node.pose.as_ref())?;
        }
    }
    Ok(())
}
