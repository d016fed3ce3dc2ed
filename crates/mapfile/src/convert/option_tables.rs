//! Tables of options and their messages (`formats.md` §3a).

use portolan_config as c;

use super::option_message::{OptionMessage, nested_message, option_message};
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::proto::mapping::grid_options2_d::GridType;
use portolan_pbstream::proto::mapping::range_data_inserter_options::RangeDataInserterType;
use portolan_pbstream::proto::mapping::trajectory_builder_options as tb;
use portolan_pbstream::proto::{common, scan_matching as sm, sensor};

option_message!(c::SolverOptions => common::CeresSolverOptions {
    use_nonmonotonic_steps, max_num_iterations, num_threads
});

option_message!(c::AdaptiveVoxelFilterOptions => sensor::AdaptiveVoxelFilterOptions {
    max_length, min_num_points, max_range
});

option_message!(c::MotionFilterOptions => m::MotionFilterOptions {
    max_time_seconds, max_distance_meters, max_angle_radians
});

option_message!(c::ConstantVelocityPoseExtrapolatorOptions => m::ConstantVelocityPoseExtrapolatorOptions {
    imu_gravity_time_constant, pose_queue_duration
});

option_message!(c::ImuBasedPoseExtrapolatorOptions => m::ImuBasedPoseExtrapolatorOptions {
    pose_queue_duration, gravity_constant, pose_translation_weight, pose_rotation_weight,
    imu_acceleration_weight, imu_rotation_weight, solver_options, odometry_translation_weight,
    odometry_rotation_weight
});

option_message!(c::PoseExtrapolatorOptions => m::PoseExtrapolatorOptions {
    use_imu_based, constant_velocity, imu_based
});

option_message!(c::RealTimeCorrelativeScanMatcherOptions => sm::RealTimeCorrelativeScanMatcherOptions {
    linear_search_window, angular_search_window, translation_delta_cost_weight, rotation_delta_cost_weight
});

option_message!(c::CeresScanMatcher2dOptions => sm::CeresScanMatcherOptions2D {
    occupied_space_weight, translation_weight, rotation_weight, ceres_solver_options
});

option_message!(c::IntensityCostFunctionOptions => sm::IntensityCostFunctionOptions {
    weight, huber_scale, intensity_threshold
});

option_message!(c::GridOptions2d => m::GridOptions2D { grid_type, resolution });

option_message!(
    c::ProbabilityGridRangeDataInserter2dOptions => m::ProbabilityGridRangeDataInserterOptions2D {
        hit_probability, miss_probability, insert_free_space
    }
);

option_message!(c::NormalEstimation2dOptions => m::NormalEstimationOptions2D {
    num_normal_samples, sample_radius
});

option_message!(c::TsdfRangeDataInserter2dOptions => m::TsdfRangeDataInserterOptions2D {
    truncation_distance, maximum_weight, update_free_space, normal_estimation_options,
    project_sdf_distance_to_scan_normal, update_weight_range_exponent,
    update_weight_angle_scan_normal_to_ray_kernel_bandwidth,
    update_weight_distance_cell_to_hit_kernel_bandwidth
});

option_message!(
    c::RangeDataInserter2dOptions => m::RangeDataInserterOptions { range_data_inserter_type },
    {
        probability_grid_range_data_inserter => probability_grid_range_data_inserter_options_2d,
        tsdf_range_data_inserter => tsdf_range_data_inserter_options_2d
    }
);

option_message!(
    c::Submaps2dOptions => m::SubmapsOptions2D { num_range_data, grid_options_2d },
    { range_data_inserter => range_data_inserter_options }
);

option_message!(c::RangeDataInserter3dOptions => m::RangeDataInserterOptions3D {
    hit_probability, miss_probability, num_free_space_voxels, intensity_threshold
});

option_message!(
    c::Submaps3dOptions => m::SubmapsOptions3D {
        high_resolution, high_resolution_max_range, low_resolution, num_range_data
    },
    { range_data_inserter => range_data_inserter_options }
);

option_message!(
    c::TrajectoryBuilder2dOptions => m::LocalTrajectoryBuilderOptions2D {
        min_range, max_range, min_z, max_z, missing_data_ray_length, num_accumulated_range_data,
        voxel_filter_size, use_online_correlative_scan_matching, imu_gravity_time_constant, use_imu_data
    },
    {
        adaptive_voxel_filter => adaptive_voxel_filter_options,
        loop_closure_adaptive_voxel_filter => loop_closure_adaptive_voxel_filter_options,
        real_time_correlative_scan_matcher => real_time_correlative_scan_matcher_options,
        ceres_scan_matcher => ceres_scan_matcher_options,
        motion_filter => motion_filter_options,
        pose_extrapolator => pose_extrapolator_options,
        submaps => submaps_options
    }
);

