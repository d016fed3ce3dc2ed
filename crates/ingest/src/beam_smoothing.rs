//! Smooths the readings of a noisy scanner: each is replaced by the line through its neighbours.
//!
//! Grids, matching and the criteria that use them expect walls thinner than a cell. Where readings scatter
//! more, each is averaged with its neighbours on the same wall until the scatter is small enough: a robust
//! local regression in polar coordinates (Cleveland, "Robust locally weighted regression and smoothing
//! scatterplots", JASA 74, 1979), with the number of neighbours that the noise requires. Edges stay: a
//! reading that differs by more than the noise explains is on another surface.

use crate::polar_line::{LineSums, PolarLine};

/// Wanted scatter of the readings, metres: less than half a cell of grids.
const WANTED: f64 = 0.02;
/// Maximum number of neighbours on either side.
const MOST_NEIGHBOURS: usize = 12;
/// Maximum distance of a neighbour along the arc, metres, over which walls are assumed straight.
const REACH: f64 = 0.6;
/// Maximum deviation of a reading from the line of its surface, standard deviations.
const SAME: f64 = 3.0;
/// Additional deviation from the neighbour that is allowed before a line is known, metres for each metre of
/// arc: walls seen as obliquely as 56°.
const SLOPE: f64 = 1.5;
/// Number of line fits, each to the readings that agree with the line before.
const ROUNDS: usize = 4;
/// Minimum number of readings that determine a line and confirm it.
const LEAST_READINGS: usize = 3;

/// Smoothing of readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BeamSmoothing {
    /// Standard deviation of the readings, metres.
    sigma: f64,
    /// Neighbours on either side.
    neighbours: usize,
}

impl BeamSmoothing {
    /// Smoothing for readings with this standard deviation, metres; none if they are precise enough.
    pub fn of(sigma: f64) -> Option<Self> {
        let beams = (sigma / WANTED).powi(2);
        let neighbours = (((beams - 1.0) / 2.0).round().max(0.0) as usize).min(MOST_NEIGHBOURS);
        (sigma.is_finite() && neighbours > 0).then_some(Self { sigma, neighbours })
    }

    /// Returns the readings of beams that are `increment` radians apart, smoothed where they are within
    /// `limits`, metres.
    pub fn smoothed(&self, ranges: &[f32], increment: f32, limits: [f32; 2]) -> Vec<f32> {
        let window = Window { of: *self, ranges, increment: f64::from(increment), limits };
        ranges.iter().enumerate().map(|(i, range)| window.smoothed(i).unwrap_or(*range)).collect()
    }
}

/// Beams of a scan.
struct Window<'a> {
    of: BeamSmoothing,
    ranges: &'a [f32],
    increment: f64,
    limits: [f32; 2],
}

