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
        /// Largest fraction by which the score of a correlative match of local SLAM in 2D may be lowered because it
        /// is off the prediction. 1 is Cartographer's rule. Below 1 the gradient matcher is also held
        /// near what was found instead of near the prediction, so that high weights hold the pose
        /// that the scan does not constrain (along a corridor), and slipping wheels are still recognised
        /// where it does. Raise it when odometry is better than the scans.
        search_penalty_limit: f64 = 1.0, "fraction", Bounds::UNIT;
        /// In 2D: search for scans around their predictions as far as predictions were wrong lately, and as far
        /// as a robot can have gone where the scan contradicts the map. Off, windows are those of
        /// `real_time_correlative_scan_matcher`, as in Cartographer.
        adaptive_search: bool = false, "", Bounds::ANY;
        /// At the end, leave out loop closures that all others together contradict, and optimise once
        /// more. They are mostly matches shifted along corridors and between rooms that look alike.
        drop_contradicted_loop_closures: bool = true, "", Bounds::ANY;
        /// At the end, try so many pairs of nodes and submaps in all, however few `sampling_ratio` has
        /// picked: short recordings get enough loop closures that way. 0 tries no more, as in the
        /// reference; long recordings are beyond it anyway.
        min_loop_closure_searches: usize = 0, "pairs", Bounds::ANY;
        /// In 2D: loop closures are looked for as far around where a node is believed to be as local SLAM may
        /// have drifted since its submap was last seen: metres for each metre of the shortest path
        /// over trajectory and loop closures. 0 takes the windows of `fast_correlative_scan_matcher` instead, as
        /// Cartographer does. Raise it when a long path comes back to where it was and the loop is not closed.
        loop_search_drift: f64 = 0.0, "m/m", Bounds::within(0.0, 10.0);
        /// A node is looked for in a submap once in so many metres of path, however many scans
        /// that are. 0 takes `sampling_ratio` instead, as Cartographer does. Lower it when loops are missed.
        loop_search_spacing: f64 = 0.0, "m", Bounds::within(0.0, 1000.0);
        /// In 2D: fraction of the beams of a node that must end at something solid that the submap knows, for a
        /// loop closure to be believed; where scans explain less than 0.8 on the way, proportionally less. 0 asks only for the score, as Cartographer does. Lower it when loops
        /// are missed where scans overlap little.
        loop_min_explained: f64 = 0.0, "fraction", Bounds::UNIT;
        /// In 2D: fraction of the beams of a node that may contradict the submap, ending where it is free or
        /// passing through what is solid, in all beams about which it knows something; more where more is contradicted on the way. 1 does not look, as
        /// Cartographer. Lower it when wrong loop closures are made, raise it where much has moved.
        loop_max_contradiction: f64 = 1.0, "fraction", Bounds::UNIT;
        /// In 2D: where scans are more than 0.25 m apart a submap is full after a path of this length, too, however few
        /// scans it has. Lower it when scans are metres apart and the map bends within submaps. 0 counts only scans (`submaps.num_range_data`), as Cartographer does.
        submap_length: f64 = 0.0, "m", Bounds::within(0.0, 1000.0);
        /// In 2D: keep all scans in memory (four bytes a point), and draw the submaps again when the map is finished: each
        /// scan where it is then, its beams as sectors, so that far ones do not wipe out walls that were seen from
        /// nearby. Otherwise submaps stay as local SLAM drew them, as in Cartographer.
        redraw_submaps: bool = false, "", Bounds::ANY;
        /// In 2D: neighbouring returns that lie on one line with the one before or after them hit one surface, up to 0.8 m apart, and
        /// what lies between them is drawn, too. Otherwise far walls are rows of dots, as in Cartographer, and scans taken
        /// elsewhere fall between the dots. Turn it off where fences and rows of posts are taken for walls. `localize` does
        /// without.
        join_surfaces: bool = false, "", Bounds::ANY;
        /// Keep of each place the submap that saw it first and so many of the newest, and drop the others with their nodes, so
        /// that memory and time follow the area that is mapped and not how long it takes. 0 keeps everything.
        /// `map --lifelong` sets 4. Raise it when loops are missed in long recordings.
        submaps_per_place: usize = 0, "submaps", Bounds::ANY;
        /// Scans that must be found in whole submaps, all saying the same place within 0.5 m and 5 degrees
        /// and at least twice as many as say any other, before a trajectory is connected with another part
        /// of the map. 1 takes the first that is found, as Cartographer does. Raise it where places
        /// look alike.
        global_localization_min_matches: usize = 1, "scans", Bounds::at_least(1.0);
        /// In 2D: after so many seconds without a scan, and with neither odometry nor a gyroscope to
        /// measure the motion meanwhile, the robot is looked for at any angle and as far away as it can have
        /// gone, instead of going on from the old velocity. 0 never does that, as in Cartographer.
        /// Lower it when a hand-held scanner rotates fast between its scans.
        wide_search_after_gap: f64 = 0.5, "s", Bounds::at_least(0.0);
        /// 3D: match scans, and loop closures after they were found, to planes in voxels of submaps instead
        /// of to the cells of hybrid grids. Where surfaces are flat, poses come out several times more
        /// exact (corridor_imu: see BENCHMARKS.md). Biases of the IMU are estimated, too. `map --engine` sets it;
        /// a Lua configuration that does not name it has it on.
        match_surfaces: bool = false, "", Bounds::ANY;
        /// 3D: edge of the largest voxels for that; smaller ones down to a quarter are used where they are
        /// not flat. Raise it outside, where beams lie far apart.
        surface_voxel_size: f64 = 1.0, "m", Bounds::within(0.05, 100.0);
        /// 3D: gather range data to one scan until it spans about this long, in addition to
        /// `num_accumulated_range_data`. Raise it when a revolution of the scanner comes in pieces, or when
        /// several scanners take turns.
        min_scan_duration: f64 = 0.0, "s", Bounds::within(0.0, 10.0);
    }
}
