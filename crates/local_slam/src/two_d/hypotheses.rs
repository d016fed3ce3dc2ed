//! Search hypotheses of a scan in a submap, and their results.

use portolan_geometry::Rigid2;
use portolan_submaps::{ScanMatch2d, SearchWindow};

/// Fraction of the window beyond which the optimum of a match may be outside the window; dimensionless.
const AT_EDGE: f64 = 0.85;

/// A search and its best match.
pub(super) struct CachedSearch {
    pub around: Rigid2,
    pub window: SearchWindow,
    pub found: ScanMatch2d,
}

/// Which of the candidate poses of a scan is accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Judgement {
    /// The match near the prediction.
    Near,
    /// The match far from the prediction.
    Far,
    /// The prediction: the match is unlikely.
    Predicted,
}

/// Centre of the search for a scan, and the match found there.
pub(super) struct Hypothesis {
    pub around: Rigid2,
    pub found: ScanMatch2d,
    pub basis: Basis,
    /// Alternative pose of the scan: that of odometry, if odometry is assumed to have caught up; that of
    /// constant velocity, if the velocity is no longer known.
    pub otherwise: Option<Rigid2>,
}

/// What the centre of the search is based on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Basis {
    /// Odometry or an IMU.
    Measured,
    /// Odometry that lagged behind and has caught up.
    CaughtUp,
    /// Only the previous motion (constant velocity).
    ConstantVelocity,
}

impl Hypothesis {
    /// Whether the optimum may be outside the window.
    pub fn is_at_edge(&self, window: SearchWindow) -> bool {
        let offset = self.around.inverse() * self.found.pose;
        offset.translation.amax() > AT_EDGE * window.linear || offset.angle.abs() > AT_EDGE * window.angular
    }
}
