//! The inertial Kalman filter: position, velocity and specific force at rest (gravity and accelerometer bias), all in the
//! local map.
//!
//! From one sweep to the next the accelerometer changes the velocity,
//!
//! ```text
//! a = R f − f₀,   v ← v + ∫ a dt,   p ← p + ∫ v dt
//! ```
//!
//! with the specific force f, its value at rest f₀ and the orientation R from the prediction; then the registered pose
//! corrects all three (Kalman 1960), but not along degenerate directions. A platform that starts to move among trees is
//! followed by the accelerometer long before planes that its own beams drew while it stood let go of it.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Time, Vector3};
use portolan_sensor::ImuData;

use crate::imu_buffer::ImuBuffer;
use crate::segment::TrajectorySegment;
use crate::settings::{ImuSettings, InertialSettings};

type Covariance = na::SMatrix<f64, 9, 9>;
const PLACE: usize = 0;
const VELOCITY: usize = 3;
const FORCE: usize = 6;

/// A trajectory segment whose translation the accelerometer predicts.
#[derive(Clone, Debug)]
pub(crate) struct InertialPrediction {
    pub segment: TrajectorySegment,
    /// At its end, m/s in the local map.
    velocity: Vector3,
}

/// What the filter begins with.
pub(crate) struct InertialStart {
    /// Metres, in the local map.
    pub place: Vector3,
    /// m/s, in the local map.
    pub velocity: Vector3,
    /// m/s², in the local map.
    pub force_at_rest: Vector3,
    /// Whether the IMU is at rest, or moves.
    pub is_at_rest: bool,
}

/// What a registered sweep says of the place of its end.
pub(crate) struct PlaceMeasurement<'a> {
    /// Metres, in the local map.
    pub place: Vector3,
    /// Unit vectors along which it says nothing, in the local map.
    pub degenerate: &'a [Vector3],
    /// Covariance of what attenuation may keep it off by, m². None where the sweep fits nothing.
    pub attenuation: Option<na::Matrix3<f64>>,
    /// Whether the platform stands.
    pub is_standing: bool,
}

/// The filter. It knows nothing before [`InertialFilter::begin`].
#[derive(Clone, Debug)]
pub(crate) struct InertialFilter {
    settings: InertialSettings,
    imu: ImuSettings,
    samples: ImuBuffer,
    last: Option<Time>,
    state: na::SVector<f64, 9>,
    covariance: Covariance,
    /// Mean square errors of places that the accelerometer and constant velocity predicted, m².
    errors: [f64; 2],
}

impl InertialFilter {
    pub fn new(settings: &InertialSettings, imu: &ImuSettings) -> Self {
        Self {
            settings: settings.clone(),
            imu: imu.clone(),
            samples: ImuBuffer::default(),
            last: None,
            state: na::SVector::zeros(),
            covariance: Covariance::zeros(),
            errors: [0.0; 2],
        }
    }

    /// Takes a sample, in order of time.
    pub fn add_imu(&mut self, data: &ImuData) {
        self.samples.push(data, self.imu.max_samples);
    }

    /// Begins at the end of a sweep.
    pub fn begin(&mut self, time: Time, start: &InertialStart) {
        let settings = &self.settings;
        self.last = Some(time);
        self.state.fixed_rows_mut::<3>(PLACE).copy_from(&start.place);
        self.state.fixed_rows_mut::<3>(VELOCITY).copy_from(&start.velocity);
        self.state.fixed_rows_mut::<3>(FORCE).copy_from(&start.force_at_rest);
        let (first_velocity, first_force) = match start.is_at_rest {
            true => (settings.first_velocity_at_rest, settings.first_force_at_rest),
            false => (settings.first_velocity_moving, settings.first_force_moving),
        };
        let match_error = settings.match_error;
        self.covariance = Covariance::from_fn(|i, j| match (i == j, i) {
            (false, _) => 0.0,
            (true, PLACE..VELOCITY) => match_error * match_error,
            (true, VELOCITY..FORCE) => first_velocity * first_velocity,
            (true, _) => first_force * first_force,
        });
        self.samples.forget_until(time);
    }

