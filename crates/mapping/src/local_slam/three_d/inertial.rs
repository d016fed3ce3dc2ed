//! How fast it goes, from accelerations and from where sweeps matched.
//!
//! A Kalman filter of place, velocity and specific force at rest (gravity, and what the accelerometer adds to it), all
//! in the local map. From one sweep to the next the accelerometer tells how the velocity changes; then the match
//! corrects all three, but not along directions that the sweep left open. Who starts to walk among trees is seen
//! to do so by the accelerometer long before planes that its own beams made while it stood let go of it.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Time, Vector3};
use portolan_lidar_odometry::Way;
use portolan_sensor::ImuData;

use super::upright::{MAX_GAP, MOST_SAMPLES};

/// More than what any carrier does and most accelerometers measure, m/s²: such a sample is wrong.
const MOST_ACCELERATION: f64 = 200.0;
/// Standard deviations at the beginning: of velocity (m/s), and of the force at rest (m/s²) as the first second of an
/// IMU that moves or rests tells it.
const FIRST_VELOCITY_MOVING: f64 = 1.0;
const FIRST_VELOCITY_AT_REST: f64 = 0.3;
const FIRST_FORCE_MOVING: f64 = 0.3;
const FIRST_FORCE_AT_REST: f64 = 0.03;
/// How far matches are off, metres, and along open directions.
const MATCH: f64 = 0.02;
const OPEN: f64 = 30.0;
/// How far accelerations are off, m/s² averaged over a second, and how fast the force at rest changes (a bias turns with
/// its carrier), m/s² in a second. With 0.2, 0.3 and 0.5 twelve walks through parks without wheels came out alike.
const ACCELERATION: f64 = 0.3;
const FORCE_WALK: f64 = 0.02;
/// A velocity that nothing tells is believed to be about this within a second, m/s: so it ends some time.
const USUAL_SPEED: f64 = 1.5;
/// Velocity of who stands, m/s.
const STANDING: f64 = 0.01;
/// Errors of predictions are averaged over about so many sweeps. Accelerations are not followed while they predict
/// clearly worse than going on as before (so many times the mean square, m² beyond what does not matter): clocks, axes
/// or units may be wrong.
const COMPARED: f64 = 20.0;
const CLEARLY_WORSE: f64 = 2.0;
const SMALL_ERROR: f64 = 1e-4;

/// They are not followed either before velocity (m/s) and force at rest (m/s²) are known so well: at once if it began at
/// rest, after ten seconds of sweeps that tell the place if it began on the way. With 0.5 m/s², of 25 walks among trees
/// that are recorded from their middle on three were 4 to 27 m off; so two are, 2 and 8 m. With 0.5 m/s² and 2 m/s, too, two
/// (1.7 and 8 m), and of ten with all beams none was 0.4 m off, where one was 3.7 m off: too few to tell the two apart.
const SURE_VELOCITY: f64 = 0.5;
const SURE_FORCE: f64 = 0.1;

type Covariance = na::SMatrix<f64, 9, 9>;
const PLACE: usize = 0;
const VELOCITY: usize = 3;
const FORCE: usize = 6;

/// A way as accelerations tell it.
#[derive(Clone, Debug)]
pub(super) struct Felt {
    pub way: Way,
    /// At its end, m/s in the local map.
    velocity: Vector3,
}

/// What a sweep says of where it ended.
pub(super) struct Arrival<'a> {
    /// Metres, in the local map.
    pub place: Vector3,
    /// Unit vectors along which it says nothing, in the local map.
    pub open: &'a [Vector3],
    /// Covariance of what else it may be off by, m². None where the sweep fits nothing.
    pub held: Option<na::Matrix3<f64>>,
    /// Whether it stands.
    pub stands: bool,
}

/// The filter. It knows nothing before [`Inertial::begin`].
#[derive(Clone, Debug, Default)]
pub(super) struct Inertial {
    /// Since the last sweep, and the last one before.
    samples: Vec<ImuData>,
    last: Option<Time>,
    state: na::SVector<f64, 9>,
    covariance: Covariance,
    /// Mean square errors of places that accelerations and the velocity before predicted, m².
    errors: [f64; 2],
}

impl Inertial {
    /// Takes a sample, in order of time.
    pub fn add_imu(&mut self, data: &ImuData) {
        // Without sweeps nothing is integrated, and the gap is noticed.
        if self.samples.len() >= MOST_SAMPLES {
            self.samples.clear();
        }
        self.samples.push(*data);
    }

