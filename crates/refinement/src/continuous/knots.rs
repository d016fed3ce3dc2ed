//! Knots at equal steps of time, between which an increment is linear.

/// Knots from second 0 to the end of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knots {
    spacing: f64,
    count: usize,
}

impl Knots {
    /// Knots about `spacing` seconds apart over `duration` seconds; at least two.
    pub fn new(duration: f64, spacing: f64) -> Self {
        let intervals = (duration / spacing).ceil().max(1.0);
        Self { spacing: duration / intervals, count: intervals as usize + 1 }
    }

    /// Number of knots.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Seconds between two knots.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    /// Time of a knot, seconds.
    pub fn seconds(&self, knot: usize) -> f64 {
        knot as f64 * self.spacing
    }

    /// The knot before a time and the position between it and the next, 0 to 1; clamped to the span.
    #[inline]
    pub fn place(&self, seconds: f64) -> (usize, f64) {
        let at = (seconds / self.spacing).clamp(0.0, (self.count - 1) as f64);
        let knot = (at as usize).min(self.count - 2);
        (knot, at - knot as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_clamped() {
        let knots = Knots::new(10.0, 3.0);
        assert_eq!((knots.count(), knots.spacing()), (5, 2.5));
        assert_eq!((knots.place(-1.0), knots.place(10.0), knots.place(99.0)), ((0, 0.0), (3, 1.0), (3, 1.0)));
        assert_eq!(knots.place(3.75), (1, 0.5));
    }
}
