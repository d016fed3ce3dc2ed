//! Parameters of semi-rigid refinement.

use crate::RefineError;
use crate::continuous::OdometryNoise;

/// Shortest element, seconds: the spacing at which poses are kept.
const SHORTEST_ELEMENT: f64 = 0.005;

/// Parameters as in the paper.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct SemiRigidOptions {
    /// Seconds of one element of the trajectory (a profile, a packet, or whole sweeps for the coarse mode).
    pub element: f64,
    /// Number of elements from one section to the next.
    pub interval: usize,
    /// Number of elements on each side of the middle of a section whose points it holds.
    pub half_width: usize,
    /// Edge of the voxels of which one point is kept, metres.
    pub voxel: f64,
    /// Maximum number of iterations of the registration of the sections.
    pub rigid_iterations: usize,
    /// Number of pairs above which two sections are linked.
    pub min_pairs: usize,
    /// Maximum distance of the points of a pair, metres.
    pub max_distance: f64,
    /// Minimum number of elements between the times of paired points.
    pub time_window: usize,
    /// Number of outer iterations: sections are made and registered, and elements solved for.
    pub outer_iterations: usize,
    /// Noise of the motion of the input.
    pub odometry: OdometryNoise,
}

impl Default for SemiRigidOptions {
    fn default() -> Self {
        Self {
            element: 1.0 / 120.0,
            interval: 300,
            half_width: 150,
            voxel: 0.10,
            rigid_iterations: 20,
            min_pairs: 400,
            max_distance: 0.5,
            time_window: 180,
            outer_iterations: 1,
            odometry: OdometryNoise { translation: 0.05, rotation: 0.5_f64.to_radians() },
        }
    }
}

impl SemiRigidOptions {
    /// The coarse mode: the smallest element is two sweeps of `sweep_seconds`. Sections and the time window
    /// keep their durations.
    pub fn coarse(self, sweep_seconds: f64) -> Self {
        let element = 2.0 * sweep_seconds;
        let elements = |count: usize| (count as f64 * self.element / element).ceil().max(1.0) as usize;
        let half_width = elements(self.half_width);
        let interval = elements(self.interval).min(2 * half_width);
        Self { element, interval, half_width, time_window: elements(self.time_window), ..self }
    }

    /// Checks the options.
    ///
    /// # Errors
    /// The first invalid option.
    pub(super) fn check(&self) -> Result<(), RefineError> {
        let sensible =
            [self.element, self.voxel, self.max_distance, self.odometry.translation, self.odometry.rotation]
                .iter()
                .all(|v| *v > 0.0 && *v < 1e6);
        if !sensible || self.interval == 0 {
            return Err(RefineError::Option(
                "element, interval, voxel, pair distance and odometry noise must be above 0".to_owned(),
            ));
        }
        if self.element < SHORTEST_ELEMENT {
            return Err(RefineError::Option(format!(
                "an element must last at least {SHORTEST_ELEMENT} s, but is {} s",
                self.element
            )));
        }
        if 2 * self.half_width < self.interval {
            return Err(RefineError::Option(format!(
                "with a half width of {} elements sections every {} elements leave gaps; it must be at least half of that",
                self.half_width, self.interval
            )));
        }
        Ok(())
    }
}
