//! Pieces of map: ends one, begins the next, and sets the velocity of the scanner there.

use portolan_geometry::{Duration, Quaternion, Rigid2, Rigid3, Time, embed_3d, yaw};
use portolan_motion::PoseExtrapolator;

use super::super::co_moving::CoMoving;
use super::super::pose_status::PoseStatus;
use super::super::start::Velocity;
use super::{FrontEnd, no_submaps};
use crate::{Lost, OdometryBridge, Space2d, motion_filter};

/// Time over which a velocity is passed to the extrapolator as a motion, seconds.
const SHORTLY: f64 = 0.1;

impl FrontEnd {
    /// Ends the current piece of map, which no measurement connects to the next scans. The scanner is
    /// assumed to be at this pose of the tracking frame, and new submaps begin there.
    fn restart(&mut self, since: Time, time: Time, local_from_tracking: Rigid3) -> Lost<Space2d> {
        let remaining = self.active_submaps.finish();
        self.active_submaps = no_submaps(&self.options, &self.extras);
        self.motion_filter = motion_filter(&self.options.motion_filter);
        self.co_moving = CoMoving::default();
        let is_unmeasured = |e: &&mut PoseExtrapolator| !e.odometry_since_last_pose(time);
        if let Some(extrapolator) = self.extrapolator.as_mut().filter(is_unmeasured) {
            restart(extrapolator, time, local_from_tracking, Velocity::default());
            self.has_restarted = true;
            self.tracker.restart();
        }
        Lost { since, remaining, old_from_new: Rigid3::identity(), bridge: None }
    }

    /// Ends the piece of map that scans no longer fit. New submaps begin at the pose of odometry, or,
    /// where odometry gives none, at the last accepted pose.
    pub(super) fn begin_at_dead_reckoning(
        &mut self,
        since: Time,
        time: Time,
        gravity: &Quaternion,
    ) -> (Rigid2, Option<Lost<Space2d>>) {
        let reckoned = self.reckoned.bridge();
        let pose = reckoned.map_or(self.last_confirmed, |(tracking, _)| Rigid2 {
            angle: tracking.angle - yaw(gravity),
            ..tracking
        });
        let lost = self.restart(since, time, embed_3d(&pose) * *gravity);
        (pose, Some(Lost { bridge: reckoned.map(|(_, bridge)| bridge), ..lost }))
    }

    /// Ends the piece of map that only odometry connects to the next scans. New submaps begin at the pose
    /// of odometry.
    pub(super) fn begin_after_gap(
        &mut self,
        time: Time,
        (seconds, bridge): (f64, OdometryBridge),
        local_from_tracking: Rigid3,
    ) -> Lost<Space2d> {
        let since = time - Duration::from_seconds(seconds);
        Lost { bridge: Some(bridge), ..self.restart(since, time, local_from_tracking) }
    }

    /// Time since which scans have fitted nowhere in the search window, if the last ones do not fit and
    /// the pose is a guess.
    pub fn lost_since(&self) -> Option<Time> {
        match self.status {
            PoseStatus::Suspect { since, is_elsewhere: true, .. } => Some(since),
            PoseStatus::Confirmed | PoseStatus::Suspect { .. } | PoseStatus::Lost { .. } => None,
        }
    }

    /// Whether a piece of map that no measurement connects to the one before was begun since the last
    /// call.
    pub fn take_restarted(&mut self) -> bool {
        std::mem::take(&mut self.has_restarted)
    }

    /// Sets the velocity where odometry contradicts it because odometry fails.
    pub fn set_velocity_against_odometry(&mut self, velocity: Velocity) {
        self.tracker.odometry_contradicts(&velocity.motion(SHORTLY), SHORTLY);
        self.set_velocity(velocity);
    }

    /// Sets the velocity of the scanner: at the start in the frame of the start, later in that of the last
    /// pose.
    pub fn set_velocity(&mut self, velocity: Velocity) {
        self.start_velocity = velocity;
        if let Some(extrapolator) = &mut self.extrapolator
            && let Some((time, pose)) = extrapolator.last_pose()
        {
            restart(extrapolator, time, pose, velocity);
        }
    }
}

/// Restarts the predictions at a pose with this velocity, in the frame of that pose.
pub(super) fn restart(
    extrapolator: &mut PoseExtrapolator,
    time: Time,
    local_from_tracking: Rigid3,
    velocity: Velocity,
) {
    let motion = embed_3d(&velocity.motion(SHORTLY));
    extrapolator.restart(time, local_from_tracking, &motion, SHORTLY);
}
