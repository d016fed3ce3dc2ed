//! Measurements of sensors, already in the tracking frame.

use std::sync::Arc;

use portolan_geometry::{Point3f, Rigid3, Time, Vector3};

use crate::TimedPoint;

/// What a sensor measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum SensorKind {
    /// Laser scans and point clouds.
    Range,
    /// Accelerometer and gyroscope.
    Imu,
    /// Wheel or visual odometry.
    Odometry,
    /// Poses in a fixed frame, for example from GNSS.
    FixedFramePose,
    /// Observations of landmarks with an identity.
    Landmark,
}

/// One sensor of a trajectory; ordered by name as the collator needs it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SensorId {
    /// Name, unique within the trajectory: the topic of the sensor.
    pub id: Arc<str>,
    /// What it measures.
    pub kind: SensorKind,
}

impl SensorId {
    /// A sensor named `id`.
    pub fn new(kind: SensorKind, id: impl Into<Arc<str>>) -> Self {
        Self { id: id.into(), kind }
    }
}

/// One message of a range sensor. `time` is the time of the last point; times of points are relative
/// to it, at most zero.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedPointCloudData {
    /// Time of the last point.
    pub time: Time,
    /// Position of the sensor in the tracking frame, metres.
    pub origin_in_tracking: Point3f,
    /// Points in the tracking frame as it was at each point's own time.
    pub points_in_tracking: Vec<TimedPoint>,
    /// One per point, or empty.
    pub intensities: Vec<f32>,
}

/// One IMU sample, rotated into the tracking frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuData {
    /// Time of the sample.
    pub time: Time,
    /// Specific force, m/s²; at rest it points up with about 9.8.
    pub linear_acceleration: Vector3,
    /// Angular velocity, rad/s.
    pub angular_velocity: Vector3,
}

/// One odometry pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryData {
    /// Time of the pose.
    pub time: Time,
    /// Tracking frame in the odometry frame.
    pub odom_from_tracking: Rigid3,
}

/// One pose in a fixed frame (GNSS).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixedFramePoseData {
    /// Time of the pose.
    pub time: Time,
    /// Tracking frame in the fixed frame; `None` while there is no fix.
    pub fixed_from_tracking: Option<Rigid3>,
}

/// Observations of landmarks at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkData {
    /// Time of the observations.
    pub time: Time,
    /// One entry per observed landmark.
    pub observations: Vec<LandmarkObservation>,
}

/// Observation of one landmark.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkObservation {
    /// Identity of the landmark (any bytes in files; text here).
    pub id: String,
    /// Landmark in the tracking frame.
    pub tracking_from_landmark: Rigid3,
    /// Weight of the translation residual, 1/m.
    pub translation_weight: f64,
    /// Weight of the rotation residual, 1/rad.
    pub rotation_weight: f64,
}

/// Any measurement of one sensor.
#[derive(Clone, Debug, PartialEq)]
pub enum Measurement {
    /// A range scan.
    Range(TimedPointCloudData),
    /// An IMU sample.
    Imu(ImuData),
    /// An odometry pose.
    Odometry(OdometryData),
    /// A fixed-frame pose.
    FixedFramePose(FixedFramePoseData),
    /// Landmark observations.
    Landmark(LandmarkData),
}

impl Measurement {
    /// Time of the measurement.
    pub fn time(&self) -> Time {
        match self {
            Self::Range(d) => d.time,
            Self::Imu(d) => d.time,
            Self::Odometry(d) => d.time,
            Self::FixedFramePose(d) => d.time,
            Self::Landmark(d) => d.time,
        }
    }

    /// The kind of its sensor.
    pub fn kind(&self) -> SensorKind {
        match self {
            Self::Range(_) => SensorKind::Range,
            Self::Imu(_) => SensorKind::Imu,
            Self::Odometry(_) => SensorKind::Odometry,
            Self::FixedFramePose(_) => SensorKind::FixedFramePose,
            Self::Landmark(_) => SensorKind::Landmark,
        }
    }
}
