//! What can be wrong with a request.

use portolan_worlds::WorldError;

/// Why nothing could be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimulatorError {
    /// The world cannot be drawn.
    #[error(transparent)]
    World(#[from] WorldError),
    /// An option is out of bounds.
    #[error("{option} must be {bounds}, but is {value}")]
    OutOfBounds {
        /// Which option.
        option: &'static str,
        /// What is allowed.
        bounds: String,
        /// What was given.
        value: f64,
    },
    /// Two sensors would write to the same topic, or topics or frames have no name.
    #[error("{detail}")]
    BadNames {
        /// What to change.
        detail: String,
    },
    /// A fault could not be understood.
    #[error(
        "\"{text}\" is not a fault; write one of duplicate:SENSOR:N, backward:SENSOR:N:SECONDS, \
         gap:SENSOR:FROM:TO, nan:N, empty:N, jump:SECONDS:X:Y:YAW, no-gravity, clock:SENSOR:SECONDS, \
         no-tf:SENSOR, dies:SECONDS, saturate:GYROSCOPE:ACCELEROMETER, swap-axes, where SENSOR is scan, odom or imu and N is at least 2 (nan, empty: at least 1)"
    )]
    BadFault {
        /// What was given.
        text: String,
    },
    /// A fault of a sensor that is not there.
    #[error("the fault \"{text}\" has no effect: no {sensor} is recorded")]
    FaultWithoutSensor {
        /// What was given.
        text: String,
        /// What is missing.
        sensor: &'static str,
    },
    /// The robot fits nowhere.
    #[error(
        "the robot fits at no junction of this building; use a smaller robot_radius or less clutter, \
         or give the plan junctions"
    )]
    NoWay,
}
