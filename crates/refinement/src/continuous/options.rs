//! How to refine.

use super::OdometryNoise;
use crate::RefineError;

/// How to refine. The defaults are meant for every recording; nothing needs to be tuned.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ContinuousOptions {
    /// Length of the windows within which the input shows a wall as one sheet, seconds. Longer for slow
    /// scanners, shorter for an input that is wrong from one second to the next.
    pub window: f64,
    /// Seconds between knots at the end. Shorter follows faster errors, if there are points enough.
    pub knot_spacing: f64,
    /// Farthest that surfaces may lie apart at the start because of drift, metres.
    pub reach: f64,
    /// How wrong the motion of the input may be at the start; afterwards it is found out.
    pub odometry: OdometryNoise,
    /// At most so many rounds of fine stages.
    pub max_rounds: usize,
}

impl Default for ContinuousOptions {
    fn default() -> Self {
        Self {
            window: 2.0,
            knot_spacing: 0.1,
            reach: 2.0,
            odometry: OdometryNoise { translation: 0.05, rotation: 0.5_f64.to_radians() },
            max_rounds: 8,
        }
    }
}

impl ContinuousOptions {
    /// # Errors
    /// Fails for values that make no sense.
    pub(crate) fn check(&self) -> Result<(), RefineError> {
        let positive = |name: &str, value: f64| {
            if value > 0.0 && value < 1e6 {
                return Ok(());
            }
            Err(RefineError::Option(format!("{name} must be above 0, but is {value}")))
        };
        positive("the window (seconds)", self.window)?;
        positive("the spacing of knots (seconds)", self.knot_spacing)?;
        positive("the reach (metres)", self.reach)?;
        positive("the noise of the odometry (metres)", self.odometry.translation)?;
        positive("the noise of the odometry (radians)", self.odometry.rotation)
    }
}
