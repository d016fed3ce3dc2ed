//! What is made of what sensors say.

use portolan_config::PortolanOptions;

/// What is made of what sensors say; nothing by default, as in Cartographer, which takes it as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorPolicy {
    /// Biases of gyroscopes are estimated and taken away (in 3D, where heights are free).
    pub estimates_imu_biases: bool,
    /// An IMU whose mounting is estimated stays about as it was said to be mounted.
    pub holds_imu_mounting: bool,
    /// The frame of satellite fixes is put where all of them lie best, and they are weighed by how far they scatter about the
    /// trajectory; they are left out where they contradict it, or the robot moved too little for a heading.
    pub weighs_fixes_by_scatter: bool,
    /// Single satellite fixes that are far off count less.
    pub has_robust_fixes: bool,
    /// Where satellite fixes, but no IMU, tell which way is up, the start is about level.
    pub holds_start_level: bool,
}

impl SensorPolicy {
    /// As the options say.
    pub fn new(options: &PortolanOptions) -> Self {
        Self {
            estimates_imu_biases: options.estimates_imu_biases(),
            holds_imu_mounting: options.holds_imu_mounting(),
            weighs_fixes_by_scatter: options.weighs_fixes_by_scatter(),
            has_robust_fixes: options.has_robust_fixes(),
            holds_start_level: options.holds_start_level(),
        }
    }
}
