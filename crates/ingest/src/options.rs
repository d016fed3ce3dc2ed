//! Options of reading the sensors of a recording. What the user does not set is determined automatically.

use portolan_geometry::{Dimension, Duration};

use crate::RobotDescription;
use crate::azimuth_time::AzimuthTimes;
use crate::beam_elevation::BeamElevation;
use crate::even_stamps::StampPolicy;
use crate::range_noise::RangeNoise;

/// Sensors as a robot configuration names them (`spec/options.md` §8): `scan` or `scan_1` …,
/// `echoes`, `points2`, and `odom`, `imu`, `fix`, `landmark`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ConfiguredSensors {
    /// Number of laser scanners.
    pub num_laser_scans: usize,
    /// Number of multi-echo laser scanners.
    pub num_multi_echo_laser_scans: usize,
    /// Number of sources of point clouds.
    pub num_point_clouds: usize,
    /// Whether odometry is used; none: if there is any.
    pub use_odometry: Option<bool>,
    /// Whether the IMU is used; none: if there is one that is plausible.
    pub use_imu: Option<bool>,
    /// Whether satellite fixes are used; none: no.
    pub use_nav_sat: Option<bool>,
    /// Whether landmarks are used; none: if there are any.
    pub use_landmarks: Option<bool>,
}

/// Fraction of messages that is kept, 0 to 1, per kind of sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SamplingRatios {
    /// Laser scans and point clouds.
    pub rangefinder: f64,
    /// Odometry.
    pub odometry: f64,
    /// Satellite fixes and other poses in a fixed frame.
    pub fixed_frame_pose: f64,
    /// IMU.
    pub imu: f64,
    /// Landmarks.
    pub landmarks: f64,
}

impl Default for SamplingRatios {
    fn default() -> Self {
        Self { rangefinder: 1.0, odometry: 1.0, fixed_frame_pose: 1.0, imu: 1.0, landmarks: 1.0 }
    }
}

/// How to turn a recording into measurements. By default everything is determined automatically.
#[derive(Clone, Debug, PartialEq)]
pub struct IngestOptions {
    /// Topics of scans and point clouds to use; empty: chosen automatically.
    pub range_topics: Vec<String>,
    /// Topic of odometry; none: chosen automatically.
    pub odometry_topic: Option<String>,
    /// Topic of the IMU; none: chosen automatically.
    pub imu_topic: Option<String>,
    /// Topic of satellite fixes; naming one switches them on.
    pub nav_sat_topic: Option<String>,
    /// Topic of landmarks; none: chosen automatically.
    pub landmark_topic: Option<String>,
    /// Topic of poses in a fixed frame (`geometry_msgs/PoseStamped` of the tracking frame).
    pub fixed_frame_pose_topic: Option<String>,
    /// Whether to use odometry; none: if there is any.
    pub use_odometry: Option<bool>,
    /// Whether to use the IMU; none: if there is one that is plausible.
    pub use_imu: Option<bool>,
    /// Whether to use satellite fixes; none: only if a topic is named.
    pub use_nav_sat: Option<bool>,
    /// Whether to use landmarks; none: if there are any.
    pub use_landmarks: Option<bool>,
    /// The frame whose motion is estimated; none: chosen automatically.
    pub tracking_frame: Option<String>,
    /// Transforms below this frame are results of mapping and are not used.
    pub map_frame: String,
    /// In 2D or in 3D; none: chosen automatically.
    pub dimension: Option<Dimension>,
    /// Sensors as a configuration names them; they replace the automatic choice.
    pub configured: Option<ConfiguredSensors>,
    /// Pairs (name, topic): the sensor that a configuration calls `name` is on `topic`.
    pub remappings: Vec<(String, String)>,
    /// Robot description whose fixed joints count as transforms.
    pub description: Option<RobotDescription>,
    /// Whether to use the transforms in the recording.
    pub use_recorded_transforms: bool,
    /// Every laser scan is split into this many pieces in time (point clouds are not).
    pub num_subdivisions_per_laser_scan: usize,
    /// Times of clouds whose points have no times of their own. With any choice but `Auto` and `Recorded`,
    /// the recorded times of spinning lidars are not used.
    pub azimuth_times: AzimuthTimes,
    /// Angle by which the beams of spinning lidars are raised.
    pub beam_elevation: BeamElevation,
    /// Noise of the readings of planar scanners: noisy ones are smoothed.
    pub range_noise: RangeNoise,
    /// Pairs of a topic and the offset added to its stamps and times of points.
    pub time_offsets: Vec<(String, Duration)>,
    /// Treatment of stamps.
    pub stamps: StampPolicy,
    /// Thinning of messages.
    pub sampling: SamplingRatios,
    /// Messages out of order are always left out and counted; with this they do not count as a loss.
    pub ignore_out_of_order: bool,
    /// Whether points carry intensities.
    pub with_intensities: bool,
    /// Duration that is skipped at the beginning.
    pub skip: Duration,
    /// Duration that is read after that; none: all.
    pub length: Option<Duration>,
}

impl Default for IngestOptions {
    fn default() -> Self {
        Self {
            range_topics: Vec::new(),
            odometry_topic: None,
            imu_topic: None,
            nav_sat_topic: None,
            landmark_topic: None,
            fixed_frame_pose_topic: None,
            use_odometry: None,
            use_imu: None,
            use_nav_sat: None,
            use_landmarks: None,
            tracking_frame: None,
            map_frame: "map".to_owned(),
            dimension: None,
            configured: None,
            remappings: Vec::new(),
            description: None,
            use_recorded_transforms: true,
            num_subdivisions_per_laser_scan: 1,
            azimuth_times: AzimuthTimes::default(),
            beam_elevation: BeamElevation::default(),
            range_noise: RangeNoise::default(),
            time_offsets: Vec::new(),
            stamps: StampPolicy::default(),
            sampling: SamplingRatios::default(),
            ignore_out_of_order: false,
            with_intensities: false,
            skip: Duration::ZERO,
            length: None,
        }
    }
}
