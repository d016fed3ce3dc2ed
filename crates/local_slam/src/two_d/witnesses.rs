//! How much a scan can say at all: by how many beams that do not see the same thing.

use std::f64::consts::TAU;

use portolan_sensor::PointCloud;

/// Beams in one of so many sectors of a turn, five degrees each, are one witness: they hit the same person or wall.
const SECTORS: usize = 72;
/// A scan says as much as so many beams that are independent, however many it has: those of half a turn.
const MOST: usize = 36;
/// With less than half of them a match far from its prediction is doubted, …
const FEW: usize = 18;
/// … and with less than a quarter every match is weighed with it: what is in reach looks alike at many poses.
const NEXT_TO_NONE: usize = 9;

/// Independent witnesses among the returns of a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Witnesses(usize);

impl Default for Witnesses {
    /// Those of a scan with returns all around.
    fn default() -> Self {
        Self(MOST)
    }
}

impl Witnesses {
    /// Of returns in the frame of the scanner.
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

    /// Whether a scan tells so little that a prediction far from its match may be right.
    pub fn are_few(self) -> bool {
        self.0 < FEW
    }

    /// Whether it tells so little that its match is one opinion beside that of the prediction.
    pub fn are_next_to_none(self) -> bool {
        self.0 < NEXT_TO_NONE
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Point3f;

    fn seen(degrees: impl Iterator<Item = i32>) -> Witnesses {
        let point = |d: i32| {
            let (y, x) = f64::from(d).to_radians().sin_cos();
            Point3f::new(x as f32, y as f32, 0.0)
        };
        Witnesses::of(&PointCloud::new(degrees.map(point).collect()))
    }

    #[test]
    fn neighbours_are_one_witness() {
        assert!(seen(0..0).are_few());
        assert!(seen(1..20).are_next_to_none());
        assert!(seen(1..80).are_few() && !seen(1..80).are_next_to_none());
        assert_eq!(seen(1..5), seen(1..2));
        assert!(!seen(-89..90).are_few());
        assert_eq!(seen(-89..90), Witnesses::default());
        assert_eq!(seen(0..360), Witnesses::default());
    }
}
