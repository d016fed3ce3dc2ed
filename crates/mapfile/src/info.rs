//! Summarises a map: counts, times, lengths, extents.

use std::collections::BTreeMap;

use nalgebra::Point3;
use portolan_geometry::{Rigid3, Time, Vector3};
use prost::Message as _;
use serde::Serialize;

use portolan_pbstream::PbstreamError;
use portolan_pbstream::kind_of;
use portolan_pbstream::mapping_to_text;
use portolan_pbstream::proto::mapping::sensor_id::SensorType;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::mapping::{
    self, AllTrajectoryBuilderOptions, HybridGrid, PoseGraph, Submap, Submap2D, Submap3D, grid2_d,
    pose_graph::constraint::Tag,
};
use portolan_pbstream::{IdInFile, pose_from_proto, submap_id, submap_poses};
use portolan_pbstream::{IgnoredMessages, MapReader};

/// Summary of a map.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MapInfo {
    /// Format version of the file.
    pub format_version: u32,
    /// Numbers of messages after the first three, by name. The counters of submaps are always present.
    pub counters: BTreeMap<String, u64>,
    /// Bytes of the messages before compression, by name.
    pub unpacked_bytes: BTreeMap<String, u64>,
    /// Trajectories in the order of the file.
    pub trajectories: Vec<TrajectoryInfo>,
    /// Constraints by kind.
    pub constraints: ConstraintCounts,
    /// Landmarks with a pose.
    pub landmarks: u64,
    /// Summary of the grids.
    pub grids: GridInfo,
    /// Box around the positions of all nodes, in the global map.
    pub bounding_box: Option<Extent>,
    /// Box around the known cells of all submaps, in the global map.
    pub mapped_extent: Option<Extent>,
    /// Damage that ends reading early, if any; messages after it are not counted.
    pub damage: Option<String>,
    /// Messages that were skipped.
    pub ignored: IgnoredMessages,
}

/// Summary of one trajectory.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TrajectoryInfo {
    /// Number of the trajectory in the file.
    pub id: i32,
    /// Nodes in the pose graph.
    pub nodes: u64,
    /// Submaps in the pose graph.
    pub submaps: u64,
    /// Submaps that are finished.
    pub finished_submaps: u64,
    /// Length of the polyline through the positions of the nodes, metres.
    pub path_length: f64,
    /// Unix time of the first node, seconds with seven exact decimal places.
    pub start_time: Option<String>,
    /// Time from the first to the last node, seconds.
    pub duration: f64,
    /// Sensors by kind and name.
    pub sensors: Vec<SensorInfo>,
    /// Numbers of sensor messages kept for optimisation, by kind.
    pub sensor_data: BTreeMap<String, u64>,
    /// Estimated gravity, m/s²; none if it was not estimated.
    pub gravity_constant: Option<f64>,
    /// Whether a fixed frame (GNSS) has a pose in the map.
    pub has_fixed_frame: bool,
    /// Origin of that frame on the Earth, if the file has it: latitude and longitude in degrees, altitude in
    /// metres.
    pub fixed_frame_on_earth: Option<[f64; 3]>,
    /// The options in protobuf text.
    pub options: String,
}

/// One sensor of a trajectory.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SensorInfo {
    /// RANGE, IMU, ODOMETRY, FIXED_FRAME_POSE, LANDMARK or LOCAL_SLAM_RESULT.
    pub kind: String,
    /// Its name.
    pub id: String,
}

/// Numbers of constraints by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ConstraintCounts {
    /// Nodes in the submaps they were inserted into.
    pub intra_submap: u64,
    /// Loop closures within a trajectory.
    pub inter_submap: u64,
    /// Loop closures between trajectories.
    pub inter_trajectory: u64,
}

/// Summary of the grids of a map.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct GridInfo {
    /// 2D grids of probabilities.
    pub probability_grids: u64,
    /// 2D grids of signed distances.
    pub tsdfs: u64,
    /// Pairs of 3D grids.
    pub hybrid_grids: u64,
    /// Number of cells, known or unknown (3D: stored cells of the fine grids).
    pub cells: u64,
    /// Numbers of grids by the edge of their cells, metres.
    pub resolutions: BTreeMap<String, u64>,
}

/// An axis-aligned box, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Extent {
    /// Smallest coordinates.
    pub min: [f64; 3],
    /// Largest coordinates.
    pub max: [f64; 3],
}

impl Extent {
    /// The box extended by a point.
    fn with(extent: Option<Self>, point: &Vector3) -> Option<Self> {
        if !point.iter().all(|v| v.is_finite()) {
            return extent;
        }
        let p = [point.x, point.y, point.z];
        let mut extent = extent.unwrap_or(Self { min: p, max: p });
        for ((min, max), v) in extent.min.iter_mut().zip(&mut extent.max).zip(p) {
            *min = min.min(v);
            *max = max.max(v);
        }
        Some(extent)
    }
}

