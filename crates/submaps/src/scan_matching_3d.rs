//! Builds 3D scan matchers from the options, and matches scans to the submap that is being filled
//! (`slam3d.md` §3).

use portolan_config::{
    CeresScanMatcher3dOptions, FastCorrelativeScanMatcher3dOptions, TrajectoryBuilder3dOptions,
};
use portolan_geometry::Rigid3;
use portolan_matching::{
    CloudInGrid, FastCorrelativeOptions3d, GradientMatch3d, GradientMatcher3d, GradientMatcherOptions3d,
    IntensityCostOptions, MatcherOptionError, RealTimeCorrelativeMatcher3d, RealTimeCorrelativeOptions,
};
use portolan_sensor::PointCloud;
use portolan_solver::SolverOptions;

use crate::Submap3d;

/// Correlative search around the prediction, if the options enable it, then descent along the gradient.
pub struct ScanMatcher3d {
    correlative: Option<RealTimeCorrelativeMatcher3d>,
    gradient: GradientMatcher3d,
}

impl ScanMatcher3d {
    /// With the options of local SLAM; weights that are not positive are an error.
    pub fn new(options: &TrajectoryBuilder3dOptions) -> Result<Self, MatcherOptionError> {
        let o = &options.real_time_correlative_scan_matcher;
        let correlative = options
            .use_online_correlative_scan_matching
            .then(|| {
                RealTimeCorrelativeMatcher3d::new(&RealTimeCorrelativeOptions {
                    linear_search_window: o.linear_search_window,
                    angular_search_window: o.angular_search_window,
                    translation_delta_cost_weight: o.translation_delta_cost_weight,
                    rotation_delta_cost_weight: o.rotation_delta_cost_weight,
                })
            })
            .transpose()?;
        let gradient = gradient_matcher_3d(&options.ceres_scan_matcher, options.use_intensities)?;
        Ok(Self { correlative, gradient })
    }

    /// The pose of the scan in the local map, and the result of the descent. Without a submap the result is
    /// the prediction.
    pub fn match_scan(
        &self,
        prediction: &Rigid3,
        [high, low]: [&PointCloud; 2],
        submap: Option<&Submap3d>,
    ) -> (Rigid3, Option<GradientMatch3d>) {
        let Some(submap) = submap else { return (*prediction, None) };
        let local_from_submap = submap.local_from_submap;
        let predicted = local_from_submap.inverse() * prediction;
        let searched = self
            .correlative
            .as_ref()
            .and_then(|m| m.match_scan(&predicted, high, &submap.high_resolution_grid));
        let initial = searched.map_or(predicted, |found| found.pose);
        let found = self.gradient.match_scan(
            predicted.translation.vector,
            &initial,
            &clouds_in_grids([high, low], submap),
        );
        (local_from_submap * found.pose, Some(found))
    }
}

/// The clouds of a scan with the grids they are matched with.
pub fn clouds_in_grids<'a>([high, low]: [&'a PointCloud; 2], submap: &'a Submap3d) -> [CloudInGrid<'a>; 2] {
    let intensities = submap.intensity_grid.as_ref();
    [
        CloudInGrid { cloud: high, grid: &submap.high_resolution_grid, intensities },
        CloudInGrid { cloud: low, grid: &submap.low_resolution_grid, intensities: None },
    ]
}

/// The gradient matcher that the options describe, for a fine and a coarse cloud.
///
/// # Errors
/// If a weight is not positive.
pub fn gradient_matcher_3d(
    options: &CeresScanMatcher3dOptions,
    use_intensities: bool,
) -> Result<GradientMatcher3d, MatcherOptionError> {
    let solver = &options.ceres_solver_options;
    let intensity = |o: &portolan_config::IntensityCostFunctionOptions| IntensityCostOptions {
        weight: o.weight,
        huber_scale: o.huber_scale,
        intensity_threshold: o.intensity_threshold,
    };
    let intensity_costs = match use_intensities {
        true => options.intensity_cost_functions().map(intensity).collect(),
        false => Vec::new(),
    };
    let options = GradientMatcherOptions3d {
        occupied_space_weights: options.occupied_space_weights().to_vec(),
        intensity_costs,
        translation_weight: options.translation_weight,
        rotation_weight: options.rotation_weight,
        only_optimize_yaw: options.only_optimize_yaw,
        solver: SolverOptions {
            max_num_iterations: u32::try_from(solver.max_num_iterations).unwrap_or(u32::MAX),
            use_nonmonotonic_steps: solver.use_nonmonotonic_steps,
            ..SolverOptions::default()
        },
    };
    GradientMatcher3d::new(&options, 2)
}

/// The settings of the search for constraints.
pub fn fast_matcher_options_3d(options: &FastCorrelativeScanMatcher3dOptions) -> FastCorrelativeOptions3d {
    let depth = |v: usize| u32::try_from(v).unwrap_or(u32::MAX);
    FastCorrelativeOptions3d {
        branch_and_bound_depth: depth(options.branch_and_bound_depth),
        full_resolution_depth: depth(options.full_resolution_depth),
        min_rotational_score: options.min_rotational_score,
        min_low_resolution_score: options.min_low_resolution_score,
        linear_xy_search_window: options.linear_xy_search_window,
        linear_z_search_window: options.linear_z_search_window,
        angular_search_window: options.angular_search_window,
    }
}
