//! State of the inertial filter with its uncertainty, and their change with time and with measurements: an
//! error-state Kalman filter over pose, velocity, the biases of gyroscope and accelerometer, and gravity
//! (Solà 2017, "Quaternion kinematics for the error-state Kalman filter").
//!
//! ```text
//! a = R (f − b_a) − g,   p ← p + ∫ v dt,   v ← v + ∫ a dt,   R ← R Exp(∫ (ω − b_ω) dt)
//! ```
//!
//! with specific force f, angular velocity ω and the specific force at rest g.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{
    Duration, Quaternion, Rigid3, Time, Vector3, angle_axis_from_quaternion, quaternion_from_angle_axis,
};
use portolan_sensor::ImuData;

/// Gravity before it is estimated, m/s²: that of middle latitudes; 9.78 to 9.83 on Earth.
pub const USUAL_GRAVITY: f64 = 9.81;

const SIZE: usize = 18;

type Covariance = na::SMatrix<f64, SIZE, SIZE>;
type Matrix3 = na::Matrix3<f64>;

/// Entries of the error state, three numbers each: in the local map, except for the biases, which are in the
/// tracking frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InertialEntry {
    /// Position, metres.
    Place = 0,
    /// Velocity, m/s.
    Velocity = 3,
    /// A rotation vector in the local map, radians.
    Rotation = 6,
    /// Bias of the gyroscope, rad/s.
    Gyroscope = 9,
    /// Bias of the accelerometer, m/s².
    Accelerometer = 12,
    /// Specific force at rest that an accelerometer without bias measures, m/s².
    Force = 15,
}

use InertialEntry::{Accelerometer, Force, Gyroscope, Place, Rotation, Velocity};

/// Errors of an IMU (standard deviations).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialNoise {
    /// Noise of angular velocities: drift of the rotation within a second in addition to the bias, radians.
    pub turn: f64,
    /// Errors of scale and alignment of the gyroscope, as a fraction of the angular velocity.
    pub turn_scale: f64,
    /// Bias of the gyroscope before it is estimated, rad/s.
    pub gyroscope_bias: f64,
    /// Random walk of the bias of the gyroscope within a second, rad/s.
    pub gyroscope_walk: f64,
    /// Noise of accelerations averaged over a second, m/s².
    pub acceleration: f64,
    /// Bias of the accelerometer before it is estimated, m/s².
    pub accelerometer_bias: f64,
    /// Random walk of gravity in the local map within a second, because the local map drifts, m/s².
    pub gravity_walk: f64,
}

/// The nominal state, and the covariance of its error. The error of the rotation is a rotation vector in the local map,
/// applied after the rotation.
#[derive(Clone, Debug)]
pub struct InertialEstimate {
    /// Position, metres.
    pub place: Vector3,
    /// Velocity, m/s.
    pub velocity: Vector3,
    /// Orientation of the tracking frame in the local map.
    pub rotation: Quaternion,
    /// Bias of the gyroscope, rad/s.
    pub gyroscope_bias: Vector3,
    /// Bias of the accelerometer, m/s².
    pub accelerometer_bias: Vector3,
    /// Specific force at rest that an accelerometer without bias measures, m/s²: it points up.
    pub force_at_rest: Vector3,
    covariance: Covariance,
}

/// IMU measurements over some time, preintegrated for the covariance.
#[derive(Clone, Debug)]
pub struct Preintegrated {
    seconds: f64,
    /// The integral of the rotation, seconds.
    rotation: Matrix3,
    /// The integral of the specific force in the local map, m/s.
    force: Vector3,
    /// The integral of the squared turn rate, rad²/s.
    squared_turn_rate: f64,
}

impl Default for Preintegrated {
    fn default() -> Self {
        Self { seconds: 0.0, rotation: Matrix3::zeros(), force: Vector3::zeros(), squared_turn_rate: 0.0 }
    }
}

fn diagonal(sigma: f64) -> Matrix3 {
    Matrix3::from_diagonal_element(sigma * sigma)
}

impl InertialEstimate {
    /// Only the rotation is known (tracking in local), and the force that an accelerometer measured (m/s² in
    /// the local map). `force_sigma` is the standard deviation of its difference from the force at rest.
    pub fn first(
        rotation: Quaternion,
        (force, force_sigma): (Vector3, f64),
        gravity: f64,
        noise: &InertialNoise,
    ) -> Self {
        let up = force.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        let mut estimate = Self {
            place: Vector3::zeros(),
            velocity: Vector3::zeros(),
            rotation,
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
            force_at_rest: up * gravity,
            covariance: Covariance::zeros(),
        };
        estimate.set(Gyroscope, &diagonal(noise.gyroscope_bias));
        estimate.set(Accelerometer, &diagonal(noise.accelerometer_bias));
        // Only the accelerometer measures the direction of gravity.
        estimate.set(Force, &diagonal(gravity));
        estimate.keep_strength(gravity);
        let mut jacobian = na::SMatrix::<f64, 3, SIZE>::zeros();
        jacobian
            .fixed_view_mut::<3, 3>(0, Accelerometer as usize)
            .copy_from(rotation.to_rotation_matrix().matrix());
        jacobian.fixed_view_mut::<3, 3>(0, Force as usize).copy_from(&Matrix3::identity());
        let innovation = force - estimate.force_at_rest;
        estimate.correct_by(&jacobian, &innovation, &diagonal(force_sigma));
        estimate
    }

