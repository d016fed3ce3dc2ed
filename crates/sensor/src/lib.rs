//! Measurements in the tracking frame: range data, IMU, odometry, fixed-frame poses, landmarks;
//! point clouds and their filters; ordering of several sensors.
//!
//! Nothing here knows of files, topics or maps. Points are `f32` metres, poses `f64`.

mod collator;
mod compressed_point_cloud;
mod fixed_ratio_sampler;
mod measurement;
mod point_cloud;
mod range_data_collator;
mod rounding;
mod voxel_filter;

pub use collator::{CollatedItem, Collator, CollatorOptions, CollatorReport, SensorCounts, WaitLimit};
pub use compressed_point_cloud::{CompressedPointCloud, CompressedPointCloudError};
pub use fixed_ratio_sampler::{FixedRatioSampler, InvalidRatio};
pub use measurement::{
    FixedFramePoseData, ImuData, LandmarkData, LandmarkObservation, Measurement, OdometryData, SensorId,
    SensorKind, TimedPointCloudData,
};
pub use point_cloud::{PointCloud, RangeData, TimedPoint};
pub use range_data_collator::{
    RangeDataCollator, RangeDataCollatorCounts, SynchronizedPoint, SynchronizedRanges,
};
pub use rounding::{lround, lround_small};
pub use voxel_filter::{
    adaptive_voxel_filter, adaptive_voxel_filter_indices, voxel_filter, voxel_filter_indices,
    voxel_filter_points, voxel_filter_timed,
};
