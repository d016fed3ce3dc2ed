//! `submaps` of 3D: two grids and how scans are inserted into them.

use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// Submaps in 3D.
    Submaps3dOptions {
        /// Edge of a cell of the high-resolution grid. Raise it for less memory and time.
        high_resolution: f64 = 0.10, "m", Bounds::at_least(1e-3);
        /// Points farther than this from the scanner are not inserted into the high-resolution grid. Raise it
        /// for scanners that are dense far away.
        high_resolution_max_range: f64 = 20.0, "m", Bounds::above(0.0).or_infinite();
        /// Edge of a cell of the low-resolution grid. Raise it to catch poorer predictions.
        low_resolution: f64 = 0.45, "m", Bounds::at_least(1e-3);
        /// Number of scans after which the next submap is begun; a submap gets twice as many. Raise it for
        /// larger submaps, which are easier to recognise and drift more within.
        num_range_data: usize = 160, "scans", Bounds::at_least(1.0);
        /// How a scan is inserted into the grids.
        range_data_inserter: RangeDataInserter3dOptions = RangeDataInserter3dOptions::default();
    }
}

options! {
    /// Insertion into the grids of 3D.
    RangeDataInserter3dOptions {
        /// Occupancy probability that one hit stands for. Raise it when few scans see each place.
        hit_probability: f64 = 0.55, "probability", Bounds::between(0.5, 1.0);
        /// Occupancy probability that one passing ray stands for. Lower it so that objects that have moved
        /// away disappear sooner.
        miss_probability: f64 = 0.49, "probability", Bounds::between(0.0, 0.5);
        /// Cells in front of each hit that are marked as free. Raise it to clear more; the cost grows
        /// with it.
        num_free_space_voxels: usize = 2, "cells", Bounds::at_least(0.0);
        /// Intensities above this are not inserted. Raise it for scanners with a larger intensity scale.
        intensity_threshold: f32 = 40.0, "intensity", Bounds::ANY.or_infinite();
    }
}
