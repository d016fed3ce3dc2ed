//! How the optimisation uses other sensors.

use portolan_config::PortolanOptions;

/// How the optimisation uses other sensors; by default as Cartographer does, which takes measurements as they
/// are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorPolicy {
    /// Biases of gyroscopes are estimated and removed (in 3D, where heights are free).
    pub estimates_imu_biases: bool,
    /// An IMU whose mounting is estimated stays close to the given mounting.
    pub holds_imu_mounting: bool,
    /// The frame of satellite fixes is fitted to all of them, and they are weighted by their scatter about
    /// the trajectory; they are left out where they contradict it, or the robot moved too little for a
    /// heading.
    pub weighs_fixes_by_scatter: bool,
    /// Single satellite fixes with large errors get less weight (robust loss).
    pub has_robust_fixes: bool,
    /// Where satellite fixes, but no IMU, determine the vertical, the start is assumed to be about level.
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
