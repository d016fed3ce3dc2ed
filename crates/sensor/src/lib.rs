//! Measurements in the tracking frame: range data, IMU, odometry, fixed-frame poses, landmarks;
//! point clouds and their filters; ordering of several sensors.
//!
//! Nothing here knows of files, topics or maps. Points are `f32` metres, poses `f64`.

mod measurement;
mod point_cloud;

pub use measurement::{
    FixedFramePoseData, ImuData, LandmarkData, LandmarkObservation, Measurement, OdometryData, SensorId,
    SensorKind, TimedPointCloudData,
};
pub use point_cloud::{PointCloud, RangeData, TimedPoint};
