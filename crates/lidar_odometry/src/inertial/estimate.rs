//! What the inertial filter knows, how sure it is of that, and how both change with time and with measurements.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{
    Quaternion, Rigid3, Vector3, angle_axis_from_quaternion, quaternion_from_angle_axis,
};
use portolan_sensor::ImuData;

use crate::settings::{GyroscopeSettings, InertialSettings};

/// Entries of the error state: each three, in the local map but for the biases, which are in the tracking frame.
pub(super) const PLACE: usize = 0;
pub(super) const VELOCITY: usize = 3;
pub(super) const ROTATION: usize = 6;
const GYROSCOPE: usize = 9;
const ACCELEROMETER: usize = 12;
const FORCE: usize = 15;
const SIZE: usize = 18;

pub(super) type Covariance = na::SMatrix<f64, SIZE, SIZE>;
type Matrix3 = na::Matrix3<f64>;

/// The nominal state, and the covariance of its error. The error of the rotation is a rotation vector in the local map,
/// applied after the rotation.
#[derive(Clone, Debug)]
pub(super) struct Estimate {
    /// Metres.
    pub place: Vector3,
    /// m/s.
    pub velocity: Vector3,
    /// Tracking in local.
    pub rotation: Quaternion,
    /// rad/s.
    pub gyroscope_bias: Vector3,
    /// m/s².
    pub accelerometer_bias: Vector3,
    /// What an accelerometer without bias measures at rest, m/s²: it points up.
    pub force_at_rest: Vector3,
    pub covariance: Covariance,
}

/// What an IMU measured over some time, as the covariance needs it.
#[derive(Clone, Debug)]
pub(super) struct Preintegrated {
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

impl Estimate {
    /// Nothing but the rotation (tracking in local), and the force that an accelerometer measured (m/s² in the local map), which
    /// is that at rest but for so much.
    pub fn first(
        rotation: Quaternion,
        (force, force_sigma): (Vector3, f64),
        gravity: f64,
        settings: &InertialSettings,
        gyroscope: &GyroscopeSettings,
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
        estimate.set(GYROSCOPE, &diagonal(gyroscope.bias));
        estimate.set(ACCELEROMETER, &diagonal(settings.accelerometer_bias));
        // Where gravity points to the accelerometer alone tells.
        estimate.set(FORCE, &diagonal(gravity));
        estimate.keep_strength(gravity);
        let mut jacobian = na::SMatrix::<f64, 3, SIZE>::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, ACCELEROMETER).copy_from(rotation.to_rotation_matrix().matrix());
        jacobian.fixed_view_mut::<3, 3>(0, FORCE).copy_from(&Matrix3::identity());
        let innovation = force - estimate.force_at_rest;
        estimate.correct_by(&jacobian, &innovation, &diagonal(force_sigma));
        estimate
    }

    /// Goes on from another pose (tracking in local) and velocity, of which place, rotation and velocity are known so well.
    /// Biases and gravity remain what they are.
    pub fn moved_to(&mut self, local_from_tracking: &Rigid3, velocity: Vector3, sigmas: [f64; 3]) {
        self.place = local_from_tracking.translation.vector;
        self.rotation = local_from_tracking.rotation;
        self.velocity = velocity;
        for (entry, sigma) in [PLACE, ROTATION, VELOCITY].into_iter().zip(sigmas) {
            self.forget(entry, sigma);
        }
    }

    /// Nothing told of three entries any more: they are off by so much, whatever else is.
    pub fn forget(&mut self, entry: usize, sigma: f64) {
        self.covariance.fixed_rows_mut::<3>(entry).fill(0.0);
        self.covariance.fixed_columns_mut::<3>(entry).fill(0.0);
        self.set(entry, &diagonal(sigma));
    }

    fn set(&mut self, entry: usize, covariance: &Matrix3) {
        self.covariance.fixed_view_mut::<3, 3>(entry, entry).copy_from(covariance);
    }

    /// Covariance of three entries.
    pub fn covariance_of(&self, entry: usize) -> Matrix3 {
        self.covariance.fixed_view::<3, 3>(entry, entry).into_owned()
    }

    /// The acceleration in the local map at a sample, m/s².
    pub fn acceleration(&self, rotation: &Quaternion, sample: &ImuData) -> Vector3 {
        rotation * (sample.linear_acceleration - self.accelerometer_bias) - self.force_at_rest
    }

    /// Standard deviation of what the accelerometer is believed to measure at rest, in the worst direction, m/s².
    pub fn force_sigma(&self) -> f64 {
        let turn = self.rotation.to_rotation_matrix();
        let mixed = turn * self.covariance.fixed_view::<3, 3>(ACCELEROMETER, FORCE);
        let bias = turn * self.covariance_of(ACCELEROMETER) * turn.transpose();
        let sum = self.covariance_of(FORCE) + bias + mixed + mixed.transpose();
        worst_sigma(&sum)
    }

    /// Moves the nominal state on by some seconds, in which a sample holds.
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