    /// At a pose (tracking in local) of a local map whose z axis points up, at rest up to a standard
    /// deviation in m/s. `sigmas` are the standard deviations of position, rotation and velocity.
    pub fn in_level_map(
        local_from_tracking: &Rigid3,
        sigmas: [f64; 3],
        gravity: f64,
        noise: &InertialNoise,
    ) -> Self {
        let up = Vector3::z() * gravity;
        let mut estimate = Self::first(local_from_tracking.rotation, (up, 0.0), gravity, noise);
        estimate.covariance = Covariance::zeros();
        estimate.accelerometer_bias = Vector3::zeros();
        estimate.force_at_rest = up;
        estimate.set(Gyroscope, &diagonal(noise.gyroscope_bias));
        estimate.set(Accelerometer, &diagonal(noise.accelerometer_bias));
        estimate.moved_to(local_from_tracking, Vector3::zeros(), sigmas);
        estimate
    }

    /// Continues from another pose (tracking in local) and velocity, with these standard deviations of
    /// position, rotation and velocity. Biases and gravity remain unchanged.
    pub fn moved_to(&mut self, local_from_tracking: &Rigid3, velocity: Vector3, sigmas: [f64; 3]) {
        self.place = local_from_tracking.translation.vector;
        self.rotation = local_from_tracking.rotation;
        self.velocity = velocity;
        for (entry, sigma) in [Place, Rotation, Velocity].into_iter().zip(sigmas) {
            self.forget(entry, sigma);
        }
    }

    /// Resets three entries to this standard deviation, uncorrelated with all others.
    pub fn forget(&mut self, entry: InertialEntry, sigma: f64) {
        self.covariance.fixed_rows_mut::<3>(entry as usize).fill(0.0);
        self.covariance.fixed_columns_mut::<3>(entry as usize).fill(0.0);
        self.set(entry, &diagonal(sigma));
    }

    fn set(&mut self, entry: InertialEntry, covariance: &Matrix3) {
        self.covariance.fixed_view_mut::<3, 3>(entry as usize, entry as usize).copy_from(covariance);
    }

    /// Standard deviation of three entries along the axis on which it is largest.
    pub fn sigma_of(&self, entry: InertialEntry) -> f64 {
        worst_sigma(&self.covariance_of(entry))
    }

    /// Covariance of three entries.
    pub fn covariance_of(&self, entry: InertialEntry) -> Matrix3 {
        self.covariance.fixed_view::<3, 3>(entry as usize, entry as usize).into_owned()
    }

    /// Acceleration in the local map at a sample, m/s².
    pub fn acceleration(&self, rotation: &Quaternion, sample: &ImuData) -> Vector3 {
        rotation * (sample.linear_acceleration - self.accelerometer_bias) - self.force_at_rest
    }

    /// Standard deviation of the estimated reading of the accelerometer at rest, in the worst direction,
    /// m/s².
    pub fn force_sigma(&self) -> f64 {
        let turn = self.rotation.to_rotation_matrix();
        let mixed = turn * self.covariance.fixed_view::<3, 3>(Accelerometer as usize, Force as usize);
        let bias = turn * self.covariance_of(Accelerometer) * turn.transpose();
        let sum = self.covariance_of(Force) + bias + mixed + mixed.transpose();
        worst_sigma(&sum)
    }

    /// Propagates the nominal state by some seconds, in which a sample is valid.
    pub fn advance(&mut self, sample: &ImuData, seconds: f64, measured: &mut Preintegrated) {
        let turn = (sample.angular_velocity - self.gyroscope_bias) * seconds;
        let middle = self.rotation * quaternion_from_angle_axis(&(turn * 0.5));
        let acceleration = self.acceleration(&middle, sample);
        self.place += self.velocity * seconds + acceleration * (0.5 * seconds * seconds);
        self.velocity += acceleration * seconds;
        self.rotation =
            Quaternion::new_normalize((self.rotation * quaternion_from_angle_axis(&turn)).into_inner());
        measured.seconds += seconds;
        measured.rotation += middle.to_rotation_matrix().matrix() * seconds;
        measured.force += (acceleration + self.force_at_rest) * seconds;
        measured.squared_turn_rate += turn.norm_squared() / seconds.max(1e-9);
    }