    fn part(&self, first: usize) -> Vector3 {
        self.state.fixed_rows::<3>(first).into()
    }

    /// Standard deviation of the velocity in its worst direction, m/s.
    pub fn velocity_sigma(&self) -> f64 {
        (VELOCITY..FORCE)
            .map(|i| self.covariance[(i, i)])
            .fold(0.0, f64::max)
            .sqrt()
            .min(self.settings.first_velocity_moving)
    }

    /// Whether velocity and force at rest are known, and the accelerometer predicts about as well as constant velocity.
    pub fn is_reliable(&self) -> bool {
        let settings = &self.settings;
        let [inertial, constant_velocity] = self.errors;
        let force_sigma = (FORCE..9).map(|i| self.covariance[(i, i)]).fold(0.0, f64::max).sqrt();
        inertial <= settings.clearly_worse * constant_velocity + settings.small_error
            && self.velocity_sigma() < settings.sure_velocity
            && force_sigma < settings.sure_force
    }

    /// A segment that begins where the last sweep ended, with the rotations of `predicted`, and with the translation that
    /// accelerations give. None where these are not known.
    pub fn predict(&self, start: Time, predicted: &TrajectorySegment) -> Option<InertialPrediction> {
        let mut next = self.samples.count_until(start);
        if self.last != Some(start) || next == 0 || predicted.seconds() <= 0.0 {
            return None;
        }
        let samples = self.samples.all();
        let (at_rest, mut velocity) = (self.part(FORCE), self.part(VELOCITY));
        let mut place = predicted.start().translation.vector;
        let (mut before, mut last, mut is_known) = (0.0, None, true);
        let segment = predicted.clone().changed(|seconds, pose| {
            let is_past = |s: &ImuData| s.time.seconds_since(start) <= seconds;
            while samples.get(next).is_some_and(is_past) {
                next += 1;
            }
            let sample = &samples[next - 1];
            let acceleration = pose.rotation * sample.linear_acceleration - at_rest;
            is_known &= seconds - sample.time.seconds_since(start) <= self.imu.max_gap;
            is_known &= acceleration.norm() <= self.settings.max_acceleration;
            let (mean, step) = (0.5 * (last.unwrap_or(acceleration) + acceleration), seconds - before);
            place += velocity * step + mean * (0.5 * step * step);
            velocity += mean * step;
            pose.translation.vector = place;
            (before, last) = (seconds, Some(acceleration));
        });
        is_known.then_some(InertialPrediction { segment, velocity })
    }

    /// Goes on to the end of a sweep, which constant velocity predicted to end at `by_constant_velocity`: prediction,
    /// correction by the registered place, correction by what velocities are like.
    pub fn update(
        &mut self,
        end: Time,
        prediction: &InertialPrediction,
        by_constant_velocity: &Vector3,
        measured: &PlaceMeasurement<'_>,
    ) {
        let seconds = prediction.segment.seconds();
        if measured.attenuation.is_some() {
            let predicted = prediction.segment.end().translation.vector;
            self.compare(&predicted, by_constant_velocity, measured);
        }
        let place = self.part(PLACE) + prediction.segment.translation();
        self.state.fixed_rows_mut::<3>(PLACE).copy_from(&place);
        self.state.fixed_rows_mut::<3>(VELOCITY).copy_from(&prediction.velocity);
        self.propagate_covariance(seconds);
        let settings = &self.settings;
        let variance = match measured.is_standing {
            true => settings.standing_velocity * settings.standing_velocity,
            false => settings.usual_speed * settings.usual_speed / seconds,
        };
        let (match_error, unknown) = (settings.match_error, settings.degenerate_error);
        if let Some(attenuation) = measured.attenuation {
            let known = na::Matrix3::from_diagonal_element(match_error * match_error) + attenuation;
            let error = measured
                .degenerate
                .iter()
                .fold(known, |sum, d| sum + d * d.transpose() * (unknown * unknown));
            self.correct(PLACE, &measured.place, &error);
        }
        self.correct(VELOCITY, &Vector3::zeros(), &na::Matrix3::from_diagonal_element(variance));
        self.last = Some(end);
        self.samples.forget_until(end);
    }

