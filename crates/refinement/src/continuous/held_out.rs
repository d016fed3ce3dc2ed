//! Cross-validation: tests whether surfaces that took no part in the fit agree better with the result than
//! with the input.
//!
//! A fraction of space, in blocks, is held out of the fit. Afterwards the patches there are paired, window
//! with window, once with the input and once with the result, and the distance of each pair is computed with
//! both. Windows near in time show the thickness of surfaces, others the agreement of passes. Where held-out
//! surfaces fit worse than with the input, the fit has followed something other than the motion, and the
//! motion of the input is kept (hold-out validation; Arlot and Celisse, "A survey of cross-validation
//! procedures for model selection", 2010).

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use portolan_geometry::{
    Rigid3, Vector3, angle_axis_from_quaternion, nalgebra as na, quaternion_from_angle_axis,
};
use portolan_numeric::scramble;
use serde::Serialize;

use super::DenseTrajectory;
use super::correction::Corrections;
use super::dense_trajectory::PoseMatrices;
use super::pairs::{PlacedSurfel, find_pairs, place};
use super::surfels::SurfelMap;

/// Edge of the blocks of space that are held out, metres: the width of several patches.
const BLOCK: f64 = 4.0;
/// One of this many blocks is held out.
const ONE_OF: u32 = 5;
/// Maximum distance of pairs across a surface, metres; larger distances count as this.
const REACH: f64 = 0.3;
/// Difference of window numbers above which windows are different passes.
const PASS: usize = 5;
/// Number of windows that are evaluated together: single windows are dominated by chance.
const TOGETHER: usize = 10;
/// Minimum number of pairs of windows for an evaluation.
const LEAST_PAIRS: usize = 30;
/// Number of standard errors from which the result is worse, if it is also [`RELEVANT`].
const SIGNIFICANT: f64 = 3.0;
/// Minimum fraction of the cost by which the result must be worse.
const RELEVANT: f64 = 0.1;
/// Minimum scale of the robust cost, metres: the noise of ranges.
const LEAST_SCALE: f64 = 0.02;

/// A part of the points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// All points.
    All,
    /// Points that are fitted.
    Fitted,
    /// Points that are held out of the fit.
    HeldOut,
}

/// Selects a part of the points, by blocks of the world as placed by the input.
#[derive(Clone, Copy)]
pub(crate) struct Selection<'a> {
    pub part: Part,
    /// Poses of the input.
    pub input: &'a PoseMatrices,
}

impl Selection<'_> {
    /// Whether a point, given by its recorded time and position in the tracking frame, belongs to the part.
    #[inline]
    pub fn contains(&self, seconds: f64, in_tracking: [f32; 3]) -> bool {
        let wanted = match self.part {
            Part::All => return true,
            Part::Fitted => false,
            Part::HeldOut => true,
        };
        let block = self.input.to_world(seconds, in_tracking).map(|v| (v / BLOCK).floor() as i64 as u32);
        let hash = block.iter().fold(0, |hash, index| scramble(hash ^ index));
        (hash % ONE_OF == 0) == wanted
    }
}

/// Agreement of patches that were held out of the fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Agreement {
    /// Number of pairs of windows with the same surfaces.
    pub pairs: usize,
    /// Root mean square distance with the input, metres; distances of 0.3 m and more count as 0.3 m.
    pub before: f64,
    /// The same with the result.
    pub after: f64,
}

/// Result of the cross-validation of a refinement.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CrossValidation {
    /// Windows near in time: thickness of surfaces.
    pub near_in_time: Agreement,
    /// Windows of different passes: agreement of these.
    pub between_passes: Agreement,
    /// Intervals in which the motion of the input was kept because held-out surfaces agreed less with the
    /// result (from, to; seconds since the start of the trajectory).
    pub refused: Vec<[f64; 2]>,
    /// Whether the whole result was refused.
    pub is_refused: bool,
}

/// Costs of the pairs of two windows with input and result.
#[derive(Clone, Copy, Debug, Default)]
struct Costs {
    count: f64,
    robust: [f64; 2],
    squares: [f64; 2],
}

/// Numbers of two windows, and their costs.
type Sample<'a> = (&'a (usize, usize), &'a Costs);

/// Compares the agreement of held-out patches with the result to that with the input. None if there are too
/// few.
pub(super) fn judge(
    map: &SurfelMap,
    corrections: &Corrections,
    trajectory: &DenseTrajectory,
) -> Option<CrossValidation> {
    let mut input = trajectory.clone();
    input.reset();
    let placed = [place(map, &Corrections::default(), &input), place(map, corrections, trajectory)];
    let costs = costs_of_windows(map, &placed);
    let is_near = |(a, b): &(usize, usize)| a.abs_diff(*b) <= PASS;
    let (near, far): (Vec<_>, Vec<_>) = costs.iter().partition(|(windows, _)| is_near(windows));
    let mut result = CrossValidation {
        near_in_time: agreement(&near),
        between_passes: agreement(&far),
        ..CrossValidation::default()
    };
    if near.len() < LEAST_PAIRS {
        return None;
    }
    result.is_refused = is_worse(&near) || is_worse(&far);
    let last = map.windows.iter().map(|window| window.number).max()?;
    for first in (0..=last).step_by(TOGETHER) {
        let here = first..(first + TOGETHER).min(last + 1);
        if [&near, &far].iter().any(|all| is_worse(&touching(all, &here))) {
            result.refused.extend(span(map, trajectory.duration(), &here));
        }
    }
    join(&mut result.refused);
    Some(result)
}

