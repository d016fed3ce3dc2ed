//! How a known place is tracked (`belief.rs`, `finder.rs`, `pace.rs`).

use super::scans::NEW_VIEW_RADIANS;
use crate::known_map::Window;

/// Translational drift of local SLAM as a random walk by distance, metres per root of a metre.
pub(crate) const DRIFT_METRES_BY_DISTANCE: f64 = 0.04;
/// Rotational drift by distance, radians per root of a metre.
pub(crate) const DRIFT_RADIANS_BY_DISTANCE: f64 = 0.012;
/// Rotational drift by rotation, radians per root of a radian.
pub(crate) const DRIFT_RADIANS_BY_TURN: f64 = 0.02;
/// Translational drift by time, metres per root of a second.
pub(crate) const DRIFT_METRES_BY_TIME: f64 = 0.005;
/// Rotational drift by time, radians per root of a second.
pub(crate) const DRIFT_RADIANS_BY_TIME: f64 = 0.001;
/// Number of matches of which the median distance from predictions is compared with what the covariance
/// predicts: an odd number, half a second at 10 Hz.
pub(crate) const INNOVATIONS: usize = 5;
/// Largest factor on the variance of drift. Drift is then about as large as the distance travelled.
pub(crate) const LARGEST_DRIFT_SCALE: f64 = 1000.0;
/// Distance after which two matches are independent, metres; nearer ones share the errors of the map.
pub(crate) const INDEPENDENT_METRES: f64 = 0.5;
/// Rotation after which two matches are independent, radians.
pub(crate) const INDEPENDENT_RADIANS: f64 = NEW_VIEW_RADIANS;
/// Time after which two matches are independent, seconds.
pub(crate) const INDEPENDENT_SECONDS: f64 = 10.0;

/// Window around the tracked pose in which a scan that contradicts the map is searched.
pub(crate) const SLIP_WINDOW: Window = Window { metres: 1.0, radians: 0.3 };
/// Minimum gain in fit for the pose to slip to a match in [`SLIP_WINDOW`].
pub(crate) const SLIP_FIT: f64 = 0.2;
/// Standard deviations of the pose after a slip, metres and radians.
pub(crate) const SLIP_SIGMAS: (f64, f64) = (0.15, 0.03);
/// Time between searches of the whole map for better places while the place is uncertain, seconds.
pub(crate) const UNCERTAIN_CHECK_SECONDS: f64 = 2.0;
/// Minimum time between searches of the whole map while the place is certain, seconds.
pub(crate) const SURE_CHECK_SECONDS: f64 = 10.0;
/// Minimum distance travelled between searches of the whole map while the place is certain, metres.
pub(crate) const SURE_CHECK_METRES: f64 = 3.0;
/// Standard deviation of the position at which a place is lost outside of the map, metres.
pub(crate) const LOST_SIGMA: f64 = 2.0;

/// Minimum time over which a speed is measured, seconds: time stamps come in bursts.
pub(crate) const SPEED_SPAN: f64 = 1.0;
/// Number of time spans ([`SPEED_SPAN`]) after which the highest speed is known well enough to detect jumps.
pub(crate) const MOVING_SPANS: u32 = 5;
/// Multiple of the highest measured speed above which a step is a jump; dimensionless.
pub(crate) const TIMES_AS_FAST: f64 = 3.0;
/// Minimum length of a step that is a jump because of its speed, metres: the platform was carried while
/// nothing was recorded, or its odometry was reset.
pub(crate) const SHORTEST_JUMP: f64 = 2.0;
/// Largest acceleration of a platform that moves by itself, m/s²: friction does not exceed its weight. It
/// limits the deviation from constant velocity.
pub(crate) const FRICTION: f64 = 9.81;
/// Minimum deviation from constant velocity for a jump, metres. In real recordings the trajectory deviates
/// by up to 0.85 m (docs/experiments/2026-11-kidnapped.md).
pub(crate) const FARTHEST_OFF: f64 = 1.0;
/// Error of time stamps, seconds.
pub(crate) const STAMP_ERROR: f64 = 0.3;
/// Minimum deviation for another jump within a second after a jump, metres: local SLAM may still be catching
/// up (docs/experiments/2026-11-kidnapped.md).
pub(crate) const CATCHING_UP: f64 = 0.3;