    /// Averages how far off both predictions were in the directions that the sweep constrains.
    fn compare(&mut self, inertial: &Vector3, constant_velocity: &Vector3, measured: &PlaceMeasurement<'_>) {
        for (error, predicted) in self.errors.iter_mut().zip([inertial, constant_velocity]) {
            let all = measured.place - predicted;
            let constrained = measured.degenerate.iter().fold(all, |rest, d| rest - d * d.dot(&rest));
            *error += (constrained.norm_squared() - *error) / self.settings.compared_sweeps;
        }
    }

    /// The covariance after so many more seconds: white noise of acceleration, and a random walk of the force at rest.
    fn propagate_covariance(&mut self, seconds: f64) {
        let mut transition = Covariance::identity();
        let mut noise = Covariance::zeros();
        let variance = self.settings.acceleration_noise * self.settings.acceleration_noise;
        let force_walk = self.settings.force_walk;
        for i in 0..3 {
            let (place, velocity, force) = (PLACE + i, VELOCITY + i, FORCE + i);
            transition[(place, velocity)] = seconds;
            transition[(place, force)] = -0.5 * seconds * seconds;
            transition[(velocity, force)] = -seconds;
            noise[(place, place)] = variance * seconds.powi(3) / 3.0;
            noise[(place, velocity)] = variance * seconds.powi(2) / 2.0;
            noise[(velocity, place)] = noise[(place, velocity)];
            noise[(velocity, velocity)] = variance * seconds;
            noise[(force, force)] = force_walk * force_walk * seconds;
        }
        self.covariance = transition * self.covariance * transition.transpose() + noise;
    }

    /// Three entries from `first` on were measured with this covariance.
    fn correct(&mut self, first: usize, measured: &Vector3, error: &na::Matrix3<f64>) {
        let innovation = measured - self.part(first);
        let predicted = self.covariance.fixed_view::<3, 3>(first, first) + error;
        let Some(inverse) = predicted.try_inverse() else { return };
        let gain = self.covariance.fixed_view::<9, 3>(0, first) * inverse;
        self.state += gain * innovation;
        self.covariance -= gain * self.covariance.fixed_view::<3, 9>(first, 0).into_owned();
        self.covariance = 0.5 * (self.covariance + self.covariance.transpose());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Duration, Quaternion, Rigid3, quaternion_from_angle_axis};

    const GRAVITY: Vector3 = Vector3::new(0.0, 0.0, 9.81);

    fn time(seconds: f64) -> Time {
        Time::from_ticks(0) + Duration::from_seconds(seconds)
    }

    /// It stands for a second, then speeds up to 1.5 m/s within another one, and walks on with gait, turning.
    fn place(t: f64) -> Vector3 {
        let since = (t - 1.0).max(0.0);
        let way = if since < 1.0 { 0.75 * since * since } else { 0.75 + 1.5 * (since - 1.0) };
        Vector3::new(way, 0.0, 0.02 * (1.0 - (11.0 * since).cos()))
    }

    fn turn(t: f64) -> Quaternion {
        quaternion_from_angle_axis(&Vector3::new(0.05 * (6.0 * t).sin(), 0.0, 0.2 * t))
    }

    fn sample(t: f64, bias: &Vector3) -> ImuData {
        let h = 1e-4;
        let acceleration = (place(t + h) - 2.0 * place(t) + place(t - h)) / (h * h);
        ImuData {
            time: time(t),
            linear_acceleration: turn(t).inverse() * (acceleration + GRAVITY) + bias,
            angular_velocity: Vector3::zeros(),
        }
    }

    fn at_rest(place: Vector3) -> InertialStart {
        InertialStart { place, velocity: Vector3::zeros(), force_at_rest: GRAVITY, is_at_rest: true }
    }

