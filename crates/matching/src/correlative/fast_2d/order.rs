//! Selects among equally good placements the one that plain branch and bound would find.
//!
//! It descends first into the box with the larger bound, among equals into the one made first, and keeps
//! the first best placement it meets. So of two placements the one comes first whose boxes come first
//! where their paths from the root part.

use std::cmp::Ordering;

use super::super::joint_search::Placement;
use super::super::rotated_scans::RotatedScans;
use super::FastCorrelativeMatcher2d;

/// The first of `placements` in the order of the search of depth `branch_and_bound_depth`.
pub(super) fn first_of(
    placements: &[Placement],
    matcher: &FastCorrelativeMatcher2d,
    scans: &mut RotatedScans,
) -> Option<Placement> {
    let (first, rest) = placements.split_first()?;
    let mut best = *first;
    for placement in rest {
        if compare(placement, &best, matcher, scans) == Ordering::Less {
            best = *placement;
        }
    }
    Some(best)
}

fn compare(
    a: &Placement,
    b: &Placement,
    matcher: &FastCorrelativeMatcher2d,
    scans: &mut RotatedScans,
) -> Ordering {
    for exponent in (0..matcher.options.branch_and_bound_depth).rev() {
        let (box_a, box_b) = (box_of(a, exponent, scans), box_of(b, exponent, scans));
        if box_a != box_b {
            let score_a = score(&box_a, exponent, matcher, scans);
            let score_b = score(&box_b, exponent, matcher, scans);
            return score_b.total_cmp(&score_a).then(box_a.cmp(&box_b));
        }
    }
    Ordering::Equal
}

/// The box of 2^`exponent` shifts along each axis that holds a placement.
fn box_of(placement: &Placement, exponent: u32, scans: &mut RotatedScans) -> Placement {
    let num_linear = scans.num_linear();
    let cells = scans.cells(placement.scan);
    let [x, y] = [0, 1].map(|axis| {
        let last = cells.iter().map(|c| c[axis]).max().unwrap_or(0);
        // Boxes are counted from the smallest shift of the scan.
        let start = (-last).min(0).max(-num_linear);
        let shift = if axis == 0 { placement.x } else { placement.y };
        start + ((shift - start) >> exponent << exponent)
    });
    Placement { scan: placement.scan, x, y }
}

fn score(
    first: &Placement,
    exponent: u32,
    matcher: &FastCorrelativeMatcher2d,
    scans: &mut RotatedScans,
) -> f32 {
    let byte = |c: &[i32; 2]| matcher.pyramid.window_max(c[0] + first.x, c[1] + first.y, exponent);
    let sum = scans.cells(first.scan).iter().map(|c| u32::from(byte(c))).sum();
    matcher.score.of(sum, scans.num_points())
}
