//! Keeps 2D scans in memory, compressed, until the map is finished.

use portolan_geometry::{Point3f, Rigid3f};
use portolan_grids::beam_spacing;
use portolan_sensor::{PointCloud, RangeData};

/// A 2D scan in four bytes a point: coordinates in steps of the farthest one over 32,767 (0.9 mm where beams
/// reach 30 m). Heights are left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KeptScan2d {
    /// Metres.
    origin: [f32; 2],
    /// Metres a step.
    step: f32,
    /// Returns, then misses.
    points: Box<[[i16; 2]]>,
    returns: usize,
    /// Radians.
    beam_spacing: f32,
}

impl KeptScan2d {
    /// Keeps the finite points of a scan in the frame in which it is given.
    pub fn new(scan: &RangeData) -> Self {
        let finite = |cloud: &PointCloud| -> Vec<[f32; 2]> {
            cloud.points.iter().map(|p| [p.x, p.y]).filter(|p| p.iter().all(|v| v.is_finite())).collect()
        };
        let (mut points, misses) = (finite(&scan.returns), finite(&scan.misses));
        let returns = points.len();
        points.extend(misses);
        let farthest = points.iter().flatten().fold(0.0, |farthest: f32, v| farthest.max(v.abs()));
        let step = farthest / f32::from(i16::MAX);
        let in_steps = |value: f32| if step > 0.0 { (value / step).round() as i16 } else { 0 };
        Self {
            origin: [scan.origin.x, scan.origin.y],
            step,
            points: points.into_iter().map(|p| p.map(in_steps)).collect(),
            returns,
            beam_spacing: beam_spacing(scan),
        }
    }

    /// Angle between its beams, radians.
    pub fn beam_spacing(&self) -> f32 {
        self.beam_spacing
    }

    /// The scan in frame a.
    pub fn range_data(&self, a_from_b: &Rigid3f) -> RangeData {
        let place = |[x, y]: [f32; 2]| a_from_b * Point3f::new(x, y, 0.0);
        let cloud = |points: &[[i16; 2]]| {
            PointCloud::new(points.iter().map(|p| place(p.map(|v| f32::from(v) * self.step))).collect())
        };
        let (returns, misses) = self.points.split_at(self.returns.min(self.points.len()));
        RangeData { origin: place(self.origin), returns: cloud(returns), misses: cloud(misses) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_is_kept_to_a_millimetre() {
        let point = |x: f32, y: f32| Point3f::new(x, y, 0.0);
        let scan = RangeData {
            origin: point(0.1, 0.2),
            returns: PointCloud::new(vec![point(30.0, -12.345), point(f32::NAN, 1.0), point(-0.004, 7.5)]),
            misses: PointCloud::new(vec![point(0.0, -5.0)]),
        };
        let kept = KeptScan2d::new(&scan).range_data(&Rigid3f::translation(1.0, 2.0, 0.0));
        assert_eq!((kept.origin, kept.returns.len(), kept.misses.len()), (point(1.1, 2.2), 2, 1));
        let expected = [point(31.0, -10.345), point(0.996, 9.5), point(1.0, -3.0)];
        for (kept, expected) in kept.returns.points.iter().chain(&kept.misses.points).zip(expected) {
            assert!((kept - expected).norm() < 0.001, "{kept} {expected}");
        }
        assert_eq!(
            KeptScan2d::new(&RangeData::default()).range_data(&Rigid3f::identity()),
            RangeData::default()
        );
    }
}
