//! Knowing that nothing moves: an IMU at rest, and sweeps that match where they did before.
//!
//! A scanner that stands among people sees walls that come and go behind them, and every sweep matches a
//! little elsewhere. While the IMU is at rest the median of the last matches is where it stands (a
//! zero-velocity update as in pedestrian navigation, with the scans instead of an assumption as the last
//! word: where their median moves, it moves).

use std::collections::VecDeque;

use portolan_geometry::{Rigid3, Time, Vector3, angle_axis_from_quaternion, quaternion_from_angle_axis};
use portolan_sensor::ImuData;

/// Samples are averaged over this long, seconds, so that vibrations do not count.
const BIN: f64 = 0.05;
/// The IMU has to be at rest for so many of these.
const BINS: usize = 20;
/// Standard deviations of the averages of an IMU at rest, m/s² and rad/s, and how fast it may seem to turn.
const MAX_ACCELERATION_SPREAD: f64 = 0.08;
const MAX_TURN_SPREAD: f64 = 0.01;
const MAX_TURN_RATE: f64 = 0.02;
/// What the scanner may have moved by within the last matches before it is taken to stand, metres and radians.
const MAX_SHIFT: f64 = 0.06;
const MAX_TURN: f64 = 0.015;
/// How far the median of the newest matches may be from that of all while it stands, metres and radians.
const MAX_CREEP: f64 = 0.02;
const MAX_CREEP_TURN: f64 = 0.005;
/// Wheels that stand turn slower than this, m/s.
const MAX_ODOMETRY_SPEED: f64 = 0.02;
/// Matches are remembered this long, seconds; the newest third tell whether it moves again.
const MEMORY: f64 = 3.0;
/// So many matches are needed.
const MIN_MATCHES: usize = 10;

/// The mean of the samples of a short time.
#[derive(Clone, Copy, Debug, Default)]
struct Bin {
    acceleration: Vector3,
    turn_rate: Vector3,
}

/// Finds out whether the scanner stands still.
#[derive(Clone, Debug, Default)]
pub(super) struct Standstill {
    bins: VecDeque<Bin>,
    /// The bin that is being filled: since when, samples, and their sum.
    filling: Option<(Time, u32, Bin)>,
    /// Poses (tracking in local) at which sweeps matched, not those that were made of them.
    matches: VecDeque<(Time, Rigid3)>,
    /// How far odometry went since it stands, metres.
    crept: Vector3,
}

impl Standstill {
    /// Takes a sample without the bias of the gyroscope.
    pub fn add_imu(&mut self, data: &ImuData) {
        let (since, count, sum) = self.filling.get_or_insert((data.time, 0, Bin::default()));
        let age = data.time.seconds_since(*since);
        if !(0.0..BIN).contains(&age) && *count > 0 {
            let share = 1.0 / f64::from(*count);
            self.bins
                .push_back(Bin { acceleration: sum.acceleration * share, turn_rate: sum.turn_rate * share });
            // A gap tells nothing of what happened in it.
            if !(0.0..10.0 * BIN).contains(&age) {
                self.bins.clear();
            }
            if self.bins.len() > BINS {
                self.bins.pop_front();
            }
            (*since, *count, *sum) = (data.time, 0, Bin::default());
        }
        *count += 1;
        sum.acceleration += data.linear_acceleration;
        sum.turn_rate += data.angular_velocity;
    }

    /// Takes the pose at which a sweep matched.
    pub fn add_match(&mut self, time: Time, local_from_tracking: &Rigid3) {
        self.matches.push_back((time, *local_from_tracking));
        while self.matches.front().is_some_and(|(t, _)| time.seconds_since(*t) > MEMORY) {
            self.matches.pop_front();
        }
    }

    /// Takes the shift that odometry measured since the last sweep (metres) and how long that took (seconds).
    /// Scans that leave a direction open match where the scanner is believed to stand, and an IMU feels no even
    /// motion: what odometry saw moving does not stand.
    pub fn add_odometry(&mut self, shift: &Vector3, seconds: f64) {
        if shift.norm() > MAX_ODOMETRY_SPEED * seconds {
            self.matches.clear();
            self.crept = Vector3::zeros();
            return;
        }
        self.crept += shift;
        if self.crept.norm() > MAX_CREEP {
            self.matches.clear();
            self.crept = Vector3::zeros();
        }
    }

    /// Where it stands (tracking in local), if it does.
    pub fn pose(&self) -> Option<Rigid3> {
        let is_resting = self.bins.len() >= BINS && self.imu_rests();
        if !is_resting || self.matches.len() < MIN_MATCHES {
            return None;
        }
        let all: Vec<Rigid3> = self.matches.iter().map(|(_, pose)| *pose).collect();
        let (older, newer) = all.split_at(all.len() - all.len() / 3);
        let (stands, now) = (median(&all)?, median(newer)?);
        let (shift, turn) = distance(&stands, &now);
        let half_way = |poses: &[Rigid3]| {
            let near = |p: &&Rigid3| {
                let (shift, turn) = distance(&stands, p);
                shift < MAX_SHIFT && turn < MAX_TURN
            };
            2 * poses.iter().filter(near).count() > poses.len()
        };
        (shift < MAX_CREEP && turn < MAX_CREEP_TURN && half_way(older)).then_some(stands)
    }

