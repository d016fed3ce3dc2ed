//! Reads a map into a pose graph (`formats.md` §2.2).

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use portolan_config::{Options, PoseGraphOptions};
use portolan_geometry::{Rigid3, Time, is_on_earth};
use portolan_issue::{IssueKind, IssueLog};
use portolan_mapping::{
    Constraint, ConstraintTag, EndedTrajectory, InitialTrajectoryPose, Map, NodeData, NodeId, PoseGraph,
    ScanPose, Space2d, SubmapId, TrajectoryId, of_trajectory,
};

use super::MapConversionError;
use super::grid::MapFileSpace;
use super::pose_graph::pose_in_memory;
use super::sensors::{imu_state_from_proto, load_sensor_data};
use super::trajectory_options::{initial_pose_from_proto, trajectory_options_from_proto};
use super::values::{cloud_from_proto, place_in_file, pose_in_file, rotation_in_file};
use portolan_pbstream::MapReader;
use portolan_pbstream::ReadLimits;
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::proto::mapping::pose_graph::constraint::Tag;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::{IdInFile, node_id, submap_id};

/// Settings of reading a map.
#[derive(Clone, Debug, Default)]
pub struct MapLoadSettings {
    /// Options of the pose graph for the map; files do not have them.
    pub pose_graph: PoseGraphOptions,
    /// Trajectories that become a fixed part of the map.
    pub frozen: FrozenTrajectories,
    /// Memory limits.
    pub limits: ReadLimits,
}

/// Frozen trajectories of a file: a fixed part of the map. Their measurements and the constraints between
/// them are kept for saving, but do not affect the optimisation.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum FrozenTrajectories {
    /// None: all trajectories are optimised.
    #[default]
    None,
    /// The trajectories with these numbers in the file.
    Only(BTreeSet<i32>),
    /// The whole map.
    All,
}

impl FrozenTrajectories {
    /// Whether the trajectory with this number in the file is frozen.
    pub fn contains(&self, trajectory_id: i32) -> bool {
        match self {
            Self::None => false,
            Self::Only(ids) => ids.contains(&trajectory_id),
            Self::All => true,
        }
    }
}

/// A map read from a file.
pub struct LoadedMap<S: MapFileSpace> {
    /// Nodes, submaps, constraints, measurements.
    pub graph: PoseGraph<S>,
    /// Options and sensors of each trajectory; its nodes as scans.
    pub trajectories: BTreeMap<TrajectoryId, EndedTrajectory>,
    /// From numbers of trajectories in the file to those in the graph.
    pub trajectory_ids: BTreeMap<i32, TrajectoryId>,
    /// Format version of the file.
    pub format_version: u32,
    /// What was repaired or left out.
    pub issues: IssueLog,
}

impl<S: MapFileSpace> LoadedMap<S> {
    /// Converts to a finished map; `options` apply to later additions.
    pub fn into_map(self, options: Options) -> Map<S> {
        Map::new(options, self.graph, self.trajectories)
    }
}

/// Content that [`load_map`] reads in addition to that of the graph.
#[derive(Clone, Debug, Default)]
pub struct LoadedTrajectories {
    /// Options and sensors of each trajectory; its nodes as scans.
    pub trajectories: BTreeMap<TrajectoryId, EndedTrajectory>,
    /// From numbers of trajectories in the file to those in the graph.
    pub trajectory_ids: BTreeMap<i32, TrajectoryId>,
    /// What was repaired or left out.
    pub issues: IssueLog,
}

/// Reads a 2D map; see [`read_map`].
///
/// # Errors
/// As for [`read_map`].
pub fn read_map_2d(
    path: impl AsRef<Path>,
    settings: &MapLoadSettings,
) -> Result<LoadedMap<Space2d>, MapConversionError> {
    read_map(path, settings)
}

/// Reads a map, format version 1 or 2.
///
/// # Errors
/// If the file is damaged or not a pbstream, the map is of the other dimension, a trajectory occurs twice, or
/// grids, poses or clouds are not valid. Inconsistent parts are no errors: they are left out and counted.
pub fn read_map<S: MapFileSpace>(
    path: impl AsRef<Path>,
    settings: &MapLoadSettings,
) -> Result<LoadedMap<S>, MapConversionError> {
    let mut reader = MapReader::open_with(path, settings.limits)?;
    let mut graph = PoseGraph::new(settings.pose_graph.clone());
    let loaded = load_map(&mut reader, &mut graph, &settings.frozen)?;
    Ok(LoadedMap {
        graph,
        trajectories: loaded.trajectories,
        trajectory_ids: loaded.trajectory_ids,
        format_version: reader.header().format_version,
        issues: loaded.issues,
    })
}

