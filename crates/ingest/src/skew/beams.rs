//! Estimates by how much all beams point too low.
//!
//! The residuals of registered sweeps depend linearly on an angle by which all beams are raised: a surface
//! seen from afar rises by more than one seen from nearby. One step finds a part of the angle, since points
//! are paired anew when they move. The angle is where the step vanishes, by the secant through the last two.

use super::evidence::{Step, TurnTimes, beam_step};
use super::follow::{self, Followed};
use super::{Batch, INFLATION};
use crate::beam_elevation::{ElevationOffset, Raise};

/// Number of standard deviations of the first step below which the search ends without an offset.
const WORTHWHILE: f64 = 3.0;
/// Approximate fraction of the angle that the first step finds.
const FOUND_AT_ONCE: f64 = 0.5;
/// Minimum of that fraction: on real lidars it is 0.52 to 0.55. Where it is smaller, the error is not in the
/// beams.
const LEAST_SLOPE: f64 = 0.35;
/// Maximum number of secant steps.
const SECANTS: usize = 2;

/// Offset at which the step vanishes. The sweeps were `followed` with these times.
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
        // An offset that was corrected must no longer be found; otherwise the cause is another one.
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
