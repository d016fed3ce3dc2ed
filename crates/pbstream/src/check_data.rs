//! Checks of submaps, nodes and sensor data.

use crate::check::{Check, FindingKind};
use crate::grid_check::{GridReport, check_grid_2d, check_hybrid_grid};
use crate::point_cloud::decompress;
use crate::pose::{IdInFile, is_rotation, node_id, submap_id};
use crate::proto::mapping::serialized_data::Data;
use crate::proto::mapping::{self, Submap3D};
use crate::proto::transform::Vector3d;

/// Numbers of the streams whose times must ascend; see `Check::ascending`.
const STREAM_IMU: u32 = 6;
const STREAM_ODOMETRY: u32 = 7;
const STREAM_FIXED_FRAME: u32 = 8;

impl Check {
    pub(crate) fn submap(&mut self, submap: &mapping::Submap) {
        let id = submap_id(submap.submap_id.as_ref());
        self.belongs("submap", id, |graph| graph.submaps.contains(&id));
        if !self.submaps_seen.insert(id) {
            self.error(FindingKind::DuplicateId, format!("submap {id:?} is repeated"));
        }
        match (&submap.submap_2d, &submap.submap_3d) {
            (None, None) => self.error(FindingKind::Grid, format!("submap {id:?} has no content")),
            (Some(_), Some(_)) => {
                self.error(FindingKind::Grid, format!("submap {id:?} is both 2D and 3D"));
            }
            (Some(submap), None) => {
                self.pose(&format!("submap {id:?} in its local map"), submap.local_pose.as_ref());
                match &submap.grid {
                    Some(grid) => self.grid(id, &check_grid_2d(grid)),
                    None => self.error(FindingKind::Grid, format!("submap {id:?} has no grid")),
                }
            }
            (None, Some(submap)) => self.submap_3d(id, submap),
        }
    }

    fn submap_3d(&mut self, id: IdInFile, submap: &Submap3D) {
        self.is_3d = true;
        self.pose(&format!("submap {id:?} in its local map"), submap.local_pose.as_ref());
        for grid in [&submap.high_resolution_hybrid_grid, &submap.low_resolution_hybrid_grid] {
            match grid {
                Some(grid) => self.grid(id, &check_hybrid_grid(grid)),
                None => self.error(FindingKind::Grid, format!("submap {id:?} lacks one of its two grids")),
            }
        }
        let histogram = &submap.rotational_scan_matcher_histogram;
        if !histogram.iter().all(|v| v.is_finite()) {
            self.error(FindingKind::Histogram, format!("the histogram of submap {id:?} is not finite"));
        } else if histogram.is_empty() && self.version() != Some(1) {
            self.warn(
                FindingKind::Histogram,
                format!("submap {id:?} has no histogram; `migrate` creates one"),
            );
        }
    }

    fn grid(&mut self, id: IdInFile, report: &GridReport) {
        if let Some(problem) = &report.broken {
            self.error(FindingKind::Grid, format!("submap {id:?}: {problem}"));
        }
        if report.bad_cells > 0 {
            let text = format!("submap {id:?} has {} cells out of range", report.bad_cells);
            self.error(FindingKind::Grid, text);
        }
        if report.bad_box {
            let text = format!("the box of known cells of submap {id:?} is not inside its grid");
            self.error(FindingKind::Grid, text);
        }
    }

    pub(crate) fn node(&mut self, node: &mapping::Node) {
        let id = node_id(node.node_id.as_ref());
        self.belongs("node", id, |graph| graph.nodes.contains_key(&id));
        if !self.nodes_seen.insert(id) {
            self.error(FindingKind::DuplicateId, format!("node {id:?} is repeated"));
        }
        let Some(data) = &node.node_data else {
            self.error(FindingKind::MissingPart, format!("node {id:?} has no data"));
            return;
        };
        self.pose(&format!("node {id:?} in its local map"), data.local_pose.as_ref());
        if !data.gravity_alignment.as_ref().is_some_and(is_rotation) {
            self.error(FindingKind::Pose, format!("the gravity alignment of node {id:?} is not a rotation"));
        }
        let time = self.graph().and_then(|g| g.nodes.get(&id)).copied();
        if time.is_some_and(|t| t != data.timestamp) {
            self.warn(FindingKind::Time, format!("node {id:?} has a different time in the pose graph"));
        }
        let clouds = [
            &data.filtered_gravity_aligned_point_cloud,
            &data.high_resolution_point_cloud,
            &data.low_resolution_point_cloud,
        ];
        for cloud in clouds.into_iter().flatten() {
            if let Err(error) = decompress(cloud) {
                self.error(FindingKind::PointCloud, format!("node {id:?}: {error}"));
            }
        }
        if !data.rotational_scan_matcher_histogram.iter().all(|v| v.is_finite()) {
            self.error(FindingKind::Histogram, format!("the histogram of node {id:?} is not finite"));
        }
    }

