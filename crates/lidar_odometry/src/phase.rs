//! The phases of an odometry.

use portolan_motion::GravityInitialisation;

use crate::motion_state::MotionState;
use crate::settings::InitialisationSettings;
use crate::start::FirstMotion;
use crate::tracker::Tracker;

/// Where an odometry stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Sweeps wait until an IMU has told which way is up, or until it is clear that there is none.
    WaitingForGravity,
    /// The first sweep waits for the second, which tells how fast everything was already moving, and for more where that is
    /// not clear.
    FirstSweep,
    /// The map is made of a few key frames; it is registered to, but nothing is learned from it yet.
    WarmUp,
    /// All else.
    Tracking,
}

/// What an odometry knows in each phase.
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

    /// What is known of the motion, once gravity is.
    pub fn motion(&self) -> Option<&MotionState> {
        match self {
            Self::WaitingForGravity(_) => None,
            Self::FirstSweep(first) => Some(&first.motion),
            Self::Tracking(tracker) => Some(tracker.motion()),
        }
    }
}
