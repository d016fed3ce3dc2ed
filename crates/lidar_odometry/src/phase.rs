//! Phases of a lidar odometry.

use portolan_motion::GravityInitialisation;

use crate::motion_state::MotionState;
use crate::settings::InitialisationSettings;
use crate::start::FirstMotion;
use crate::tracker::Tracker;

/// Phase of a lidar odometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Sweeps wait until an IMU has measured the vertical, or until it is clear that there is none.
    WaitingForGravity,
    /// The first sweep waits for the second, which determines the initial velocity, and for more where
    /// that is ambiguous.
    FirstSweep,
    /// The map consists of a few key frames: sweeps are registered to it, but nothing is
    /// learned from the results yet.
    WarmUp,
    /// All else.
    Tracking,
}

/// State of a lidar odometry in each phase.
pub(crate) enum State {
    WaitingForGravity(GravityInitialisation),
    FirstSweep(Box<FirstMotion>),
    /// Warm-up and tracking, which differ by the number of key frames in the map.
    Tracking(Box<Tracker>),
}

impl Default for State {
    fn default() -> Self {
        Self::WaitingForGravity(GravityInitialisation::new(InitialisationSettings::default().leveling_time))
    }
}

impl State {
    pub fn phase(&self) -> Phase {
        match self {
            Self::WaitingForGravity(_) => Phase::WaitingForGravity,
            Self::FirstSweep(_) => Phase::FirstSweep,
            Self::Tracking(tracker) if tracker.is_warming_up() => Phase::WarmUp,
            Self::Tracking(_) => Phase::Tracking,
        }
    }

    /// State of motion, once gravity is known.
    pub fn motion(&self) -> Option<&MotionState> {
        match self {
            Self::WaitingForGravity(_) => None,
            Self::FirstSweep(first) => Some(&first.motion),
            Self::Tracking(tracker) => Some(tracker.motion()),
        }
    }
}
