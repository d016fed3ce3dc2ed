//! Converts a message to one or more measurements in the tracking frame (`spec/slam2d.md` §1).

use portolan_geometry::{
    GeodeticPosition, Quaternion, Rigid3, Time, Vector3, nalgebra, pose_from_xyz_quaternion, to_f32,
};
use portolan_recording::{Imu, LandmarkList, NavSatFix, Pose};
use portolan_sensor::{
    FixedFramePoseData, ImuData, LandmarkData, LandmarkObservation, OdometryData, TimedPointCloudData,
};

use crate::plan::ImuScale;
use crate::statistics::is_partial;
use crate::tf::{TfError, TfTree, frame_name};
use crate::timed_points::TimedPoints;

/// Lookups in the tree for one tracking frame. Frames without a name are the tracking frame.
pub(crate) struct Frames<'a> {
    pub tree: &'a TfTree,
    pub tracking: &'a str,
}

impl Frames<'_> {
    /// `tracking_from_frame` at a time.
    ///
    /// # Errors
    /// As for [`TfTree::lookup`].
    pub fn tracking_from(&self, frame: &str, time: Time) -> Result<Rigid3, TfError> {
        match frame_name(frame) {
            "" => Ok(Rigid3::identity()),
            frame => self.tree.lookup(self.tracking, frame, time),
        }
    }
}

/// Points transformed into the tracking frame, with the origin of their sensor.
pub(crate) fn range_data(points: TimedPoints, tracking_from_sensor: &Rigid3) -> TimedPointCloudData {
    let TimedPoints { time, mut points, intensities } = points;
    let tracking_from_sensor = to_f32(tracking_from_sensor);
    if tracking_from_sensor != nalgebra::Isometry3::identity() {
        for point in &mut points {
            point.position = tracking_from_sensor * point.position;
        }
    }
    let origin_in_tracking = tracking_from_sensor.translation.vector.into();
    TimedPointCloudData { time, origin_in_tracking, points_in_tracking: points, intensities }
}

/// The pose of a message, and whether its quaternion had to be normalised. A quaternion with a norm between ½
/// and 2 is normalised.
pub fn pose_of(pose: &Pose) -> Option<(Rigid3, bool)> {
    if let Some(valid) = pose_from_xyz_quaternion(pose.position, pose.orientation_xyzw) {
        return Some((valid, false));
    }
    let [x, y, z, w] = pose.orientation_xyzw;
    let quaternion = nalgebra::Quaternion::new(w, x, y, z);
    let usable = (0.5..2.0).contains(&quaternion.norm()) && pose.position.iter().all(|v| v.is_finite());
    usable.then(|| {
        let rotation = Quaternion::new_normalize(quaternion);
        (Rigid3::from_parts(Vector3::from(pose.position).into(), rotation), true)
    })
}

/// Odometry of the tracking frame: pose of the child, times tracking in child.
pub(crate) fn odometry(time: Time, odom_from_child: Rigid3, tracking_from_child: &Rigid3) -> OdometryData {
    OdometryData { time, odom_from_tracking: odom_from_child * tracking_from_child.inverse() }
}

/// Reasons why an IMU sample cannot be used.
pub(crate) enum ImuFault {
    NotFinite,
    Impossible,
    Partial,
}

/// Twice the range of common gyroscopes, rad/s; single samples beyond are transmission errors.
pub const MAX_ANGULAR_VELOCITY: f64 = 80.0;
/// Two and a half times the range of common accelerometers (16 g), m/s².
pub const MAX_ACCELERATION: f64 = 400.0;

/// An IMU sample rotated into the tracking frame.
pub(crate) fn imu(
    time: Time,
    message: &Imu,
    scale: ImuScale,
    tracking_from_imu: &Quaternion,
) -> Result<ImuData, ImuFault> {
    if is_partial(message) {
        return Err(ImuFault::Partial);
    }
    let values = message.linear_acceleration.iter().chain(&message.angular_velocity);
    if values.clone().any(|v| !v.is_finite()) {
        return Err(ImuFault::NotFinite);
    }
    let linear_acceleration = scale.acceleration * Vector3::from(message.linear_acceleration);
    let angular_velocity = scale.angular_velocity * Vector3::from(message.angular_velocity);
    if linear_acceleration.amax() > MAX_ACCELERATION || angular_velocity.amax() > MAX_ANGULAR_VELOCITY {
        return Err(ImuFault::Impossible);
    }
    Ok(ImuData {
        time,
        linear_acceleration: tracking_from_imu * linear_acceleration,
        angular_velocity: tracking_from_imu * angular_velocity,
    })
}

/// Fixes relative to the first one (`spec/slam2d.md` §1.1).
#[derive(Clone, Debug, Default)]
pub(crate) struct LocalFixes {
    origin: Option<(GeodeticPosition, Rigid3)>,
    newest: Option<SatelliteFix>,
}

/// A satellite fix and its accuracy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SatelliteFix {
    /// Its time.
    pub time: Time,
    /// Position of the antenna.
    pub place: GeodeticPosition,
    /// Standard deviation along the worst horizontal direction, metres; none if the receiver does not report
    /// it.
    pub horizontal_sigma: Option<f64>,
}

/// Standard deviation of a fix along the worst horizontal direction. Receivers without an estimate report 0,
/// or a covariance of unknown type.
fn horizontal_sigma(message: &NavSatFix) -> Option<f64> {
    let [ee, en, _, ne, nn, ..] = message.position_covariance;
    let (mean, half, cross) = (0.5 * (ee + nn), 0.5 * (ee - nn), 0.5 * (en + ne));
    let variance = mean + half.hypot(cross);
    (message.position_covariance_type != 0 && variance.is_finite() && variance > 0.0).then(|| variance.sqrt())
}

