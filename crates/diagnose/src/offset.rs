//! Estimates the offset of two clocks from rotations that both sensors measured.
//!
//! Some rotations of a lidar are wrong: people pass, doors come and go. At each lag, differences of
//! rotations count up to a limit, so that large outliers count no more than their number; the lag with the
//! lowest cost is the offset. Its uncertainty comes from leaving out parts of the recording in turn (block
//! jackknife).

use portolan_geometry::{Duration, Time};

use crate::rotation::{Angle, JOINT, Turn};

/// Approximate length of windows, seconds: longer than the period of the sway of steps, shorter than a turn.
const LENGTH: f64 = 0.25;
/// Maximum number of windows.
const MAX_WINDOWS: usize = 4000;
/// Range of lags to each side of a first guess, seconds.
const REACH: f64 = 0.2;
/// Step of the lags, seconds.
const STEP: f64 = 0.01;
/// Limit up to which differences count, in multiples of their usual size.
const LIMIT: f64 = 2.5;
/// Error of the scale of rotations between sensors, as a fraction of each rotation.
const SCALE_ERROR: f64 = 0.2;
/// Number of parts of the recording, each of which is left out once.
const BLOCKS: usize = 12;
/// Minimum number of windows.
const ENOUGH_WINDOWS: usize = 40;

/// An offset of clocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Offset {
    /// Time by which the second sensor is stamped too late, seconds.
    pub lag: f64,
    /// Standard deviation of the lag, seconds.
    pub sigma: f64,
    /// Relative decrease of the cost against no offset.
    pub gain: f64,
}

/// Finds the offset near `guess` of a sensor whose rotations are `slope` times those of the first. None
/// without enough common data.
pub(super) fn clock_offset(first: &Angle, second: &[Turn], slope: f64, guess: f64) -> Option<Offset> {
    let windows = windows(second);
    let steps = (REACH / STEP) as i32;
    let lags: Vec<f64> = (-steps..=steps).map(|i| guess + STEP * f64::from(i)).collect();
    // Difference of each window at each lag; windows that are unknown at any of the lags are left out.
    let differences: Vec<(f64, Vec<f64>)> = windows
        .iter()
        .filter_map(|window| {
            let of_window: Option<Vec<f64>> =
                lags.iter().map(|lag| window.difference(first, slope, *lag)).collect();
            Some((window.turn, of_window?))
        })
        .collect();
    if differences.len() < ENOUGH_WINDOWS {
        return None;
    }
    let usual = (0..lags.len()).map(|i| median(differences.iter().map(|(_, d)| d[i].abs()).collect()));
    let limit = LIMIT * 1.48 * usual.fold(f64::INFINITY, f64::min).max(1e-6);
    let block = |i: usize| i * BLOCKS / differences.len();
    let mut costs = vec![vec![0.0; lags.len()]; BLOCKS];
    for (i, (turn, of_window)) in differences.iter().enumerate() {
        for (cost, difference) in costs[block(i)].iter_mut().zip(of_window) {
            *cost += robust(*difference, limit, *turn);
        }
    }
    let without = |left_out: Option<usize>| -> Vec<f64> {
        let kept = |i: usize| (0..BLOCKS).filter(|b| Some(*b) != left_out).map(|b| costs[b][i]).sum::<f64>();
        (0..lags.len()).map(kept).collect()
    };
    let at = |place: f64| guess + STEP * (place - f64::from(steps));
    let all = without(None);
    let lag = at(lowest(&all));
    let parts: Vec<f64> = (0..BLOCKS).map(|b| at(lowest(&without(Some(b))))).collect();
    let cost_without = cost_at_zero(&windows, first, slope, limit);
    let cost = all.iter().copied().fold(f64::INFINITY, f64::min) / differences.len() as f64;
    let mean = parts.iter().sum::<f64>() / BLOCKS as f64;
    let squares: f64 = parts.iter().map(|part| (part - mean).powi(2)).sum();
    let gain = 1.0 - cost / cost_without.max(1e-12);
    Some(Offset { lag, sigma: (squares * (BLOCKS - 1) as f64 / BLOCKS as f64).sqrt(), gain })
}

/// Cost of a difference after Geman and McClure: bounded, with a limit that grows with the rotation.
fn robust(difference: f64, limit: f64, turn: f64) -> f64 {
    let squared = difference * difference / (limit * limit + (SCALE_ERROR * turn).powi(2));
    squared / (1.0 + squared)
}

/// Mean cost of windows without any offset.
fn cost_at_zero(windows: &[Window], first: &Angle, slope: f64, limit: f64) -> f64 {
    let costs = windows.iter().filter_map(|w| Some(robust(w.difference(first, slope, 0.0)?, limit, w.turn)));
    let (sum, count) = costs.fold((0.0, 0.0), |(sum, count), cost| (sum + cost, count + 1.0));
    sum / f64::max(count, 1.0)
}

/// Rotation over some scans.
struct Window {
    start: Time,
    end: Time,
    turn: f64,
}

impl Window {
    fn difference(&self, first: &Angle, slope: f64, lag: f64) -> Option<f64> {
        let lag = Duration::from_seconds(lag);
        Some(self.turn - slope * first.between(self.start - lag, self.end - lag)?)
    }
}

/// Rotations joined to windows, one from each rotation on.
fn windows(turns: &[Turn]) -> Vec<Window> {
    let from = |first: usize| {
        let (start, mut end, mut turn) = *turns.get(first)?;
        for (next_start, next_end, next) in &turns[first + 1..] {
            if end.seconds_since(start) >= LENGTH {
                break;
            }
            if next_start.seconds_since(end).abs() > JOINT {
                return None;
            }
            (end, turn) = (*next_end, turn + next);
        }
        (end.seconds_since(start) >= LENGTH).then_some(Window { start, end, turn })
    };
    let stride = turns.len().div_ceil(MAX_WINDOWS).max(1);
    (0..turns.len()).step_by(stride).filter_map(from).collect()
}

/// Median (the upper one of two middle values); 0 if there are none.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    portolan_numeric::median(&mut values).unwrap_or(0.0)
}

/// Position of the lowest cost, with a fraction.
fn lowest(costs: &[f64]) -> f64 {
    let best = (0..costs.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or(0);
    let (Some(before), Some(after)) = (best.checked_sub(1).and_then(|i| costs.get(i)), costs.get(best + 1))
    else {
        return best as f64;
    };
    let curvature = before - 2.0 * costs[best] + after;
    let fraction = if curvature > 0.0 { 0.5 * (before - after) / curvature } else { 0.0 };
    best as f64 + fraction.clamp(-0.5, 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rotation::tests::turns;

    #[test]
    fn wrong_turns_do_not_move_the_offset_and_poor_ones_make_it_unsure() {
        let first = Angle::new(&turns(0.0, 1.0, 0.02));
        let found = |every: usize, size: f64| {
            let mut second = turns(0.05, 1.0, 0.1);
            for (i, turn) in second.iter_mut().enumerate() {
                // One scan in `every` fits another wall.
                if i % every == 0 {
                    turn.2 += size * (i as f64 * 1.7).sin();
                }
            }
            clock_offset(&first, &second, 1.0, 0.04).unwrap()
        };
        let good = found(20, 0.3);
        assert!((good.lag - 0.05).abs() < 0.004 && good.sigma < 0.004, "{good:?}");
        let poor = found(1, 0.3);
        assert!(poor.sigma > 3.0 * good.sigma, "{poor:?}");
        assert_eq!(clock_offset(&first, &[], 1.0, 0.0), None);
    }
}
