//! Zero-velocity updates: detects that the platform is at rest from an IMU at rest and from sweeps that
//! register at the same pose.
//!
//! If the scanner stands among people, it sees walls that are occluded and reappear, and every sweep
//! registers at a slightly different pose. While the IMU is at rest, the median of the last poses is taken
//! as the pose (a zero-velocity update as in pedestrian navigation: Foxlin, "Pedestrian Tracking with
//! Shoe-Mounted Inertial Sensors", 2005). Unlike there, the scans decide and not an assumption: where their
//! median moves, the platform moves.

use std::collections::VecDeque;

use portolan_geometry::{Rigid3, Time, Vector3, angle_axis_from_quaternion, quaternion_from_angle_axis};
use portolan_sensor::ImuData;

/// Distance from their median, in standard deviations, within which most poses of a platform at rest are.
const OUTLIER: f64 = 3.0;
/// Time for which poses are kept, as a multiple of the required time at rest; the newest third is compared
/// with the others.
const REMEMBERED: f64 = 3.0;
/// Minimum number of poses, as they are split into thirds.
const LEAST_POSES: usize = 3;

/// Tolerances within which a platform counts as at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StandstillTolerances {
    /// Time for which the IMU has to be at rest, and for which the last poses have to agree with those
    /// before them, seconds.
    pub time: f64,
    /// Time over which samples of the IMU are averaged, seconds, so that vibrations do not count.
    pub bin: f64,
    /// Standard deviation of averaged accelerations at rest, m/s².
    pub acceleration_error: f64,
    /// Standard deviation of averaged angular velocities at rest, whose bias may still be unknown, rad/s.
    pub turn_rate_error: f64,
    /// Speed from odometry above which the platform moves, m/s.
    pub resting_speed: f64,
    /// Standard deviation of registered positions, metres.
    pub place_error: f64,
    /// Standard deviation of registered rotations, radians.
    pub rotation_error: f64,
}

/// The mean of the samples of a short time.
#[derive(Clone, Copy, Debug, Default)]
struct Bin {
    acceleration: Vector3,
    turn_rate: Vector3,
}

/// Detects whether the platform is at rest.
#[derive(Clone, Debug)]
pub struct ZeroVelocityDetector {
    tolerances: StandstillTolerances,
    bins: VecDeque<Bin>,
    /// The bin that is being filled: its start, the number of samples, and their sum.
    filling: Option<(Time, u32, Bin)>,
    /// Poses (tracking in local) at which sweeps were registered, before any zero-velocity update.
    poses: VecDeque<(Time, Rigid3)>,
    /// Sum of the translations from odometry while at rest, metres.
    drift: Vector3,
}

impl ZeroVelocityDetector {
    /// A detector without measurements.
    pub fn new(tolerances: &StandstillTolerances) -> Self {
        Self {
            tolerances: *tolerances,
            bins: VecDeque::new(),
            filling: None,
            poses: VecDeque::new(),
            drift: Vector3::zeros(),
        }
    }

    /// Takes a sample from which the bias of the gyroscope was subtracted.
    pub fn add_imu(&mut self, data: &ImuData) {
        let (duration, wanted_bins) = (self.tolerances.bin, self.wanted_bins());
        let (since, count, sum) = self.filling.get_or_insert((data.time, 0, Bin::default()));
        let age = data.time.seconds_since(*since);
        if !(0.0..duration).contains(&age) && *count > 0 {
            let weight = 1.0 / f64::from(*count);
            let mean = Bin { acceleration: sum.acceleration * weight, turn_rate: sum.turn_rate * weight };
            self.bins.push_back(mean);
            // The motion during a gap is unknown.
            if !(0.0..10.0 * duration).contains(&age) {
                self.bins.clear();
            }
            if self.bins.len() > wanted_bins {
                self.bins.pop_front();
            }
            (*since, *count, *sum) = (data.time, 0, Bin::default());
        }
        *count += 1;
        sum.acceleration += data.linear_acceleration;
        sum.turn_rate += data.angular_velocity;
    }

