//! Scans and poses of the golden vectors, which match the scenes that tests of `portolan-grids` draw.

use portolan_geometry::{Rigid2, Rigid3, rotation_from_roll_pitch_yaw, to_f32};
use portolan_matching::Transform2d;
use portolan_sensor::PointCloud;
use portolan_testing::clouds;

#[path = "../../../grids/tests/common/mod.rs"]
mod scenes;
pub use scenes::*;

/// Room 2 seen from (1.5, 0.7, 0.2): scan S of the golden vectors.
pub fn golden_scan() -> PointCloud {
    let pose = Transform2d::from_pose(&Rigid2::new(1.5, 0.7, 0.2)).inverse();
    PointCloud::new(room2().returns.points.iter().map(|p| pose.apply(p)).collect())
}

/// Initial pose I of the golden vectors.
pub fn golden_initial() -> Rigid2 {
    Rigid2::new(1.53, 0.66, 0.17)
}

/// Cloud A of the golden vectors: random points in a flat box.
pub fn cloud_a() -> PointCloud {
    PointCloud::new(clouds::flat_box(1, 1000))
}

/// Cloud B seen from a pose in it, and that pose: the scan of the golden vectors.
pub fn golden_scan_3d() -> PointCloud {
    cloud_b().transformed(&to_f32(&golden_pose_3d().inverse()))
}

/// Where the scan of the golden vectors was taken.
pub fn golden_pose_3d() -> Rigid3 {
    Rigid3::from_parts([0.4, -0.3, 0.1].into(), rotation_from_roll_pitch_yaw(0.0, 0.0, 0.1))
}

/// Initial pose I of the golden vectors in 3D.
pub fn golden_initial_3d() -> Rigid3 {
    Rigid3::from_parts([0.5, -0.2, 0.05].into(), rotation_from_roll_pitch_yaw(0.005, -0.004, 0.09))
}