    /// The mean specific force (m/s²) of an IMU that has been at rest for half a second or more.
    pub fn force_at_rest(&self) -> Option<f64> {
        let sum: Vector3 = self.bins.iter().map(|bin| bin.acceleration).sum();
        let is_resting = self.bins.len() >= BINS / 2 && self.imu_rests();
        is_resting.then(|| sum.norm() / self.bins.len() as f64)
    }

    fn imu_rests(&self) -> bool {
        let spread = |value: fn(&Bin) -> Vector3| {
            let count = self.bins.len() as f64;
            let mean = self.bins.iter().map(value).sum::<Vector3>() / count;
            let squares = self.bins.iter().map(|bin| (value(bin) - mean).norm_squared()).sum::<f64>();
            (mean, (squares / count).sqrt())
        };
        let (_, by_acceleration) = spread(|bin| bin.acceleration);
        let (turn_rate, by_turn) = spread(|bin| bin.turn_rate);
        by_acceleration < MAX_ACCELERATION_SPREAD
            && by_turn < MAX_TURN_SPREAD
            && turn_rate.norm() < MAX_TURN_RATE
    }
}

fn distance(a: &Rigid3, b: &Rigid3) -> (f64, f64) {
    let difference = a.inverse() * b;
    (difference.translation.vector.norm(), difference.rotation.angle())
}

/// The median of each coordinate of poses near each other, turns as seen from the last one.
fn median(poses: &[Rigid3]) -> Option<Rigid3> {
    let reference = poses.last()?;
    let middle = |mut values: Vec<f64>| {
        values.sort_unstable_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let turns: Vec<Vector3> = poses
        .iter()
        .map(|p| angle_axis_from_quaternion(&(reference.rotation.inverse() * p.rotation)))
        .collect();
    let along = |axis: usize| middle(poses.iter().map(|p| p.translation.vector[axis]).collect());
    let about = |axis: usize| middle(turns.iter().map(|t| t[axis]).collect());
    let turn = quaternion_from_angle_axis(&Vector3::new(about(0), about(1), about(2)));
    Some(Rigid3::from_parts([along(0), along(1), along(2)].into(), reference.rotation * turn))
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Duration;

    fn time(seconds: f64) -> Time {
        Time::from_ticks(0) + Duration::from_seconds(seconds)
    }

    fn sample(seconds: f64, acceleration: f64) -> ImuData {
        // A fast tremble is no motion.
        let tremble = if (seconds * 200.0).round() as i64 % 2 == 0 { 0.5 } else { -0.5 };
        ImuData {
            time: time(seconds),
            linear_acceleration: Vector3::new(acceleration, tremble, 9.8),
            angular_velocity: Vector3::zeros(),
        }
    }

    /// Ten seconds of matches along x at `speed`, every seventh one pulled away; the IMU sways by `sway`.
    fn after_ten_seconds(speed: f64, sway: f64) -> Option<Rigid3> {
        let mut standstill = Standstill::default();
        for i in 0..2000 {
            let t = 0.005 * f64::from(i);
            standstill.add_imu(&sample(t, sway * (6.0 * t).sin()));
            if i % 20 == 0 {
                let pulled = if i % 140 == 0 { 0.15 } else { 0.002 * f64::from(i % 3) };
                standstill.add_match(time(t), &Rigid3::translation(speed * t, pulled, 0.0));
            }
        }
        standstill.pose()
    }

    #[test]
    fn it_stands_where_most_sweeps_match() {
        let pose = after_ten_seconds(0.0, 0.0).unwrap();
        assert!(pose.translation.vector.norm() < 0.005, "{pose}");
    }

    #[test]
    fn what_odometry_saw_moving_does_not_stand() {
        let after = |speed: f64| {
            let mut standstill = Standstill::default();
            for i in 0..2000 {
                let t = 0.005 * f64::from(i);
                standstill.add_imu(&sample(t, 0.0));
                if i % 20 == 0 {
                    if i > 1000 {
                        standstill.add_odometry(&(Vector3::x() * speed * 0.1), 0.1);
                    }
                    // As matches in a tunnel: where it was believed to be.
                    standstill.add_match(time(t), &Rigid3::identity());
                }
            }
            standstill.pose().is_some()
        };
        assert!(after(0.0) && after(0.001));
        assert!(!after(0.5));
    }

    #[test]
    fn what_moves_does_not_stand() {
        assert_eq!(after_ten_seconds(0.03, 0.0), None);
        assert_eq!(after_ten_seconds(0.0, 0.5), None);
        assert_eq!(Standstill::default().pose(), None);
    }
}
