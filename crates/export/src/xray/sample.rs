//! Estimates the extent of a cloud and the direction of its walls from a sample of its points.

use std::f64::consts::FRAC_PI_2;

/// Maximum number of points kept.
const MOST: usize = 60_000;
/// Maximum number of points used for the direction of walls.
const MOST_FOR_WALLS: usize = 20_000;
/// Widths of the bins in which points of walls are counted, metres: for the coarse and the fine search.
const BIN: f64 = 0.1;
const FINE_BIN: f64 = 0.03;
/// Number of bins in each direction. Positions beyond wrap around, 123 m apart and more, where they hardly
/// coincide with other walls.
const BINS: usize = 1 << 12;
/// Numbers of points in the bins along a direction and across it.
type Bins = [[u32; 2]; BINS];
/// Minimum ratio of the score of the best direction to the median score for walls to be found; dimensionless.
const STANDS_OUT: f64 = 1.1;

/// Every n-th point of a cloud, with n chosen by the number of points.
#[derive(Clone, Debug)]
pub struct CloudSample {
    points: Vec<[f64; 3]>,
    stride: u64,
    seen: u64,
}

/// Smallest and largest value along an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Smallest value, metres.
    pub from: f64,
    /// Largest value, metres.
    pub to: f64,
}

impl Default for CloudSample {
    fn default() -> Self {
        Self { points: Vec::new(), stride: 1, seen: 0 }
    }
}

impl CloudSample {
    /// Adds the next point.
    pub fn add(&mut self, position: [f64; 3]) {
        if self.seen.is_multiple_of(self.stride) {
            self.points.push(position);
            if self.points.len() >= 2 * MOST {
                let mut index = 0;
                self.points.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                self.stride *= 2;
            }
        }
        self.seen += 1;
    }

    /// Extent of the cloud in the values of `measure`, without the fraction `outliers` of the points on
    /// either side. Points with a NaN value are ignored. None without points.
    pub fn extent(&self, outliers: f64, measure: impl Fn([f64; 3]) -> f64) -> Option<Extent> {
        let mut values: Vec<f64> =
            self.points.iter().map(|p| measure(*p)).filter(|v| v.is_finite()).collect();
        let outliers = (outliers.clamp(0.0, 0.4) * values.len() as f64) as usize;
        let last = values.len().checked_sub(1)?;
        let (_, from, above) = values.select_nth_unstable_by(outliers, f64::total_cmp);
        let from = *from;
        // The smallest of these values is number `outliers` + 1 of all.
        let to = match (last - outliers).checked_sub(outliers + 1) {
            Some(index) => *above.select_nth_unstable_by(index, f64::total_cmp).1,
            None => from,
        };
        Some(Extent { from, to })
    }

    /// The direction in the map in which most walls run, from −π/4 to π/4, radians; none if there are no
    /// walls at right angles.
    pub fn wall_direction(&self) -> Option<f64> {
        let step = self.points.len().div_ceil(MOST_FOR_WALLS).max(1);
        let points: Vec<[f64; 2]> = self.points.iter().step_by(step).map(|p| [p[0], p[1]]).collect();
        let degree = 1f64.to_radians();
        let bins = &mut [[0; 2]; BINS];
        let coarse: Vec<(f64, f64)> =
            (-45..45).map(f64::from).map(|d| (gathered(&points, d * degree, BIN, bins), d)).collect();
        let mut scores: Vec<f64> = coarse.iter().map(|(score, _)| *score).collect();
        scores.sort_by(f64::total_cmp);
        let middle = *scores.get(scores.len() / 2)?;
        let best = |tries: &[(f64, f64)]| tries.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0));
        let (score, about) = best(&coarse)?;
        if score.is_nan() || score <= STANDS_OUT * middle {
            return None;
        }
        let fine: Vec<(f64, f64)> = (-10..=10)
            .map(|i| about + 0.1 * f64::from(i))
            .map(|d| (gathered(&points, d * degree, FINE_BIN, bins), d))
            .collect();
        let yaw = best(&fine)?.1 * degree;
        Some(yaw - (yaw / FRAC_PI_2).round() * FRAC_PI_2)
    }
}

/// Concentration of points in lines along a direction and across it: the sum of squared counts.
fn gathered(points: &[[f64; 2]], yaw: f64, bin: f64, bins: &mut Bins) -> f64 {
    let ((s, c), per_bin) = (yaw.sin_cos(), 1.0 / bin);
    bins.fill([0; 2]);
    for p in points {
        let along = ((c * p[0] + s * p[1]) * per_bin).floor();
        let across = ((c * p[1] - s * p[0]) * per_bin).floor();
        bins[along as i64 as usize % BINS][0] += 1;
        bins[across as i64 as usize % BINS][1] += 1;
    }
    bins.iter().flatten().map(|count| f64::from(*count).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Walls of a room of 8 m by 5 m, rotated, with its floor.
    fn room(yaw: f64, walls: bool) -> CloudSample {
        let mut sample = CloudSample::default();
        let (s, c) = yaw.sin_cos();
        for i in 0..40_000 {
            let (u, v) = (f64::from(i % 200) / 200.0, f64::from(i / 200) / 200.0);
            let [x, y, z] = match i % 5 {
                0 if walls => [8.0 * u, 0.0, 3.0 * v],
                1 if walls => [8.0 * u, 5.0, 3.0 * v],
                2 if walls => [0.0, 5.0 * u, 3.0 * v],
                3 if walls => [8.0, 5.0 * u, 3.0 * v],
                _ => [8.0 * (u - 0.5) * v.sqrt(), 8.0 * (v - 0.5) * u.sqrt(), 0.0],
            };
            sample.add([c * x - s * y, s * x + c * y, z]);
        }
        sample
    }

    #[test]
    fn walls_show_their_direction() {
        for degrees in [-44.0, -10.3, 0.0, 7.0, 31.5] {
            let found = room(f64::to_radians(degrees), true).wall_direction().unwrap().to_degrees();
            assert!((found - degrees).abs() < 0.25, "{degrees}: {found}");
        }
        assert_eq!(CloudSample::default().wall_direction(), None);
    }

    #[test]
    fn outliers_do_not_count_and_memory_is_bounded() {
        let mut sample = CloudSample::default();
        for i in 0..1_000_000 {
            let x = if i % 5003 == 0 { 500.0 } else { f64::from(i % 1000) / 100.0 };
            sample.add([x, 0.0, 0.0]);
        }
        assert!(sample.points.len() < 2 * MOST);
        let extent = sample.extent(0.001, |p| p[0]).unwrap();
        assert!(extent.from < 0.1 && (9.9..10.0).contains(&extent.to), "{extent:?}");
        assert_eq!(CloudSample::default().extent(0.0, |p| p[0]), None);
    }
}
