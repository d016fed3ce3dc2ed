//! `portolan`: options that only Portolan has.
//!
//! Adding one is one entry below: documentation, name, type, default, unit, bounds. It is then read from
//! files, set from the command line, checked, listed and documented; nothing else is to be touched.
//! Files keep these keys in a table `portolan` beside `map_builder`, which may be left out.

use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// Options that only Portolan has.
    PortolanOptions {
        /// Predict the motion between scans by integrating odometry over the gap instead of from its last
        /// velocity. Turn it off only to compare with Cartographer.
        use_all_odometry: bool = true, "", Bounds::ANY;
        /// In 2D, largest fraction by which the distance from the prediction may lower the score of a
        /// correlative match of local SLAM. 1 is Cartographer's rule. Below 1 the gradient matcher is also
        /// held near the result of the search instead of near the prediction: high weights then hold the pose
        /// where the scan does not constrain it (along a corridor), and slipping wheels are still recognised
        /// where it does. Raise it when odometry is better than the scans.
        search_penalty_limit: f64 = 1.0, "fraction", Bounds::UNIT;
        /// In 2D, adapt the window of the search around predictions to their recent errors, and widen it to
        /// the distance that the robot can have moved where a scan contradicts the map. Off, windows are
        /// those of `real_time_correlative_scan_matcher`, as in Cartographer.
        adaptive_search: bool = false, "", Bounds::ANY;
        /// At the end, leave out loop closures that all others together contradict, and optimise once more.
        /// Most of them are wrong matches, shifted along corridors or between rooms that look alike.
        drop_contradicted_loop_closures: bool = true, "", Bounds::ANY;
        /// Minimum number of pairs of nodes and submaps that are searched for loop closures. If
        /// `sampling_ratio` has selected fewer, the rest is searched at the end, so that short recordings get
        /// enough loop closures. 0 adds none, as in Cartographer; long recordings exceed it anyway.
        min_loop_closure_searches: usize = 0, "pairs", Bounds::ANY;
        /// In 2D, drift of local SLAM by which the search window of a loop closure grows, per metre of the
        /// shortest path over trajectory and loop closures since the submap was last seen. The window is
        /// around the estimated pose of the node. 0 uses the windows of `fast_correlative_scan_matcher`
        /// instead, as Cartographer does. Raise it when a long path returns to an earlier place and the loop
        /// is not closed.
        loop_search_drift: f64 = 0.0, "m/m", Bounds::within(0.0, 10.0);
        /// Path length after which a node is searched again in a submap, regardless of the number of scans. 0
        /// uses `sampling_ratio` instead, as Cartographer does. Lower it when loops are missed.
        loop_search_spacing: f64 = 0.0, "m", Bounds::within(0.0, 1000.0);
        /// In 2D, minimum fraction of the beams of a node that must end at something solid in the submap for
        /// a loop closure to be accepted; proportionally less if less than 0.8 of the beams are explained
        /// along the trajectory. 0 checks only the score, as Cartographer does. Lower it when loops are
        /// missed where scans overlap little.
        loop_min_explained: f64 = 0.0, "fraction", Bounds::UNIT;
        /// In 2D, maximum fraction of the beams of a node that may contradict the submap, by ending in free
        /// space or passing through something solid, of all beams in known cells; more if more is
        /// contradicted along the trajectory. 1 disables the check, as in Cartographer. Lower it when wrong
        /// loop closures are made, raise it where much has moved.
        loop_max_contradiction: f64 = 1.0, "fraction", Bounds::UNIT;
        /// In 2D, path length after which a submap is full, however few scans it has. It applies where scans
        /// are more than 0.25 m apart. Lower it when scans are metres apart and the map bends within submaps.
        /// 0 counts only scans (`submaps.num_range_data`), as Cartographer does.
        submap_length: f64 = 0.0, "m", Bounds::within(0.0, 1000.0);
        /// In 2D, insert all scans into their submaps again when the map is finished: each scan at its final
        /// pose, its beams as sectors, so that distant ones do not erase walls that were seen from nearby.
        /// This keeps all scans in memory (four bytes per point). Off, submaps stay as local SLAM made them,
        /// as in Cartographer.
        redraw_submaps: bool = false, "", Bounds::ANY;
        /// In 2D, fill the gaps between neighbouring returns of one surface, which are up to 0.8 m apart and
        /// on one line with the return before or after them. Off, far walls are rows of dots, as in
        /// Cartographer, and scans taken elsewhere fall between the dots. Turn it off where fences and rows
        /// of posts are taken for walls. `localize` does not use it.
        join_surfaces: bool = false, "", Bounds::ANY;
        /// Number of newest submaps of each place that are kept, besides the first; the others are dropped
        /// with their nodes, so that memory and time grow with the mapped area and not with the duration. 0
        /// keeps everything. `map --lifelong` sets 4. Raise it when loops are missed in long recordings.
        submaps_per_place: usize = 0, "submaps", Bounds::ANY;
        /// Number of scans that must be matched in whole submaps before a trajectory is connected with
        /// another part of the map. They must agree on one pose within 0.5 m and 5 degrees, and be at least
        /// twice as many as those that agree on any other pose. 1 accepts the first match, as Cartographer
        /// does. Raise it where places look alike.
        global_localization_min_matches: usize = 1, "scans", Bounds::at_least(1.0);
        /// In 2D, time without a scan after which the pose is searched at any heading and as far away as the
        /// robot can have moved, instead of being predicted from the old velocity; only if neither odometry
        /// nor a gyroscope measured the motion. 0 disables it, as in Cartographer. Lower it when a hand-held
        /// scanner rotates fast between its scans.
        wide_search_after_gap: f64 = 0.5, "s", Bounds::at_least(0.0);
        /// In 3D, match scans to planes in voxels of submaps instead of to the cells of hybrid grids; loop
        /// closures that were found are refined by it, too. Where surfaces are flat, poses are several times
        /// more accurate (corridor_imu: see BENCHMARKS.md). Biases of the IMU are estimated, too. `map
        /// --engine` sets it; with a Lua configuration that does not set it, it is on.
        match_surfaces: bool = false, "", Bounds::ANY;
        /// In 3D, edge of the largest voxels of `match_surfaces`; smaller ones down to a quarter are used
        /// where surfaces are not flat. Raise it outdoors, where beams are far apart.
        surface_voxel_size: f64 = 1.0, "m", Bounds::within(0.05, 100.0);
        /// In 3D, accumulate range data to one scan until it spans about this time, in addition to
        /// `num_accumulated_range_data`. Raise it when a revolution of the scanner is split over several
        /// messages, or when several scanners take turns.
        min_scan_duration: f64 = 0.0, "s", Bounds::within(0.0, 10.0);
    }
}
