//! An elevation error that is common to all beams of a lidar.
//!
//! The calibration of a spinning lidar gives the elevation of each beam. If all of them are off by the same
//! angle, flat ground becomes a shallow cone around the lidar, and every sweep that is registered to those
//! before pitches a little: a straight drive bends up or down. KITTI's HDL-64 has such an error of 0.2°
//! (Deschaud, "IMLS-SLAM: Scan-to-Model Matching Based on 3D Data", 2018, section IV).

use portolan_geometry::{Point3f, Vector3};

/// Largest angle that can be a calibration error, radians.
const LARGEST: f64 = 0.017;
/// Systematic error of an estimate beside its standard deviation, as sparse rings are taken for one surface,
/// radians: half of the error in a simulated hall with sixteen beams.
const SYSTEMATIC: f64 = 8e-4;
/// Number of standard deviations above which an offset counts, each of them the random and the systematic one
/// together: twice the latter is the largest systematic error that was seen.
const SIGNIFICANT: f64 = 2.0;
/// Offset about as large as KITTI's, radians: as long as it is possible, more sweeps are evaluated.
const WORTHWHILE: f64 = 3.5e-3;
/// Standard deviation above which not even all sweeps would suffice, radians: the search then ends.
const MAX_SIGMA: f64 = 2.1e-3;

/// Choice of the angle by which beams are raised.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum BeamElevation {
    /// The angle estimated from motion, if it is clear.
    #[default]
    Auto,
    /// This angle, radians.
    Fixed(f64),
}

/// Elevation offset of the beams, estimated from motion.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ElevationOffset {
    /// Angle to be added to all elevations, radians.
    pub radians: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

impl ElevationOffset {
    /// Standard deviation including the systematic error.
    pub fn uncertainty(&self) -> f64 {
        self.sigma.hypot(SYSTEMATIC)
    }

    /// Whether more sweeps may show a significant offset.
    pub(crate) fn may_be_there(&self) -> bool {
        self.sigma < MAX_SIGMA && self.radians.abs() + SIGNIFICANT * self.sigma > WORTHWHILE
    }

    /// Whether the offset is significant, and small enough for a calibration error.
    pub fn is_clear(&self) -> bool {
        self.radians.abs() < LARGEST && self.radians.abs() > SIGNIFICANT * (self.sigma + SYSTEMATIC)
    }
}

/// Raises points, given in the frame of their lidar, by an angle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Raise {
    sine: f32,
    cosine: f32,
}

impl Raise {
    pub fn new(radians: f64) -> Self {
        Self { sine: radians.sin() as f32, cosine: radians.cos() as f32 }
    }

    /// Raises a point. Straight up there is no elevation to change.
    pub fn point(&self, point: &Point3f) -> Point3f {
        let level = point.x.hypot(point.y);
        if level < 1e-6 {
            return *point;
        }
        let share = self.cosine - self.sine * point.z / level;
        Point3f::new(share * point.x, share * point.y, self.sine * level + self.cosine * point.z)
    }
}

/// Displacement of a point for each radian that its beam is raised.
pub(crate) fn by_elevation(point: &Vector3) -> Vector3 {
    let level = point.x.hypot(point.y).max(1e-6);
    Vector3::new(-point.x / level * point.z, -point.y / level * point.z, level)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_are_raised_and_ranges_are_kept() {
        for point in [Point3f::new(3.0, -4.0, 1.0), Point3f::new(-10.0, 0.5, -2.0)] {
            let elevation = |p: &Point3f| f64::from(p.z).atan2(f64::from(p.x.hypot(p.y)));
            let raised = Raise::new(0.01).point(&point);
            assert!((elevation(&raised) - elevation(&point) - 0.01).abs() < 1e-6);
            assert!((raised.coords.norm() - point.coords.norm()).abs() < 1e-5);
            assert!((raised.y.atan2(raised.x) - point.y.atan2(point.x)).abs() < 1e-6);
            let small = Raise::new(1e-3).point(&point) - point;
            assert!((small.cast::<f64>() - by_elevation(&point.coords.cast()) * 1e-3).norm() < 1e-4);
        }
        assert_eq!(Raise::new(0.1).point(&Point3f::new(0.0, 0.0, 5.0)), Point3f::new(0.0, 0.0, 5.0));
    }

    #[test]
    fn only_clear_errors_count() {
        let is_clear = |radians, sigma| ElevationOffset { radians, sigma }.is_clear();
        assert!(is_clear(0.004, 0.0003) && is_clear(-0.004, 0.0003));
        assert!(!is_clear(0.004, 0.002) && !is_clear(0.0015, 0.00001) && !is_clear(0.2, 0.001));
        let may_be_there = |radians, sigma| ElevationOffset { radians, sigma }.may_be_there();
        assert!(may_be_there(0.0, 0.0019) && may_be_there(-0.002, 0.001));
        assert!(!may_be_there(0.0, 0.001) && !may_be_there(0.004, 0.01));
        assert!(!is_clear(0.004, f64::INFINITY) && !is_clear(f64::NAN, 0.0));
    }
}
