//! How a known place is followed (`belief.rs`, `finder.rs`, `pace.rs`).

use super::scans::NEW_VIEW_RADIANS;
use crate::known_map::Window;

/// Drift of local SLAM as a random walk: metres per root of a metre, …
pub(crate) const DRIFT_METRES_BY_WAY: f64 = 0.04;
/// … radians per root of a metre …
pub(crate) const DRIFT_RADIANS_BY_WAY: f64 = 0.012;
/// … and of a radian, …
pub(crate) const DRIFT_RADIANS_BY_TURN: f64 = 0.02;
/// … metres per root of a second …
pub(crate) const DRIFT_METRES_BY_TIME: f64 = 0.005;
/// … and radians per root of a second.
pub(crate) const DRIFT_RADIANS_BY_TIME: f64 = 0.001;
/// Two matches are independent after this way, metres, …
pub(crate) const INDEPENDENT_METRES: f64 = 0.5;
/// … this turn, radians, …
pub(crate) const INDEPENDENT_RADIANS: f64 = NEW_VIEW_RADIANS;
/// … or this time, seconds; nearer ones see the same errors of the map.
pub(crate) const INDEPENDENT_SECONDS: f64 = 10.0;

/// A scan that contradicts the map where it is believed to be is looked for so far around, …
pub(crate) const SLIP_WINDOW: Window = Window { metres: 1.0, radians: 0.3 };
/// … is believed to be there if it fits better by so much, …
pub(crate) const SLIP_FIT: f64 = 0.2;
/// … and its place is then known to these standard deviations, metres and radians.
pub(crate) const SLIP_SIGMAS: (f64, f64) = (0.15, 0.03);
/// The whole map is searched for better places after so many seconds where the place is uncertain; …
pub(crate) const UNCERTAIN_CHECK_SECONDS: f64 = 2.0;
/// … where it is not, after more seconds …
pub(crate) const SURE_CHECK_SECONDS: f64 = 10.0;
/// … and this way, metres.
pub(crate) const SURE_CHECK_METRES: f64 = 3.0;
/// Outside of the map the place is lost when its standard deviation reaches this, metres.
pub(crate) const LOST_SIGMA: f64 = 2.0;

/// Speeds are those over at least so many seconds: stamps come in bursts.
pub(crate) const SPEED_SPAN: f64 = 1.0;
/// Nothing that has moved for so many such spans …
pub(crate) const MOVING_SPANS: u32 = 5;
/// … moves so many times as fast all at once, …
pub(crate) const TIMES_AS_FAST: f64 = 3.0;
/// … by so many metres at least: it was carried while nothing was recorded, or its odometry was reset.
pub(crate) const SHORTEST_JUMP: f64 = 2.0;
/// What moves by itself changes its velocity by what friction holds at most, m/s², as much as its weight: …
pub(crate) const FRICTION: f64 = 9.81;
/// … beyond that it does not leave the way on which it was by so many metres. Ways of real recordings leave it by 0.85 m
/// (docs/experiments/2026-11-kidnapped.md).
pub(crate) const FARTHEST_OFF: f64 = 1.0;
/// Stamps are off by so many seconds.
pub(crate) const STAMP_ERROR: f64 = 0.3;
/// In the second after a jump local SLAM may still be catching up: from so many metres on that is one more
/// (docs/experiments/2026-11-kidnapped.md).
pub(crate) const CATCHING_UP: f64 = 0.3;
