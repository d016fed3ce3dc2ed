//! Point clouds and range data.

use portolan_geometry::{Point3f, Rigid3f};

/// A point with the time at which it was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPoint {
    /// Metres.
    pub position: Point3f,
    /// Seconds relative to the time of the cloud; at most zero.
    pub time: f32,
}

/// Points in one frame, with an intensity each or none at all.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// Metres.
    pub points: Vec<Point3f>,
    /// One per point, or empty.
    pub intensities: Vec<f32>,
}

impl PointCloud {
    /// Points without intensities.
    pub fn new(points: Vec<Point3f>) -> Self {
        Self { points, intensities: Vec::new() }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The same points in frame a.
    pub fn transformed(&self, a_from_b: &Rigid3f) -> Self {
        let points = self.points.iter().map(|p| a_from_b * p).collect();
        Self { points, intensities: self.intensities.clone() }
    }

    /// Keeps the points for which `keep` returns true, with their intensities.
    pub fn retained(&self, mut keep: impl FnMut(&Point3f) -> bool) -> Self {
        let mut result = Self::default();
        for (i, point) in self.points.iter().enumerate() {
            if keep(point) {
                result.points.push(*point);
                result.intensities.extend(self.intensities.get(i));
            }
        }
        result
    }
}

/// Measurements of a range sensor from one position.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RangeData {
    /// Start of the rays.
    pub origin: Point3f,
    /// End points of the rays that hit something.
    pub returns: PointCloud,
    /// End points of rays that hit nothing and are known to be free.
    pub misses: PointCloud,
}

impl RangeData {
    /// The same data in frame a.
    pub fn transformed(&self, a_from_b: &Rigid3f) -> Self {
        Self {
            origin: a_from_b * self.origin,
            returns: self.returns.transformed(a_from_b),
            misses: self.misses.transformed(a_from_b),
        }
    }

    /// Keeps the returns and misses with `min_z ≤ z ≤ max_z`.
    pub fn cropped_z(&self, min_z: f32, max_z: f32) -> Self {
        let keep = |p: &Point3f| min_z <= p.z && p.z <= max_z;
        Self { origin: self.origin, returns: self.returns.retained(keep), misses: self.misses.retained(keep) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Rigid3, Vector3, to_f32};

    #[test]
    fn a_quarter_turn_moves_points() {
        let turn = to_f32(&Rigid3::rotation(Vector3::z() * std::f64::consts::FRAC_PI_2));
        let cloud = PointCloud::new(vec![Point3f::new(0.5, 0.5, 1.0), Point3f::new(3.5, 0.5, 42.0)]);
        let moved = cloud.transformed(&turn);
        assert!((moved.points[0] - Point3f::new(-0.5, 0.5, 1.0)).norm() < 1e-6);
        assert!((moved.points[1] - Point3f::new(-0.5, 3.5, 42.0)).norm() < 1e-6);
    }

    #[test]
    fn intensities_remain_with_their_points() {
        let cloud = PointCloud {
            points: vec![Point3f::new(0.0, 0.0, 0.0), Point3f::new(1.0, 0.0, 0.0)],
            intensities: vec![5.0, 6.0],
        };
        assert_eq!(cloud.retained(|p| p.x > 0.5).intensities, [6.0]);
        assert!(PointCloud::new(cloud.points).retained(|_| true).intensities.is_empty());
    }
}