    /// Takes the pose at which a sweep was registered.
    pub fn add_pose(&mut self, time: Time, local_from_tracking: &Rigid3) {
        self.poses.push_back((time, *local_from_tracking));
        let is_old =
            |(pose, _): &(Time, Rigid3)| time.seconds_since(*pose) > REMEMBERED * self.tolerances.time;
        while self.poses.front().is_some_and(is_old) {
            self.poses.pop_front();
        }
    }

    /// Takes the translation from odometry since the last sweep (metres) and its duration (seconds). Scans
    /// with a degenerate direction register at the predicted pose, and an IMU does not measure constant
    /// velocity. So motion measured by odometry means that the platform is not at rest.
    pub fn add_odometry(&mut self, translation: &Vector3, seconds: f64) {
        if translation.norm() > self.tolerances.resting_speed * seconds {
            self.poses.clear();
            self.drift = Vector3::zeros();
            return;
        }
        self.drift += translation;
        if self.drift.norm() > self.tolerances.place_error {
            self.poses.clear();
            self.drift = Vector3::zeros();
        }
    }

    /// Pose of the platform (tracking in local), if it is at rest.
    pub fn pose(&self) -> Option<Rigid3> {
        let is_resting = self.bins.len() >= self.wanted_bins() && self.imu_rests();
        if !is_resting || !self.sweeps_are_enough() {
            return None;
        }
        let &StandstillTolerances { place_error, rotation_error, .. } = &self.tolerances;
        let all: Vec<Rigid3> = self.poses.iter().map(|(_, pose)| *pose).collect();
        let (older, newer) = all.split_at(all.len() - all.len() / 3);
        let (stands, now) = (median(&all)?, median(newer)?);
        let (shift, turn) = distance(&stands, &now);
        let most_are_near = |poses: &[Rigid3]| {
            let near = |p: &&Rigid3| {
                let (shift, turn) = distance(&stands, p);
                shift < OUTLIER * place_error && turn < OUTLIER * rotation_error
            };
            2 * poses.iter().filter(near).count() > poses.len()
        };
        let is_steady = shift < place_error && turn < rotation_error;
        (is_steady && most_are_near(older)).then_some(stands)
    }

    /// Whether the sweeps with poses, each with the duration of the mean interval, cover the required time
    /// at rest, rounded to a sweep.
    fn sweeps_are_enough(&self) -> bool {
        let (Some(first), Some(last)) = (self.poses.front(), self.poses.back()) else { return false };
        let interval = last.0.seconds_since(first.0) / (self.poses.len() as f64 - 1.0).max(1.0);
        self.poses.len() >= LEAST_POSES && (self.poses.len() as f64 + 0.5) * interval >= self.tolerances.time
    }

    /// Mean specific force (m/s²) of an IMU that has been at rest for at least half of the required time.
    pub fn force_at_rest(&self) -> Option<f64> {
        let sum: Vector3 = self.bins.iter().map(|bin| bin.acceleration).sum();
        let is_resting = self.bins.len() >= self.wanted_bins() / 2 && self.imu_rests();
        is_resting.then(|| sum.norm() / self.bins.len() as f64)
    }

    /// Number of bins in the required time at rest.
    fn wanted_bins(&self) -> usize {
        (self.tolerances.time / self.tolerances.bin).round() as usize
    }

    /// Generalised likelihood ratio test of an IMU at rest (Skog et al. 2010): up to noise, accelerations
    /// equal their mean and angular velocities are zero.
    fn imu_rests(&self) -> bool {
        let count = self.bins.len() as f64;
        let mean = self.bins.iter().map(|bin| bin.acceleration).sum::<Vector3>() / count;
        let &StandstillTolerances { acceleration_error, turn_rate_error, .. } = &self.tolerances;
        let ratio = |bin: &Bin| {
            let acceleration = (bin.acceleration - mean) / acceleration_error;
            acceleration.norm_squared() + (bin.turn_rate / turn_rate_error).norm_squared()
        };
        self.bins.iter().map(ratio).sum::<f64>() < count
    }
}

