//! By how much all beams point too low.
//!
//! The residuals of registered sweeps depend linearly on an angle by which all beams are raised: what was seen from afar is
//! higher by more than what is seen from near. One step finds a part of the way, since points are paired anew when they
//! move; the angle is where the step vanishes, by the secant through the last two.

use super::evidence::{Step, TurnTimes, beam_step};
use super::follow::{self, Followed};
use super::{Batch, INFLATION};
use crate::beam_elevation::{ElevationOffset, Raise};

/// A first step with fewer standard deviations ends the search: there is nothing to be found.
const WORTHWHILE: f64 = 3.0;
/// The first step finds about so much of the way.
const FOUND_AT_ONCE: f64 = 0.5;
/// On real lidars it finds 0.52 to 0.55 of the way; where it is less than this share, beams are not what is wrong.
const LEAST_SLOPE: f64 = 0.35;
/// Secants at most.
const SECANTS: usize = 2;

/// The offset at which nothing more is to be found, from sweeps as they were `followed` with these times.
pub(super) fn elevation(
    batches: &[Batch],
    followed: &[Followed],
    times: Option<TurnTimes>,
) -> Option<ElevationOffset> {
    let first = step_of(followed)?;
    let (mut last, mut step) = (0.0, first.factors.x);
    let mut sigma = INFLATION * first.sigmas.x;
    if step.abs() < WORTHWHILE * sigma {
        return Some(ElevationOffset { radians: step / FOUND_AT_ONCE, sigma: sigma / FOUND_AT_ONCE });
    }
    let mut next = step / FOUND_AT_ONCE;
    for _ in 0..SECANTS {
        let raise = Raise::new(next);
        let raised: Vec<Followed> = (batches.iter().zip(followed))
            .filter_map(|(batch, followed)| {
                let samples: Vec<_> = batch.samples.iter().map(|sample| sample.raised(&raise)).collect();
                follow::follow(&samples, times, Some(&followed.without_surfaces()))
            })
            .collect();
        let there = step_of(&raised)?;
        let slope = (step - there.factors.x) / (next - last);
        // What is taken out must no longer be found, or it is something else.
        if slope.is_nan() || slope < LEAST_SLOPE {
            return None;
        }
        sigma = INFLATION * there.sigmas.x / slope;
        (last, step) = (next, there.factors.x);
        next += step / slope;
    }
    Some(ElevationOffset { radians: next, sigma })
}

fn step_of(followed: &[Followed]) -> Option<Step> {
    beam_step(&followed.iter().flat_map(|f| &f.pairs).collect::<Vec<_>>())
}
