//! Ways of the scanner from the last pose to the end of a sweep, as they are predicted.

use portolan_geometry::{Rigid3, Time, quaternion_from_angle_axis};
use portolan_lidar_odometry::{Going, Way};
use portolan_motion::PoseExtrapolator;

fn start_of(extrapolator: &PoseExtrapolator, end: Time) -> Time {
    extrapolator.last_pose_time().unwrap_or(end).min(end)
}

/// As an extrapolator predicts it.
pub(super) fn predicted(extrapolator: &mut PoseExtrapolator, end: Time) -> Way {
    let mut way = Way::new(start_of(extrapolator, end), end, |t| extrapolator.extrapolate_pose(t));
    if extrapolator.has_odometry(end) {
        way.going = Going::Measured;
    }
    way
}

/// As an extrapolator predicts it, but turning as the last scans did instead of as a gyroscope says.
pub(super) fn turning_on(extrapolator: &mut PoseExtrapolator, end: Time) -> Way {
    let last = extrapolator.last_pose();
    let turn_rate = extrapolator.angular_velocity_from_poses();
    predicted(extrapolator, end).changed(|seconds, predicted| {
        if let Some((_, pose)) = last {
            predicted.rotation = pose.rotation * quaternion_from_angle_axis(&(turn_rate * seconds));
        }
    })
}

/// Standing at `pose` since the last pose.
pub(super) fn standing(extrapolator: &PoseExtrapolator, end: Time, pose: &Rigid3) -> Way {
    Way::new(start_of(extrapolator, end), end, |_| *pose)
}