option_message!(
    c::TrajectoryBuilder3dOptions => m::LocalTrajectoryBuilderOptions3D {
        min_range, max_range, num_accumulated_range_data, voxel_filter_size,
        use_online_correlative_scan_matching, imu_gravity_time_constant, rotational_histogram_size,
        use_intensities
    },
    {
        high_resolution_adaptive_voxel_filter => high_resolution_adaptive_voxel_filter_options,
        low_resolution_adaptive_voxel_filter => low_resolution_adaptive_voxel_filter_options,
        real_time_correlative_scan_matcher => real_time_correlative_scan_matcher_options,
        ceres_scan_matcher => ceres_scan_matcher_options,
        motion_filter => motion_filter_options,
        pose_extrapolator => pose_extrapolator_options,
        submaps => submaps_options
    },
    // Initial measurements, which callers give and files do not configure.
    empty { initial_poses, initial_imu_data }
);

option_message!(c::PureLocalizationTrimmerOptions => tb::PureLocalizationTrimmerOptions {
    max_submaps_to_keep
});

option_message!(
    c::TrajectoryBuilderOptions => m::TrajectoryBuilderOptions {
        pure_localization_trimmer, collate_fixed_frame, collate_landmarks, pose_graph_odometry_motion_filter
    },
    {
        trajectory_builder_2d => trajectory_builder_2d_options,
        trajectory_builder_3d => trajectory_builder_3d_options
    },
    // The first is part of the pose graph, the second a deprecated form of the trimmer.
    empty { initial_trajectory_pose, pure_localization }
);

impl OptionMessage<i32> for c::GridType2d {
    fn to_message(&self) -> i32 {
        match self {
            Self::ProbabilityGrid => GridType::ProbabilityGrid.into(),
            Self::Tsdf => GridType::Tsdf.into(),
        }
    }
    fn of_message(message: &i32, fallback: &Self) -> Self {
        match GridType::try_from(*message) {
            Ok(GridType::ProbabilityGrid) => Self::ProbabilityGrid,
            Ok(GridType::Tsdf) => Self::Tsdf,
            Ok(GridType::InvalidGrid) | Err(_) => *fallback,
        }
    }
}

impl OptionMessage<i32> for c::RangeDataInserterType2d {
    fn to_message(&self) -> i32 {
        match self {
            Self::ProbabilityGrid => RangeDataInserterType::ProbabilityGridInserter2d.into(),
            Self::Tsdf => RangeDataInserterType::TsdfInserter2d.into(),
        }
    }
    fn of_message(message: &i32, fallback: &Self) -> Self {
        match RangeDataInserterType::try_from(*message) {
            Ok(RangeDataInserterType::ProbabilityGridInserter2d) => Self::ProbabilityGrid,
            Ok(RangeDataInserterType::TsdfInserter2d) => Self::Tsdf,
            Ok(RangeDataInserterType::InvalidInserter) | Err(_) => *fallback,
        }
    }
}

/// Weights and intensity terms are lists in messages: one entry for each of the two grids.
impl OptionMessage<sm::CeresScanMatcherOptions3D> for c::CeresScanMatcher3dOptions {
    fn to_message(&self) -> sm::CeresScanMatcherOptions3D {
        sm::CeresScanMatcherOptions3D {
            occupied_space_weight: self.occupied_space_weights().to_vec(),
            translation_weight: self.translation_weight,
            rotation_weight: self.rotation_weight,
            only_optimize_yaw: self.only_optimize_yaw,
            ceres_solver_options: self.ceres_solver_options.to_message(),
            intensity_cost_function_options: self
                .intensity_cost_functions()
                .map(OptionMessage::to_message)
                .collect(),
        }
    }
    fn of_message(message: &sm::CeresScanMatcherOptions3D, fallback: &Self) -> Self {
        let weight = |i, fallback| message.occupied_space_weight.get(i).copied().unwrap_or(fallback);
        let intensity =
            |i| OptionMessage::of_message(&message.intensity_cost_function_options.get(i).copied(), &None);
        Self {
            occupied_space_weight_0: weight(0, fallback.occupied_space_weight_0),
            occupied_space_weight_1: weight(1, fallback.occupied_space_weight_1),
            intensity_cost_function_options_0: intensity(0),
            intensity_cost_function_options_1: intensity(1),
            translation_weight: message.translation_weight,
            rotation_weight: message.rotation_weight,
            only_optimize_yaw: message.only_optimize_yaw,
            ceres_solver_options: OptionMessage::of_message(
                &message.ceres_solver_options,
                &fallback.ceres_solver_options,
            ),
        }
    }
}
nested_message!(c::CeresScanMatcher3dOptions => sm::CeresScanMatcherOptions3D);