/// Reads the rest of a map and summarises it up to the first damage ([`MapInfo::damage`]). The pose graph is
/// taken out of the reader, because it would take most of the memory.
///
/// # Errors
/// If the map cannot be read.
pub fn info(reader: &mut MapReader) -> Result<MapInfo, PbstreamError> {
    let mut info = MapInfo { format_version: reader.header().format_version, ..MapInfo::default() };
    for name in ["submap_2d", "submap_2d_grid", "submap_3d", "submap_3d_high_resolution_hybrid_grid"] {
        info.counters.insert(name.to_owned(), 0);
    }
    let pose_graph = reader.take_pose_graph();
    info.add_pose_graph(&pose_graph);
    info.add_options(reader.options());
    info.add_size("pose_graph", pose_graph.encoded_len());
    info.add_size("all_trajectory_builder_options", reader.options().encoded_len());
    let poses = submap_poses(&pose_graph);
    drop(pose_graph);
    loop {
        let message = match reader.next_message() {
            Ok(Some(message)) => message,
            Ok(None) => break,
            Err(error @ PbstreamError::Record { .. }) => {
                info.damage = Some(error.to_string());
                break;
            }
            Err(error) => return Err(error),
        };
        let name = kind_of(&message.data).name();
        info.count(name);
        info.add_size(name, message.size);
        info.grids.cells += message.cells;
        info.add_data(&message.data, &poses);
    }
    info.ignored = reader.ignored();
    Ok(info)
}

impl MapInfo {
    fn count(&mut self, name: &str) {
        match self.counters.get_mut(name) {
            Some(counter) => *counter += 1,
            None => {
                self.counters.insert(name.to_owned(), 1);
            }
        }
    }

    fn add_size(&mut self, name: &str, size: usize) {
        match self.unpacked_bytes.get_mut(name) {
            Some(bytes) => *bytes += size as u64,
            None => {
                self.unpacked_bytes.insert(name.to_owned(), size as u64);
            }
        }
    }

    fn add_pose_graph(&mut self, pose_graph: &PoseGraph) {
        for trajectory in &pose_graph.trajectory {
            let times = trajectory.node.iter().map(|n| Time::from_ticks(n.timestamp));
            let mut last: Option<Vector3> = None;
            let mut path_length = 0.0;
            for node in &trajectory.node {
                let Some(pose) = pose_from_proto(node.pose.as_ref()) else { continue };
                let position = pose.translation.vector;
                path_length += last.map_or(0.0, |l| (position - l).norm());
                last = Some(position);
                self.bounding_box = Extent::with(self.bounding_box, &position);
            }
            self.trajectories.push(TrajectoryInfo {
                id: trajectory.trajectory_id,
                nodes: trajectory.node.len() as u64,
                submaps: trajectory.submap.len() as u64,
                path_length,
                start_time: times.clone().next().map(Time::unix_decimal),
                duration: times
                    .clone()
                    .next_back()
                    .zip(times.clone().next())
                    .map_or(0.0, |(e, s)| e.seconds_since(s)),
                ..TrajectoryInfo::default()
            });
        }
        for constraint in &pose_graph.constraint {
            let between = constraint.submap_id.map_or(0, |id| id.trajectory_id)
                != constraint.node_id.map_or(0, |id| id.trajectory_id);
            let counts = &mut self.constraints;
            match constraint.tag() {
                Tag::IntraSubmap => counts.intra_submap += 1,
                Tag::InterSubmap if between => counts.inter_trajectory += 1,
                Tag::InterSubmap => counts.inter_submap += 1,
            }
        }
        self.landmarks = pose_graph.landmark_poses.len() as u64;
    }

