//! Stores the other measurements of motion of a recording: angular velocities, accelerations, wheel odometry,
//! fixes.

use portolan_geometry::{Rigid3, Time, Vector3, quaternion_from_angle_axis};
use portolan_sensor::{FixedFramePoseData, ImuData, OdometryData};

/// Interval between samples above which they are not bridged, seconds.
const GAP: f64 = 0.25;

/// Measurements of other sensors than lidars, in the tracking frame and in order of time. Samples that are not finite or
/// not later than the one before are left out and counted.
#[derive(Clone, Debug, Default)]
pub struct MotionSensors {
    imu: Vec<ImuData>,
    odometry: Vec<OdometryData>,
    fixes: Vec<(Time, Vector3)>,
    left_out: u64,
}

impl MotionSensors {
    /// Adds a sample of the IMU.
    pub fn push_imu(&mut self, sample: &ImuData) {
        let finite = |v: &Vector3| v.iter().all(|x| x.is_finite());
        let later = self.imu.last().is_none_or(|last| last.time < sample.time);
        if later && finite(&sample.angular_velocity) && finite(&sample.linear_acceleration) {
            self.imu.push(*sample);
        } else {
            self.left_out += 1;
        }
    }

    /// Adds a pose of the odometry.
    pub fn push_odometry(&mut self, sample: &OdometryData) {
        let later = self.odometry.last().is_none_or(|last| last.time < sample.time);
        if later && portolan_geometry::is_valid_pose(&sample.odom_from_tracking) {
            self.odometry.push(*sample);
        } else {
            self.left_out += 1;
        }
    }

    /// Adds a position in a fixed frame (of a satellite receiver); without a fix nothing is added.
    pub fn push_fix(&mut self, sample: &FixedFramePoseData) {
        let Some(pose) = sample.fixed_from_tracking else { return };
        let later = self.fixes.last().is_none_or(|last| last.0 < sample.time);
        if later && pose.translation.vector.iter().all(|x| x.is_finite()) {
            self.fixes.push((sample.time, pose.translation.vector));
        } else {
            self.left_out += 1;
        }
    }

    /// Samples of the IMU.
    pub fn imu(&self) -> &[ImuData] {
        &self.imu
    }

    /// Poses of the odometry.
    pub fn odometry(&self) -> &[OdometryData] {
        &self.odometry
    }

    /// Positions in the fixed frame, metres.
    pub fn fixes(&self) -> &[(Time, Vector3)] {
        &self.fixes
    }

    /// Number of samples that could not be used.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Track of the wheel odometry; none without wheels.
    pub(crate) fn odometry_track(&self, start: Time) -> Option<PoseTrack> {
        let poses = self.odometry.iter().map(|o| (o.time.seconds_since(start), o.odom_from_tracking));
        PoseTrack::new(poses.collect())
    }

    /// Orientations from the gyroscope alone, minus a bias (rad/s); none without an IMU.
    pub(crate) fn gyroscope_track(&self, start: Time, bias: &Vector3) -> Option<PoseTrack> {
        let mut rotation = portolan_geometry::Quaternion::identity();
        let mut poses = Vec::with_capacity(self.imu.len());
        let mut before: Option<&ImuData> = None;
        for sample in &self.imu {
            if let Some(before) = before {
                let rate = (before.angular_velocity + sample.angular_velocity) * 0.5 - bias;
                let seconds = sample.time.seconds_since(before.time);
                // The motion over a gap is unknown; the track has a gap there, too.
                if seconds <= GAP {
                    rotation *= quaternion_from_angle_axis(&(rate * seconds));
                    rotation.renormalize();
                }
            }
            let pose = Rigid3::from_parts(Vector3::zeros().into(), rotation);
            poses.push((sample.time.seconds_since(start), pose));
            before = Some(sample);
        }
        PoseTrack::new(poses)
    }
}

/// Poses in order of time in a frame of their own, of which only the relative motion is used.
#[derive(Clone, Debug)]
pub(crate) struct PoseTrack {
    poses: Vec<(f64, Rigid3)>,
    gap: f64,
}

impl PoseTrack {
    fn new(poses: Vec<(f64, Rigid3)>) -> Option<Self> {
        let mut steps: Vec<f64> = poses.windows(2).map(|w| w[1].0 - w[0].0).collect();
        steps.sort_by(f64::total_cmp);
        let usual = *steps.get(steps.len() / 2)?;
        Some(Self { poses, gap: GAP.max(3.0 * usual) })
    }

    fn at(&self, seconds: f64) -> Option<Rigid3> {
        let next = self.poses.partition_point(|p| p.0 <= seconds);
        let (a, b) = (self.poses.get(next.checked_sub(1)?)?, self.poses.get(next)?);
        if b.0 - a.0 > self.gap {
            return None;
        }
        let f = (seconds - a.0) / (b.0 - a.0);
        let rotation = a.1.rotation.try_slerp(&b.1.rotation, f, 1e-12)?;
        let place = a.1.translation.vector * (1.0 - f) + b.1.translation.vector * f;
        Some(Rigid3::from_parts(place.into(), rotation))
    }

    /// The motion between two times (tracking frame then from tracking frame later); none over a gap.
    pub fn motion(&self, from: f64, to: f64) -> Option<Rigid3> {
        let (first, last) =
            (self.poses.partition_point(|p| p.0 <= from), self.poses.partition_point(|p| p.0 <= to));
        let bridged =
            self.poses[first.saturating_sub(1)..last].windows(2).all(|w| w[1].0 - w[0].0 <= self.gap);
        if !bridged {
            return None;
        }
        Some(self.at(from)?.inverse() * self.at(to)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Duration;

    fn sample(seconds: f64, rate: f64) -> ImuData {
        let time = Time::from_unix_seconds(100.0) + Duration::from_seconds(seconds);
        let up = Vector3::new(0.0, 0.0, 9.8);
        ImuData { time, linear_acceleration: up, angular_velocity: Vector3::new(0.0, 0.0, rate) }
    }

    #[test]
    fn a_gyroscope_is_integrated_and_gaps_are_not_bridged() {
        let mut sensors = MotionSensors::default();
        for i in 0..200 {
            sensors.push_imu(&sample(f64::from(i) * 0.01, 0.6));
        }
        for i in 300..400 {
            sensors.push_imu(&sample(f64::from(i) * 0.01, 0.6));
        }
        sensors.push_imu(&sample(0.0, 0.0));
        sensors.push_imu(&sample(9.0, f64::NAN));
        assert_eq!(sensors.left_out(), 2);
        let bias = Vector3::new(0.0, 0.0, 0.1);
        let track = sensors.gyroscope_track(Time::from_unix_seconds(100.0), &bias).unwrap();
        let turn = track.motion(0.5, 1.5).unwrap().rotation.angle();
        assert!((turn - 0.5).abs() < 1e-9, "{turn}");
        assert!(track.motion(1.5, 3.5).is_none() && track.motion(-1.0, 1.0).is_none());
        assert!(sensors.odometry_track(Time::from_unix_seconds(100.0)).is_none());
    }
}