    /// How far off the filter is (metres, and m/s) after so many seconds, of which the sweeps from `blind` on leave the
    /// plane open.
    fn errors_after(seconds: f64, blind: f64, bias: &Vector3, scale: f64) -> (f64, f64, bool) {
        let mut inertial = InertialFilter::new(&InertialSettings::default(), &ImuSettings::default());
        let (mut now, mut before, mut start) = (Vector3::zeros(), Vector3::zeros(), time(0.0));
        for i in 0..(200.0 * seconds) as i32 {
            let t = 0.005 * f64::from(i);
            let data = sample(t, bias);
            inertial.add_imu(&ImuData { linear_acceleration: scale * data.linear_acceleration, ..data });
            if i % 20 != 0 {
                continue;
            }
            let end = time(t);
            let segment = TrajectorySegment::new(start, end, |at| {
                Rigid3::from_parts(now.into(), turn(at.seconds_since(time(0.0))))
            });
            let Some(prediction) = inertial.predict(start, &segment) else {
                inertial.begin(end, &at_rest(place(t)));
                continue;
            };
            let (mut arrived, mut degenerate) = (place(t), Vec::new());
            if t >= blind {
                degenerate = vec![Vector3::x(), Vector3::y()];
                let predicted = prediction.segment.end().translation.vector;
                arrived = Vector3::new(predicted.x, predicted.y, arrived.z);
            }
            let measured = PlaceMeasurement {
                place: arrived,
                degenerate: &degenerate,
                attenuation: Some(na::Matrix3::zeros()),
                is_standing: false,
            };
            inertial.update(end, &prediction, &(2.0 * now - before), &measured);
            (before, now, start) = (now, arrived, end);
        }
        let last = start.seconds_since(time(0.0));
        let velocity = (place(last + 1e-4) - place(last - 1e-4)) / 2e-4;
        let error = (now - place(last)).norm();
        (error, (inertial.part(VELOCITY) - velocity).norm(), inertial.is_reliable())
    }

    #[test]
    fn who_starts_to_walk_where_scans_tell_nothing_is_followed() {
        // Told until it walks for a tenth of a second only.
        let after = |seconds: f64| errors_after(seconds, 1.1, &Vector3::new(0.02, -0.01, 0.0), 1.0);
        let (place, velocity, is_reliable) = after(3.0);
        assert!(place < 0.35 && velocity < 0.25 && is_reliable, "{place} m, {velocity} m/s");
        // But not for ever.
        assert!(!after(8.0).2);
    }

    #[test]
    fn what_sweeps_tell_is_known_better() {
        let (place, velocity, is_reliable) = errors_after(8.0, 99.0, &Vector3::new(0.05, 0.0, 0.05), 1.0);
        assert!(place < 1e-9 && velocity < 0.06 && is_reliable, "{place} m, {velocity} m/s");
    }

    #[test]
    fn an_accelerometer_in_other_units_is_not_followed() {
        let (_, _, is_reliable) = errors_after(2.0, 99.0, &Vector3::zeros(), 0.102);
        assert!(!is_reliable);
    }

    /// Whether 0.3 s at rest are predicted if a sample is wrong by so much, m/s²; with and without samples after the first.
    fn predicts(wrong: f64, has_samples: bool) -> bool {
        let mut inertial = InertialFilter::new(&InertialSettings::default(), &ImuSettings::default());
        inertial.add_imu(&sample(0.0, &Vector3::zeros()));
        let segment = TrajectorySegment::new(time(0.0), time(0.3), |_| Rigid3::identity());
        assert!(inertial.predict(time(0.0), &segment).is_none(), "not begun");
        inertial.begin(time(0.0), &at_rest(Vector3::zeros()));
        for i in 1..=60 {
            let mut sample = sample(0.005 * f64::from(i), &Vector3::zeros());
            sample.linear_acceleration.x += if i == 30 { wrong } else { 0.0 };
            if has_samples {
                inertial.add_imu(&sample);
            }
        }
        inertial.predict(time(0.0), &segment).is_some()
    }

    #[test]
    fn nothing_is_predicted_over_a_gap_or_a_wrong_sample() {
        assert!(predicts(0.0, true));
        assert!(!predicts(0.0, false) && !predicts(1e6, true));
    }
}