    /// Propagates the nominal state from one time to another. Samples are in order of time, and measurements
    /// are interpolated linearly between them; before the first and after the last one, these are held.
    pub fn advance_along(
        &mut self,
        samples: &[ImuData],
        (from, to): (Time, Time),
        measured: &mut Preintegrated,
    ) {
        let mut at = from;
        let mut before: Option<&ImuData> = None;
        for sample in samples.iter().filter(|sample| sample.time > from) {
            let until = sample.time.min(to);
            let middle = at + Duration::from_ticks((until - at).ticks() / 2);
            let held = before.or_else(|| samples.iter().rfind(|s| s.time <= from)).unwrap_or(sample);
            self.advance(&between(held, sample, middle), until.seconds_since(at), measured);
            (at, before) = (until, Some(sample));
            if at >= to {
                return;
            }
        }
        if let Some(last) = samples.last().filter(|_| at < to) {
            self.advance(last, to.seconds_since(at), measured);
        }
    }

    /// Propagates the covariance. The transition is that of Solà (2017, §5.4.1), integrated over all samples
    /// since the last sweep at once (Forster et al. 2017), with force and rotation taken as constant within
    /// a sweep.
    pub fn propagate(&mut self, measured: &Preintegrated, noise_scale: f64, errors: &InertialNoise) {
        let (t, a) = (measured.seconds, measured.rotation);
        let force = measured.force.cross_matrix();
        let one = Matrix3::identity();
        let mut transition = Covariance::identity();
        for (row, column, block) in [
            (Place, Velocity, one * t),
            (Place, Rotation, force * (-0.5 * t)),
            (Place, Gyroscope, force * a * (t / 6.0)),
            (Place, Accelerometer, a * (-0.5 * t)),
            (Place, Force, one * (-0.5 * t * t)),
            (Velocity, Rotation, -force),
            (Velocity, Gyroscope, force * a * 0.5),
            (Velocity, Accelerometer, -a),
            (Velocity, Force, one * -t),
            (Rotation, Gyroscope, -a),
        ] {
            transition.fixed_view_mut::<3, 3>(row as usize, column as usize).copy_from(&block);
        }
        let acceleration = noise_scale * errors.acceleration * errors.acceleration;
        let turn = errors.turn * errors.turn * t
            + errors.turn_scale * errors.turn_scale * measured.squared_turn_rate;
        let mut noise = Covariance::zeros();
        for (row, column, variance) in [
            (Place, Place, acceleration * t.powi(3) / 3.0),
            (Place, Velocity, acceleration * t * t / 2.0),
            (Velocity, Place, acceleration * t * t / 2.0),
            (Velocity, Velocity, acceleration * t),
            (Rotation, Rotation, turn),
            (Gyroscope, Gyroscope, errors.gyroscope_walk * errors.gyroscope_walk * t),
            (Force, Force, errors.gravity_walk * errors.gravity_walk * t),
        ] {
            noise.fixed_view_mut::<3, 3>(row as usize, column as usize).copy_from(&(one * variance));
        }
        self.covariance = transition * self.covariance * transition.transpose() + noise;
        self.keep_strength(self.force_at_rest.norm());
    }