    pub(crate) fn trajectory_data(&mut self, data: &mapping::TrajectoryData) {
        self.trajectory("trajectory data", data.trajectory_id);
        if !data.gravity_constant.is_finite() {
            self.error(FindingKind::Pose, "the gravity constant is not finite");
        }
        if data.fixed_frame_origin_in_map.is_some() {
            self.pose("the fixed frame", data.fixed_frame_origin_in_map.as_ref());
        }
    }

    pub(crate) fn sensor_data(&mut self, data: &Data) {
        match data {
            Data::ImuData(data) => {
                self.trajectory("IMU data", data.trajectory_id);
                let Some(imu) = &data.imu_data else {
                    return self.error(FindingKind::MissingPart, "an IMU message without content");
                };
                let first = self.first_imu.entry(data.trajectory_id).or_insert(imu.timestamp);
                *first = imu.timestamp.min(*first);
                self.ascending(data.trajectory_id, STREAM_IMU, imu.timestamp, "IMU data");
                let values = [imu.linear_acceleration, imu.angular_velocity].map(Option::unwrap_or_default);
                if !values.iter().all(|v: &Vector3d| v.x.is_finite() && v.y.is_finite() && v.z.is_finite()) {
                    self.error(FindingKind::Pose, "an IMU sample is not finite");
                }
            }
            Data::OdometryData(data) => {
                self.trajectory("odometry", data.trajectory_id);
                let Some(odometry) = &data.odometry_data else {
                    return self.error(FindingKind::MissingPart, "an odometry message without content");
                };
                self.ascending(data.trajectory_id, STREAM_ODOMETRY, odometry.timestamp, "odometry");
                self.pose("odometry", odometry.pose.as_ref());
            }
            Data::FixedFramePoseData(data) => {
                self.trajectory("fixed-frame poses", data.trajectory_id);
                let Some(fixed) = &data.fixed_frame_pose_data else {
                    return self.error(FindingKind::MissingPart, "a fixed-frame message without content");
                };
                self.ascending(data.trajectory_id, STREAM_FIXED_FRAME, fixed.timestamp, "a fixed-frame pose");
                // Without a GNSS fix there is no pose.
                if fixed.pose.is_some() {
                    self.pose("the fixed frame", fixed.pose.as_ref());
                }
            }
            Data::LandmarkData(data) => {
                self.trajectory("landmarks", data.trajectory_id);
                let Some(landmarks) = &data.landmark_data else {
                    return self.error(FindingKind::MissingPart, "a landmark message without content");
                };
                for seen in &landmarks.landmark_observations {
                    let name = format!("an observation of landmark {:?}", String::from_utf8_lossy(&seen.id));
                    self.pose(&name, seen.landmark_to_tracking_transform.as_ref());
                }
            }
            _ => {}
        }
    }

    fn trajectory(&mut self, what: &str, id: i32) {
        if self.graph().is_some_and(|g| !g.trajectories.contains(&id)) {
            let text = format!("{what} of trajectory {id}, which is not in the pose graph");
            self.error(FindingKind::MissingPart, text);
        }
    }

    /// Checks that the pose graph has a submap or node. A missing pose graph is reported once, at the end.
    fn belongs(&mut self, what: &str, id: IdInFile, known: impl Fn(&crate::check::GraphIds) -> bool) {
        if self.graph().is_some_and(|g| !known(g)) {
            self.error(FindingKind::MissingPart, format!("{what} {id:?} has no pose in the pose graph"));
        }
    }
}
