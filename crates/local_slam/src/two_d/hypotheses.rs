//! What is looked for in a submap, and what was found there.

use portolan_geometry::Rigid2;
use portolan_submaps::{ScanMatch2d, SearchWindow};

/// A match beyond this fraction of the window may have its best place outside.
const AT_EDGE: f64 = 0.85;

/// A search and what it found.
pub(super) struct Looked {
    pub around: Rigid2,
    pub window: SearchWindow,
    pub found: ScanMatch2d,
}

/// Which of the places that a scan may have been taken at is believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Judgement {
    /// Where it was found near its prediction.
    Near,
    /// Where it was found far from it.
    Far,
    /// The prediction: what was found is not likely.
    Predicted,
}

/// Where a scan was looked for, and what was found there.
pub(super) struct Hypothesis {
    pub around: Rigid2,
    pub found: ScanMatch2d,
    pub basis: Basis,
    /// Where else it may be: where odometry says, if it is believed to have caught up; where the velocity led, if nothing is known
    /// of it any more.
    pub otherwise: Option<Rigid2>,
}

/// What says that a scan is somewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Basis {
    /// Odometry or an IMU.
    Measured,
    /// Odometry that was behind and has caught up.
    CaughtUp,
    /// Nothing but the motion before.
    WentOn,
}

impl Hypothesis {
    /// What fits best may lie outside the window.
    pub fn is_at_edge(&self, window: SearchWindow) -> bool {
        let offset = self.around.inverse() * self.found.pose;
        offset.translation.amax() > AT_EDGE * window.linear || offset.angle.abs() > AT_EDGE * window.angular
    }
}
