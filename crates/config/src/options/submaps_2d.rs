//! `submaps` of 2D: grids and how scans are inserted into them.

use crate::bounds::Bounds;
use crate::define::{choices, options};

options! {
    /// Submaps in 2D.
    Submaps2dOptions {
        /// Number of scans after which the next submap is begun; a submap gets twice as many. Raise it for
        /// larger submaps, which are easier to recognise and drift more within.
        num_range_data: usize = 90, "scans", Bounds::at_least(1.0);
        /// Kind and cell size of the grid.
        grid_options_2d: GridOptions2d = GridOptions2d::default();
        /// How a scan is inserted into the grid.
        range_data_inserter: RangeDataInserter2dOptions = RangeDataInserter2dOptions::default();
    }
}

choices! {
    /// What the cells of a 2D grid hold.
    GridType2d {
        /// The probability of being occupied.
        ProbabilityGrid = "PROBABILITY_GRID",
        /// The truncated signed distance to the nearest surface, and a weight.
        Tsdf = "TSDF",
    }
}

options! {
    /// Kind and cell size of a 2D grid.
    GridOptions2d {
        /// What the cells hold; must fit `range_data_inserter_type`. Take TSDF for smooth surfaces from
        /// dense scans.
        grid_type: GridType2d = GridType2d::ProbabilityGrid, "", Bounds::ANY;
        /// Edge of a cell. Raise it for less memory and time and a coarser map.
        resolution: f32 = 0.05, "m", Bounds::at_least(1e-3);
    }
}

choices! {
    /// How scans are inserted into a 2D grid.
    RangeDataInserterType2d {
        /// Into a probability grid.
        ProbabilityGrid = "PROBABILITY_GRID_INSERTER_2D",
        /// Into a TSDF.
        Tsdf = "TSDF_INSERTER_2D",
    }
}

options! {
    /// How a scan is inserted into a 2D grid.
    RangeDataInserter2dOptions {
        /// Which of the two tables below is used; must fit `grid_type`.
        range_data_inserter_type: RangeDataInserterType2d = RangeDataInserterType2d::ProbabilityGrid, "", Bounds::ANY;
        /// Insertion into a probability grid.
        probability_grid_range_data_inserter: ProbabilityGridRangeDataInserter2dOptions =
            ProbabilityGridRangeDataInserter2dOptions::default();
        /// Insertion into a TSDF.
        tsdf_range_data_inserter: TsdfRangeDataInserter2dOptions = TsdfRangeDataInserter2dOptions::default();
    }
}

options! {
    /// Insertion into a probability grid.
    ProbabilityGridRangeDataInserter2dOptions {
        /// Mark the cells between sensor and hit as free. Turn it off when rays pass over obstacles.
        insert_free_space: bool = true, "", Bounds::ANY => optional;
        /// Occupancy probability that one hit stands for. Raise it when few scans see each place, so that
        /// walls become clear sooner.
        hit_probability: f64 = 0.55, "probability", Bounds::between(0.5, 1.0);
        /// Occupancy probability that one passing ray stands for. Lower it so that objects that have moved
        /// away disappear sooner.
        miss_probability: f64 = 0.49, "probability", Bounds::between(0.0, 0.5);
    }
}

options! {
    /// Insertion into a TSDF.
    TsdfRangeDataInserter2dOptions {
        /// Distances are truncated here, and only cells within this distance of a surface are changed. Raise
        /// it for noisy scanners.
        truncation_distance: f64 = 0.3, "m", Bounds::above(0.0);
        /// Maximum weight of a cell. Raise it to average longer, lower it to follow changes.
        maximum_weight: f64 = 10.0, "weight", Bounds::above(0.0);
        /// Change the cells between sensor and surface too. Turn it on to remove objects that have moved
        /// away.
        update_free_space: bool = false, "", Bounds::ANY;
        /// Estimation of surface normals from the scan.
        normal_estimation_options: NormalEstimation2dOptions = NormalEstimation2dOptions::default();
        /// Measure distances along the normal of the surface instead of along the ray. Turn it off when
        /// scans are too sparse for normals.
        project_sdf_distance_to_scan_normal: bool = true, "", Bounds::ANY;
        /// Weight of a hit falls with range to this power. Raise it when far hits are imprecise.
        update_weight_range_exponent: i32 = 0, "exponent", Bounds::ANY;
        /// Width of the kernel over the angle between ray and normal; 0: no such weighting. Raise it to
        /// trust grazing rays more.
        update_weight_angle_scan_normal_to_ray_kernel_bandwidth: f64 = 0.5, "rad", Bounds::at_least(0.0);
        /// Width of the kernel over the distance between cell and hit; 0: no such weighting. Raise it to
        /// let a hit count farther away.
        update_weight_distance_cell_to_hit_kernel_bandwidth: f64 = 0.5, "m", Bounds::at_least(0.0);
    }
}

options! {
    /// Estimation of surface normals in 2D.
    NormalEstimation2dOptions {
        /// Number of neighbouring points used for one normal. Raise it for noisy scanners.
        num_normal_samples: usize = 4, "points", Bounds::at_least(1.0);
        /// Points farther away than this are not neighbours. Raise it for sparse scans.
        sample_radius: f32 = 0.5, "m", Bounds::above(0.0);
    }
}
