//! `portolan`: options that only Portolan has.
//!
//! Adding one is one entry below: documentation, name, type, default, unit, bounds. It is then read from
//! files, set from the command line, checked, listed and documented; nothing else is to be touched.
//! Files keep these keys in a table `portolan` beside `map_builder`, which may be left out.

use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// What Portolan does beyond the options that Cartographer's files know.
    PortolanOptions {
        /// Predict the motion between scans by integrating odometry over the gap instead of from its last
        /// velocity. Turn it off only to compare with Cartographer.
        use_all_odometry: bool = true, "", Bounds::ANY;
        /// Largest share by which the score of a correlative match of local SLAM in the plane may be lowered because it
        /// is off the prediction. 1 is the reference's rule. Below 1 the gradient matcher is also held
        /// near what was found instead of near the prediction, so that high weights hold the pose
        /// where the scan tells nothing (along a corridor), and slipping wheels are still recognised where
        /// it does. Raise it when odometry is better than the scans.
        search_penalty_limit: f64 = 1.0, "share", Bounds::UNIT;
        /// At the end, leave out loop closures that all others together contradict, and optimise once
        /// more. They are mostly matches shifted along corridors and between rooms that look alike.
        drop_contradicted_loop_closures: bool = true, "", Bounds::ANY;
        /// At the end, try so many pairs of nodes and submaps in all, however few `sampling_ratio` has
        /// picked: short recordings get enough loop closures that way. 0 tries no more, as in the
        /// reference; long recordings are beyond it anyway.
        min_loop_closure_searches: usize = 0, "pairs", Bounds::ANY;
        /// Scans that must be found in whole submaps, all saying the same place within 0.5 m and 5 degrees
        /// and at least twice as many as say any other, before a trajectory is connected with another part
        /// of the map. 1 takes the first that is found, as the reference does. Raise it where places
        /// look alike.
        global_localization_min_matches: usize = 1, "scans", Bounds::at_least(1.0);
        /// In the plane: after so many seconds without a scan, and with neither odometry nor a gyroscope to tell
        /// what happened meanwhile, the robot is looked for at any angle and as far away as it can have
        /// gone, instead of going on from the old velocity. 0 never does that, as in the reference.
        /// Lower it when a hand-held scanner turns fast between its scans.
        wide_search_after_gap: f64 = 0.5, "s", Bounds::at_least(0.0);
        /// 3D: match scans, and loop closures after they were found, to planes in voxels of submaps instead
        /// of to the cells of hybrid grids. Where surfaces are flat, poses come out several times more
        /// exact (corridor_imu: see BENCHMARKS.md). Biases of the IMU are estimated, too. On
        /// unless a configuration is given, which means the reference's way.
        match_surfaces: bool = false, "", Bounds::ANY;
        /// 3D: edge of the largest voxels for that; smaller ones down to a quarter are used where they are
        /// not flat. Raise it outside, where beams lie far apart.
        surface_voxel_size: f64 = 1.0, "m", Bounds::within(0.05, 100.0);
        /// 3D: gather range data to one scan until it spans about this long, in addition to
        /// `num_accumulated_range_data`. Raise it when a turn of the scanner comes in pieces, or when
        /// several scanners take turns.
        min_scan_duration: f64 = 0.0, "s", Bounds::within(0.0, 10.0);
    }
}
