//! Search windows: range and steps of placements.

use std::f64::consts::PI;

use portolan_geometry::Point3f;

/// At most this many angles to either side: enough for a whole turn with points 500 m away in cells of
/// 5 cm. A wider search is made in larger steps.
const MAX_ANGULAR_STEPS: f64 = 32768.0;
/// At most this many cells to either side.
pub(crate) const MAX_LINEAR_STEPS: i32 = 1 << 20;

/// The step between angles and how many of them a window has to either side, the number rounded by
/// `rounded`. A step of zero, for points at absurd ranges, would make an infinite number: then steps are
/// larger.
pub(crate) fn bounded_angular_steps(step: f64, window: f64, rounded: fn(f64) -> f64) -> (f64, i32) {
    let count = rounded(window / step);
    let step = if count <= MAX_ANGULAR_STEPS { step } else { window / MAX_ANGULAR_STEPS };
    (step, count.clamp(0.0, MAX_ANGULAR_STEPS) as i32)
}

/// Steps of an angle that move a point at `farthest` metres by just less than a cell (by the fraction
/// `margin`), and how many of them a window has to either side. In single precision, as in Cartographer.
pub(crate) fn angular_steps_3d(farthest: f32, resolution: f32, margin: f32, window: f64) -> (f32, i32) {
    let max_range = farthest.max(3.0 * resolution);
    let ratio = resolution * resolution / (2.0 * max_range * max_range);
    let step = (1.0 - margin) * (1.0 - ratio).acos();
    let (step, count) = bounded_angular_steps(f64::from(step), window.min(PI), f64::round);
    (step as f32, count)
}

/// A window of placements around an initial pose: angles and shifts in steps of one cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SearchWindow {
    /// Edge of a cell, metres.
    pub resolution: f64,
    /// Step between neighbouring angles, radians: the farthest point moves by just less than a cell.
    pub angular_step: f64,
    /// Angles to either side of the initial one.
    pub num_angular: i32,
    /// Cells to either side of the initial translation, along each axis.
    pub num_linear: i32,
    /// Range of the farthest point, at least three cells, metres.
    pub max_range: f64,
}

impl SearchWindow {
    /// The window for `points` around the origin of their frame (metres).
    pub fn new(points: &[Point3f], resolution: f64, linear_window: f64, angular_window: f64) -> Self {
        let farthest = points.iter().map(|p| p.coords.xy().norm()).fold(0.0, f32::max);
        let max_range = f64::from(farthest).max(3.0 * resolution);
        let ratio = resolution / max_range;
        let step = 0.999 * (1.0 - ratio * ratio / 2.0).acos();
        let (angular_step, num_angular) = bounded_angular_steps(step, angular_window.min(PI), f64::ceil);
        Self {
            resolution,
            angular_step,
            num_angular,
            num_linear: (linear_window / resolution).ceil().clamp(0.0, f64::from(MAX_LINEAR_STEPS)) as i32,
            max_range,
        }
    }

    /// Number of angles.
    pub fn num_scans(&self) -> i32 {
        2 * self.num_angular + 1
    }

    /// Angle of scan `k` from the initial one, radians.
    pub fn angle(&self, k: i32) -> f64 {
        f64::from(k - self.num_angular) * self.angular_step
    }

    /// Translation of the scan by a shift in cells, metres along x and y of the map.
    pub fn shift(&self, x: i32, y: i32) -> [f64; 2] {
        [-f64::from(y) * self.resolution, -f64::from(x) * self.resolution]
    }

    /// The pose of a placement.
    pub fn pose(
        &self,
        initial: &portolan_geometry::Rigid2,
        placement: &super::joint_search::Placement,
    ) -> portolan_geometry::Rigid2 {
        let [x, y] = self.shift(placement.x, placement.y);
        portolan_geometry::Rigid2::new(
            initial.translation.x + x,
            initial.translation.y + y,
            initial.angle + self.angle(placement.scan),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correlative::joint_search::Placement;
    use portolan_geometry::Rigid2;

    #[test]
    fn placements_become_poses() {
        let window = SearchWindow {
            resolution: 0.05,
            angular_step: 0.03,
            num_angular: 5,
            num_linear: 4,
            max_range: 1.0,
        };
        assert_eq!(window.num_scans(), 11);
        let pose = window.pose(&Rigid2::identity(), &Placement { scan: 3, x: 4, y: -5 });
        assert!((pose.translation.x - 0.25).abs() < 1e-12 && (pose.translation.y + 0.2).abs() < 1e-12);
        assert!((pose.angle + 0.06).abs() < 1e-12);
    }

    #[test]
    fn absurd_points_do_not_make_absurd_windows() {
        for range in [1e9, f32::INFINITY, f32::NAN] {
            let points = [Point3f::new(range, 0.0, 0.0)];
            let window = SearchWindow::new(&points, 0.05, 1e12, 3.0);
            assert!(window.num_scans() <= 65537 && window.num_linear == MAX_LINEAR_STEPS, "{window:?}");
            assert!(window.angular_step > 0.0, "{window:?}");
        }
        let round = |window| SearchWindow::new(&[Point3f::new(9.0, 0.0, 0.0)], 0.05, 0.0, window).num_angular;
        assert_eq!(round(1e9), round(PI), "more than a whole turn");
        let still = SearchWindow::new(&[], 0.05, 0.0, 0.0);
        assert_eq!((still.num_scans(), still.num_linear), (1, 0));
    }
}