/// Adds the map of a newly opened reader to a graph. Its trajectories are numbered after those of the graph.
///
/// # Errors
/// As for [`read_map`]. The graph may then have a part of the map and should be dropped.
pub fn load_map<S: MapFileSpace>(
    reader: &mut MapReader,
    graph: &mut PoseGraph<S>,
    frozen: &FrozenTrajectories,
) -> Result<LoadedTrajectories, MapConversionError> {
    (S::file_work().load)(reader, graph, frozen)
}

pub(super) fn load_map_here<S: MapFileSpace>(
    reader: &mut MapReader,
    graph: &mut PoseGraph<S>,
    frozen: &FrozenTrajectories,
) -> Result<LoadedTrajectories, MapConversionError> {
    let mut loading = Loading::start(reader, graph, frozen)?;
    while let Some(message) = reader.next_message()? {
        match message.data {
            Data::Submap(submap) => loading.submap(submap)?,
            Data::Node(node) => loading.node(node)?,
            Data::TrajectoryData(data) => loading.trajectory_data(&data),
            data => load_sensor_data(
                data,
                &loading.result.trajectory_ids,
                loading.graph,
                &mut loading.result.issues,
            ),
        }
    }
    let ignored = reader.ignored();
    loading.count(IssueKind::SecondPoseGraph, ignored.pose_graphs);
    loading.count(IssueKind::SecondOptions, ignored.options);
    loading.count(IssueKind::UnknownMapMessage, ignored.unknown);
    loading.constraints(&reader.pose_graph().constraint)?;
    loading.landmark_poses(&reader.pose_graph().landmark_poses);
    Ok(loading.finish())
}

/// State while reading a map from a file into a graph.
struct Loading<'a, S: MapFileSpace> {
    graph: &'a mut PoseGraph<S>,
    frozen: &'a FrozenTrajectories,
    /// Global poses by the ids of the file; removed when their submaps and nodes are read.
    submap_poses: BTreeMap<IdInFile, Rigid3>,
    node_poses: BTreeMap<IdInFile, Rigid3>,
    result: LoadedTrajectories,
}

impl<'a, S: MapFileSpace> Loading<'a, S> {
    fn start(
        reader: &MapReader,
        graph: &'a mut PoseGraph<S>,
        frozen: &'a FrozenTrajectories,
    ) -> Result<Self, MapConversionError> {
        let (submap_poses, node_poses, duplicates) = global_poses(reader.pose_graph())?;
        let result = LoadedTrajectories::default();
        let mut loading = Self { graph, frozen, submap_poses, node_poses, result };
        loading.count(IssueKind::SecondMapPose, duplicates);
        loading.trajectories(reader)?;
        Ok(loading)
    }

    fn count(&mut self, kind: IssueKind, count: u64) {
        self.result.issues.count(kind, count);
    }

    /// Assigns new numbers to the trajectories and adds them to the graph.
    fn trajectories(&mut self, reader: &MapReader) -> Result<(), MapConversionError> {
        let first = self.graph.state().trajectories.keys().last().map_or(0, |id| id.0.saturating_add(1));
        let options = &reader.options().options_with_sensor_ids;
        for (number, (trajectory, options)) in
            (first..).zip(reader.pose_graph().trajectory.iter().zip(options))
        {
            let id = TrajectoryId(number);
            if self.result.trajectory_ids.insert(trajectory.trajectory_id, id).is_some() {
                return Err(MapConversionError::DuplicateTrajectory(trajectory.trajectory_id));
            }
            let (options, sensors) = trajectory_options_from_proto(options, &mut self.result.issues);
            let loaded =
                EndedTrajectory { options, sensors, scans: Default::default(), fixed_frame_on_earth: None };
            self.result.trajectories.insert(id, loaded);
            self.graph.load_trajectory(id, None);
        }
        if let FrozenTrajectories::Only(ids) = self.frozen
            && let Some(id) = ids.iter().find(|id| !self.result.trajectory_ids.contains_key(id))
        {
            return Err(MapConversionError::NoSuchTrajectory(*id));
        }
        // All trajectories are known only now, so that starts can refer to each other.
        for (trajectory, options) in reader.pose_graph().trajectory.iter().zip(options) {
            let Some(id) = self.result.trajectory_ids.get(&trajectory.trajectory_id).copied() else {
                continue;
            };
            let initial = initial_pose_from_proto(options).map(|(to, relative_pose, time)| {
                let to_trajectory_id = self.result.trajectory_ids.get(&to).copied()?;
                Some(InitialTrajectoryPose { to_trajectory_id, relative_pose: relative_pose?, time })
            });
            match initial {
                Some(Some(initial)) => self.graph.load_trajectory(id, Some(initial)),
                Some(None) => self.count(IssueKind::InvalidStart, 1),
                None => {}
            }
            if self.frozen.contains(trajectory.trajectory_id) {
                self.graph.freeze_trajectory(id);
            }
        }
        Ok(())
    }

