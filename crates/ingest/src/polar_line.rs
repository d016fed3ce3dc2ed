//! Fits lines to neighbouring readings of a planar scanner.
//!
//! In polar coordinates a line is 1 / r = a cos φ + b sin φ, linear in a and b. With noise of σ on each range
//! r the error of 1 / r is σ / r², so readings have the weight r⁴.

/// Sums of weighted least squares over readings.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LineSums {
    readings: usize,
    weight: f64,
    cos_cos: f64,
    cos_sin: f64,
    sin_sin: f64,
    cos_inverse: f64,
    sin_inverse: f64,
}

/// Regularisation of b where readings hardly constrain it, as a fraction of the weight of all readings.
const DAMPING: f64 = 1e-9;

impl LineSums {
    /// Adds a reading in a direction, given as sine and cosine; range in metres.
    pub fn add(&mut self, (sin, cos): (f64, f64), range: f64) {
        let weight = range.powi(4);
        self.readings += 1;
        self.weight += weight;
        self.cos_cos += weight * cos * cos;
        self.cos_sin += weight * cos * sin;
        self.sin_sin += weight * sin * sin;
        self.cos_inverse += weight * cos / range;
        self.sin_inverse += weight * sin / range;
    }

    pub fn readings(&self) -> usize {
        self.readings
    }

    /// The line; none if the readings do not determine one.
    pub fn line(&self) -> Option<PolarLine> {
        let sin_sin = self.sin_sin + DAMPING * self.weight;
        let determinant = self.cos_cos * sin_sin - self.cos_sin * self.cos_sin;
        let cos = (sin_sin * self.cos_inverse - self.cos_sin * self.sin_inverse) / determinant;
        let sin = (self.cos_cos * self.sin_inverse - self.cos_sin * self.cos_inverse) / determinant;
        (cos.is_finite() && sin.is_finite()).then_some(PolarLine { cos, sin })
    }
}

/// The line 1 / r = a cos φ + b sin φ.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PolarLine {
    cos: f64,
    sin: f64,
}

impl PolarLine {
    /// The range in a direction, metres; none where the line is not seen from the scanner.
    pub fn range(&self, (sin, cos): (f64, f64)) -> Option<f64> {
        let inverse = self.cos * cos + self.sin * sin;
        (inverse > 0.0).then(|| 1.0 / inverse)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_is_found_from_its_readings() {
        // x = 3 m, seen to the side.
        let readings = (0..9).map(|i| 0.4 + 0.02 * f64::from(i));
        let mut sums = LineSums::default();
        readings.for_each(|angle| sums.add(angle.sin_cos(), 3.0 / angle.cos()));
        let line = sums.line().unwrap();
        let at = |angle: f64| line.range(angle.sin_cos());
        assert!((at(0.5).unwrap() - 3.0 / 0.5_f64.cos()).abs() < 1e-2);
        assert!(at(2.5).is_none());
        assert!(LineSums::default().line().is_none());
    }
}