impl LocalFixes {
    /// The pose of a fix; a message without a fix has none. `None` for a place that is not on Earth.
    pub fn convert(&mut self, time: Time, message: &NavSatFix) -> Option<FixedFramePoseData> {
        // Receivers without a fix report that, or zero latitude and longitude.
        let is_nowhere = message.latitude_degrees == 0.0 && message.longitude_degrees == 0.0;
        if message.status < 0 || is_nowhere {
            return Some(FixedFramePoseData { time, fixed_from_tracking: None });
        }
        let place = GeodeticPosition {
            latitude_degrees: message.latitude_degrees,
            longitude_degrees: message.longitude_degrees,
            altitude: message.altitude,
        };
        if !place.is_valid() {
            return None;
        }
        self.newest = Some(SatelliteFix { time, place, horizontal_sigma: horizontal_sigma(message) });
        let (_, local_from_ecef) = self.origin.get_or_insert_with(|| (place, place.local_from_ecef()));
        let position = *local_from_ecef * nalgebra::Point3::from(place.to_ecef());
        let pose = Rigid3::from_parts(position.coords.into(), Quaternion::identity());
        Some(FixedFramePoseData { time, fixed_from_tracking: Some(pose) })
    }

    /// The newest fix.
    pub fn newest(&self) -> Option<SatelliteFix> {
        self.newest
    }

    /// The position of the first fix.
    pub fn origin(&self) -> Option<GeodeticPosition> {
        self.origin.map(|(place, _)| place)
    }
}

/// Landmarks in the tracking frame, and how many had an invalid pose or weight. Without a transform they stay
/// unchanged.
pub(crate) fn landmarks(
    time: Time,
    message: &LandmarkList,
    tracking_from_frame: Option<&Rigid3>,
) -> (LandmarkData, u64) {
    let mut invalid = 0;
    let observation = |entry: &portolan_recording::LandmarkEntry| {
        let weights = [entry.translation_weight, entry.rotation_weight];
        match pose_of(&entry.tracking_from_landmark) {
            Some((pose, _)) if weights.iter().all(|w| w.is_finite() && *w >= 0.0) => {
                Some(LandmarkObservation {
                    id: entry.id.clone(),
                    tracking_from_landmark: tracking_from_frame.map_or(pose, |t| t * pose),
                    translation_weight: entry.translation_weight,
                    rotation_weight: entry.rotation_weight,
                })
            }
            _ => {
                invalid += 1;
                None
            }
        }
    };
    let observations = message.landmarks.iter().filter_map(observation).collect();
    (LandmarkData { time, observations }, invalid)
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_recording::{Header, LandmarkEntry};

    #[test]
    fn landmarks_keep_id_pose_and_weights() {
        let entry = |id: &str, w: f64| LandmarkEntry {
            id: id.into(),
            tracking_from_landmark: Pose { position: [1.0, 2.0, 3.0], orientation_xyzw: [0.0, 0.0, 0.0, w] },
            translation_weight: 10.0,
            rotation_weight: 20.0,
        };
        let message = LandmarkList {
            header: Header { stamp: Time::UNIX_EPOCH, frame_id: "camera".into() },
            landmarks: vec![entry("a", 1.0), entry("b", 0.0)],
        };
        let shift = Rigid3::translation(0.0, 0.0, 1.0);
        let (data, invalid) = landmarks(Time::UNIX_EPOCH, &message, Some(&shift));
        assert_eq!((data.observations.len(), invalid), (1, 1));
        let seen = &data.observations[0];
        assert_eq!((seen.id.as_str(), seen.translation_weight, seen.rotation_weight), ("a", 10.0, 20.0));
        assert!(
            (seen.tracking_from_landmark.translation.vector - Vector3::new(1.0, 2.0, 4.0)).norm() < 1e-12
        );
    }

    #[test]
    fn quaternions_of_wrong_length_are_repaired_or_refused() {
        let pose = |w: f64| Pose { position: [0.0; 3], orientation_xyzw: [0.0, 0.0, 0.0, w] };
        assert!(!pose_of(&pose(1.0)).unwrap().1);
        assert!(pose_of(&pose(1.01)).unwrap().1);
        assert!(pose_of(&pose(0.0)).is_none());
        assert!(pose_of(&pose(f64::NAN)).is_none());
    }

    #[test]
    fn fixes_count_from_the_first() {
        let mut fixes = LocalFixes::default();
        let fix = |status, latitude_degrees| NavSatFix {
            header: Header { stamp: Time::UNIX_EPOCH, frame_id: "gps".into() },
            status,
            service: 1,
            latitude_degrees,
            longitude_degrees: 11.0,
            altitude: 500.0,
            position_covariance: [0.0; 9],
            position_covariance_type: 0,
        };
        let time = Time::UNIX_EPOCH;
        assert_eq!(fixes.convert(time, &fix(-1, 48.0)).unwrap().fixed_from_tracking, None);
        let first = fixes.convert(time, &fix(0, 48.0)).unwrap().fixed_from_tracking.unwrap();
        assert!((first.translation.vector - Vector3::new(0.0, 0.0, 500.0)).norm() < 1e-6);
        // A thousandth of a degree north is 111.2 m towards −x.
        let second = fixes.convert(time, &fix(0, 48.001)).unwrap().fixed_from_tracking.unwrap();
        assert!((second.translation.vector - Vector3::new(-111.2, 0.0, 500.0)).norm() < 0.1);
        assert!(fixes.convert(time, &fix(0, 91.0)).is_none());
        let nowhere = NavSatFix { longitude_degrees: 0.0, ..fix(0, 0.0) };
        assert_eq!(fixes.convert(time, &nowhere).unwrap().fixed_from_tracking, None);
        assert!(fixes.origin().is_some());
    }
}
