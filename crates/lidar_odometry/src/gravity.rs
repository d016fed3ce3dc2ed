//! The gravity estimator: which way is up in the local map, from accelerations and from where sweeps were registered.
//!
//! A platform that is already walking when a recording starts shakes the accelerometer by some m/s²: a single sample leans
//! by 10° and more, and a slow average forgets that only after its time constant. But registration tells how the scanner
//! moved. With R(t) from local SLAM, X the double integral of R a (a: specific force) and p the place of the scanner,
//!
//! ```text
//! p − X = p₀ + v₀ t − ½ g t²
//! ```
//!
//! a parabola of which least squares over the last sweeps give g: no matter how it walks, brakes or turns.

use std::collections::VecDeque;

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Quaternion, Rigid3, Time, Vector3, quaternion_from_angle_axis, rotation_between};
use portolan_sensor::ImuData;

use crate::imu_buffer::ImuBuffer;
use crate::settings::{GravitySettings, ImuSettings};

/// The mean of accelerations (m/s²) as seen from the tracking frame at the first sample, turned there by the
/// gyroscope. None without a sample.
pub(crate) fn mean_acceleration(samples: &[ImuData]) -> Option<Vector3> {
    let mut turned = Quaternion::identity();
    let mut sum = samples.first()?.linear_acceleration;
    for pair in samples.windows(2) {
        let seconds = pair[1].time.seconds_since(pair[0].time);
        turned *= quaternion_from_angle_axis(&(pair[0].angular_velocity * seconds));
        sum += turned * pair[1].linear_acceleration;
    }
    Some(sum / samples.len() as f64)
}

/// Follows the direction of gravity in the local map.
#[derive(Clone, Debug)]
pub(crate) struct GravityEstimator {
    settings: GravitySettings,
    imu: ImuSettings,
    samples: ImuBuffer,
    last: Option<(Time, Rigid3)>,
    /// X and its derivative: integrals of the specific force in the local map, twice and once.
    double_integral: Vector3,
    integral: Vector3,
    /// Time and p − X of each sweep.
    fitted: VecDeque<(Time, Vector3)>,
    /// Specific force at rest in the local map as far as it was known before the fit.
    believed: Option<Vector3>,
    known: Option<Vector3>,
}

impl GravityEstimator {
    pub fn new(settings: &GravitySettings, imu: &ImuSettings) -> Self {
        Self {
            settings: settings.clone(),
            imu: imu.clone(),
            samples: ImuBuffer::default(),
            last: None,
            double_integral: Vector3::zeros(),
            integral: Vector3::zeros(),
            fitted: VecDeque::new(),
            believed: None,
            known: None,
        }
    }

    /// Takes a sample, in order of time.
    pub fn add_imu(&mut self, data: &ImuData) {
        self.samples.push(data, self.imu.max_samples);
    }

    /// Takes the pose (tracking in local) at which a sweep was registered, and what the IMU alone says of gravity there
    /// (tracking to level), which counts at the beginning.
    pub fn add_sweep(&mut self, time: Time, local_from_tracking: &Rigid3, level_from_tracking: &Quaternion) {
        if self.believed.is_none() {
            let up = local_from_tracking.rotation * (level_from_tracking.inverse() * Vector3::z());
            self.believed = Some(up * self.imu.gravity);
        }
        let last = self.last;
        if !last.is_some_and(|last| self.integrate(last, (time, local_from_tracking))) {
            self.start_anew();
        }
        self.last = Some((time, *local_from_tracking));
        self.fitted.push_back((time, local_from_tracking.translation.vector - self.double_integral));
        while self.fitted.front().is_some_and(|(first, _)| time.seconds_since(*first) > self.settings.memory)
        {
            self.fitted.pop_front();
        }
        let is_plausible = |g: &Vector3| (g.norm() - self.imu.gravity).abs() < self.settings.max_difference;
        if let Some(fit) = self.fit().filter(is_plausible) {
            self.known = Some(fit);
        }
    }

    /// From the tracking frame, which lies in the local map as given, to a gravity-aligned one of the same heading.
    pub fn level_from_tracking(&self, local_from_tracking: &Quaternion) -> Option<Quaternion> {
        let up = self.known.or(self.believed)?;
        Some(rotation_between(&up, &Vector3::z()) * local_from_tracking)
    }

    fn start_anew(&mut self) {
        self.believed = self.known.or(self.believed);
        self.fitted.clear();
        (self.integral, self.double_integral) = (Vector3::zeros(), Vector3::zeros());
    }

    /// Integrates what the IMU measured between two sweeps, with interpolated rotations. False if it did not measure.
    fn integrate(&mut self, (from, start): (Time, Rigid3), (to, end): (Time, &Rigid3)) -> bool {
        let after = self.samples.count_until(to);
        let used = self.samples.all().get(..after).unwrap_or_default();
        let seconds = to.seconds_since(from);
        let Some(mut current) = used.first().copied().filter(|s| s.time <= from && seconds > 0.0) else {
            self.samples.forget_until(to);
            return false;
        };
        let (mut velocity, mut way, mut time) = (self.integral, self.double_integral, from);
        let mut is_whole = true;
        for i in 1..=used.len() {
            let next = used.get(i).copied().filter(|s| s.time > from);
            if next.is_none() && i < used.len() {
                current = used[i];
                continue;
            }
            let until = next.map_or(to, |s| s.time);
            is_whole &= until.seconds_since(current.time) <= self.imu.max_gap;
            let step = until.seconds_since(time);
            let fraction = (time.seconds_since(from) + 0.5 * step) / seconds;
            let rotation = start.rotation.slerp(&end.rotation, fraction.clamp(0.0, 1.0));
            let force = rotation * current.linear_acceleration;
            way += velocity * step + force * (0.5 * step * step);
            velocity += force * step;
            time = until;
            current = next.unwrap_or(current);
        }
        (self.integral, self.double_integral) = (velocity, way);
        self.samples.forget_until(to);
        is_whole
    }

