//! Estimates the range noise of a planar scanner from its scans: from the deviations of neighbouring readings
//! from lines.

use portolan_numeric::quantile;
use portolan_recording::LaserScan;

use crate::polar_line::LineSums;

/// The noise of the ranges of planar scanners.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum RangeNoise {
    /// Estimated from the scans.
    #[default]
    Auto,
    /// Standard deviation, metres; with zero readings stay unchanged.
    Fixed(f64),
}

/// Number of neighbouring readings that are compared with a line.
const BEAMS: usize = 9;
/// Number of these readings that are left out, those farthest from the line: dust, people and edges are not
/// noise.
const OUTLIERS: usize = 3;
/// Degrees of freedom that remain.
const FREEDOM: f64 = (BEAMS - OUTLIERS - 2) as f64;
/// Minimum fraction of the groups of readings that see a straight wall.
const STRAIGHT: f64 = 0.2;
/// Quantile at this fraction of the scatter of normally distributed readings over their standard deviation
/// (by simulation).
const QUANTILE_FACTOR: f64 = 0.26;
/// Maximum width of a group, radians from the first beam to the last. Wider groups rarely see one straight
/// wall, and corners and steps would pass for noise. So scanners with beams of a degree and finer are
/// evaluated.
const WIDEST: f64 = 0.2;
/// Maximum range of evaluated readings, metres: readings beyond it are few and far apart.
const FARTHEST: f32 = 30.0;
/// Minimum number of groups for an estimate, and the number that suffices.
const GROUPS: std::ops::Range<usize> = 500..100_000;

/// Estimates the noise of the readings from scans.
#[derive(Clone, Debug, Default)]
pub struct RangeNoiseEstimator {
    /// Root mean squares of the deviations of groups of readings from their lines, metres.
    scatters: Vec<f64>,
}

impl RangeNoiseEstimator {
    /// Adds a scan.
    pub fn add(&mut self, scan: &LaserScan) {
        if self.scatters.len() >= GROUPS.end {
            return;
        }
        let increment = f64::from(scan.angle_increment);
        if (BEAMS - 1) as f64 * increment.abs() > WIDEST {
            return;
        }
        let is_seen =
            |range: &f32| scan.range_min <= *range && *range <= scan.range_max.min(FARTHEST) && *range > 0.0;
        let groups = scan.ranges.chunks_exact(BEAMS).filter(|group| group.iter().all(is_seen));
        self.scatters.extend(groups.filter_map(|group| scatter(group, increment)));
    }

    /// Standard deviation of the ranges, metres; none if there are too few groups.
    pub fn sigma(&self) -> Option<f64> {
        let mut scatters = self.scatters.clone();
        let straight = quantile(&mut scatters, STRAIGHT)?;
        (scatters.len() >= GROUPS.start).then_some(straight / QUANTILE_FACTOR)
    }
}

/// Scatter of readings about their line, metres, without the farthest.
fn scatter(group: &[f32], increment: f64) -> Option<f64> {
    let middle = (BEAMS / 2) as f64;
    let mut readings: Vec<((f64, f64), f64)> = group
        .iter()
        .enumerate()
        .map(|(i, range)| ((increment * (i as f64 - middle)).sin_cos(), f64::from(*range)))
        .collect();
    let mut squares = squared_residuals(&readings)?;
    for _ in 0..OUTLIERS {
        let (farthest, _) = squares.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
        readings.remove(farthest);
        squares = squared_residuals(&readings)?;
    }
    Some((squares.iter().sum::<f64>() / FREEDOM).sqrt()).filter(|scatter| scatter.is_finite())
}

/// Squared deviations of readings, each a direction and a range, from the line through all of them, metres².
fn squared_residuals(readings: &[((f64, f64), f64)]) -> Option<Vec<f64>> {
    let mut sums = LineSums::default();
    readings.iter().for_each(|(direction, range)| sums.add(*direction, *range));
    let line = sums.line()?;
    readings.iter().map(|(direction, range)| Some((range - line.range(*direction)?).powi(2))).collect()
}
