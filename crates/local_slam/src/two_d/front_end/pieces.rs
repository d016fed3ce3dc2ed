//! Pieces of map: where one ends and the next begins, and how the scanner moves then.

use portolan_geometry::{Duration, Quaternion, Rigid2, Rigid3, Time, embed_3d, yaw};
use portolan_motion::PoseExtrapolator;

use super::super::belief::PoseBelief;
use super::super::co_moving::CoMoving;
use super::super::start::Velocity;
use super::{FrontEnd, no_submaps};
use crate::{Lost, OdometryBridge, Space2d, motion_filter};

/// A velocity is given to predictions as the motion of so many seconds.
const SHORTLY: f64 = 0.1;

impl FrontEnd {
    /// Ends the piece of map that nothing ties to what comes: the scanner is believed to stand at this pose of the tracking
    /// frame, and new submaps are drawn from there.
    fn begin_anew(&mut self, since: Time, time: Time, local_from_tracking: Rigid3) -> Lost<Space2d> {
        let remaining = self.active_submaps.finish();
        self.active_submaps = no_submaps(&self.options, &self.extras);
        self.motion_filter = motion_filter(&self.options.motion_filter);
        self.co_moving = CoMoving::default();
        let nothing_tells = |e: &&mut PoseExtrapolator| !e.odometry_since_last_pose(time);
        if let Some(extrapolator) = self.extrapolator.as_mut().filter(nothing_tells) {
            begin_anew(extrapolator, time, local_from_tracking, Velocity::default());
            self.has_begun_anew = true;
            self.tracker.begin_anew();
        }
        Lost { since, remaining, ended_from_begun: Rigid3::identity(), bridge: None }
    }

    /// Ends the piece of map that scans do not fit any more: new submaps are drawn from where odometry says that the scanner is,
    /// or, where it says nothing, from where it was last seen.
    pub(super) fn begin_where_reckoned(
        &mut self,
        since: Time,
        time: Time,
        gravity: &Quaternion,
    ) -> (Rigid2, Option<Lost<Space2d>>) {
        let reckoned = self.reckoned.bridge();
        let pose = reckoned.map_or(self.last_sure, |(tracking, _)| Rigid2 {
            angle: tracking.angle - yaw(gravity),
            ..tracking
        });
        let lost = self.begin_anew(since, time, embed_3d(&pose) * *gravity);
        (pose, Some(Lost { bridge: reckoned.map(|(_, bridge)| bridge), ..lost }))
    }

    /// Ends the piece of map that odometry alone ties to what comes: new submaps are drawn from where it says that the
    /// scanner is.
    pub(super) fn begin_after_gap(
        &mut self,
        time: Time,
        (seconds, bridge): (f64, OdometryBridge),
        local_from_tracking: Rigid3,
    ) -> Lost<Space2d> {
        let since = time - Duration::from_seconds(seconds);
        Lost { bridge: Some(bridge), ..self.begin_anew(since, time, local_from_tracking) }
    }

    /// Since when scans have fitted nothing where they were looked for, if the last ones do not and it is a guess.
    pub fn lost_since(&self) -> Option<Time> {
        match self.belief {
            PoseBelief::Doubtful { since, is_elsewhere: true, .. } => Some(since),
            PoseBelief::Sure | PoseBelief::Doubtful { .. } | PoseBelief::Lost { .. } => None,
        }
    }

    /// Whether, since this was asked last, a piece of map was begun that nothing measured ties to the one before.
    pub fn take_begun_anew(&mut self) -> bool {
        std::mem::take(&mut self.has_begun_anew)
    }

    /// The same where odometry says otherwise, and fails.
    pub fn set_velocity_in_spite_of_odometry(&mut self, velocity: Velocity) {
        self.tracker.odometry_contradicts(&velocity.motion(SHORTLY), SHORTLY);
        self.set_velocity(velocity);
    }

    /// Says how the scanner moves when it begins, seen from where it begins, or, where it has, from the last pose.
    pub fn set_velocity(&mut self, velocity: Velocity) {
        self.start_velocity = velocity;
        if let Some(extrapolator) = &mut self.extrapolator
            && let Some((time, pose)) = extrapolator.last_pose()
        {
            begin_anew(extrapolator, time, pose, velocity);
        }
    }
}

/// Predictions go on from a pose with this velocity, seen from there.
pub(super) fn begin_anew(
    extrapolator: &mut PoseExtrapolator,
    time: Time,
    local_from_tracking: Rigid3,
    velocity: Velocity,
) {
    let motion = embed_3d(&velocity.motion(SHORTLY));
    extrapolator.begin_anew(time, local_from_tracking, &motion, SHORTLY);
}
