//! Decides whether the times of points are right, by comparing sweeps de-skewed with them and with other
//! times.

use std::f32::consts::TAU;

use super::evidence::{self, TurnTimes};
use super::follow::{Followed, Sample};
use super::hypotheses::{self, AzimuthSkew, Fits, FittingTimes, Times};
use super::{Judged, Skew, SkewEstimator, SkewState, beams, fit, pairs};
use crate::beam_elevation::ElevationOffset;

/// Likeness from which times by azimuth count as the recorded ones (coefficient of correlation, mean
/// resultant length).
const SAME_TIMES: f64 = 0.9;

/// Number of azimuth sectors, all of which must hold points of a spinning lidar.
const SECTORS: usize = 24;

/// Times of points where the recorded ones are wrong, and the elevation offset of the beams.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RightTimes {
    /// The times.
    pub times: Times,
    /// Whether these times are clearly right. Otherwise it is only clear that the recorded ones are wrong.
    pub is_clear: bool,
    /// Offset of the elevations of all beams, if it is clear.
    pub elevation: Option<ElevationOffset>,
}

impl SkewEstimator {
    /// Times of the points where the recorded ones are wrong. These span the fraction `duty` of the interval
    /// between clouds, and the skew is in units of the motion during that time. For a lidar that `spins`,
    /// times by azimuth are tried as well.
    pub fn right_times(&self, skew: &Skew, duty: f64, spins: bool) -> Option<RightTimes> {
        let is_settled = hypotheses::is_whole_turn(duty)
            && !self.is_open
            && matches!(skew.state(), SkewState::Raw | SkewState::Removed);
        if !self.has_times || is_settled {
            return None;
        }
        let by_azimuth = if spins { self.other_times_by_azimuth(duty) } else { None };
        if let (None, Some(scale)) = (&by_azimuth, hypotheses::scale_of_times(skew)) {
            let elevation = skew.elevation;
            return Some(RightTimes { times: Times::Scaled(scale), is_clear: true, elevation });
        }
        let mut fits = FitsOfTimes(Vec::new());
        for scale in hypotheses::scales_of_times(duty) {
            let times = TurnTimes { part: scale * duty, ..TurnTimes::RECORDED };
            fits.0.push((Times::Scaled(scale), times, self.deskewed(times)?));
        }
        let azimuth_skew = by_azimuth.map(|(judged, azimuth_skew)| {
            fits.0.push((Times::ByAzimuth(azimuth_skew.skew.turn()), judged.times, judged.deskewed));
            azimuth_skew
        });
        let FittingTimes { times, is_clear } = hypotheses::times_that_fit(skew, duty, azimuth_skew, &fits)?;
        let elevation = (fits.of(times))
            .filter(|_| is_clear)
            .and_then(|(_, times, followed)| beams::elevation(&self.batches, followed, Some(*times)));
        Some(RightTimes { times, is_clear, elevation })
    }

    /// Most likely turn, if its times by azimuth differ from the recorded ones.
    fn other_times_by_azimuth(&self, duty: f64) -> Option<(Judged, AzimuthSkew)> {
        let judged = self.judged_by_azimuth()?;
        let alike = self.alike(judged.times)?;
        let azimuth_skew = AzimuthSkew { skew: judged.skew, slope: alike.slope * duty / judged.times.part };
        (alike.correlation.abs() < SAME_TIMES).then_some((judged, azimuth_skew))
    }

    /// State of the skew with times by azimuth; none if they equal the recorded ones, or if azimuths do not
    /// cover the full circle.
    pub(super) fn other_state_by_azimuth(&self) -> Option<SkewState> {
        if !self.sees_all_around() {
            return None;
        }
        let (judged, _) = self.other_times_by_azimuth(1.0)?;
        Some(judged.skew.state())
    }

