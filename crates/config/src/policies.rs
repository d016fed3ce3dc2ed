//! What options decide along with what they are for: one question, one answer.
//!
//! Cartographer takes what sensors say as it is, and searches as its options say. Settings that go beyond it, planes in 3D and
//! windows of loop closures that follow the drift in 2D, do otherwise.

use crate::options::PortolanOptions;

impl PortolanOptions {
    fn goes_beyond_cartographer(&self) -> bool {
        self.match_surfaces || self.loop_search_drift > 0.0
    }

    /// Whether biases of gyroscopes are estimated when optimising, and taken away.
    pub fn estimates_imu_biases(&self) -> bool {
        self.goes_beyond_cartographer()
    }

    /// Whether an IMU whose mounting is estimated stays about as it was said to be mounted.
    pub fn holds_imu_mounting(&self) -> bool {
        self.goes_beyond_cartographer()
    }

    /// Whether satellite fixes are weighed by how far they scatter about the trajectory, and left out where they contradict it.
    pub fn weighs_fixes_by_scatter(&self) -> bool {
        self.goes_beyond_cartographer()
    }

    /// Whether single satellite fixes that are far off count less.
    pub fn has_robust_fixes(&self) -> bool {
        self.goes_beyond_cartographer()
    }

    /// Whether the start is held about level where satellite fixes, but no IMU, tell which way is up.
    pub fn holds_start_level(&self) -> bool {
        self.goes_beyond_cartographer()
    }

    /// Whether a trajectory without a place in the rest is searched in whole parts of the map at once.
    pub fn searches_whole_maps(&self) -> bool {
        self.goes_beyond_cartographer()
    }

    /// Whether trajectories without a place in the map are searched as soon as nodes come, which planes leave time for.
    pub fn localises_while_recording(&self) -> bool {
        self.match_surfaces
    }

    /// Whether `max_constraint_distance` counts from where the nodes of a submap were taken, instead of from its origin.
    pub fn measures_distance_from_nodes(&self) -> bool {
        self.match_surfaces
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_cartographer_sensors_are_believed() {
        let (as_cartographer, mut with_drift) = (PortolanOptions::default(), PortolanOptions::default());
        with_drift.loop_search_drift = 0.04;
        let with_planes = PortolanOptions { match_surfaces: true, ..PortolanOptions::default() };
        for (options, is_beyond) in [(&as_cartographer, false), (&with_drift, true), (&with_planes, true)] {
            assert_eq!(options.estimates_imu_biases(), is_beyond);
            assert_eq!(options.weighs_fixes_by_scatter(), is_beyond);
            assert_eq!(options.searches_whole_maps(), is_beyond);
        }
        assert!(!with_drift.localises_while_recording() && with_planes.localises_while_recording());
    }
}