    /// Begins at the end of a sweep, with the velocity that it had and the force at rest (m/s²), both in the local map;
    /// the force as an IMU that `rests` or moves tells it.
    pub fn begin(&mut self, time: Time, [place, velocity, force]: [&Vector3; 3], rests: bool) {
        self.last = Some(time);
        self.state.fixed_rows_mut::<3>(PLACE).copy_from(place);
        self.state.fixed_rows_mut::<3>(VELOCITY).copy_from(velocity);
        self.state.fixed_rows_mut::<3>(FORCE).copy_from(force);
        let (first_velocity, first_force) = match rests {
            true => (FIRST_VELOCITY_AT_REST, FIRST_FORCE_AT_REST),
            false => (FIRST_VELOCITY_MOVING, FIRST_FORCE_MOVING),
        };
        self.covariance = Covariance::from_fn(|i, j| match (i == j, i) {
            (false, _) => 0.0,
            (true, PLACE..VELOCITY) => MATCH * MATCH,
            (true, VELOCITY..FORCE) => first_velocity * first_velocity,
            (true, _) => first_force * first_force,
        });
        self.forget_until(time);
    }

    fn part(&self, first: usize) -> Vector3 {
        self.state.fixed_rows::<3>(first).into()
    }

    /// How far off the velocity may be in any direction, m/s (standard deviation).
    pub fn velocity_error(&self) -> f64 {
        (VELOCITY..FORCE)
            .map(|i| self.covariance[(i, i)])
            .fold(0.0, f64::max)
            .sqrt()
            .min(FIRST_VELOCITY_MOVING)
    }

    /// Whether velocity and force at rest are known, and accelerations predict where it goes about as well as the velocity
    /// before does.
    pub fn is_right(&self) -> bool {
        let [felt, before] = self.errors;
        let force_error = (FORCE..9).map(|i| self.covariance[(i, i)]).fold(0.0, f64::max).sqrt();
        felt <= CLEARLY_WORSE * before + SMALL_ERROR
            && self.velocity_error() < SURE_VELOCITY
            && force_error < SURE_FORCE
    }

    /// A way that begins where the last sweep ended, turning as `predicted`, but going on as accelerations tell. None
    /// where these are not known.
    pub fn felt(&self, start: Time, predicted: &Way) -> Option<Felt> {
        let mut next = self.samples.partition_point(|s| s.time <= start);
        if self.last != Some(start) || next == 0 || predicted.seconds() <= 0.0 {
            return None;
        }
        let (at_rest, mut velocity) = (self.part(FORCE), self.part(VELOCITY));
        let mut place = predicted.start().translation.vector;
        let (mut before, mut last, mut is_known) = (0.0, None, true);
        let way = predicted.clone().changed(|seconds, pose| {
            let is_past = |s: &ImuData| s.time.seconds_since(start) <= seconds;
            while self.samples.get(next).is_some_and(is_past) {
                next += 1;
            }
            let sample = &self.samples[next - 1];
            let acceleration = pose.rotation * sample.linear_acceleration - at_rest;
            is_known &= seconds - sample.time.seconds_since(start) <= MAX_GAP;
            is_known &= acceleration.norm() <= MOST_ACCELERATION;
            let (mean, step) = (0.5 * (last.unwrap_or(acceleration) + acceleration), seconds - before);
            place += velocity * step + mean * (0.5 * step * step);
            velocity += mean * step;
            pose.translation.vector = place;
            (before, last) = (seconds, Some(acceleration));
        });
        is_known.then_some(Felt { way, velocity })
    }

    /// Goes on to the end of a sweep, which was predicted to end at `before` with the velocity before.
    pub fn follow(&mut self, end: Time, felt: &Felt, before: &Vector3, arrival: &Arrival<'_>) {
        let seconds = felt.way.seconds();
        if arrival.held.is_some() {
            self.compare(&felt.way.end().translation.vector, before, arrival);
        }
        let place = self.part(PLACE) + felt.way.shift();
        self.state.fixed_rows_mut::<3>(PLACE).copy_from(&place);
        self.state.fixed_rows_mut::<3>(VELOCITY).copy_from(&felt.velocity);
        self.spread(seconds);
        if let Some(held) = arrival.held {
            let told = na::Matrix3::from_diagonal_element(MATCH * MATCH) + held;
            let error = arrival.open.iter().fold(told, |sum, d| sum + d * d.transpose() * (OPEN * OPEN));
            self.correct(PLACE, &arrival.place, &error);
        }
        let variance = match arrival.stands {
            true => STANDING * STANDING,
            false => USUAL_SPEED * USUAL_SPEED / seconds,
        };
        self.correct(VELOCITY, &Vector3::zeros(), &na::Matrix3::from_diagonal_element(variance));
        self.last = Some(end);
        self.forget_until(end);
    }

    /// Averages how far off both predictions were in the directions that the sweep tells.
    fn compare(&mut self, felt: &Vector3, before: &Vector3, arrival: &Arrival<'_>) {
        for (error, predicted) in self.errors.iter_mut().zip([felt, before]) {
            let all = arrival.place - predicted;
            let told = arrival.open.iter().fold(all, |rest, d| rest - d * d.dot(&rest));
            *error += (told.norm_squared() - *error) / COMPARED;
        }
    }

