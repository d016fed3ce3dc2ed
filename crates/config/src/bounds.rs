//! Bounds of a number.

use std::fmt;

/// The values that a number may have. NaN is outside all bounds. Infinite values are outside unless
/// [`Bounds::or_infinite`] was called.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    min: f64,
    max: f64,
    min_open: bool,
    max_open: bool,
    infinite: bool,
}

impl Bounds {
    /// Any finite number; also used for options that are not numbers.
    pub const ANY: Self = Self {
        min: f64::NEG_INFINITY,
        max: f64::INFINITY,
        min_open: false,
        max_open: false,
        infinite: false,
    };
    /// A ratio or probability: 0 to 1, both included.
    pub const UNIT: Self = Self::within(0.0, 1.0);

    /// `min` or more.
    pub const fn at_least(min: f64) -> Self {
        Self { min, ..Self::ANY }
    }

    /// More than `min`.
    pub const fn above(min: f64) -> Self {
        Self { min, min_open: true, ..Self::ANY }
    }

    /// `min` to `max`, both included.
    pub const fn within(min: f64, max: f64) -> Self {
        Self { min, max, ..Self::ANY }
    }

    /// `min` to `max`, both excluded.
    pub const fn between(min: f64, max: f64) -> Self {
        Self { min, max, min_open: true, max_open: true, ..Self::ANY }
    }

    /// The same bounds; `math.huge` (or `-math.huge` if there is no lower bound) is allowed, too.
    pub const fn or_infinite(self) -> Self {
        Self { infinite: true, ..self }
    }

    /// Whether a value is within the bounds.
    pub fn contain(&self, value: f64) -> bool {
        let above = if self.min_open { value > self.min } else { value >= self.min };
        let below = if self.max_open { value < self.max } else { value <= self.max };
        above && below && (value.is_finite() || self.infinite)
    }

    /// Whether every finite number is allowed.
    pub fn is_any(&self) -> bool {
        self.min == f64::NEG_INFINITY && self.max == f64::INFINITY
    }
}

impl fmt::Display for Bounds {
    /// `>= 0`, `> 0`, `0 to 1`, `between 0.5 and 1 (both excluded)` …, with `or math.huge` where allowed.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (min, max) = (self.min, self.max);
        match (min.is_finite(), max.is_finite()) {
            (false, false) if self.infinite => return f.write_str("any number, also math.huge"),
            (false, false) => return f.write_str("any finite number"),
            (true, false) => write!(f, "{} {min}", if self.min_open { ">" } else { ">=" })?,
            (false, true) => write!(f, "{} {max}", if self.max_open { "<" } else { "<=" })?,
            (true, true) if self.min_open && self.max_open => {
                write!(f, "between {min} and {max} (both excluded)")?;
            }
            (true, true) => write!(f, "{min} to {max}")?,
        }
        if self.infinite { f.write_str(" or math.huge") } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_belong_to_closed_bounds_only() {
        assert!(Bounds::at_least(0.0).contain(0.0) && !Bounds::above(0.0).contain(0.0));
        assert!(Bounds::UNIT.contain(1.0) && !Bounds::between(0.5, 1.0).contain(1.0));
    }

    #[test]
    fn infinity_must_be_allowed_and_nan_never_is() {
        assert!(!Bounds::ANY.contain(f64::INFINITY));
        assert!(Bounds::above(0.0).or_infinite().contain(f64::INFINITY));
        assert!(!Bounds::above(0.0).or_infinite().contain(f64::NEG_INFINITY));
        assert!(!Bounds::ANY.or_infinite().contain(f64::NAN));
    }

    #[test]
    fn bounds_are_described_in_words() {
        assert_eq!(Bounds::at_least(1.0).to_string(), ">= 1");
        assert_eq!(Bounds::UNIT.to_string(), "0 to 1");
        assert_eq!(Bounds::between(0.5, 1.0).to_string(), "between 0.5 and 1 (both excluded)");
        assert_eq!(Bounds::above(0.0).or_infinite().to_string(), "> 0 or math.huge");
    }
}
