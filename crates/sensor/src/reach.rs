//! Range of scans compared with that of the scans before.

use portolan_geometry::Point3f;

/// Memory of the usual range, in scans.
const SCANS_REMEMBERED: f64 = 100.0;

/// Logarithm of the root-mean-square range, in metres, of points in the frame of the scanner; `None` without
/// points.
pub fn log_reach<'a>(points: impl Iterator<Item = &'a Point3f>) -> Option<f64> {
    let (sum, count) = points.fold((0.0, 0u32), |(sum, n), p| {
        let [x, y, z] = [p.x, p.y, p.z].map(f64::from);
        (sum + x * x + y * y + z * z, n + 1)
    });
    (sum > 0.0).then(|| 0.5 * (sum / f64::from(count)).ln())
}

/// Usual range of scans.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UsualReach {
    /// Mean of the logarithm of the range.
    mean: Option<f64>,
}

impl UsualReach {
    /// Mean of the logarithm of the range of recent scans; `None` before the first scan.
    pub fn log_mean(&self) -> Option<f64> {
        self.mean
    }

    /// Adds the logarithm of the range of a scan.
    pub fn add(&mut self, reach: f64) {
        let mean = self.mean.get_or_insert(reach);
        *mean += (reach - *mean) / SCANS_REMEMBERED;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_usual_reach_follows_slowly() {
        let at = |range: f32| log_reach([Point3f::new(0.0, 0.6 * range, -0.8 * range)].iter()).unwrap();
        assert!((at(5.0) - 5f64.ln()).abs() < 1e-6 && log_reach([].iter()).is_none());
        let mut usual = UsualReach::default();
        assert_eq!(usual.log_mean(), None);
        usual.add(at(10.0));
        usual.add(at(0.1));
        assert!(usual.log_mean().unwrap() > at(9.0));
        (0..500).for_each(|_| usual.add(at(0.1)));
        assert!(usual.log_mean().unwrap() < at(0.11));
    }
}