    /// The id in the graph.
    fn ids(&self, what: &'static str, id: IdInFile) -> Result<(TrajectoryId, u32), MapConversionError> {
        let trajectory = self.result.trajectory_ids.get(&id.0);
        let index = u32::try_from(id.1).ok();
        trajectory.copied().zip(index).ok_or(MapConversionError::Id { what, id })
    }

    fn submap(&mut self, message: m::Submap) -> Result<(), MapConversionError> {
        let id_in_file = submap_id(message.submap_id.as_ref());
        let Some(map_from_submap) = self.submap_poses.remove(&id_in_file) else {
            self.count(IssueKind::SubmapUnplaced, 1);
            return Ok(());
        };
        let (trajectory_id, index) = self.ids("submap", id_in_file)?;
        let (submap, finished) = S::submap_from_proto(message, id_in_file, &mut self.result.issues)?;
        let id = SubmapId::new(trajectory_id, index);
        self.graph.load_submap(id, Arc::new(submap), finished, map_from_submap);
        Ok(())
    }

    fn node(&mut self, message: m::Node) -> Result<(), MapConversionError> {
        let id_in_file = node_id(message.node_id.as_ref());
        let Some(map_from_tracking) = self.node_poses.remove(&id_in_file) else {
            self.count(IssueKind::NodeUnplaced, 1);
            return Ok(());
        };
        let (trajectory_id, index) = self.ids("node", id_in_file)?;
        let data = node_data(message, id_in_file)?;
        self.graph.load_node(NodeId::new(trajectory_id, index), Arc::new(data), map_from_tracking);
        Ok(())
    }

    fn trajectory_data(&mut self, data: &m::TrajectoryData) {
        if S::OPTIMIZES_WITH_IMU {
            match (self.result.trajectory_ids.get(&data.trajectory_id), imu_state_from_proto(data)) {
                (Some(id), Some(state)) => self.graph.set_imu_state(*id, state),
                _ => self.count(IssueKind::InvalidImuCalibration, 1),
            }
        }
        let Some(origin) = &data.fixed_frame_origin_in_map else { return };
        match (self.result.trajectory_ids.get(&data.trajectory_id), pose_in_file(Some(origin))) {
            (Some(id), Some(pose)) => {
                self.graph.set_fixed_frame_origin(*id, pose);
                if let Some(trajectory) = self.result.trajectories.get_mut(id) {
                    trajectory.fixed_frame_on_earth =
                        place_in_file(data.fixed_frame_origin_on_earth.as_ref());
                }
            }
            _ => self.count(IssueKind::InvalidFixedFrameOrigin, 1),
        }
    }

    /// Called after all nodes have been read, because in 2D their gravity alignment is needed.
    fn constraints(&mut self, constraints: &[m::pose_graph::Constraint]) -> Result<(), MapConversionError> {
        for constraint in constraints {
            let weights = [constraint.translation_weight, constraint.rotation_weight];
            if !weights.iter().all(|w| w.is_finite() && *w >= 0.0) {
                self.count(IssueKind::ConstraintWeight, 1);
            } else if !self.constraint(constraint)? {
                self.count(IssueKind::ConstraintUnconnected, 1);
            }
        }
        Ok(())
    }

