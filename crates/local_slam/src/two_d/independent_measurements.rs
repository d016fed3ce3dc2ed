//! Counts the independent measurements in a scan: sectors with returns.

use std::f64::consts::TAU;

use portolan_sensor::PointCloud;

/// Number of sectors of a turn, five degrees each. Beams in one sector are one independent measurement:
/// they hit the same person or wall.
const SECTORS: usize = 72;
/// Maximum number of independent measurements that a scan counts as: the sectors of half a turn.
const MOST: usize = 36;
/// Number of independent measurements below which a match far from its prediction is questioned: half of
/// the maximum.
const FEW: usize = 18;
/// Number of independent measurements below which every match is weighed with the prediction: a quarter of
/// the maximum. The few surfaces in reach look alike at many poses.
const VERY_FEW: usize = 9;

/// Number of independent measurements among the returns of a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct IndependentMeasurements(usize);

impl Default for IndependentMeasurements {
    /// That of a scan with returns all around.
    fn default() -> Self {
        Self(MOST)
    }
}

impl IndependentMeasurements {
    /// Counts the sectors of returns in the frame of the scanner.
    pub fn of(returns: &PointCloud) -> Self {
        let mut seen = [false; SECTORS];
        for point in &returns.points {
            let share = f64::from(point.y).atan2(f64::from(point.x)) / TAU + 0.5;
            if let Some(sector) = seen.get_mut((share * SECTORS as f64) as usize % SECTORS) {
                *sector = true;
            }
        }
        Self(seen.iter().filter(|seen| **seen).count().min(MOST))
    }

    pub fn count(self) -> f64 {
        self.0 as f64
    }

    /// Whether a scan constrains its pose so weakly that a prediction far from its match may be correct.
    pub fn are_few(self) -> bool {
        self.0 < FEW
    }

    /// Whether it constrains its pose so weakly that the match is weighed with the prediction.
    pub fn are_very_few(self) -> bool {
        self.0 < VERY_FEW
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Point3f;

    fn seen(degrees: impl Iterator<Item = i32>) -> IndependentMeasurements {
        let point = |d: i32| {
            let (y, x) = f64::from(d).to_radians().sin_cos();
            Point3f::new(x as f32, y as f32, 0.0)
        };
        IndependentMeasurements::of(&PointCloud::new(degrees.map(point).collect()))
    }

    #[test]
    fn neighbouring_beams_are_one_independent_measurement() {
        assert!(seen(0..0).are_few());
        assert!(seen(1..20).are_very_few());
        assert!(seen(1..80).are_few() && !seen(1..80).are_very_few());
        assert_eq!(seen(1..5), seen(1..2));
        assert!(!seen(-89..90).are_few());
        assert_eq!(seen(-89..90), IndependentMeasurements::default());
        assert_eq!(seen(0..360), IndependentMeasurements::default());
    }
}
