use portolan_geometry::{Duration, quaternion_from_angle_axis};

use super::*;

const GRAVITY: f64 = USUAL_GRAVITY;

fn time(seconds: f64) -> Time {
    Time::from_ticks(0) + Duration::from_seconds(seconds)
}

/// A simulated walker, and the errors of the IMU.
#[derive(Clone)]
struct Walk {
    /// Time at which the walker starts, seconds.
    starts_at: f64,
    /// Tilt of the local map.
    tilt: Quaternion,
    accelerometer_bias: Vector3,
    gyroscope_bias: Vector3,
    /// Scale factor of accelerations.
    scale: f64,
}

impl Default for Walk {
    fn default() -> Self {
        let (accelerometer_bias, gyroscope_bias) = (Vector3::zeros(), Vector3::zeros());
        Self { starts_at: 0.0, tilt: Quaternion::identity(), accelerometer_bias, gyroscope_bias, scale: 1.0 }
    }
}

impl Walk {
    /// The walker accelerates to 1.5 m/s within a second, and walks on with gait, turning.
    fn pose(&self, t: f64) -> Rigid3 {
        let since = (t - self.starts_at).max(0.0);
        let travelled = if since < 1.0 { 0.75 * since * since } else { 0.75 + 1.5 * (since - 1.0) };
        let place = Vector3::new(travelled, 0.0, 0.02 * (1.0 - (11.0 * since).cos()));
        let turn = quaternion_from_angle_axis(&Vector3::new(0.05 * (6.0 * since).sin(), 0.0, 0.2 * since));
        Rigid3::from_parts(place.into(), turn)
    }

    fn velocity(&self, t: f64) -> Vector3 {
        let h = 1e-4;
        (self.pose(t + h).translation.vector - self.pose(t - h).translation.vector) / (2.0 * h)
    }

    fn sample(&self, t: f64) -> ImuData {
        let h = 1e-4;
        let place = |t: f64| self.pose(t).translation.vector;
        let acceleration = (place(t + h) - 2.0 * place(t) + place(t - h)) / (h * h);
        let turn = self.pose(t).rotation;
        let force = acceleration + self.tilt * Vector3::z() * GRAVITY;
        let turned = turn.inverse() * self.pose(t + h).rotation;
        ImuData {
            time: time(t),
            linear_acceleration: (turn.inverse() * force + self.accelerometer_bias) * self.scale,
            angular_velocity: turned.scaled_axis() / h + self.gyroscope_bias,
        }
    }

    fn start(&self, is_at_rest: bool) -> InertialStart {
        InertialStart {
            local_from_tracking: self.pose(0.0),
            velocity: self.velocity(0.0),
            force_at_rest: is_at_rest.then(|| (GRAVITY + self.accelerometer_bias.z) * self.scale),
        }
    }
}

/// Which sweeps and samples are missing or degenerate.
#[derive(Clone, Copy)]
struct Sweeps {
    seconds: f64,
    /// Time from which on sweeps do not constrain the horizontal plane.
    blind_from: f64,
    /// Times between which no samples come.
    gap: (f64, f64),
    /// Metres.
    noise: f64,
}

impl Default for Sweeps {
    fn default() -> Self {
        Self { seconds: 8.0, blind_from: f64::MAX, gap: (0.0, 0.0), noise: 0.0 }
    }
}

/// The filter after sweeps, ten a second, started with `up`; with the final time and position.
fn after(walk: &Walk, sweeps: Sweeps, up: &Vector3, is_at_rest: bool) -> (InertialFilter, f64, Vector3) {
    let mut inertial = InertialFilter::new(&OdometrySettings::default());
    let (mut now, mut start) = (walk.pose(0.0), 0.0);
    for i in 0..(200.0 * sweeps.seconds) as i32 {
        let t = 0.005 * f64::from(i);
        if !(sweeps.gap.0..sweeps.gap.1).contains(&t) {
            inertial.add_imu(&walk.sample(t));
        }
        if i == 0 {
            inertial.begin(time(t), &walk.start(is_at_rest), up);
        }
        if i % 20 != 0 || i == 0 {
            continue;
        }
        let segment = TrajectorySegment::new(time(start), time(t), |_| now);
        let prediction = inertial.predict(time(start), &segment);
        now = walk.pose(t);
        now.translation.vector += Vector3::new(1.0, -1.0, 1.0) * (sweeps.noise * f64::from(i / 20 % 3 - 1));
        start = t;
        let Some(prediction) = prediction else {
            let velocity = walk.velocity(t);
            let start = InertialStart { local_from_tracking: now, velocity, force_at_rest: None };
            inertial.restart(time(t), &start);
            continue;
        };
        let mut degenerate = DegenerateDirections::default();
        if t >= sweeps.blind_from {
            degenerate.translations = vec![Vector3::x(), Vector3::y()];
            let predicted = prediction.segment.end().translation.vector;
            now.translation.vector = Vector3::new(predicted.x, predicted.y, now.translation.vector.z);
        }
        let measured = PoseMeasurement {
            local_from_tracking: &now,
            degenerate: &degenerate,
            attenuation: Some(na::Matrix3::zeros()),
            measures_rotation: true,
            gyroscope_holds: true,
            is_standing: false,
        };
        inertial.update(time(t), &prediction, &measured);
    }
    (inertial, start, now.translation.vector)
}

fn velocity_error(inertial: &InertialFilter, walk: &Walk, t: f64) -> f64 {
    (inertial.estimate.as_ref().unwrap().velocity - walk.velocity(t)).norm()
}

