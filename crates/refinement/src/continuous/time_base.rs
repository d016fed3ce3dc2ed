//! Tests whether trajectory and points belong together. Points of short windows are placed with the
//! trajectory, shifted in time by up to several seconds, and with none at all; the sharper the result, the
//! better the fit.

use portolan_geometry::{Rigid3, Vector3};
use rayon::prelude::*;

use super::cells::Cells;
use super::coverage::TimedPoints;
use super::dense_trajectory::DenseTrajectory;

/// Length of a window, seconds.
const WINDOW: f64 = 1.0;
/// Number of windows.
const WINDOWS: usize = 16;
/// Maximum number of points of a window that are used.
const POINTS: usize = 8000;
/// Bounds of the edges of the cells, metres. The edge is twice the motion during a sweep of most lidars, so
/// that surfaces displaced by the motion of one turn are in the same cell and make it thick.
const CELL: [f64; 2] = [0.5, 4.0];
/// Duration of a sweep of most lidars, seconds.
const TURN: f64 = 0.1;
/// Thickness added to all cells, metres: below it, thinner cells do not count as sharper.
const THIN: f64 = 0.01;
/// Steps of the search, seconds.
const STEP: f64 = 0.1;
/// Offsets to each side that are always searched, seconds.
const NEAR: f64 = 2.0;
/// Offsets to each side that are searched if the trajectory does not fit, seconds.
const FAR: f64 = 30.0;
/// Number of standard errors from which a difference is significant, if it is also at least [`LARGE`].
const SIGNIFICANT: f64 = 4.0;
/// Minimum of a significant difference (natural logarithm of the thickness).
const LARGE: f64 = 0.05;
/// Number of standard errors by which a trajectory must be sharper than standing still to belong to this
/// recording, however inaccurate it is.
const HINT: f64 = 1.0;
/// Mean motion in the windows below which a trajectory cannot be distinguished from standing still, metres
/// and radians.
const STANDING: (f64, f64) = (0.05, 0.03);

/// Result of the test of the times of trajectory and points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum TimeBase {
    /// The times fit, as well as can be determined.
    Fits,
    /// The times fit better with this offset added to the stamps of the trajectory, seconds.
    FitsWith(f64),
    /// They fit no better than if the sensor had stood still.
    FitsNowhere,
}

/// Points of one window.
struct Sample {
    /// Times in seconds since the start of the trajectory, and positions in the tracking frame.
    points: Vec<(f64, [f32; 3])>,
}

/// Tests whether the trajectory fits. The search begins at the offset `around`, seconds added to its stamps,
/// and covers at least `reach` seconds to each side.
pub(crate) fn test_time_base(
    points: &TimedPoints,
    trajectory: &DenseTrajectory,
    around: f64,
    reach: f64,
) -> TimeBase {
    let samples = samples(points);
    if samples.len() < WINDOWS / 3 {
        return TimeBase::Fits;
    }
    let edge = (2.0 * TURN * speed(trajectory, &samples)).clamp(CELL[0], CELL[1]);
    let score = |delay: f64| -> Vec<Option<f64>> {
        // Added to the stamps of the trajectory: its pose at s − delay belongs to s.
        samples.par_iter().map(|s| thickness(s, edge, |at| pose_within(trajectory, at - delay))).collect()
    };
    let still: Vec<Option<f64>> =
        samples.par_iter().map(|s| thickness(s, edge, |_| Some(Rigid3::identity()))).collect();
    let given = score(0.0);
    let moves = moves(trajectory, &samples);
    let fits = !moves || improvement(&given, &still).is_some_and(|(_, errors)| errors > HINT);
    let reach = if fits { NEAR } else { FAR.min(trajectory.duration()) }.max(reach);
    let steps = (reach / STEP).ceil() as i64;
    let mut best: Option<(f64, Vec<Option<f64>>)> = None;
    for step in -steps..=steps {
        let delay = around + step as f64 * STEP;
        let scores = score(delay);
        if best.as_ref().is_none_or(|(_, b)| gain(&scores, &still) > gain(b, &still)) {
            best = Some((delay, scores));
        }
    }
    let Some((mut delay, mut scores)) = best else { return TimeBase::Fits };
    let mut step = STEP / 2.0;
    while step > 0.002 {
        for candidate in [delay - step, delay + step] {
            let other = score(candidate);
            if gain(&other, &still) > gain(&scores, &still) {
                (delay, scores) = (candidate, other);
            }
        }
        step /= 2.0;
    }
    let better_than_given = given.iter().all(Option::is_none) || is_better(&scores, &given);
    if delay.abs() > 0.02 && better_than_given && is_better(&scores, &still) {
        TimeBase::FitsWith(delay)
    } else if fits {
        TimeBase::Fits
    } else {
        TimeBase::FitsNowhere
    }
}

