//! Checks the bounds of all values, and options that must be consistent with each other.

use portolan_geometry::Dimension;

use crate::catalogue::walk;
use crate::error::ConfigError;
use crate::node::{NodeRef, Section};
use crate::options::{
    GridType2d, MapBuilderOptions, MapBuilderServerOptions, Options, RangeDataInserterType2d,
};
use crate::value::Value;

/// Errors in a tree, separated by whether they matter.
#[derive(Clone, Debug, Default)]
pub(crate) struct Findings {
    /// Errors that make the configuration unusable.
    pub errors: Vec<ConfigError>,
    /// Errors in tables that the chosen dimension does not use.
    pub unused: Vec<ConfigError>,
}

impl MapBuilderOptions {
    /// The selected dimension; exactly one must be selected.
    ///
    /// # Errors
    /// If both are selected, or none is.
    pub fn dimension(&self) -> Result<Dimension, ConfigError> {
        match (self.use_trajectory_builder_2d, self.use_trajectory_builder_3d) {
            (true, false) => Ok(Dimension::TwoD),
            (false, true) => Ok(Dimension::ThreeD),
            (two, _) => Err(ConfigError::Inconsistent {
                paths: vec![
                    "map_builder.use_trajectory_builder_2d".to_owned(),
                    "map_builder.use_trajectory_builder_3d".to_owned(),
                ],
                message: format!(
                    "exactly one of map_builder.use_trajectory_builder_2d and use_trajectory_builder_3d must \
                     be true, but {} are",
                    if two { "both" } else { "none" }
                ),
            }),
        }
    }
}

impl Options {
    /// Checks every value against its bounds, and the consistency of the options. Tables of the dimension
    /// that is not in use are not checked.
    ///
    /// # Errors
    /// All errors.
    pub fn validate(&self) -> Result<(), Vec<ConfigError>> {
        let errors = self.findings().errors;
        if errors.is_empty() { Ok(()) } else { Err(errors) }
    }

    pub(crate) fn findings(&self) -> Findings {
        let dimension = self.map_builder.dimension();
        let mut findings = bounds_findings(self, dimension.as_ref().ok().copied());
        match dimension {
            Ok(Dimension::TwoD) => self.check_2d(&mut findings.errors),
            Ok(Dimension::ThreeD) => {
                let local = &self.trajectory_builder.trajectory_builder_3d;
                let table = "trajectory_builder.trajectory_builder_3d";
                check_order(&mut findings.errors, table, "range", local.min_range, local.max_range);
            }
            Err(error) => findings.errors.push(error),
        }
        self.check_sensors(&mut findings.errors);
        findings
    }

    fn check_2d(&self, errors: &mut Vec<ConfigError>) {
        const TABLE: &str = "trajectory_builder.trajectory_builder_2d";
        let builder = &self.trajectory_builder.trajectory_builder_2d;
        check_order(errors, TABLE, "range", builder.min_range, builder.max_range);
        check_order(errors, TABLE, "z", builder.min_z, builder.max_z);
        if builder.pose_extrapolator.use_imu_based {
            errors.push(ConfigError::Inconsistent {
                paths: vec![format!("{TABLE}.pose_extrapolator.use_imu_based")],
                message: format!("{TABLE}.pose_extrapolator.use_imu_based must be false in 2D"),
            });
        }
        let grid = builder.submaps.grid_options_2d.grid_type;
        let inserter = builder.submaps.range_data_inserter.range_data_inserter_type;
        let fits = matches!(
            (grid, inserter),
            (GridType2d::ProbabilityGrid, RangeDataInserterType2d::ProbabilityGrid)
                | (GridType2d::Tsdf, RangeDataInserterType2d::Tsdf)
        );
        if !fits {
            let paths = [
                format!("{TABLE}.submaps.grid_options_2d.grid_type"),
                format!("{TABLE}.submaps.range_data_inserter.range_data_inserter_type"),
            ];
            let message = format!(
                "{} = \"{}\" does not fit {} = \"{}\"; take PROBABILITY_GRID with \
                 PROBABILITY_GRID_INSERTER_2D or TSDF with TSDF_INSERTER_2D",
                paths[0],
                grid.name(),
                paths[1],
                inserter.name()
            );
            errors.push(ConfigError::Inconsistent { paths: paths.to_vec(), message });
        }
    }

    fn check_sensors(&self, errors: &mut Vec<ConfigError>) {
        let bridge = &self.bridge;
        if bridge.num_laser_scans == 0
            && bridge.num_multi_echo_laser_scans == 0
            && bridge.num_point_clouds == 0
        {
            let paths = ["num_laser_scans", "num_multi_echo_laser_scans", "num_point_clouds"];
            errors.push(ConfigError::Inconsistent {
                paths: paths.map(str::to_owned).to_vec(),
                message: format!("at least one of {} must be 1 or more", paths.join(", ")),
            });
        }
    }
}

/// The minimum of a range must be below its maximum.
fn check_order(errors: &mut Vec<ConfigError>, table: &str, what: &str, min: f32, max: f32) {
    if min < max || min.is_nan() || max.is_nan() {
        return;
    }
    let paths = ["min", "max"].map(|end| format!("{table}.{end}_{what}"));
    let message =
        format!("`{}` = {min} must be less than `{}` = {max}: nothing lies between them", paths[0], paths[1]);
    errors.push(ConfigError::Inconsistent { paths: paths.to_vec(), message });
}

impl MapBuilderServerOptions {
    /// Checks every value against its bounds, and the consistency of the options.
    ///
    /// # Errors
    /// All errors.
    pub fn validate(&self) -> Result<(), Vec<ConfigError>> {
        let errors = self.findings().errors;
        if errors.is_empty() { Ok(()) } else { Err(errors) }
    }

    pub(crate) fn findings(&self) -> Findings {
        let dimension = self.map_builder.dimension();
        let mut findings = bounds_findings(self, dimension.as_ref().ok().copied());
        findings.errors.extend(dimension.err());
        findings
    }
}

fn bounds_findings(section: &dyn Section, dimension: Option<Dimension>) -> Findings {
    let mut findings = Findings::default();
    walk(section, &mut |visit| {
        let NodeRef::Leaf(leaf) = &visit.node else { return };
        let Value::Number(value) = leaf.to_value() else { return };
        if !visit.present || visit.spec.bounds.contain(value) {
            return;
        }
        let error = ConfigError::OutOfBounds {
            path: visit.path.to_owned(),
            value,
            bounds: visit.spec.bounds,
            place: None,
        };
        let unused = dimension.is_some_and(|dimension| !is_used(visit.path, dimension));
        if unused { &mut findings.unused } else { &mut findings.errors }.push(error);
    });
    findings
}

/// Whether a dimension uses an option, by the tables that contain it.
fn is_used(path: &str, dimension: Dimension) -> bool {
    const MATCHERS_2D: [&str; 2] = ["fast_correlative_scan_matcher", "ceres_scan_matcher"];
    let in_constraints = path.contains(".constraint_builder.");
    !path.split('.').any(|segment| match dimension {
        Dimension::TwoD => segment.ends_with("_3d") && segment != "use_trajectory_builder_3d",
        Dimension::ThreeD => {
            segment == "trajectory_builder_2d"
                || segment == "overlapping_submaps_trimmer_2d"
                || (in_constraints && MATCHERS_2D.contains(&segment))
        }
    })
}