/// Robust costs (Geman and McClure 1987) and squares of the distances of pairs, for each pair of windows.
fn costs_of_windows(map: &SurfelMap, placed: &[Vec<PlacedSurfel>; 2]) -> BTreeMap<(usize, usize), Costs> {
    let window_of = |surfel: u32| {
        let index = map.windows.partition_point(|w| w.surfels.end <= surfel as usize);
        map.windows[index].number
    };
    // Pairs found with only one of both count, too.
    let mut pairs: BTreeSet<(u32, u32)> = BTreeSet::new();
    for placed in placed {
        let found = find_pairs(map, placed, REACH, None);
        pairs.extend(found.iter().map(|pair| (pair.a.min(pair.b), pair.a.max(pair.b))));
    }
    let distance = |placed: &[PlacedSurfel], (a, b): (u32, u32)| {
        let (a, b) = (&placed[a as usize], &placed[b as usize]);
        let normal = (a.normal + b.normal).try_normalize(1e-6).unwrap_or(a.normal);
        normal.dot(&(a.mean - b.mean)).abs().min(REACH)
    };
    let distances: Vec<((u32, u32), [f64; 2])> =
        pairs.into_iter().map(|pair| (pair, [0, 1].map(|k| distance(&placed[k], pair)))).collect();
    // The smaller distances of both determine the flatness of patches.
    let mut smaller: Vec<f64> = distances.iter().map(|(_, [a, b])| a.min(*b)).collect();
    smaller.sort_by(f64::total_cmp);
    let scale = smaller.get(smaller.len() / 2).map_or(LEAST_SCALE, |median| median / 0.6745).max(LEAST_SCALE);
    let mut costs: BTreeMap<(usize, usize), Costs> = BTreeMap::new();
    for ((a, b), distances) in distances {
        let windows = (window_of(a), window_of(b));
        let sum = costs.entry((windows.0.min(windows.1), windows.0.max(windows.1))).or_default();
        sum.count += 1.0;
        for (k, d) in distances.into_iter().enumerate() {
            sum.robust[k] += d * d / (scale * scale + d * d);
            sum.squares[k] += d * d;
        }
    }
    costs
}

/// The samples of which one window is in the range.
fn touching<'a>(costs: &[Sample<'a>], windows: &Range<usize>) -> Vec<Sample<'a>> {
    let touches = |(a, b): &(usize, usize)| windows.contains(a) || windows.contains(b);
    costs.iter().filter(|(pair, _)| touches(pair)).copied().collect()
}

fn agreement(costs: &[Sample]) -> Agreement {
    let count: f64 = costs.iter().map(|(_, c)| c.count).sum();
    let rms = |k: usize| (costs.iter().map(|(_, c)| c.squares[k]).sum::<f64>() / f64::max(count, 1.0)).sqrt();
    Agreement { pairs: costs.len(), before: rms(0), after: rms(1) }
}

/// Whether pairs fit worse with the result than with the input. Errors of pairs of the same two windows are
/// correlated, so together they are one sample.
fn is_worse(costs: &[Sample]) -> bool {
    if costs.len() < LEAST_PAIRS {
        return false;
    }
    let mean = |k: usize, c: &Costs| c.robust[k] / c.count.max(1.0);
    let number = costs.len() as f64;
    let differences: Vec<f64> = costs.iter().map(|(_, c)| mean(1, c) - mean(0, c)).collect();
    let before = costs.iter().map(|(_, c)| mean(0, c)).sum::<f64>() / number;
    let worse = differences.iter().sum::<f64>() / number;
    let variance = differences.iter().map(|d| (d - worse).powi(2)).sum::<f64>() / (number - 1.0);
    worse > SIGNIFICANT * (variance / number).sqrt() && worse > RELEVANT * before
}

/// Time span of the patches of some windows, seconds.
fn span(map: &SurfelMap, duration: f64, windows: &Range<usize>) -> Option<[f64; 2]> {
    let own = map.windows.iter().filter(|w| windows.contains(&w.number));
    let times = own.flat_map(|w| &map.surfels[w.surfels.clone()]).map(|surfel| surfel.seconds);
    let [from, to] = times.fold([f64::INFINITY, f64::NEG_INFINITY], |[from, to], t| [from.min(t), to.max(t)]);
    (from < to).then(|| [from.max(0.0), to.min(duration)])
}

