//! Decisions that follow from options beyond their main purpose, each defined in one place.
//!
//! Cartographer uses sensor data without corrections and searches as its options specify. Settings that go
//! beyond it (planes in 3D, and windows of loop closures that follow the drift in 2D) behave differently.

use crate::options::PortolanOptions;

impl PortolanOptions {
    fn extends_cartographer(&self) -> bool {
        self.match_surfaces || self.loop_search_drift > 0.0
    }

    /// Whether biases of gyroscopes are estimated in the optimisation and subtracted.
    pub fn estimates_imu_biases(&self) -> bool {
        self.extends_cartographer()
    }

    /// Whether the estimated mounting of an IMU is kept close to the mounting given by the user.
    pub fn holds_imu_mounting(&self) -> bool {
        self.extends_cartographer()
    }

    /// Whether satellite fixes are weighted by their scatter about the trajectory, and left out where they
    /// contradict it.
    pub fn weighs_fixes_by_scatter(&self) -> bool {
        self.extends_cartographer()
    }

    /// Whether single satellite fixes with large errors have less weight.
    pub fn has_robust_fixes(&self) -> bool {
        self.extends_cartographer()
    }

    /// Whether the start is held approximately level if there are satellite fixes, but no IMU to measure the
    /// vertical.
    pub fn holds_start_level(&self) -> bool {
        self.extends_cartographer()
    }

    /// Whether a trajectory that is not connected to the rest of the map is searched in whole parts of the
    /// map at once.
    pub fn searches_whole_maps(&self) -> bool {
        self.extends_cartographer()
    }

    /// Whether trajectories that are not connected to the map are searched as soon as nodes are added;
    /// matching to planes leaves time for it.
    pub fn localises_while_recording(&self) -> bool {
        self.match_surfaces
    }

    /// Whether `max_constraint_distance` is measured from the positions of the nodes of a submap, instead of
    /// from its origin.
    pub fn measures_distance_from_nodes(&self) -> bool {
        self.match_surfaces
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cartographer_policy_trusts_sensors() {
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