    /// Moves the covariance on. The transition is that of Solà (2017, §5.4.1), integrated over all samples since the last sweep
    /// at once (Forster et al. 2017) with force and rotation as even as they are within a sweep.
    pub fn propagate(
        &mut self,
        measured: &Preintegrated,
        noise_scale: f64,
        settings: &InertialSettings,
        gyroscope: &GyroscopeSettings,
    ) {
        let (t, a) = (measured.seconds, measured.rotation);
        let force = measured.force.cross_matrix();
        let one = Matrix3::identity();
        let mut transition = Covariance::identity();
        for (row, column, block) in [
            (PLACE, VELOCITY, one * t),
            (PLACE, ROTATION, force * (-0.5 * t)),
            (PLACE, GYROSCOPE, force * a * (t / 6.0)),
            (PLACE, ACCELEROMETER, a * (-0.5 * t)),
            (PLACE, FORCE, one * (-0.5 * t * t)),
            (VELOCITY, ROTATION, -force),
            (VELOCITY, GYROSCOPE, force * a * 0.5),
            (VELOCITY, ACCELEROMETER, -a),
            (VELOCITY, FORCE, one * -t),
            (ROTATION, GYROSCOPE, -a),
        ] {
            transition.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        }
        let acceleration = noise_scale * settings.acceleration_noise * settings.acceleration_noise;
        let turn = gyroscope.noise * gyroscope.noise * t
            + gyroscope.scale_error * gyroscope.scale_error * measured.squared_turn_rate;
        let mut noise = Covariance::zeros();
        for (row, column, variance) in [
            (PLACE, PLACE, acceleration * t.powi(3) / 3.0),
            (PLACE, VELOCITY, acceleration * t * t / 2.0),
            (VELOCITY, PLACE, acceleration * t * t / 2.0),
            (VELOCITY, VELOCITY, acceleration * t),
            (ROTATION, ROTATION, turn),
            (GYROSCOPE, GYROSCOPE, gyroscope.bias_walk * gyroscope.bias_walk * t),
            (FORCE, FORCE, settings.gravity_walk * settings.gravity_walk * t),
        ] {
            noise.fixed_view_mut::<3, 3>(row, column).copy_from(&(one * variance));
        }
        self.covariance = transition * self.covariance * transition.transpose() + noise;
        self.keep_strength(self.force_at_rest.norm());
    }

    /// Three entries were measured with this covariance, and are off by `innovation`.
    pub fn correct(&mut self, entry: usize, innovation: &Vector3, error: &Matrix3) {
        let mut jacobian = na::SMatrix::<f64, 3, SIZE>::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, entry).copy_from(&Matrix3::identity());
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

    /// Gravity is as strong as everywhere on Earth: it errs on a sphere (as in Xu and Zhang 2021), and what else the
    /// accelerometer measures is its bias.
    fn keep_strength(&mut self, strength: f64) {
        let Some(up) = self.force_at_rest.try_normalize(1e-9) else { return };
        self.force_at_rest = up * strength;
        let mut projection = Covariance::identity();
        let tangent = Matrix3::identity() - up * up.transpose();
        projection.fixed_view_mut::<3, 3>(FORCE, FORCE).copy_from(&tangent);
        self.covariance = projection * self.covariance * projection;
    }

    /// The state with an error added.
    pub fn plus(&self, error: &na::SVector<f64, SIZE>) -> Self {
        let part = |entry: usize| -> Vector3 { error.fixed_rows::<3>(entry).into() };
        let turned = quaternion_from_angle_axis(&part(ROTATION)) * self.rotation;
        Self {
            place: self.place + part(PLACE),
            velocity: self.velocity + part(VELOCITY),
            rotation: Quaternion::new_normalize(turned.into_inner()),
            gyroscope_bias: self.gyroscope_bias + part(GYROSCOPE),
            accelerometer_bias: self.accelerometer_bias + part(ACCELEROMETER),
            force_at_rest: self.force_at_rest + part(FORCE),
            covariance: self.covariance,
        }
    }

    /// The error that takes another state here.
    #[cfg(test)]
    pub fn minus(&self, other: &Self) -> na::SVector<f64, SIZE> {
        let mut error = na::SVector::<f64, SIZE>::zeros();
        for (entry, part) in [
            (PLACE, self.place - other.place),
            (VELOCITY, self.velocity - other.velocity),
            (ROTATION, -self.rotation_to(&other.rotation)),
            (GYROSCOPE, self.gyroscope_bias - other.gyroscope_bias),
            (ACCELEROMETER, self.accelerometer_bias - other.accelerometer_bias),
            (FORCE, self.force_at_rest - other.force_at_rest),
        ] {
            error.fixed_rows_mut::<3>(entry).copy_from(&part);
        }
        error
    }

    /// From the rotation to another one, a rotation vector in the local map.
    pub fn rotation_to(&self, other: &Quaternion) -> Vector3 {
        angle_axis_from_quaternion(&(other * self.rotation.inverse()))
    }
}

/// Standard deviation along the axis on which it is largest.
pub(super) fn worst_sigma(covariance: &Matrix3) -> f64 {
    covariance.diagonal().max().max(0.0).sqrt()
}
