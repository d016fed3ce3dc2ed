//! Collects the constant data of nodes and the measurements from the files of a draft.

use std::collections::BTreeMap;

use portolan_geometry::{Quaternion, Rigid3, Time};
use portolan_mapping::TrajectoryId;
use portolan_optimization::{LandmarkNode, LandmarkSighting, TrajectorySensors};
use portolan_sensor::{FixedFramePoseData, LandmarkObservation, OdometryData};

use super::trajectory_in_memory;
use crate::convert::{imu_from_proto, imu_state_from_proto};
use crate::edit::draft::Source;
use crate::edit::{EditError, MapDraft};
use portolan_pbstream::MapReader;
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::transform::Rigid3d;
use portolan_pbstream::{IdInFile, node_id, pose_from_proto};

/// Constant data of a node for the optimisation.
pub(in crate::edit) struct NodeFacts {
    pub time: Time,
    pub local_from_tracking: Rigid3,
    pub gravity_alignment: Quaternion,
}

/// Content of the files besides poses and constraints.
#[derive(Default)]
pub(in crate::edit) struct Collected {
    pub nodes: BTreeMap<IdInFile, NodeFacts>,
    pub landmarks: BTreeMap<String, LandmarkNode>,
    pub sensors: BTreeMap<TrajectoryId, TrajectorySensors>,
    pub fixed_frame_origins: BTreeMap<TrajectoryId, Option<Rigid3>>,
}

impl Collected {
    pub fn read(draft: &MapDraft) -> Result<Self, EditError> {
        let mut collected = Self::default();
        for source in &draft.sources {
            let failed = |error| EditError::File { path: source.path.clone(), source: error };
            let mut reader = MapReader::open_with(&source.path, draft.limits).map_err(failed)?;
            while let Some(message) = reader.next_message().map_err(failed)? {
                collected.message(message.data, source)?;
            }
        }
        Ok(collected)
    }

    /// Rotations from tracking to gravity-aligned.
    pub fn gravity_alignments(&self) -> BTreeMap<IdInFile, Quaternion> {
        self.nodes.iter().map(|(id, node)| (*id, node.gravity_alignment)).collect()
    }

    fn message(&mut self, data: Data, source: &Source) -> Result<(), EditError> {
        let id = |id: i32| source.ids.get(&id).copied();
        match data {
            Data::Node(node) => self.node(&node, source)?,
            Data::TrajectoryData(data) => {
                if let (Some(id), Some(state)) = (id(data.trajectory_id), imu_state_from_proto(&data)) {
                    self.sensors_of(id).imu_state = state;
                }
                if let (Some(id), Some(origin)) =
                    (id(data.trajectory_id), pose_from_proto(data.fixed_frame_origin_in_map.as_ref()))
                {
                    let moved = source.map_from_source * origin;
                    self.fixed_frame_origins.insert(trajectory_in_memory(id), Some(moved));
                }
            }
            Data::ImuData(m::ImuData { trajectory_id, imu_data: Some(data), derived_from_poses: false }) => {
                if let (Some(id), Some(imu)) = (id(trajectory_id), imu_from_proto(&data)) {
                    self.sensors_of(id).imu.entry(imu.time).or_insert(imu);
                }
            }
            Data::OdometryData(m::OdometryData { trajectory_id, odometry_data: Some(data) }) => {
                if let (Some(id), Some(pose)) = (id(trajectory_id), pose_from_proto(data.pose.as_ref())) {
                    let time = Time::from_ticks(data.timestamp);
                    let odometry = OdometryData { time, odom_from_tracking: pose };
                    self.sensors_of(id).odometry.entry(time).or_insert(odometry);
                }
            }
            Data::FixedFramePoseData(m::FixedFramePoseData {
                trajectory_id,
                fixed_frame_pose_data: Some(data),
            }) => {
                if let Some(id) = id(trajectory_id) {
                    let time = Time::from_ticks(data.timestamp);
                    let fixed_from_tracking = pose_from_proto(data.pose.as_ref());
                    let fixed = FixedFramePoseData { time, fixed_from_tracking };
                    self.sensors_of(id).fixed_frame.entry(time).or_insert(fixed);
                }
            }
            Data::LandmarkData(m::LandmarkData { trajectory_id, landmark_data: Some(data) }) => {
                if let Some(id) = id(trajectory_id) {
                    self.landmarks(trajectory_in_memory(id), data);
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn sensors_of(&mut self, id: i32) -> &mut TrajectorySensors {
        self.sensors.entry(trajectory_in_memory(id)).or_default()
    }

    fn node(&mut self, node: &m::Node, source: &Source) -> Result<(), EditError> {
        let id = node_id(node.node_id.as_ref());
        let Some(new) = source.ids.get(&id.0) else { return Ok(()) };
        let broken = || EditError::Broken {
            path: source.path.clone(),
            reason: format!("node {},{} has no valid pose in its local map", id.0, id.1),
        };
        let data = node.node_data.as_ref().ok_or_else(broken)?;
        let gravity = Rigid3d { translation: None, rotation: data.gravity_alignment };
        let facts = NodeFacts {
            time: Time::from_ticks(data.timestamp),
            local_from_tracking: pose_from_proto(data.local_pose.as_ref()).ok_or_else(broken)?,
            gravity_alignment: pose_from_proto(Some(&gravity)).ok_or_else(broken)?.rotation,
        };
        self.nodes.entry((*new, id.1)).or_insert(facts);
        Ok(())
    }

    fn landmarks(
        &mut self,
        trajectory_id: TrajectoryId,
        data: portolan_pbstream::proto::sensor::LandmarkData,
    ) {
        for seen in data.landmark_observations {
            let weights = [seen.translation_weight, seen.rotation_weight];
            let Some(tracking_from_landmark) = pose_from_proto(seen.landmark_to_tracking_transform.as_ref())
                .filter(|_| weights.iter().all(|w| w.is_finite() && *w >= 0.0))
            else {
                continue;
            };
            let id = String::from_utf8(seen.id).unwrap_or_else(|e| e.as_bytes().escape_ascii().to_string());
            let observation = LandmarkObservation {
                id: id.clone(),
                tracking_from_landmark,
                translation_weight: seen.translation_weight,
                rotation_weight: seen.rotation_weight,
            };
            let time = Time::from_ticks(data.timestamp);
            let sighting = LandmarkSighting { trajectory_id, time, observation };
            self.landmarks.entry(id).or_default().sightings.push(sighting);
        }
    }
}