    fn sees_all_around(&self) -> bool {
        let mut seen = [false; SECTORS];
        for phases in self.batches.iter().flat_map(|b| &b.samples).flat_map(|sample| &sample.phases) {
            if let Some(seen) = seen.get_mut((phases.azimuth * SECTORS as f32) as usize) {
                *seen = true;
            }
        }
        seen.iter().all(|seen| *seen)
    }

    /// Whether sweeps, de-skewed with recorded times, show another begin of turns than these times do.
    pub(super) fn turns_begin_elsewhere(&self, deskewed: &[Followed]) -> bool {
        let better = self.recorded_turn().and_then(|turn| evidence::better_turn(&pairs(deskewed), turn));
        better.and_then(|turn| self.alike(turn)).is_some_and(|alike| alike.correlation < SAME_TIMES)
    }

    /// How the lidar turns according to recorded times, if azimuth and recorded time correspond.
    fn recorded_turn(&self) -> Option<TurnTimes> {
        let phases = || self.batches.iter().flat_map(|b| &b.samples).flat_map(|sample| &sample.phases);
        let mean = |sense: f32| {
            let begin = phases().map(|p| f64::from(TAU * (p.azimuth - sense * p.recorded)).sin_cos());
            let (n, s, c) = begin.fold((0.0, 0.0, 0.0), |(n, s, c), (y, x)| (n + 1.0, s + y, c + x));
            (f64::hypot(s, c) / n, TurnTimes::by_azimuth((s.atan2(c) as f32 / TAU).rem_euclid(1.0), sense))
        };
        let (alike, turn) = [1.0, -1.0].map(mean).into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        (alike > SAME_TIMES).then_some(turn)
    }

    /// Correlation of the recorded fractions of the sweep with those of such a turn.
    fn alike(&self, turn: TurnTimes) -> Option<Alike> {
        let samples = self.batches.iter().flat_map(|batch| &batch.samples);
        let shares = |sample: &Sample| -> Vec<[f64; 2]> {
            let both = |phases| [turn.share(phases) / turn.part, TurnTimes::RECORDED.share(phases)];
            sample.phases.iter().map(|phases| both(*phases)).collect()
        };
        Alike::of(samples.flat_map(shares))
    }
}

/// Linear relation of two values.
#[derive(Clone, Copy, Debug)]
struct Alike {
    correlation: f64,
    /// Slope of the second value by the first one.
    slope: f64,
}

impl Alike {
    fn of(values: impl Iterator<Item = [f64; 2]>) -> Option<Self> {
        let (mut n, mut sums, mut squares, mut product) = (0.0, [0.0; 2], [0.0; 2], 0.0);
        for [a, b] in values {
            n += 1.0;
            sums = [sums[0] + a, sums[1] + b];
            squares = [squares[0] + a * a, squares[1] + b * b];
            product += a * b;
        }
        let (a, b) = (squares[0] - sums[0] * sums[0] / n, squares[1] - sums[1] * sums[1] / n);
        let both = product - sums[0] * sums[1] / n;
        let alike = Self { correlation: both / (a * b).sqrt(), slope: both / a };
        (alike.correlation.is_finite() && alike.slope.is_finite()).then_some(alike)
    }
}

/// Registered sweeps for each candidate of the times of their points.
struct FitsOfTimes(Vec<(Times, TurnTimes, Vec<Followed>)>);

impl FitsOfTimes {
    fn of(&self, times: Times) -> Option<&(Times, TurnTimes, Vec<Followed>)> {
        self.0.iter().find(|(t, ..)| *t == times)
    }

    fn with(&self, times: Times) -> &[Followed] {
        self.of(times).map_or(&[], |(.., followed)| followed)
    }
}

impl Fits for FitsOfTimes {
    fn sigmas_better(&self, from: Times, to: Times) -> f64 {
        fit::sigmas_better(self.with(from), self.with(to))
    }

    fn explained(&self, times: Times) -> f64 {
        fit::explained(self.with(times))
    }
}
