//! The motion from one scan to the next: what measured it, and how far it can lead.

use std::f64::consts::PI;

use portolan_geometry::{Rigid2, Time};
use portolan_motion::PoseExtrapolator;
use portolan_submaps::SearchWindow;

/// Maximum speed and turn rate of a robot in a building, or of a carried scanner, m/s and rad/s.
pub(super) const FASTEST: SearchWindow = SearchWindow { linear: 2.0, angular: 2.5 };
/// Maximum time over which [`FASTEST`] widens the search, seconds: for measured and for unmeasured motion.
pub(super) const LONGEST_MEASURED: f64 = 0.5;
pub(super) const LONGEST_UNMEASURED: f64 = 2.0;
/// Standard deviation of the acceleration of a scanner, m/s²: the error of constant velocity.
pub(super) const ACCELERATION: f64 = 1.0;
/// Standard deviation of its angular acceleration, rad/s².
pub(super) const ANGULAR_ACCELERATION: f64 = 2.0;
/// Maximum acceleration of a scanner, even of one that is carried, m/s² and rad/s².
const LARGEST_ACCELERATION: SearchWindow = SearchWindow { linear: 10.0, angular: 30.0 };
/// Maximum search window of a scan, metres and radians.
pub(super) const WIDEST: SearchWindow = SearchWindow { linear: 3.0, angular: 1.6 };

/// Which part of a motion sensors measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Measured {
    Nothing,
    /// A gyroscope measured the rotation. The translation is unmeasured.
    Rotation,
    /// Odometry measured all of it.
    Whole,
}

impl Measured {
    /// What the extrapolator has measurements of, from the last pose to a time.
    pub fn since_last_pose(extrapolator: &PoseExtrapolator, time: Time) -> Self {
        if extrapolator.odometry_since_last_pose(time) {
            Self::Whole
        } else if extrapolator.measured_since_last_pose(time) {
            Self::Rotation
        } else {
            Self::Nothing
        }
    }
}

/// The motion since the last scan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    /// Pose of the last scan in the local map.
    pub last: Rigid2,
    /// Seconds since then.
    pub seconds: f64,
    /// Which part of it was measured.
    pub measured: Measured,
    /// Pose by odometry, if its readings are too far apart to measure the motion.
    pub between_readings: Option<Rigid2>,
    /// Yaw of the tracking frame in the gravity-aligned frame in which this motion is given, radians.
    pub tracking_yaw: f64,
}

impl Motion {
    /// Measured motion from the origin, over this time, seconds.
    #[cfg(test)]
    pub fn measured(seconds: f64) -> Self {
        Self {
            last: Rigid2::identity(),
            seconds,
            measured: Measured::Whole,
            between_readings: None,
            tracking_yaw: 0.0,
        }
    }

    /// Whether odometry measured the translation.
    pub fn is_measured(&self) -> bool {
        self.measured == Measured::Whole
    }

    /// Whether the rotation was measured.
    pub fn is_rotation_measured(&self) -> bool {
        self.measured != Measured::Nothing
    }

    /// Whether the translation was unmeasured for so long that the previous velocity is no longer valid.
    pub fn is_unknown(&self) -> bool {
        !self.is_measured() && self.seconds > LONGEST_UNMEASURED
    }

    /// Motion from the last scan to a pose, with its angle in ±π.
    pub fn to(&self, pose: &Rigid2) -> Rigid2 {
        let motion = self.last.inverse() * *pose;
        Rigid2 { angle: motion.normalized_angle(), ..motion }
    }

    /// A motion of the gravity-aligned frame as one of the tracking frame, and back.
    pub fn of_tracking(&self, motion: &Rigid2) -> Rigid2 {
        turned_by(-self.tracking_yaw, motion)
    }

    pub fn of_aligned(&self, motion: &Rigid2) -> Rigid2 {
        turned_by(self.tracking_yaw, motion)
    }
}

/// A motion as seen from a frame that is turned by the opposite angle.
fn turned_by(angle: f64, motion: &Rigid2) -> Rigid2 {
    let translation = Rigid2::new(0.0, 0.0, angle).transform_point(&motion.translation);
    Rigid2 { translation, ..*motion }
}

/// Maximum offset of a scanner from its constant-velocity prediction after this time, seconds.
pub(super) fn reached_by_acceleration(seconds: f64) -> SearchWindow {
    let square = seconds * seconds;
    SearchWindow {
        linear: LARGEST_ACCELERATION.linear * square,
        angular: LARGEST_ACCELERATION.angular * square,
    }
}

/// Search window that covers the distance the scanner can have moved.
pub(super) fn wide_window(usual: SearchWindow, motion: Motion) -> SearchWindow {
    let seconds =
        |is_measured| motion.seconds.min(if is_measured { LONGEST_MEASURED } else { LONGEST_UNMEASURED });
    let is_rotation_measured = motion.is_rotation_measured();
    let widest_angle = if is_rotation_measured { WIDEST.angular } else { PI };
    SearchWindow {
        linear: (2.0 * usual.linear).max(FASTEST.linear * seconds(motion.is_measured())).min(WIDEST.linear),
        angular: (2.0 * usual.angular).max(FASTEST.angular * seconds(is_rotation_measured)).min(widest_angle),
    }
}