impl Window<'_> {
    /// The range of a beam, metres; none without a return.
    fn range(&self, i: usize) -> Option<f64> {
        let [least, most] = self.limits;
        self.ranges.get(i).filter(|r| least <= **r && **r <= most && **r > 0.0).map(|r| f64::from(*r))
    }

    fn smoothed(&self, i: usize) -> Option<f32> {
        let range = self.range(i)?;
        let (mut line, mut readings) = (None, 0);
        for _ in 0..ROUNDS {
            let sums = self.sums(i, range, line);
            line = Some(sums.line()?);
            readings = sums.readings();
        }
        let smooth = line?.range((0.0, 1.0))?;
        let is_same = (smooth - range).abs() < (SAME + 1.0) * self.of.sigma;
        (readings >= LEAST_READINGS && is_same).then_some(smooth as f32)
    }

    /// Sums over the neighbours that agree with a line, or, before one is known, with the reading itself.
    fn sums(&self, i: usize, range: f64, line: Option<PolarLine>) -> LineSums {
        let reach = self.of.neighbours.min((REACH / (range * self.increment.abs())) as usize);
        let mut sums = LineSums::default();
        for k in i.saturating_sub(reach)..=i + reach {
            let Some(other) = self.range(k) else { continue };
            let angle = self.increment * (k as f64 - i as f64);
            let (expected, allowed) = match line {
                None => (Some(range), (SAME + 0.5) * self.of.sigma + SLOPE * angle.abs() * range),
                Some(line) => (line.range(angle.sin_cos()), SAME * self.of.sigma),
            };
            if expected.is_some_and(|expected| (other - expected).abs() < allowed) {
                sums.add(angle.sin_cos(), other);
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::range_noise::RangeNoiseEstimator;
    use portolan_geometry::Time;
    use portolan_numeric::SplitMix64;
    use portolan_recording::{Header, LaserScan};

    const INCREMENT: f32 = std::f32::consts::PI / 360.0;

    /// A wall 4 m to the left and one 6 m ahead, a post before it, and one direction without return.
    fn room() -> Vec<f32> {
        let seen = |i: usize| {
            let (sin, cos) = (INCREMENT * i as f32).sin_cos();
            match i {
                30..34 => 2.0,
                200 => f32::INFINITY,
                _ => (4.0 / sin.max(1e-3)).min(6.0 / cos.max(1e-3)),
            }
        };
        (0..270).map(seen).collect()
    }

    fn noisy(ranges: &[f32], sigma: f64, random: &mut SplitMix64) -> Vec<f32> {
        let mut normal = || (0..12).map(|_| random.uniform()).sum::<f64>() - 6.0;
        ranges.iter().map(|range| range + (sigma * normal()) as f32).collect()
    }

    fn scan(ranges: Vec<f32>, angle_increment: f32) -> LaserScan {
        LaserScan {
            header: Header { stamp: Time::UNIX_EPOCH, frame_id: "laser".into() },
            angle_min: 0.0,
            angle_max: angle_increment * (ranges.len() - 1) as f32,
            angle_increment,
            time_increment: 0.0,
            scan_time: 0.0,
            range_min: 0.1,
            range_max: 20.0,
            ranges,
            intensities: Vec::new(),
        }
    }

    fn error(ranges: &[f32], right: &[f32]) -> f64 {
        let squares = ranges.iter().zip(right).filter(|(_, right)| right.is_finite());
        let squares: Vec<f64> = squares.map(|(a, b)| f64::from(a - b)).collect();
        portolan_numeric::rms(&squares).unwrap()
    }

    #[test]
    fn noise_is_measured_and_smoothed() {
        let (right, mut random) = (room(), SplitMix64::new(7));
        for sigma in [0.005, 0.03, 0.1] {
            let mut estimator = RangeNoiseEstimator::default();
            for _ in 0..60 {
                estimator.add(&scan(noisy(&right, sigma, &mut random), INCREMENT));
            }
            let measured = estimator.sigma().unwrap();
            assert!((measured / sigma - 1.0).abs() < 0.15, "{measured} for {sigma}");
            let Some(smoothing) = BeamSmoothing::of(measured) else {
                assert!(sigma < WANTED);
                continue;
            };
            let scan = noisy(&right, sigma, &mut random);
            let smooth = smoothing.smoothed(&scan, INCREMENT, [0.1, 20.0]);
            let (before, after) = (error(&scan, &right), error(&smooth, &right));
            assert!(after < 0.75 * before && after < 0.55 * sigma + 0.007, "{before} to {after} for {sigma}");
            assert!(smooth[200].is_infinite() && (smooth[31] - 2.0).abs() < 3.0 * sigma as f32);
        }
        assert!(RangeNoiseEstimator::default().sigma().is_none());
    }

    #[test]
    fn corners_between_beams_far_apart_are_no_noise() {
        let every_tenth: Vec<f32> = room().into_iter().step_by(10).collect();
        let mut estimator = RangeNoiseEstimator::default();
        (0..600).for_each(|_| estimator.add(&scan(every_tenth.clone(), 10.0 * INCREMENT)));
        assert_eq!(estimator.sigma(), None);
    }

    #[test]
    fn good_readings_are_left_alone() {
        assert!(BeamSmoothing::of(0.02).is_none() && BeamSmoothing::of(f64::NAN).is_none());
        assert!(BeamSmoothing::of(0.03).is_some());
    }
}
