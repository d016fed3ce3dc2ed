//! A small valid map made of messages, to be damaged in tests.
#![allow(dead_code, clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::path::Path;

use portolan_geometry::Rigid3;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::mapping::{self as m, grid2_d, pose_graph, trajectory};
use portolan_pbstream::proto::{sensor, transform};
use portolan_pbstream::{PbstreamWriter, pose_to_proto};

/// A pose at `x` without rotation.
pub fn pose(x: f64) -> Option<transform::Rigid3d> {
    Some(pose_to_proto(&Rigid3::translation(x, 0.0, 0.0)))
}

/// What the tests change before the map is written.
pub struct SmallMap {
    pub version: u32,
    pub graph: m::PoseGraph,
    pub options: m::AllTrajectoryBuilderOptions,
    pub rest: Vec<Data>,
}

impl SmallMap {
    /// Two submaps, three nodes, constraints, odometry; 2D or 3D.
    pub fn new(three_d: bool) -> Self {
        let id = |i| Some(m::SubmapId { trajectory_id: 0, submap_index: i });
        let node_id = |i| Some(m::NodeId { trajectory_id: 0, node_index: i });
        let nodes = (0..3).map(|i| trajectory::Node {
            node_index: i,
            timestamp: 1000 + i64::from(i),
            pose: pose(f64::from(i)),
        });
        let submaps = (0..2).map(|i| trajectory::Submap { submap_index: i, pose: pose(f64::from(i)) });
        let constraint = (0..3).map(|i| pose_graph::Constraint {
            submap_id: id(i / 2),
            node_id: node_id(i),
            relative_pose: pose(f64::from(i - i / 2)),
            translation_weight: 500.0,
            rotation_weight: 1600.0,
            tag: i / 2,
        });
        let graph = m::PoseGraph {
            constraint: constraint.collect(),
            trajectory: vec![m::Trajectory {
                trajectory_id: 0,
                node: nodes.collect(),
                submap: submaps.collect(),
            }],
            landmark_poses: vec![],
        };
        let mut rest: Vec<Data> = (0..2).map(|i| Data::Submap(submap(i, three_d))).collect();
        rest.extend((0..3).map(|i| Data::Node(node(i))));
        // In 3D also the sample of an IMU, without which other programs take no map.
        if three_d {
            let imu_data = Some(sensor::ImuData {
                timestamp: -1,
                linear_acceleration: Some(transform::Vector3d { x: 0.0, y: 0.0, z: 9.8 }),
                angular_velocity: Some(transform::Vector3d::default()),
            });
            rest.push(Data::ImuData(m::ImuData { trajectory_id: 0, imu_data, derived_from_poses: false }));
        }
        rest.extend((i64::from(three_d)..3).map(|i| {
            Data::OdometryData(m::OdometryData {
                trajectory_id: 0,
                odometry_data: Some(sensor::OdometryData { timestamp: i, pose: pose(0.1 * i as f64) }),
            })
        }));
        let options = m::AllTrajectoryBuilderOptions {
            options_with_sensor_ids: vec![m::TrajectoryBuilderOptionsWithSensorIds::default()],
            ..Default::default()
        };
        Self { version: 2, graph, options, rest }
    }

    /// Writes the map.
    pub fn write(self, path: &Path) {
        let mut writer = PbstreamWriter::create(path).unwrap();
        writer.write_header(self.version).unwrap();
        writer.write(Data::PoseGraph(self.graph)).unwrap();
        writer.write(Data::AllTrajectoryBuilderOptions(self.options)).unwrap();
        self.rest.into_iter().for_each(|d| writer.write(d).unwrap());
        writer.finish().unwrap();
    }

    pub fn submap_2d(&mut self, i: usize) -> &mut m::Submap2D {
        match &mut self.rest[i] {
            Data::Submap(submap) => submap.submap_2d.as_mut().unwrap(),
            other => panic!("{other:?}"),
        }
    }

    pub fn submap_3d(&mut self, i: usize) -> &mut m::Submap3D {
        match &mut self.rest[i] {
            Data::Submap(submap) => submap.submap_3d.as_mut().unwrap(),
            other => panic!("{other:?}"),
        }
    }

    pub fn node(&mut self, i: usize) -> &mut m::TrajectoryNodeData {
        match &mut self.rest[2 + i] {
            Data::Node(node) => node.node_data.as_mut().unwrap(),
            other => panic!("{other:?}"),
        }
    }
}

fn submap(i: i32, three_d: bool) -> m::Submap {
    let submap_id = Some(m::SubmapId { trajectory_id: 0, submap_index: i });
    let grid = |resolution| m::HybridGrid {
        resolution,
        x_indices: vec![0, 1, -1],
        y_indices: vec![0, 0, 5],
        z_indices: vec![0, 3, 2],
        values: vec![20000, 30000, 1],
    };
    if three_d {
        let submap_3d = Some(m::Submap3D {
            local_pose: pose(f64::from(i)),
            num_range_data: 1,
            finished: i == 0,
            high_resolution_hybrid_grid: Some(grid(0.1)),
            low_resolution_hybrid_grid: Some(grid(0.45)),
            rotational_scan_matcher_histogram: vec![1.0; 10],
            planes: None,
        });
        return m::Submap { submap_id, submap_2d: None, submap_3d };
    }
    let grid = m::Grid2D {
        limits: Some(m::MapLimits {
            resolution: 0.05,
            max: Some(transform::Vector2d { x: 1.0, y: 1.0 }),
            cell_limits: Some(m::CellLimits { num_x_cells: 3, num_y_cells: 2 }),
        }),
        cells: vec![0, 100, 0, 0, 32767, 200],
        known_cells_box: Some(grid2_d::CellBox { min_x: 1, max_x: 2, min_y: 0, max_y: 1 }),
        min_correspondence_cost: 0.1,
        max_correspondence_cost: 0.9,
        grid: Some(grid2_d::Grid::ProbabilityGrid2d(m::ProbabilityGrid {})),
    };
    let submap_2d = Some(m::Submap2D {
        local_pose: pose(f64::from(i)),
        num_range_data: 1,
        finished: i == 0,
        grid: Some(grid),
    });
    m::Submap { submap_id, submap_2d, submap_3d: None }
}

fn node(i: i32) -> m::Node {
    let cloud = sensor::CompressedPointCloud { num_points: 1, point_data: vec![1, 0, 0, 0, 5] };
    m::Node {
        node_id: Some(m::NodeId { trajectory_id: 0, node_index: i }),
        node_data: Some(m::TrajectoryNodeData {
            timestamp: 1000 + i64::from(i),
            gravity_alignment: Some(transform::Quaterniond { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
            filtered_gravity_aligned_point_cloud: Some(cloud),
            rotational_scan_matcher_histogram: vec![1.0; 10],
            local_pose: pose(f64::from(i)),
            ..m::TrajectoryNodeData::default()
        }),
    }
}