    fn constraint(&mut self, constraint: &m::pose_graph::Constraint) -> Result<bool, MapConversionError> {
        let submap = submap_id(constraint.submap_id.as_ref());
        let node = node_id(constraint.node_id.as_ref());
        let (Ok((submap_trajectory, submap_index)), Ok((node_trajectory, node_index))) =
            (self.ids("submap", submap), self.ids("node", node))
        else {
            return Ok(false);
        };
        let node_id = NodeId::new(node_trajectory, node_index);
        let Some(gravity_alignment) =
            self.graph.state().nodes.get(&node_id).map(|n| n.data.gravity_alignment)
        else {
            return Ok(false);
        };
        let pose = pose_in_file(constraint.relative_pose.as_ref());
        let pose = pose.ok_or(MapConversionError::Pose { what: "constraint to node", id: node })?;
        let tag = match Tag::try_from(constraint.tag) {
            Ok(Tag::IntraSubmap) => ConstraintTag::IntraSubmap,
            Ok(Tag::InterSubmap) => ConstraintTag::InterSubmap,
            Err(_) => {
                self.count(IssueKind::ConstraintKindUnknown, 1);
                ConstraintTag::InterSubmap
            }
        };
        let constraint = Constraint {
            submap_id: SubmapId::new(submap_trajectory, submap_index),
            node_id,
            submap_from_node: pose_in_memory::<S>(pose, &gravity_alignment),
            translation_weight: constraint.translation_weight,
            rotation_weight: constraint.rotation_weight,
            tag,
            open: None,
            score: None,
        };
        Ok(self.graph.load_constraint(constraint))
    }

    /// Landmarks with a pose keep it.
    fn landmark_poses(&mut self, landmarks: &[m::pose_graph::LandmarkPose]) {
        for landmark in landmarks {
            match pose_in_file(landmark.global_pose.as_ref()) {
                Some(pose) => self.graph.set_landmark_pose(&landmark.landmark_id, pose, true),
                None => self.count(IssueKind::LandmarkWithoutPose, 1),
            }
        }
    }

    fn finish(mut self) -> LoadedTrajectories {
        self.count(IssueKind::SubmapMissing, self.submap_poses.len() as u64);
        self.count(IssueKind::NodeMissing, self.node_poses.len() as u64);
        for (id, trajectory) in &mut self.result.trajectories {
            trajectory.scans = of_trajectory(&self.graph.state().nodes, *id)
                .map(|(node_id, node)| ScanPose {
                    time: node.data.time,
                    local_from_tracking: node.data.local_from_tracking,
                    last_node_index: Some(node_id.index),
                })
                .collect();
        }
        self.result
    }
}

type Poses = BTreeMap<IdInFile, Rigid3>;

/// The global poses of submaps and of nodes, and the number of duplicates (the first pose is used).
fn global_poses(graph: &m::PoseGraph) -> Result<(Poses, Poses, u64), MapConversionError> {
    let mut submaps = Poses::new();
    let mut nodes = Poses::new();
    let mut duplicates = 0;
    let mut add = |poses: &mut Poses, what, id, pose: Option<Rigid3>| {
        let pose = pose.ok_or(MapConversionError::Pose { what, id })?;
        if !is_on_earth(&pose.translation.vector) {
            let metres = pose.translation.vector.norm();
            return Err(MapConversionError::FarAway { what, id, metres });
        }
        if let Entry::Vacant(place) = poses.entry(id) {
            place.insert(pose);
        } else {
            duplicates += 1;
        }
        Ok::<(), MapConversionError>(())
    };
    for trajectory in &graph.trajectory {
        for submap in &trajectory.submap {
            let id = (trajectory.trajectory_id, submap.submap_index);
            add(&mut submaps, "submap", id, pose_in_file(submap.pose.as_ref()))?;
        }
        for node in &trajectory.node {
            let id = (trajectory.trajectory_id, node.node_index);
            add(&mut nodes, "node", id, pose_in_file(node.pose.as_ref()))?;
        }
    }
    Ok((submaps, nodes, duplicates))
}

/// Constant data of a node.
pub(crate) fn node_data(message: m::Node, node: IdInFile) -> Result<NodeData, MapConversionError> {
    let what = "node";
    let data = message.node_data.ok_or(MapConversionError::Content { what, id: node })?;
    let no_pose = || MapConversionError::Pose { what, id: node };
    let cloud =
        |cloud| cloud_from_proto(cloud).map_err(|source| MapConversionError::PointCloud { node, source });
    Ok(NodeData {
        time: Time::from_ticks(data.timestamp),
        gravity_alignment: rotation_in_file(data.gravity_alignment.as_ref()).ok_or_else(no_pose)?,
        filtered_gravity_aligned_point_cloud: cloud(data.filtered_gravity_aligned_point_cloud)?,
        high_resolution_point_cloud: cloud(data.high_resolution_point_cloud)?,
        low_resolution_point_cloud: cloud(data.low_resolution_point_cloud)?,
        rotational_scan_matcher_histogram: data.rotational_scan_matcher_histogram,
        local_from_tracking: pose_in_file(data.local_pose.as_ref()).ok_or_else(no_pose)?,
        scan: None,
    })
}
