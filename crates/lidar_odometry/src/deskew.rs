//! De-skewing: every point of a sweep is moved to its position as seen at the end of the sweep.

use nalgebra as na;
use portolan_geometry::{Point3f, Rigid3};
use portolan_sensor::{PointCloud, RangeData};

use crate::sweep::SweepPoint;

/// A rotation matrix and a translation: the images of the axes, and of the origin. With a fourth number a
/// column is one vector instruction.
type Columns = [[f32; 4]; 4];

/// Transforms from the scanner to another frame, evenly spaced in time, and linear in between.
#[derive(Clone, Debug)]
pub struct PiecewiseLinearTrajectory {
    per_second: f32,
    knots: Vec<Columns>,
}

impl PiecewiseLinearTrajectory {
    /// Trajectory of poses with this spacing, seconds; at least one pose.
    pub(crate) fn new(spacing: f64, poses: impl Iterator<Item = Rigid3>) -> Self {
        let columns = |pose: Rigid3| pose.to_homogeneous().cast::<f32>().data.0;
        Self { per_second: (1.0 / spacing.max(1e-9)) as f32, knots: poses.map(columns).collect() }
    }

    /// The ray of a point that was measured `time` seconds from the end (not positive): from the scanner
    /// to the point, and the position of the scanner, both in the other frame. Times before the first knot
    /// are clamped to it.
    #[inline]
    pub(crate) fn ray(&self, position: &Point3f, time: f32) -> (na::Vector3<f32>, na::Vector3<f32>) {
        let last = self.knots.len() - 1;
        let place = (last as f32 + time * self.per_second).clamp(0.0, last as f32);
        let whole = (place as usize).min(last.saturating_sub(1));
        let fraction = place - whole as f32;
        let (a, b) = (&self.knots[whole], &self.knots[(whole + 1).min(last)]);
        // Loops, because `map` on arrays is not always compiled into the loop that needs it.
        let mut columns = Columns::default();
        for axis in 0..4 {
            for i in 0..4 {
                columns[axis][i] = a[axis][i] + (b[axis][i] - a[axis][i]) * fraction;
            }
        }
        let [x, y, z, from] = columns;
        let mut turned = [0.0; 4];
        for i in 0..4 {
            turned[i] = x[i] * position.x + y[i] * position.y + z[i] * position.z;
        }
        (na::Vector3::new(turned[0], turned[1], turned[2]), na::Vector3::new(from[0], from[1], from[2]))
    }

    /// A point that was measured `time` seconds from the end (not positive), in the other frame.
    #[inline]
    pub fn moved(&self, position: &Point3f, time: f32) -> Point3f {
        let (turned, from) = self.ray(position, time);
        Point3f::from(turned + from)
    }
}

/// The points of a sweep as seen from its end, in the tracking frame; with intensities if they are wanted.
pub(crate) fn deskewed(
    points: &[SweepPoint],
    to_end: &PiecewiseLinearTrajectory,
    with_intensities: bool,
) -> RangeData {
    let intensities = match with_intensities {
        true => points.iter().map(|p| p.intensity).collect(),
        false => Vec::new(),
    };
    let points = points.iter().map(|p| to_end.moved(&p.position, p.time)).collect();
    RangeData {
        origin: Point3f::origin(),
        returns: PointCloud { points, intensities },
        misses: PointCloud::default(),
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::{Duration, Time, Vector3};

    use super::*;
    use crate::segment::{SegmentCorrection, TrajectorySegment};

    /// Accelerates along x with 4 m/s², rotates with 2 rad/s about z.
    fn truth(t: f64) -> Rigid3 {
        Rigid3::new(Vector3::new(t + 2.0 * t * t, 0.0, 0.0), Vector3::z() * (2.0 * t))
    }

    #[test]
    fn points_are_transformed_to_the_end_of_the_sweep() {
        let start = Time::from_ticks(0);
        let end = start + Duration::from_seconds(0.1);
        // The velocity of the previous sweep.
        let velocity = (truth(0.0).translation.vector - truth(-0.1).translation.vector) / 0.1;
        let mut segment = TrajectorySegment::new(start, end, |t| {
            let t = t.seconds_since(start);
            Rigid3::from_parts((velocity * t).into(), truth(t).rotation)
        });
        segment.gyroscope_sigma = Some(0.0);
        let correction = segment.correction_to(&truth(0.1));
        let (to_end, to_map) = (segment.deskewing(&correction), segment.corrected(&correction));
        let fixed = na::Point3::new(5.0, 3.0, 1.0);
        for i in 0..=20 {
            let t = 0.005 * f64::from(i);
            let seen = (truth(t).inverse() * fixed).cast::<f32>();
            let expected = (truth(0.1).inverse() * fixed).cast::<f32>();
            let time = (t - 0.1) as f32;
            assert!((to_end.moved(&seen, time) - expected).norm() < 1e-4, "{t}");
            assert!((to_map.moved(&seen, time) - fixed.cast::<f32>()).norm() < 1e-4, "{t}");
        }
        assert!((segment.seconds() - 0.1).abs() < 1e-9);
    }

    #[test]
    fn a_segment_without_duration_does_not_move_points() {
        let time = Time::from_ticks(5);
        let segment = TrajectorySegment::new(time, time, |_| truth(0.3));
        let point = Point3f::new(1.0, 2.0, 3.0);
        let moved = segment.deskewing(&SegmentCorrection::default()).moved(&point, -1.0);
        assert!((moved - point).norm() < 1e-5);
    }
}
