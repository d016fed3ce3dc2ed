//! Thins poses to those that differ from each other (`slam2d.md` §10).

use portolan_geometry::{Duration, Rigid3, Time, rotation_angle};

/// Lets a pose pass if it differs from the last one that passed by time, distance or angle.
#[derive(Clone, Debug)]
pub struct MotionFilter {
    max_time: Duration,
    max_distance: f64,
    max_angle: f64,
    last: Option<(Time, Rigid3)>,
    num_total: u64,
    num_different: u64,
}

impl MotionFilter {
    /// Poses are similar while all three differences are at most as large as given: seconds, metres,
    /// radians.
    pub fn new(max_time_seconds: f64, max_distance_meters: f64, max_angle_radians: f64) -> Self {
        Self {
            max_time: Duration::from_seconds(max_time_seconds),
            max_distance: max_distance_meters,
            max_angle: max_angle_radians,
            last: None,
            num_total: 0,
            num_different: 0,
        }
    }

    /// Whether the pose is similar to the last one that passed. If not, it passes, and later ones are
    /// compared with it. The first always passes.
    pub fn is_similar(&mut self, time: Time, pose: &Rigid3) -> bool {
        self.num_total += 1;
        let similar = self.last.as_ref().is_some_and(|(last_time, last)| {
            time - *last_time <= self.max_time
                && (pose.translation.vector - last.translation.vector).norm() <= self.max_distance
                && rotation_angle(&(pose.inverse() * last)) <= self.max_angle
        });
        if !similar {
            self.num_different += 1;
            self.last = Some((time, *pose));
        }
        similar
    }

    /// Number of poses.
    pub fn num_total(&self) -> u64 {
        self.num_total
    }

    /// Number of poses that passed.
    pub fn num_different(&self) -> u64 {
        self.num_different
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Vector3;

    fn filter() -> MotionFilter {
        let mut filter = MotionFilter::new(0.5, 0.2, 2.0);
        assert!(!filter.is_similar(Time::from_ticks(42), &Rigid3::identity()));
        filter
    }

    #[test]
    fn a_pose_at_rest_passes_after_the_maximum_time() {
        let mut filter = filter();
        assert!(filter.is_similar(Time::from_ticks(42), &Rigid3::identity()));
        let later = Time::from_ticks(42) + Duration::from_seconds(1.0);
        assert!(!filter.is_similar(later, &Rigid3::identity()));
        assert!(filter.is_similar(later, &Rigid3::identity()));
        assert_eq!((filter.num_total(), filter.num_different()), (4, 2));
    }

    #[test]
    fn distance_counts_from_the_last_pose_that_passed() {
        let mut filter = filter();
        for (x, y, similar) in [(0.3, 0.0, false), (0.45, 0.0, true), (0.6, 0.0, false), (0.6, 0.15, true)] {
            let pose = Rigid3::translation(x, y, 0.0);
            assert_eq!(filter.is_similar(Time::from_ticks(42), &pose), similar, "{x} {y}");
        }
    }

    #[test]
    fn angles_are_the_smaller_rotation() {
        let mut filter = filter();
        for (angle, similar) in [(1.9, true), (2.1, false), (4.0, true), (5.9, false), (0.0, true)] {
            let pose = Rigid3::rotation(Vector3::y() * angle);
            assert_eq!(filter.is_similar(Time::from_ticks(42), &pose), similar, "{angle}");
        }
    }
}
