//! The engine of scan matching: planes or grids.

use std::fmt;

use portolan_geometry::Dimension;

use crate::options::Options;

/// Duration of the scans to which range data are gathered if scans are matched to planes, seconds: one sweep
/// of most lidars.
const PLANES_SCAN_DURATION: f64 = 0.1;

/// The map representation to which scans are matched. In 2D there is only one engine, grids.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Engine {
    /// 3D: planes in voxels that are halved until their contents are flat; biases of the IMU are estimated.
    #[default]
    Planes,
    /// Occupancy grids, as in Cartographer.
    Grids,
}

impl fmt::Display for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Planes => "planes",
            Self::Grids => "grids",
        })
    }
}

impl Options {
    /// The engine of the options.
    pub fn engine(&self) -> Engine {
        let is_3d = self.map_builder.dimension() == Ok(Dimension::ThreeD);
        if is_3d && self.portolan.match_surfaces { Engine::Planes } else { Engine::Grids }
    }

    /// Sets the engine of 3D. With planes, scans are gathered to whole sweeps unless the options contain a
    /// duration.
    pub fn set_engine(&mut self, engine: Engine) {
        self.portolan.match_surfaces = engine == Engine::Planes;
        if engine == Engine::Grids {
            self.portolan.min_scan_duration = 0.0;
        } else if self.portolan.min_scan_duration <= 0.0 {
            self.portolan.min_scan_duration = PLANES_SCAN_DURATION;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_one_engine_in_2d_and_a_choice_in_3d() {
        for engine in [Engine::Planes, Engine::Grids] {
            let (mut in_2d, mut in_3d) = (Options::for_2d(), Options::for_3d());
            in_2d.set_engine(engine);
            in_3d.set_engine(engine);
            assert_eq!(in_2d.engine(), Engine::Grids);
            assert_eq!(in_3d.engine(), engine);
        }
    }

    #[test]
    fn files_choose_planes_by_default() {
        let of = |text: &str| Options::from_lua("robot.lua", text).unwrap().options;
        let robot = r#"include "map_builder.lua" include "trajectory_builder.lua"
            MAP_BUILDER.use_trajectory_builder_3d = true
            options = { map_builder = MAP_BUILDER, trajectory_builder = TRAJECTORY_BUILDER, map_frame = "map",
            tracking_frame = "imu", published_frame = "imu", odom_frame = "odom", provide_odom_frame = true,
            use_odometry = false, use_nav_sat = false, use_landmarks = false, num_laser_scans = 0,
            num_multi_echo_laser_scans = 0, num_subdivisions_per_laser_scan = 1, num_point_clouds = 1,
            lookup_transform_timeout_sec = 0.2, submap_publish_period_sec = 0.3, pose_publish_period_sec = 5e-3,
            trajectory_publish_period_sec = 30e-3, rangefinder_sampling_ratio = 1., odometry_sampling_ratio = 1.,
            fixed_frame_pose_sampling_ratio = 1., imu_sampling_ratio = 1., landmarks_sampling_ratio = 1. }"#;
        let chosen = of(&format!("{robot} return options"));
        assert_eq!(
            (chosen.engine(), chosen.portolan.min_scan_duration),
            (Engine::Planes, PLANES_SCAN_DURATION)
        );
        let grids = of(&format!("{robot} options.portolan = {{ match_surfaces = false }} return options"));
        assert_eq!(grids.engine(), Engine::Grids);
    }
}