    /// What is not known after so many more seconds.
    fn spread(&mut self, seconds: f64) {
        let mut transition = Covariance::identity();
        let mut noise = Covariance::zeros();
        let variance = ACCELERATION * ACCELERATION;
        for i in 0..3 {
            let (place, velocity, force) = (PLACE + i, VELOCITY + i, FORCE + i);
            transition[(place, velocity)] = seconds;
            transition[(place, force)] = -0.5 * seconds * seconds;
            transition[(velocity, force)] = -seconds;
            noise[(place, place)] = variance * seconds.powi(3) / 3.0;
            noise[(place, velocity)] = variance * seconds.powi(2) / 2.0;
            noise[(velocity, place)] = noise[(place, velocity)];
            noise[(velocity, velocity)] = variance * seconds;
            noise[(force, force)] = FORCE_WALK * FORCE_WALK * seconds;
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

    fn forget_until(&mut self, time: Time) {
        let after = self.samples.partition_point(|s| s.time <= time);
        self.samples.drain(..after.saturating_sub(1));
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

    /// How far off the filter is (metres, and m/s) after so many seconds, of which the sweeps from `blind` on leave the
    /// plane open.
    fn errors_after(seconds: f64, blind: f64, bias: &Vector3, scale: f64) -> (f64, f64, bool) {
        let mut inertial = Inertial::default();
        let (mut now, mut before, mut start) = (Vector3::zeros(), Vector3::zeros(), time(0.0));
        for i in 0..(200.0 * seconds) as i32 {
            let t = 0.005 * f64::from(i);
            let data = sample(t, bias);
            inertial.add_imu(&ImuData { linear_acceleration: scale * data.linear_acceleration, ..data });
            if i % 20 != 0 {
                continue;
            }
            let end = time(t);
            let way =
                Way::new(start, end, |at| Rigid3::from_parts(now.into(), turn(at.seconds_since(time(0.0)))));
            let Some(felt) = inertial.felt(start, &way) else {
                inertial.begin(end, [&place(t), &Vector3::zeros(), &GRAVITY], true);
                continue;
            };
            let (mut arrived, mut open) = (place(t), Vec::new());
            if t >= blind {
                open = vec![Vector3::x(), Vector3::y()];
                let predicted = felt.way.end().translation.vector;
                arrived = Vector3::new(predicted.x, predicted.y, arrived.z);
            }
            let held = Some(na::Matrix3::zeros());
            let arrival = Arrival { place: arrived, open: &open, held, stands: false };
            inertial.follow(end, &felt, &(2.0 * now - before), &arrival);
            (before, now, start) = (now, arrived, end);
        }
        let last = start.seconds_since(time(0.0));
        let velocity = (place(last + 1e-4) - place(last - 1e-4)) / 2e-4;
        let error = (now - place(last)).norm();
        (error, (inertial.part(VELOCITY) - velocity).norm(), inertial.is_right())
    }

    #[test]
    fn who_starts_to_walk_where_scans_tell_nothing_is_followed() {
        // Told until it walks for a tenth of a second only.
        let after = |seconds: f64| errors_after(seconds, 1.1, &Vector3::new(0.02, -0.01, 0.0), 1.0);
        let (place, velocity, is_right) = after(3.0);
        assert!(place < 0.35 && velocity < 0.25 && is_right, "{place} m, {velocity} m/s");
        // But not for ever.
        assert!(!after(8.0).2);
    }

    #[test]
    fn what_sweeps_tell_is_known_better() {
        let (place, velocity, is_right) = errors_after(8.0, 99.0, &Vector3::new(0.05, 0.0, 0.05), 1.0);
        assert!(place < 1e-9 && velocity < 0.06 && is_right, "{place} m, {velocity} m/s");
    }

    #[test]
    fn an_accelerometer_in_other_units_is_not_followed() {
        let (_, _, is_right) = errors_after(2.0, 99.0, &Vector3::zeros(), 0.102);
        assert!(!is_right);
    }

    #[test]
    fn nothing_is_felt_before_the_beginning_or_over_a_gap() {
        let mut inertial = Inertial::default();
        inertial.add_imu(&sample(0.0, &Vector3::zeros()));
        let way = Way::new(time(0.0), time(0.3), |_| Rigid3::identity());
        assert!(inertial.felt(time(0.0), &way).is_none());
        inertial.begin(time(0.0), [&Vector3::zeros(), &Vector3::zeros(), &GRAVITY], true);
        assert!(inertial.felt(time(0.0), &way).is_none());
        (1..=60).for_each(|i| inertial.add_imu(&sample(0.005 * f64::from(i), &Vector3::zeros())));
        assert!(inertial.felt(time(0.0), &way).is_some());
        inertial.samples[30].linear_acceleration.x = 1e6;
        assert!(inertial.felt(time(0.0), &way).is_none());
    }
}