fn distance(a: &Rigid3, b: &Rigid3) -> (f64, f64) {
    let difference = a.inverse() * b;
    (difference.translation.vector.norm(), difference.rotation.angle())
}

/// Median of each coordinate of poses near each other, with rotations relative to the last one.
fn median(poses: &[Rigid3]) -> Option<Rigid3> {
    let reference = poses.last()?.rotation;
    let turn = |pose: &Rigid3| angle_axis_from_quaternion(&(reference.inverse() * pose.rotation));
    let place = median_of(&poses.iter().map(|pose| pose.translation.vector).collect::<Vec<Vector3>>())?;
    let turn = median_of(&poses.iter().map(turn).collect::<Vec<Vector3>>())?;
    Some(Rigid3::from_parts(place.into(), reference * quaternion_from_angle_axis(&turn)))
}

/// Median of each coordinate.
fn median_of(vectors: &[Vector3]) -> Option<Vector3> {
    let middle = |coordinate: fn(&Vector3) -> f64| {
        let mut values: Vec<f64> = vectors.iter().map(coordinate).collect();
        values.sort_unstable_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    Some(Vector3::new(middle(|v| v.x)?, middle(|v| v.y)?, middle(|v| v.z)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Duration;

    fn detector() -> ZeroVelocityDetector {
        ZeroVelocityDetector::new(&StandstillTolerances {
            time: 1.0,
            bin: 0.05,
            acceleration_error: 0.08,
            turn_rate_error: 0.02,
            resting_speed: 0.02,
            place_error: 0.02,
            rotation_error: 0.005,
        })
    }

    fn time(seconds: f64) -> Time {
        Time::from_ticks(0) + Duration::from_seconds(seconds)
    }

    fn sample(seconds: f64, acceleration: f64) -> ImuData {
        // Fast vibration is no motion.
        let tremble = if (seconds * 200.0).round() as i64 % 2 == 0 { 0.5 } else { -0.5 };
        ImuData {
            time: time(seconds),
            linear_acceleration: Vector3::new(acceleration, tremble, 9.8),
            angular_velocity: Vector3::zeros(),
        }
    }

    /// Ten seconds of matches along x at `speed`, of which every seventh is displaced; the IMU sways by
    /// `sway`.
    fn after_ten_seconds(speed: f64, sway: f64) -> Option<Rigid3> {
        let mut detector = detector();
        for i in 0..2000 {
            let t = 0.005 * f64::from(i);
            detector.add_imu(&sample(t, sway * (6.0 * t).sin()));
            if i % 20 == 0 {
                let pulled = if i % 140 == 0 { 0.15 } else { 0.002 * f64::from(i % 3) };
                detector.add_pose(time(t), &Rigid3::translation(speed * t, pulled, 0.0));
            }
        }
        detector.pose()
    }

    #[test]
    fn standstill_is_at_the_median_match() {
        let pose = after_ten_seconds(0.0, 0.0).unwrap();
        assert!(pose.translation.vector.norm() < 0.005, "{pose}");
    }

    #[test]
    fn motion_by_odometry_prevents_standstill() {
        let after = |speed: f64| {
            let mut detector = detector();
            for i in 0..2000 {
                let t = 0.005 * f64::from(i);
                detector.add_imu(&sample(t, 0.0));
                if i % 20 == 0 {
                    if i > 1000 {
                        detector.add_odometry(&(Vector3::x() * speed * 0.1), 0.1);
                    }
                    // As matches in a tunnel: at the predicted pose.
                    detector.add_pose(time(t), &Rigid3::identity());
                }
            }
            detector.pose().is_some()
        };
        assert!(after(0.0) && after(0.001));
        assert!(!after(0.5));
    }

    #[test]
    fn moving_platforms_are_not_at_rest() {
        assert_eq!(after_ten_seconds(0.03, 0.0), None);
        assert_eq!(after_ten_seconds(0.0, 0.5), None);
        assert_eq!(detector().pose(), None);
    }
}
