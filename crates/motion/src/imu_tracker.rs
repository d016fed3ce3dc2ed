//! Estimates orientation from gyroscope and accelerometer (`slam2d.md` §4.1).

use portolan_geometry::{Quaternion, Time, Vector3, quaternion_from_angle_axis, rotation_between};

/// Tracks the orientation by integrating angular velocity, and corrects roll and pitch with a slow average
/// of the acceleration, in which only gravity remains. Heading drifts freely.
#[derive(Clone, Copy, Debug)]
pub struct ImuTracker {
    gravity_time_constant: f64,
    time: Time,
    last_acceleration_time: Option<Time>,
    orientation: Quaternion,
    /// Average specific force in the tracking frame; its length has no meaning before the first sample.
    gravity: Vector3,
    angular_velocity: Vector3,
}

impl ImuTracker {
    /// Upright and at rest at `time`. Accelerations are averaged over `gravity_time_constant` seconds: a
    /// longer time relies more on the gyroscope.
    pub fn new(gravity_time_constant: f64, time: Time) -> Self {
        Self {
            gravity_time_constant,
            time,
            last_acceleration_time: None,
            orientation: Quaternion::identity(),
            gravity: Vector3::z(),
            angular_velocity: Vector3::zeros(),
        }
    }

    /// Integrates the current angular velocity until `time`. A time in the past changes nothing.
    pub fn advance(&mut self, time: Time) {
        if time <= self.time {
            return;
        }
        let rotation = quaternion_from_angle_axis(&(self.angular_velocity * time.seconds_since(self.time)));
        self.orientation = Quaternion::new_normalize((self.orientation * rotation).into_inner());
        self.gravity = rotation.inverse() * self.gravity;
        self.time = time;
    }

    /// Takes a specific force in the tracking frame, m/s², measured at the current time; at rest it
    /// points up.
    pub fn add_acceleration(&mut self, acceleration: &Vector3) {
        let weight = match self.last_acceleration_time {
            Some(last) => 1.0 - (-self.time.seconds_since(last) / self.gravity_time_constant).exp(),
            None => 1.0,
        };
        self.last_acceleration_time = Some(self.time);
        self.gravity = self.gravity * (1.0 - weight) + acceleration * weight;
        let up_in_tracking = self.orientation.inverse() * Vector3::z();
        let correction = rotation_between(&self.gravity, &up_in_tracking);
        self.orientation = Quaternion::new_normalize((self.orientation * correction).into_inner());
    }

    /// Takes the angular velocity in the tracking frame, rad/s, that is valid from now on.
    pub fn set_angular_velocity(&mut self, angular_velocity: &Vector3) {
        self.angular_velocity = *angular_velocity;
    }

    /// Time of the orientation.
    pub fn time(&self) -> Time {
        self.time
    }

    /// Rotation from the tracking frame to a level one.
    pub fn orientation(&self) -> Quaternion {
        self.orientation
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Duration, angular_distance};

    /// Three seconds in ten steps of constant measurements.
    fn track(acceleration: Vector3, angular_velocity: Vector3, gravity_time_constant: f64) -> Quaternion {
        let mut tracker = ImuTracker::new(gravity_time_constant, Time::from_ticks(0));
        assert_eq!(tracker.orientation(), Quaternion::identity());
        for _ in 0..10 {
            tracker.add_acceleration(&acceleration);
            tracker.set_angular_velocity(&angular_velocity);
            tracker.advance(tracker.time() + Duration::from_seconds(0.3));
        }
        tracker.orientation()
    }

    #[test]
    fn turns_in_2d_add_up() {
        let result = track(Vector3::new(0.0, 0.0, 9.9), Vector3::new(0.0, 0.0, 0.3), 0.3);
        let expected = Quaternion::from_axis_angle(&Vector3::z_axis(), 0.9);
        assert!(angular_distance(&result, &expected) < 1e-8);
    }

    #[test]
    fn a_slow_average_leaves_it_to_the_gyroscope() {
        let rate = Vector3::new(0.1, 0.4, 0.1);
        let result = track(Vector3::new(0.0, 0.0, 9.8), rate, 1e12);
        assert!(angular_distance(&result, &quaternion_from_angle_axis(&(3.0 * rate))) < 1e-8);
    }

    #[test]
    fn acceleration_measures_the_vertical() {
        let acceleration = Vector3::new(0.5, 0.3, 9.5);
        let result = track(acceleration, Vector3::zeros(), 0.3);
        assert!(angular_distance(&result, &rotation_between(&acceleration, &Vector3::z())) < 1e-8);
        assert!((result * acceleration.normalize()).z > 0.99);
    }

    #[test]
    fn free_fall_and_the_past_do_no_harm() {
        let mut tracker = ImuTracker::new(0.0, Time::from_ticks(100));
        tracker.add_acceleration(&Vector3::zeros());
        tracker.set_angular_velocity(&Vector3::new(0.0, 0.0, 1.0));
        tracker.advance(Time::from_ticks(50));
        assert_eq!((tracker.time(), tracker.orientation()), (Time::from_ticks(100), Quaternion::identity()));
        tracker.advance(Time::MAX);
        assert!(tracker.orientation().coords.iter().all(|c| c.is_finite()));
    }

    /// The measurements of the golden vectors (`vectors.md` §9).
    fn golden_measurements() -> Vec<(Vector3, Vector3)> {
        let mut state = 3_u32;
        let mut uniform = |a: f32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(((state >> 8) as f32 / 16_777_216.0 * 2.0 - 1.0) * a)
        };
        (0..50)
            .map(|_| {
                let mut vector = |x: f32, y: f32, z: f32| {
                    let (x, y) = (uniform(x), uniform(y));
                    Vector3::new(x, y, uniform(z))
                };
                let acceleration = vector(1.0, 1.0, 0.5);
                (acceleration + Vector3::z() * 9.8, vector(0.5, 0.5, 1.0))
            })
            .collect()
    }

    #[test]
    fn golden_orientations() {
        let mut tracker = ImuTracker::new(10.0, Time::from_ticks(0));
        let golden = [
            (9, [0.999699533321, 0.006336592704, 0.017876580916, 0.015527991654]),
            (19, [0.999431569366, 0.002321213635, 0.027065779561, 0.019964811518]),
            (49, [0.998858857753, 0.004186814060, 0.028692537334, 0.037949850831]),
        ];
        for (i, (acceleration, angular_velocity)) in golden_measurements().iter().enumerate() {
            tracker.advance(Time::from_ticks(100_000 * (i as i64 + 1)));
            tracker.add_acceleration(acceleration);
            tracker.set_angular_velocity(angular_velocity);
            let q = tracker.orientation();
            for (_, expected) in golden.iter().filter(|g| g.0 == i) {
                let difference = portolan_geometry::nalgebra::Vector4::new(q.w, q.i, q.j, q.k)
                    - portolan_geometry::nalgebra::Vector4::from(*expected);
                assert!(difference.amax() < 1e-12, "after {i}: {difference}");
            }
        }
    }
}
