//! Options of continuous-time refinement.

use portolan_geometry::{Rigid3, Vector3, rotation_between};

use super::{DenseTrajectory, OdometryNoise, OtherSensorsFound};
use crate::{MotionSensors, RefineError};

/// Options of continuous-time refinement. The defaults are meant for every recording; nothing needs to be
/// tuned.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ContinuousOptions {
    /// Length of the windows within which the input shows a wall as one sheet, seconds. Longer for slow
    /// scanners, shorter for an input with errors from one second to the next.
    pub window: f64,
    /// Final spacing of the knots, seconds. A shorter one follows faster errors, if there are enough points.
    pub knot_spacing: f64,
    /// Largest initial distance of surfaces because of drift, metres.
    pub reach: f64,
    /// Noise of the motion of the input at the start; later it is estimated.
    pub odometry: OdometryNoise,
    /// Maximum number of rounds of fine stages.
    pub max_rounds: usize,
    /// Whether extrinsics and clocks of all lidars but the first are solved for.
    pub calibrate_lidars: bool,
    /// The gauge of the result.
    pub gauge: Gauge,
}

/// The gauge: pose of the whole result, which points do not determine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Gauge {
    /// The first pose is that of the input.
    #[default]
    FirstPose,
    /// Position and heading of the first pose are those of the input, and z points up according to the
    /// accelerometer.
    Gravity,
    /// In the frame of the fixes: z up, the first fix at the origin.
    Fixes,
}

impl Gauge {
    /// # Errors
    /// Fails if the sensors do not determine it.
    pub(crate) fn check(self, sensors: &MotionSensors) -> Result<(), RefineError> {
        let missing = match self {
            Self::Gravity if sensors.imu().is_empty() => {
                "the result can only be aligned with gravity if there is an IMU"
            }
            Self::Fixes if sensors.fixes().is_empty() => {
                "there are no satellite fixes to align the result with"
            }
            _ => return Ok(()),
        };
        Err(RefineError::Option(missing.to_owned()))
    }

    /// Moves the whole trajectory according to the gauge. It begins at the first pose of the input; gravity
    /// and fixes were estimated before it was moved there by `anchor`.
    pub(crate) fn apply(
        self,
        trajectory: &mut DenseTrajectory,
        anchor: &Rigid3,
        found: &OtherSensorsFound,
        world_from_fixed: Option<&Rigid3>,
    ) {
        match (self, found.gravity_in_world, world_from_fixed) {
            (Self::Gravity, Some(up), _) => {
                let first = trajectory.pose(0.0).translation;
                let level = rotation_between(&(anchor.rotation * Vector3::from(up)), &Vector3::z());
                trajectory.move_whole(&(first * level * first.inverse()));
            }
            (Self::Fixes, _, Some(world_from_fixed)) => {
                trajectory.move_whole(&(anchor * world_from_fixed).inverse());
            }
            _ => {}
        }
    }
}

impl Default for ContinuousOptions {
    fn default() -> Self {
        Self {
            window: 2.0,
            knot_spacing: 0.1,
            reach: 2.0,
            odometry: OdometryNoise { translation: 0.05, rotation: 0.5_f64.to_radians() },
            max_rounds: 8,
            calibrate_lidars: false,
            gauge: Gauge::FirstPose,
        }
    }
}

/// Shortest window, seconds. Shorter windows and spacings of knots resolve nothing in sweeps of a tenth of a
/// second, and cause more unknowns than fit into memory.
const SHORTEST_WINDOW: f64 = 0.01;
/// Shortest spacing of knots, seconds.
const SHORTEST_SPACING: f64 = 0.001;
/// Lower bound of lengths and angles, metres or radians: no measurement is more accurate.
const LEAST: f64 = 1e-9;

impl ContinuousOptions {
    /// # Errors
    /// Fails for invalid values.
    pub(crate) fn check(&self) -> Result<(), RefineError> {
        let within = |name: &str, value: f64, least: f64| {
            if (least..=1e6).contains(&value) {
                return Ok(());
            }
            Err(RefineError::Option(format!("{name} must be from {least} to 1000000, but is {value}")))
        };
        within("the window (seconds)", self.window, SHORTEST_WINDOW)?;
        within("the spacing of knots (seconds)", self.knot_spacing, SHORTEST_SPACING)?;
        within("the reach (metres)", self.reach, LEAST)?;
        within("the noise of the odometry (metres)", self.odometry.translation, LEAST)?;
        within("the noise of the odometry (radians)", self.odometry.rotation, LEAST)
    }
}
