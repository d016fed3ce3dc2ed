//! Interpolates measured poses at the times of nodes.

use std::collections::BTreeMap;

use portolan_geometry::{Rigid3, Time, interpolate};
use portolan_sensor::{FixedFramePoseData, OdometryData};

/// Odometry pose at a time: interpolated between its neighbours, or the datum at exactly that time.
pub fn odometry_at(data: &BTreeMap<Time, OdometryData>, time: Time) -> Option<Rigid3> {
    pose_at(data, time, |d| Some(d.odom_from_tracking))
}

/// Fixed-frame pose at a time, if both neighbours have one.
pub fn fixed_frame_at(data: &BTreeMap<Time, FixedFramePoseData>, time: Time) -> Option<Rigid3> {
    pose_at(data, time, |d| d.fixed_from_tracking)
}

fn pose_at<T>(data: &BTreeMap<Time, T>, time: Time, pose: impl Fn(&T) -> Option<Rigid3>) -> Option<Rigid3> {
    let (next_time, next) = data.range(time..).next()?;
    if *next_time == time {
        return pose(next);
    }
    let (previous_time, previous) = data.range(..time).next_back()?;
    Some(interpolate(*previous_time, &pose(previous)?, *next_time, &pose(next)?, time))
}