#[test]
fn a_start_of_motion_in_degenerate_scans_is_tracked() {
    let accelerometer_bias = Vector3::new(0.02, -0.01, 0.0);
    let walk = Walk { starts_at: 1.0, accelerometer_bias, ..Walk::default() };
    // Poses are measured only until a tenth of a second after it starts to walk.
    let ended =
        |seconds| after(&walk, Sweeps { seconds, blind_from: 1.1, ..Sweeps::default() }, &Vector3::z(), true);
    let (inertial, end, place) = ended(3.0);
    let error = (place - walk.pose(end).translation.vector).norm();
    let velocity = velocity_error(&inertial, &walk, end);
    assert!(error < 0.35 && velocity < 0.25 && inertial.is_reliable(), "{error} m, {velocity} m/s");
    // But not indefinitely.
    assert!(!ended(8.0).0.is_reliable());
}

#[test]
fn registered_sweeps_improve_the_velocity() {
    let accelerometer_bias = Vector3::new(0.05, 0.0, 0.05);
    let walk = Walk { starts_at: 1.0, accelerometer_bias, ..Walk::default() };
    let (inertial, end, _) = after(&walk, Sweeps::default(), &Vector3::z(), true);
    let velocity = velocity_error(&inertial, &walk, end);
    assert!(velocity < 0.06 && inertial.is_reliable(), "{velocity} m/s");
}

#[test]
fn an_accelerometer_in_other_units_is_not_followed() {
    let walk = Walk { scale: 0.102, ..Walk::default() };
    for is_at_rest in [true, false] {
        let (inertial, ..) = after(&walk, Sweeps::default(), &Vector3::z(), is_at_rest);
        assert!(!inertial.is_reliable());
        // Nor does it measure the vertical.
        let up = inertial.level_from_tracking(&Quaternion::identity()).unwrap() * Vector3::z();
        assert!(up.angle(&Vector3::z()) < 0.02, "{is_at_rest}: {up}");
    }
}

#[test]
fn the_bias_of_a_gyroscope_is_learned_within_seconds() {
    let gyroscope_bias = Vector3::new(0.02, -0.01, 0.03);
    let walk = Walk { gyroscope_bias, ..Walk::default() };
    let error = |seconds: f64| {
        let sweeps = Sweeps { seconds, ..Sweeps::default() };
        let (inertial, ..) = after(&walk, sweeps, &Vector3::z(), false);
        let rest = inertial.corrected(&walk.sample(seconds)).angular_velocity
            - (walk.sample(seconds).angular_velocity - gyroscope_bias);
        rest.norm()
    };
    assert!(error(2.0) < 0.005 && error(10.0) < 0.001, "{} {}", error(2.0), error(10.0));
}

#[test]
fn a_turn_rate_too_large_for_a_bias_is_not_learned() {
    let gyroscope_bias = Vector3::new(0.0, 0.0, 0.6);
    let walk = Walk { gyroscope_bias, ..Walk::default() };
    let (inertial, ..) = after(&walk, Sweeps::default(), &Vector3::z(), false);
    assert!(inertial.estimate.unwrap().gyroscope_bias.norm() < 0.02);
}

/// Error of the vertical after this time, seconds, in radians, with initial accelerations along
/// `assumed`.
fn tilt_after(seconds: f64, assumed: &Vector3, gap: (f64, f64)) -> f64 {
    let tilt = quaternion_from_angle_axis(&Vector3::new(0.1, 0.0, 0.0));
    let walk = Walk { tilt, ..Walk::default() };
    let sweeps = Sweeps { seconds, gap, noise: 0.01, ..Sweeps::default() };
    let (inertial, ..) = after(&walk, sweeps, &assumed.normalize(), false);
    let level = inertial.level_from_tracking(&Quaternion::identity()).unwrap();
    (level * tilt * Vector3::z()).angle(&Vector3::z())
}

#[test]
fn a_tilted_initial_vertical_is_soon_corrected() {
    let tilted = Vector3::new(0.3, 0.0, 1.0);
    let after = |seconds| tilt_after(seconds, &tilted, (0.0, 0.0));
    let errors = [0.1, 1.5, 4.0, 30.0].map(after);
    assert!(errors[0] > 0.2 && errors[1] < 0.02 && errors[2] < 0.006 && errors[3] < 0.003, "{errors:?}");
}

#[test]
fn the_vertical_is_corrected_after_a_gap() {
    let error = tilt_after(5.0, &Vector3::z(), (0.5, 1.5));
    assert!(error < 0.006, "{error}");
}

/// Whether 0.3 s at rest are predicted if a sample has this error, m/s²; with and without samples after
/// the first.
fn predicts(wrong: f64, has_samples: bool) -> bool {
    let walk = Walk { starts_at: 9.0, ..Walk::default() };
    let mut inertial = InertialFilter::new(&OdometrySettings::default());
    inertial.add_imu(&walk.sample(0.0));
    let segment = TrajectorySegment::new(time(0.0), time(0.3), |_| Rigid3::identity());
    assert!(inertial.predict(time(0.0), &segment).is_none(), "not begun");
    inertial.begin(time(0.0), &walk.start(true), &Vector3::z());
    for i in 1..=60 {
        let mut sample = walk.sample(0.005 * f64::from(i));
        sample.linear_acceleration.x += if i == 30 { wrong } else { 0.0 };
        if has_samples {
            inertial.add_imu(&sample);
        }
    }
    inertial.predict(time(0.0), &segment).is_some()
}

#[test]
fn gaps_and_wrong_samples_prevent_predictions() {
    assert!(predicts(0.0, true));
    assert!(!predicts(0.0, false) && !predicts(1e6, true));
}