/// Windows spread over the recording.
fn samples(points: &TimedPoints) -> Vec<Sample> {
    let (Some(first), Some(last)) = (points.points.first(), points.points.last()) else { return Vec::new() };
    let (from, to) = (points.seconds(first), points.seconds(last));
    let step = (to - from - WINDOW) / (WINDOWS - 1) as f64;
    if step <= 0.0 {
        return Vec::new();
    }
    let sample = |i: usize| {
        let start = from + i as f64 * step;
        let part = points.between([start, start + WINDOW]);
        let stride = part.len().div_ceil(POINTS).max(1);
        // Not synchronous with the rings of a scanner.
        let stride = if stride > 1 && stride.is_multiple_of(2) { stride + 1 } else { stride };
        Sample { points: part.iter().step_by(stride).map(|p| points.place(p)).collect() }
    };
    (0..WINDOWS).map(sample).filter(|s| s.points.len() > 200).collect()
}

fn pose_within(trajectory: &DenseTrajectory, seconds: f64) -> Option<Rigid3> {
    (0.0..=trajectory.duration()).contains(&seconds).then(|| trajectory.pose(seconds))
}

/// Mean speed of the trajectory over the windows, m/s.
fn speed(trajectory: &DenseTrajectory, samples: &[Sample]) -> f64 {
    let speeds = samples.iter().filter_map(|sample| {
        let [from, to] = [sample.points.first()?.0, sample.points.last()?.0];
        let [a, b] = [pose_within(trajectory, from)?, pose_within(trajectory, to)?];
        (to > from).then(|| (b.translation.vector - a.translation.vector).norm() / (to - from))
    });
    let (sum, count) = speeds.fold((0.0, 0.0), |(sum, count), speed| (sum + speed, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

/// Whether the trajectory moves during the samples.
fn moves(trajectory: &DenseTrajectory, samples: &[Sample]) -> bool {
    let (mut shift, mut turn, mut count) = (0.0, 0.0, 0.0);
    for sample in samples {
        let ends = [sample.points.first(), sample.points.last()]
            .map(|p| p.and_then(|p| pose_within(trajectory, p.0)));
        if let [Some(a), Some(b)] = ends {
            shift += (a.translation.vector - b.translation.vector).norm();
            turn += a.rotation.angle_to(&b.rotation);
            count += 1.0;
        }
    }
    shift > STANDING.0 * count || turn > STANDING.1 * count
}

/// Mean logarithm of the thickness of the cells, weighted with their points; none outside the trajectory.
fn thickness(sample: &Sample, edge: f64, pose: impl Fn(f64) -> Option<Rigid3>) -> Option<f64> {
    let mut cells = Cells::default();
    let (mut known, mut at) = (None, f64::NEG_INFINITY);
    let mut origin = None;
    for (seconds, p) in &sample.points {
        // One pose for each five milliseconds is enough here.
        if known.is_none() || (seconds - at).abs() > 0.005 {
            (known, at) = (Some(pose(*seconds)?), *seconds);
        }
        let world = known? * portolan_geometry::nalgebra::Point3::from(p.map(f64::from));
        let origin: &Vector3 = origin.get_or_insert(world.coords);
        let local = world.coords - origin;
        let cell = cells.cell([local.x, local.y, local.z].map(|v| (v / edge).floor() as i32));
        cells.moments[cell].add(&local);
    }
    let (mut sum, mut count) = (0.0, 0.0);
    for moments in cells.moments.iter().filter(|m| m.count >= 8.0) {
        let Some(fit) = moments.plane() else { continue };
        sum += moments.count * 0.5 * (fit.variances[0] + THIN * THIN).ln();
        count += moments.count;
    }
    (count > 0.0).then(|| sum / count)
}

/// Differences of two scores in the windows that both have.
fn differences(a: &[Option<f64>], b: &[Option<f64>]) -> Vec<f64> {
    a.iter().zip(b).filter_map(|(a, b)| Some((*a)? - (*b)?)).collect()
}

/// By how much `a` is sharper than `b`, and the same in standard errors; none with too few windows.
fn improvement(a: &[Option<f64>], b: &[Option<f64>]) -> Option<(f64, f64)> {
    let differences = differences(b, a);
    let count = differences.len() as f64;
    if count < WINDOWS as f64 / 3.0 {
        return None;
    }
    let mean = differences.iter().sum::<f64>() / count;
    let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (count - 1.0);
    Some((mean, mean / (variance / count).sqrt().max(1e-12)))
}

/// Whether `a` is significantly sharper than `b`.
fn is_better(a: &[Option<f64>], b: &[Option<f64>]) -> bool {
    improvement(a, b).is_some_and(|(mean, errors)| mean > LARGE && errors > SIGNIFICANT)
}

/// By how much it is sharper than standing still, on average over the windows within the trajectory; minus
/// infinity with fewer than half of them.
fn gain(scores: &[Option<f64>], still: &[Option<f64>]) -> f64 {
    let differences = differences(still, scores);
    if 2 * differences.len() < still.len() {
        return f64::NEG_INFINITY;
    }
    differences.iter().sum::<f64>() / differences.len() as f64
}