    /// Corrects with a measurement of three entries with this covariance, which differs from the state by
    /// `innovation`.
    pub fn correct(&mut self, entry: InertialEntry, innovation: &Vector3, error: &Matrix3) {
        let mut jacobian = na::SMatrix::<f64, 3, SIZE>::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, entry as usize).copy_from(&Matrix3::identity());
        self.correct_by(&jacobian, innovation, error);
    }

    fn correct_by(&mut self, jacobian: &na::SMatrix<f64, 3, SIZE>, innovation: &Vector3, error: &Matrix3) {
        let seen = self.covariance * jacobian.transpose();
        let Some(inverse) = (jacobian * seen + error).try_inverse() else { return };
        let gain = seen * inverse;
        let strength = self.force_at_rest.norm();
        *self = self.plus(&(gain * innovation));
        self.covariance -= gain * seen.transpose();
        self.covariance = 0.5 * (self.covariance + self.covariance.transpose());
        self.keep_strength(strength);
    }

    /// Keeps the magnitude of gravity, which is nearly the same everywhere on Earth: its error is on a
    /// sphere (as in Xu and Zhang 2021), and the rest of the force is the bias of the accelerometer.
    fn keep_strength(&mut self, strength: f64) {
        let Some(up) = self.force_at_rest.try_normalize(1e-9) else { return };
        self.force_at_rest = up * strength;
        let mut projection = Covariance::identity();
        let tangent = Matrix3::identity() - up * up.transpose();
        projection.fixed_view_mut::<3, 3>(Force as usize, Force as usize).copy_from(&tangent);
        self.covariance = projection * self.covariance * projection;
    }

    /// The state with an error added.
    fn plus(&self, error: &na::SVector<f64, SIZE>) -> Self {
        let part = |entry: InertialEntry| -> Vector3 { error.fixed_rows::<3>(entry as usize).into() };
        let turned = quaternion_from_angle_axis(&part(Rotation)) * self.rotation;
        Self {
            place: self.place + part(Place),
            velocity: self.velocity + part(Velocity),
            rotation: Quaternion::new_normalize(turned.into_inner()),
            gyroscope_bias: self.gyroscope_bias + part(Gyroscope),
            accelerometer_bias: self.accelerometer_bias + part(Accelerometer),
            force_at_rest: self.force_at_rest + part(Force),
            covariance: self.covariance,
        }
    }

    /// Error that, added to another state, gives this one.
    #[cfg(test)]
    fn minus(&self, other: &Self) -> na::SVector<f64, SIZE> {
        let mut error = na::SVector::<f64, SIZE>::zeros();
        for (entry, part) in [
            (Place, self.place - other.place),
            (Velocity, self.velocity - other.velocity),
            (Rotation, -self.rotation_to(&other.rotation)),
            (Gyroscope, self.gyroscope_bias - other.gyroscope_bias),
            (Accelerometer, self.accelerometer_bias - other.accelerometer_bias),
            (Force, self.force_at_rest - other.force_at_rest),
        ] {
            error.fixed_rows_mut::<3>(entry as usize).copy_from(&part);
        }
        error
    }

    /// Rotation to another orientation, as a rotation vector in the local map.
    pub fn rotation_to(&self, other: &Quaternion) -> Vector3 {
        angle_axis_from_quaternion(&(other * self.rotation.inverse()))
    }
}

/// IMU measurement interpolated between two samples.
fn between(before: &ImuData, after: &ImuData, time: Time) -> ImuData {
    let span = after.time.seconds_since(before.time).max(1e-9);
    let fraction = (time.seconds_since(before.time) / span).clamp(0.0, 1.0);
    ImuData {
        time,
        linear_acceleration: before.linear_acceleration.lerp(&after.linear_acceleration, fraction),
        angular_velocity: before.angular_velocity.lerp(&after.angular_velocity, fraction),
    }
}

/// Standard deviation along the axis on which it is largest.
fn worst_sigma(covariance: &Matrix3) -> f64 {
    covariance.diagonal().max().max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRAVITY: f64 = USUAL_GRAVITY;
    const SILENT: InertialNoise = InertialNoise {
        turn: 0.0,
        turn_scale: 0.0,
        gyroscope_bias: 0.02,
        gyroscope_walk: 0.0,
        acceleration: 0.0,
        accelerometer_bias: 0.1,
        gravity_walk: 0.0,
    };

    /// A platform that accelerates, sways and turns.
    fn sample(t: f64) -> ImuData {
        ImuData {
            time: Time::from_ticks(0),
            linear_acceleration: Vector3::new(1.5, 0.3 * (11.0 * t).sin(), GRAVITY + 2.0 * (11.0 * t).cos()),
            angular_velocity: Vector3::new(0.3 * (6.0 * t).cos(), 0.1, 0.2),
        }
    }

    /// The transition of the covariance agrees with the propagation of small errors.
    #[test]
    fn the_covariance_propagates_like_small_errors() {
        let rotation = quaternion_from_angle_axis(&Vector3::new(0.05, -0.1, 0.4));
        let first = InertialEstimate::first(rotation, (Vector3::z() * GRAVITY, 0.1), GRAVITY, &SILENT);
        let go = |estimate: &InertialEstimate| {
            let (mut estimate, mut measured) = (estimate.clone(), Preintegrated::default());
            (0..50).for_each(|i| estimate.advance(&sample(0.002 * f64::from(i)), 0.002, &mut measured));
            (estimate, measured)
        };
        let (end, measured) = go(&first);
        for entry in 0..SIZE {
            let step = 1e-4;
            let mut error = na::SVector::<f64, SIZE>::zeros();
            error[entry] = step;
            let moved = go(&first.plus(&error)).0;
            let mut numeric = end.minus(&moved) / -step;
            // The error of gravity has only two degrees of freedom.
            numeric[SIZE - 1] = 0.0;
            let mut only = first.clone();
            only.covariance = Covariance::zeros();
            only.covariance[(entry, entry)] = 1.0;
            only.propagate(&measured, 1.0, &SILENT);
            let expected = numeric * numeric.transpose();
            let difference = (only.covariance - expected).abs().max();
            assert!(difference < 2e-3, "{entry}: {difference}");
        }
    }
}
