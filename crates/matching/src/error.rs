//! Errors of matcher options.

use thiserror::Error;

/// Error of the options of a matcher.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum MatcherOptionError {
    /// A weight or length that must be positive.
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
    /// A depth out of its bounds.
    #[error("{name} is {value}: it must be between 1 and {max}")]
    Depth {
        /// Name of the option.
        name: &'static str,
        /// Its value.
        value: u32,
        /// The largest value.
        max: u32,
    },
    /// One value per item is needed.
    #[error("{name} is given {found} times: it must be given {expected} times")]
    Count {
        /// Name of the option.
        name: &'static str,
        /// The number needed.
        expected: usize,
        /// The number given.
        found: usize,
    },
    /// A grid in 3D larger than any scan can fill.
    #[error("the grid has known cells in more than a million blocks of 4x4x4: it is damaged")]
    TooManyVoxels,
}

impl MatcherOptionError {
    /// Checks options that must be positive.
    pub(crate) fn check_positive(options: &[(&'static str, f64)]) -> Result<(), Self> {
        match options.iter().find(|(_, v)| !(*v > 0.0 && v.is_finite())) {
            Some((name, value)) => Err(Self::NotPositive { name, value: *value }),
            None => Ok(()),
        }
    }

    /// Checks options that must not be negative.
    pub(crate) fn check_not_negative(options: &[(&'static str, f64)]) -> Result<(), Self> {
        match options.iter().find(|(_, v)| !(*v >= 0.0 && v.is_finite())) {
            Some((name, value)) => Err(Self::Negative { name, value: *value }),
            None => Ok(()),
        }
    }
}