    fn add_options(&mut self, options: &AllTrajectoryBuilderOptions) {
        for (trajectory, options) in self.trajectories.iter_mut().zip(&options.options_with_sensor_ids) {
            let sensors = options.sensor_id.iter().map(|s| SensorInfo {
                kind: SensorType::try_from(s.r#type)
                    .map_or_else(|_| s.r#type.to_string(), |k| k.as_str_name().to_owned()),
                id: s.id.clone(),
            });
            trajectory.sensors = sensors.collect();
            trajectory.options = mapping_to_text(options, "TrajectoryBuilderOptionsWithSensorIds");
        }
    }

    fn add_data(&mut self, data: &Data, poses: &BTreeMap<IdInFile, Rigid3>) {
        let (id, kind) = match data {
            Data::Submap(submap) => return self.add_submap(submap, poses),
            Data::TrajectoryData(data) => return self.add_trajectory_data(data),
            Data::ImuData(d) => (d.trajectory_id, "imu_data"),
            Data::OdometryData(d) => (d.trajectory_id, "odometry_data"),
            Data::FixedFramePoseData(d) => (d.trajectory_id, "fixed_frame_pose_data"),
            Data::LandmarkData(d) => (d.trajectory_id, "landmark_data"),
            Data::Node(_) | Data::PoseGraph(_) | Data::AllTrajectoryBuilderOptions(_) => return,
        };
        if let Some(trajectory) = self.trajectories.iter_mut().find(|t| t.id == id) {
            match trajectory.sensor_data.get_mut(kind) {
                Some(counter) => *counter += 1,
                None => {
                    trajectory.sensor_data.insert(kind.to_owned(), 1);
                }
            }
        }
    }

    fn add_trajectory_data(&mut self, data: &mapping::TrajectoryData) {
        if let Some(trajectory) = self.trajectories.iter_mut().find(|t| t.id == data.trajectory_id) {
            trajectory.gravity_constant = Some(data.gravity_constant);
            trajectory.has_fixed_frame = data.fixed_frame_origin_in_map.is_some();
            let on_earth = data.fixed_frame_origin_on_earth;
            trajectory.fixed_frame_on_earth =
                on_earth.map(|place| [place.latitude_degrees, place.longitude_degrees, place.altitude]);
        }
    }

    fn add_submap(&mut self, submap: &Submap, poses: &BTreeMap<IdInFile, Rigid3>) {
        let id = submap_id(submap.submap_id.as_ref());
        let mut finished = false;
        if let Some(submap) = &submap.submap_2d {
            self.count("submap_2d");
            finished |= submap.finished;
            self.add_submap_2d(submap, poses.get(&id));
        }
        if let Some(submap) = &submap.submap_3d {
            self.count("submap_3d");
            finished |= submap.finished;
            self.add_submap_3d(submap, poses.get(&id));
        }
        if let Some(trajectory) = self.trajectories.iter_mut().find(|t| t.id == id.0) {
            trajectory.finished_submaps += u64::from(finished);
        }
    }

    fn add_resolution(&mut self, resolution: f64) {
        *self.grids.resolutions.entry(portolan_numeric::format_general(resolution, 6)).or_default() += 1;
    }

    fn add_submap_2d(&mut self, submap: &Submap2D, map_from_submap: Option<&Rigid3>) {
        let Some(grid) = &submap.grid else { return };
        self.count("submap_2d_grid");
        match grid.grid {
            Some(grid2_d::Grid::ProbabilityGrid2d(_)) => self.grids.probability_grids += 1,
            Some(grid2_d::Grid::Tsdf2d(_)) => self.grids.tsdfs += 1,
            None => {}
        }
        self.grids.cells += grid.cells.len() as u64;
        let limits = grid.limits.unwrap_or_default();
        self.add_resolution(limits.resolution);
        let local = pose_from_proto(submap.local_pose.as_ref());
        let (Some(known), Some(max), Some(local), Some(map_from_submap)) =
            (grid.known_cells_box, limits.max, local, map_from_submap)
        else {
            return;
        };
        let map_from_local = map_from_submap * local.inverse();
        // The first index runs along −y, the second along −x.
        let edges = |low: i32, high: i32| [f64::from(low), f64::from(high) + 1.0];
        for x in edges(known.min_y, known.max_y) {
            for y in edges(known.min_x, known.max_x) {
                let corner = Point3::new(max.x - limits.resolution * x, max.y - limits.resolution * y, 0.0);
                self.mapped_extent = Extent::with(self.mapped_extent, &(map_from_local * corner).coords);
            }
        }
    }

    fn add_submap_3d(&mut self, submap: &Submap3D, map_from_submap: Option<&Rigid3>) {
        let Some(grid) = &submap.high_resolution_hybrid_grid else { return };
        self.count("submap_3d_high_resolution_hybrid_grid");
        self.grids.hybrid_grids += 1;
        self.grids.cells += grid.values.len() as u64;
        self.add_resolution(f64::from(grid.resolution));
        let (Some(index_box), Some(pose)) = (index_box(grid), map_from_submap) else { return };
        let resolution = f64::from(grid.resolution);
        let edges = |[min, max]: [i32; 2]| [f64::from(min) - 0.5, f64::from(max) + 0.5];
        let [xs, ys, zs] = index_box.map(|range| edges(range).map(|index| index * resolution));
        for z in zs {
            for y in ys {
                for x in xs {
                    let corner = pose * Point3::new(x, y, z);
                    self.mapped_extent = Extent::with(self.mapped_extent, &corner.coords);
                }
            }
        }
    }
}

/// Smallest and largest index of the stored cells along each axis.
fn index_box(grid: &HybridGrid) -> Option<[[i32; 2]; 3]> {
    let range = |indices: &[i32]| Some([*indices.iter().min()?, *indices.iter().max()?]);
    Some([range(&grid.x_indices)?, range(&grid.y_indices)?, range(&grid.z_indices)?])
}
