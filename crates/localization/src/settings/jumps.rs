//! Rates at which corrections are passed on to a driver (`jumps.rs`).

use crate::known_map::Window;

/// Translation of a correction that is applied for each metre travelled, metres.
pub(crate) const METRES_BY_DISTANCE: f64 = 0.1;
/// Translation of a correction that is applied for each radian turned, metres.
pub(crate) const METRES_BY_TURN: f64 = 0.05;
/// Rotation of a correction that is applied for each metre travelled, radians.
pub(crate) const RADIANS_BY_DISTANCE: f64 = 0.05;
/// Rotation of a correction that is applied for each radian turned, radians.
pub(crate) const RADIANS_BY_TURN: f64 = 0.1;
/// Translation of a correction that is applied each second in any case, metres.
pub(crate) const METRES_BY_TIME: f64 = 0.05;
/// Rotation of a correction that is applied each second in any case, radians.
pub(crate) const RADIANS_BY_TIME: f64 = 0.02;
/// Size of a correction above which it is a jump to another place and not a better pose.
pub(crate) const OTHER_PLACE: Window = Window { metres: 0.5, radians: 0.2 };
/// Time for which the new place has to be localised before the jump is confirmed, seconds.
pub(crate) const CONFIRMED_AFTER: f64 = 2.0;
