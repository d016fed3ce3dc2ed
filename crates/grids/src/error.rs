//! Errors of grids and inserters.

use thiserror::Error;

/// Error of making or growing a grid.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum GridError {
    /// Limits that describe no grid.
    #[error(
        "a grid of {num_x_cells}×{num_y_cells} cells of {resolution} m with corner ({max_x}, {max_y}) is \
         not possible: sizes must be positive and numbers finite"
    )]
    InvalidLimits {
        /// Edge of a cell, metres.
        resolution: f64,
        /// Corner with the largest coordinates, metres.
        max_x: f64,
        /// Corner with the largest coordinates, metres.
        max_y: f64,
        /// Cells along −y.
        num_x_cells: i64,
        /// Cells along −x.
        num_y_cells: i64,
    },
    /// An invalid edge of a cell in 3D.
    #[error("cells with an edge of {0} m are not possible: it must be positive and finite")]
    InvalidResolution(f32),
    /// The grid would need more cells than allowed.
    #[error(
        "a point at ({x} m, {y} m) needs a grid of more than {max_cells} cells: check the sensor's \
         maximum range and the poses, or allow more cells"
    )]
    TooLarge {
        /// Coordinate of the point, metres.
        x: f32,
        /// Coordinate of the point, metres.
        y: f32,
        /// The limit.
        max_cells: usize,
    },
    /// A list of cells does not fit the limits.
    #[error("the grid has {expected} cells but {found} {what} are given: the map is damaged")]
    CellCount {
        /// Name of the list.
        what: &'static str,
        /// Product of the sizes.
        expected: u64,
        /// Length of the list.
        found: usize,
    },
    /// The bounds of the cell values are not usable.
    #[error("cell values from {lower} to {upper} ({what}) are not a range: the map is damaged")]
    InvalidBounds {
        /// Name of the bounds.
        what: &'static str,
        /// Given lower bound.
        lower: f32,
        /// Given upper bound.
        upper: f32,
    },
    /// The origin of a scan is not finite, or too far away for a grid in 3D.
    #[error("the origin of the range data is ({x}, {y}, {z}): it must be finite and within the grid")]
    InvalidOrigin {
        /// Metres.
        x: f32,
        /// Metres.
        y: f32,
        /// Metres.
        z: f32,
    },
}

/// Error of the options of an inserter.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum InserterOptionError {
    /// A hit must make a cell more likely occupied.
    #[error("hit_probability is {0}: it must be above 0.5 and below 1")]
    HitProbability(f64),
    /// A miss must make a cell less likely occupied.
    #[error("miss_probability is {0}: it must be below 0.5 and above 0")]
    MissProbability(f64),
    /// A length or weight that must be positive.
    #[error("{name} is {value}: it must be positive and finite")]
    NotPositive {
        /// Name of the option.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// A number that must not be negative.
    #[error("{name} is {value}: it must be finite and not negative")]
    Negative {
        /// Name of the option.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}

impl InserterOptionError {
    /// Checks the probabilities of hits and misses.
    pub(crate) fn check_probabilities(hit: f64, miss: f64) -> Result<(), Self> {
        if !(hit > 0.5 && hit < 1.0) {
            return Err(Self::HitProbability(hit));
        }
        if !(miss < 0.5 && miss > 0.0) {
            return Err(Self::MissProbability(miss));
        }
        Ok(())
    }
}