/// Joins neighbouring spans.
fn join(spans: &mut Vec<[f64; 2]>) {
    const GAP: f64 = 2.0;
    spans.dedup_by(|next, last| {
        let is_next = next[0] - last[1] < GAP;
        if is_next {
            last[1] = last[1].max(next[1]);
        }
        is_next
    });
}

/// Gives a trajectory the motion of the input within spans. Its correction changes linearly from the value
/// before to the value after the span, so that nothing around is moved.
pub(super) fn keep_input(trajectory: &mut DenseTrajectory, spans: &[[f64; 2]]) {
    const STEP: f64 = 0.1;
    for [from, to] in spans {
        let ends = [*from, *to].map(|seconds| trajectory.correction(seconds));
        let turns = ends.map(|end| angle_axis_from_quaternion(&end.turn));
        let steps = ((to - from) / STEP).ceil().max(1.0) as usize;
        let mut moves = vec![(*from, Rigid3::identity())];
        for i in 0..=steps {
            let share = i as f64 / steps as f64;
            let seconds = from + (to - from) * share;
            let input = trajectory.joined_pose(seconds);
            let shift: Vector3 = ends[0].shift.lerp(&ends[1].shift, share);
            let turn = quaternion_from_angle_axis(&turns[0].lerp(&turns[1], share));
            let place = na::Translation3::from(input.translation.vector + shift);
            let wanted = Rigid3::from_parts(place, turn * input.rotation);
            moves.push((seconds, wanted * trajectory.pose(seconds).inverse()));
        }
        moves.push((*to, Rigid3::identity()));
        trajectory.move_each(&moves);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Duration, Time};

    fn straight(seconds: i32) -> DenseTrajectory {
        let pose = |i: i32| {
            let t = 0.1 * f64::from(i);
            (Time::from_unix_seconds(1e9) + Duration::from_seconds(t), Rigid3::translation(t, 0.0, 0.0))
        };
        DenseTrajectory::new(&(0..=10 * seconds).map(pose).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn blocks_are_either_fitted_or_kept_out() {
        let input = straight(20).matrices();
        let in_part = |part, i: usize| {
            let place = [(i % 100) as f32 - 50.0, (i / 100) as f32 - 50.0, 0.5];
            Selection { part, input: &input }.contains(5.0, place)
        };
        let held_out = (0..10_000).filter(|i| in_part(Part::HeldOut, *i)).count();
        assert!((1_200..2_800).contains(&held_out), "{held_out} of 10,000");
        assert!((0..10_000).all(|i| in_part(Part::All, i)));
        assert!((0..10_000).all(|i| in_part(Part::Fitted, i) != in_part(Part::HeldOut, i)));
    }

    #[test]
    fn a_result_is_worse_if_the_difference_is_significant_and_large() {
        let costs = |after: &dyn Fn(usize) -> f64| -> BTreeMap<(usize, usize), Costs> {
            let cost = |i: usize| Costs { count: 10.0, robust: [4.0, after(i)], squares: [0.0; 2] };
            (0..100).map(|i| ((i, i + 1), cost(i))).collect()
        };
        let scatter = |i: usize| 2.0 * ((i as f64 * 0.618).fract() - 0.5);
        let is_worse_by = |shift: f64, share: f64| {
            let costs = costs(&|i| 4.0 + shift + share * scatter(i));
            is_worse(&costs.iter().collect::<Vec<_>>())
        };
        assert!(is_worse_by(1.0, 1.0) && !is_worse_by(-1.0, 1.0));
        // A difference that is hardly noticeable, and one by chance.
        assert!(!is_worse_by(0.2, 0.1) && !is_worse_by(0.5, 8.0));
        let few = costs(&|_| 8.0);
        assert!(!is_worse(&few.iter().take(LEAST_PAIRS - 1).collect::<Vec<_>>()), "too few");
    }

    #[test]
    fn a_refused_result_keeps_the_motion_of_the_input() {
        let mut trajectory = straight(30);
        let wave = |t: f64| Rigid3::translation(0.0, 0.02 * t + 0.1 * (3.0 * t).sin(), 0.0);
        let moves: Vec<(f64, Rigid3)> = (0..=300).map(|i| 0.1 * f64::from(i)).map(|t| (t, wave(t))).collect();
        trajectory.move_each(&moves);
        let before = trajectory.clone();
        keep_input(&mut trajectory, &[[10.0, 20.0]]);
        let bend = |t: f64| {
            let shift = |t: f64| trajectory.correction(t).shift.y;
            (shift(t) - 0.5 * (shift(t - 0.5) + shift(t + 0.5))).abs()
        };
        assert!((21..=39).all(|i| bend(0.5 * f64::from(i)) < 1e-3), "a straight correction within");
        for seconds in [5.0, 9.9, 10.0, 20.0, 20.1, 28.0] {
            let moved = trajectory.pose(seconds).inverse() * before.pose(seconds);
            assert!(moved.translation.vector.norm() < 0.01, "{seconds}: {moved}");
        }
    }
}
