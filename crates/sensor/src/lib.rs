#![doc = include_str!("../README.md")]

mod collator;
mod compressed_point_cloud;
mod fixed_ratio_sampler;
mod measurement;
mod point_cloud;
mod range_data_collator;
mod reach;
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
pub use reach::{UsualReach, log_reach};
pub use rounding::{lround, lround_small};
pub use voxel_filter::{
    adaptive_voxel_filter, adaptive_voxel_filter_indices, voxel_filter, voxel_filter_indices,
    voxel_filter_points, voxel_filter_timed,
};
