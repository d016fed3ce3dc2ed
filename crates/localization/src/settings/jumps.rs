//! How corrections reach a driver (`jumps.rs`).

use crate::known_map::Window;

/// A correction is taken in over a way of the robot, metres for each metre …
pub(crate) const METRES_BY_WAY: f64 = 0.1;
/// … and radian, …
pub(crate) const METRES_BY_TURN: f64 = 0.05;
/// … radians for each metre …
pub(crate) const RADIANS_BY_WAY: f64 = 0.05;
/// … and radian, …
pub(crate) const RADIANS_BY_TURN: f64 = 0.1;
/// … and at these rates in any case, metres …
pub(crate) const METRES_BY_TIME: f64 = 0.05;
/// … and radians a second.
pub(crate) const RADIANS_BY_TIME: f64 = 0.02;
/// A correction farther than this is another place and not a better pose; …
pub(crate) const OTHER_PLACE: Window = Window { metres: 0.5, radians: 0.2 };
/// … it is confirmed when the place was localised there for so long, seconds.
pub(crate) const CONFIRMED_AFTER: f64 = 2.0;