    /// Least squares of the parabola, with what was believed before as a prior.
    fn fit(&self) -> Option<Vector3> {
        let (first, believed) = (self.fitted.front()?.0, self.believed?);
        // Constant, linear and quadratic coefficient; the last one is −g.
        let ratio = self.settings.match_error / self.settings.average_error;
        let mut normal = na::Matrix3::from_diagonal(&na::Vector3::new(1e-12, 1e-12, ratio * ratio));
        let mut right = na::Matrix3::zeros();
        right.set_row(2, &(-believed * ratio * ratio).transpose());
        let origin = self.fitted.front()?.1;
        for (time, place) in &self.fitted {
            let t = time.seconds_since(first);
            let row = na::Vector3::new(1.0, t, 0.5 * t * t);
            normal += row * row.transpose();
            right += row * (place - origin).transpose();
        }
        let solution = normal.cholesky()?.solve(&right);
        let gravity: Vector3 = -solution.row(2).transpose();
        gravity.iter().all(|v| v.is_finite()).then_some(gravity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Duration;

    fn time(seconds: f64) -> Time {
        Time::from_ticks(0) + Duration::from_seconds(seconds)
    }

    /// Walking in a curve with gait, in a local map that leans by 0.1 rad about x.
    fn place(t: f64) -> Vector3 {
        Vector3::new(
            3.0 * (0.4 * t).sin() + 0.6 * t * t,
            3.0 - 3.0 * (0.4 * t).cos(),
            0.03 * (11.0 * t).sin(),
        )
    }

    fn rotation(t: f64) -> Quaternion {
        quaternion_from_angle_axis(&Vector3::new(0.05 * (6.0 * t).sin(), 0.02, 0.4 * t))
    }

    fn sample(t: f64, lean: &Quaternion) -> ImuData {
        let h = 1e-4;
        let acceleration = (place(t + h) - 2.0 * place(t) + place(t - h)) / (h * h);
        let up = lean * Vector3::z();
        let force = acceleration + up * ImuSettings::default().gravity;
        let turn = rotation(t).inverse() * rotation(t + h);
        ImuData {
            time: time(t),
            linear_acceleration: rotation(t).inverse() * force,
            angular_velocity: turn.scaled_axis() / h,
        }
    }

    /// How far off up is after so many seconds, radians, with gravity first believed along `believed`.
    fn error_after(seconds: f64, believed: &Vector3, gap: bool) -> f64 {
        let lean = quaternion_from_angle_axis(&Vector3::new(0.1, 0.0, 0.0));
        let mut estimator = GravityEstimator::new(&GravitySettings::default(), &ImuSettings::default());
        for i in 0..=(200.0 * seconds) as i32 {
            let t = 0.005 * f64::from(i);
            if !(gap && (0.5..1.5).contains(&t)) {
                estimator.add_imu(&sample(t, &lean));
            }
            if i % 20 == 0 {
                let noise = Vector3::new(1.0, -1.0, 1.0) * [0.01, -0.01, 0.0][(i as usize / 20) % 3];
                let pose = Rigid3::from_parts((place(t) + noise).into(), rotation(t));
                let level = rotation_between(&(rotation(t).inverse() * believed), &Vector3::z());
                estimator.add_sweep(time(t), &pose, &level);
            }
        }
        let local_from_tracking = rotation(seconds);
        let level = estimator.level_from_tracking(&local_from_tracking).unwrap();
        (level * local_from_tracking.inverse() * lean * Vector3::z()).angle(&Vector3::z())
    }

    #[test]
    fn a_first_belief_that_leans_is_soon_corrected() {
        let leaning = Vector3::new(0.3, 0.0, 1.0);
        assert!(error_after(0.0, &leaning, false) > 0.2);
        assert!(error_after(1.5, &leaning, false) < 0.02, "{}", error_after(1.5, &leaning, false));
        assert!(error_after(4.0, &leaning, false) < 0.004, "{}", error_after(4.0, &leaning, false));
        assert!(error_after(30.0, &leaning, false) < 0.002);
    }

    #[test]
    fn gaps_only_delay_it() {
        assert!(error_after(5.0, &Vector3::z(), true) < 0.005, "{}", error_after(5.0, &Vector3::z(), true));
    }

    #[test]
    fn the_mean_over_steps_and_turns_points_up() {
        let lean = Quaternion::identity();
        let samples: Vec<ImuData> = (0..200).map(|i| sample(0.005 * f64::from(i), &lean)).collect();
        let up = rotation(0.0) * mean_acceleration(&samples).unwrap();
        let single =
            (0..200).map(|i| rotation(0.005 * f64::from(i)) * samples[i as usize].linear_acceleration);
        let worst = single.map(|up| up.angle(&Vector3::z())).fold(0.0, f64::max);
        // Not level: it speeds up.
        assert!(up.angle(&Vector3::z()) < 0.15 && worst > 0.15, "{} {worst}", up.angle(&Vector3::z()));
        assert!(mean_acceleration(&[]).is_none());
    }
}
