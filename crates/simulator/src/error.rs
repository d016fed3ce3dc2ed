//! Errors of simulations.

use portolan_worlds::WorldError;

/// Reasons why a scenario cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimulatorError {
    /// The world cannot be drawn.
    #[error(transparent)]
    World(#[from] WorldError),
    /// An option is out of bounds.
    #[error("{option} must be {bounds}, but is {value}")]
    OutOfBounds {
        /// Name of the option.
        option: &'static str,
        /// Allowed values.
        bounds: String,
        /// The given value.
        value: f64,
    },
    /// Two sensors would write to the same topic, or topics or frames have no name.
    #[error("{detail}")]
    BadNames {
        /// What to change.
        detail: String,
    },
    /// The text of a fault is not valid.
    #[error(
        "\"{text}\" is not a fault; write one of duplicate:SENSOR:N, backward:SENSOR:N:SECONDS, \
         gap:SENSOR:FROM:TO, nan:N, empty:N, jump:SECONDS:X:Y:YAW, no-gravity, clock:SENSOR:SECONDS, \
         no-tf:SENSOR, dies:SECONDS, saturate:GYROSCOPE:ACCELEROMETER, swap-axes, where SENSOR is scan, odom or imu and N is at least 2 (nan, empty: at least 1)"
    )]
    BadFault {
        /// The given text.
        text: String,
    },
    /// A fault of a sensor that is not recorded.
    #[error("the fault \"{text}\" has no effect: no {sensor} is recorded")]
    FaultWithoutSensor {
        /// The given text.
        text: String,
        /// The missing sensor.
        sensor: &'static str,
    },
    /// There is no path for the robot.
    #[error(
        "the robot fits at no junction of this building; use a smaller robot_radius or less clutter, \
         or give the plan junctions"
    )]
    NoPath,
}
