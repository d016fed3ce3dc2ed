//! Estimates the pose in the map of a fixed frame, such as that of satellite fixes, and the weight of the
//! fixes.
//!
//! A fix does not measure headings, and a solver that starts with a wrong heading of the frame of fixes gets
//! stuck. So the frame is found from pairs of nodes (least median of squares: Rousseeuw, "Least Median of
//! Squares Regression", 1984) and refined by weighted least squares in closed form. The weight of fixes
//! follows from two errors. White noise: from differences of consecutive fixes. Slow errors, such as
//! reflected signals: from distances between fixes against the distances between their nodes, over time lags
//! that double. Neither needs a map without drift.

use std::collections::BTreeMap;

use portolan_config::OptimizationProblemOptions;
use portolan_geometry::nalgebra::Vector2;
use portolan_geometry::{Rigid3, Time, Vector3, rotation_from_roll_pitch_yaw};
use portolan_motion::{Observability, fixed_frame_at};
use portolan_numeric::{SplitMix64, median, quantile};
use portolan_sensor::FixedFramePoseData;
use portolan_solver::Loss;

use super::data::{OptimizationData, OptimizationNode};
use super::graph_problem::Weights;
use crate::{NodeId, TrajectoryId, of_trajectory};

/// Minimum number of fixes; the scatter of fewer is unknown.
const MIN_FIXES: usize = 20;
/// Median absolute deviation of a normal distribution, in standard deviations.
const MEDIAN_DEVIATION: f64 = 0.6745;
/// Number of standard deviations beyond which fixes pull with a constant force only (Huber's loss): reflected
/// signals displace them by tens of metres, for seconds.
const OUTLIER: f64 = 3.0;
/// Number of pairs of nodes that are tried.
const TRIALS: usize = 100;
/// Maximum number of fixes by which each try is scored.
const JUDGES: usize = 400;
/// Relative error of distances in the map. Assumed.
const MAP_ERROR: f64 = 0.02;
/// Relative difference from which fixes contradict the map, if half of the longest distances differ by more.
/// Assumed.
const CONTRADICTION: f64 = 0.2;
/// Ratio of the variance to that of the noise above which there are slow errors. Assumed.
const CLEARLY_MORE: f64 = 1.5;
/// Maximum standard deviation of the heading of the frame, radians. Assumed.
const HEADING: f64 = 0.1;

/// Ratio of the interval between two fixes to the usual one above which it is a gap, in which fixes are not
/// used.
const GAP: f64 = 3.0;
/// Minimum length of a gap, seconds.
const LEAST_GAP: f64 = 2.0;

/// The fixed frame of a trajectory.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FixedFrame {
    pub map_from_fixed: Rigid3,
    pub weights: Weights,
    /// The measurement at each node.
    pub measured: Vec<(NodeId, Rigid3)>,
}

/// A node and the fix at its time.
#[derive(Clone, Copy, Debug)]
struct Pair {
    place: Vector3,
    fix: Vector3,
    /// Whether nothing measured the motion to the node: the map may be wrong there, and is not compared with
    /// fixes.
    is_guess: bool,
}

impl FixedFrame {
    /// None where it is unknown: there are no poses in it, too few for a heading, or they contradict the map.
    pub fn of(
        data: &OptimizationData,
        id: TrajectoryId,
        options: &OptimizationProblemOptions,
    ) -> Option<Self> {
        let known = data.fixed_frame_origins.get(&id).copied().flatten();
        let usual = options.fixed_frame_pose_translation_weight;
        let fixed = &data.sensors.get(&id)?.fixed_frame;
        let at_node = |(id, node): (NodeId, &OptimizationNode)| Some((id, fixed_frame_at(fixed, node.time)?));
        let measured: Vec<(NodeId, Rigid3)> = of_trajectory(&data.nodes, id).filter_map(at_node).collect();
        let (first, in_fixed) = measured.first()?;
        // A satellite fix does not measure rotation. Cartographer takes it as heading east.
        let are_fixes = measured.iter().all(|(_, in_fixed)| in_fixed.rotation.angle() < 1e-9);
        if !data.sensor_policy.weighs_fixes_by_scatter || !are_fixes {
            let of_first = || Some(data.nodes.get(first)?.map_from_node * in_fixed.inverse());
            let map_from_fixed = known.or_else(of_first)?;
            let weights = (usual, options.fixed_frame_pose_rotation_weight);
            return Some(Self { map_from_fixed, weights, measured });
        }
        let measured = without_gaps(measured, data, fixed);
        let pair = |(id, fix): &(NodeId, Rigid3)| {
            let place = data.nodes.get(id)?.map_from_node.translation.vector;
            let is_guess =
                |of: &Observability| !of.degenerate.translations.is_empty() && !of.translation_is_measured;
            let is_guess = data.open.get(id).is_some_and(is_guess);
            Some(Pair { place, fix: fix.translation.vector, is_guess })
        };
        let pairs: Vec<Pair> = measured.iter().filter_map(pair).collect();
        let map_from_fixed = aligned(&pairs)?;
        let sigma = error_of(&pairs, &map_from_fixed)?;
        Some(Self { map_from_fixed, weights: (usual.min(1.0 / sigma), 0.0), measured })
    }
}

/// Number of nodes with satellite fixes that are not used, because they contradict the map or the robot moved
/// too little for a heading.
pub fn unused_fixes(
    data: &OptimizationData,
    id: TrajectoryId,
    options: &OptimizationProblemOptions,
) -> usize {
    let Some(sensors) = data.sensors.get(&id).filter(|_| FixedFrame::of(data, id, options).is_none()) else {
        return 0;
    };
    let has_fix = |node: &OptimizationNode| fixed_frame_at(&sensors.fixed_frame, node.time).is_some();
    of_trajectory(&data.nodes, id).filter(|(_, node)| has_fix(node)).count()
}

/// Removes measurements that were interpolated in gaps.
fn without_gaps(
    mut measured: Vec<(NodeId, Rigid3)>,
    data: &OptimizationData,
    fixed: &BTreeMap<Time, FixedFramePoseData>,
) -> Vec<(NodeId, Rigid3)> {
    let intervals = fixed.keys().zip(fixed.keys().skip(1)).map(|(a, b)| b.seconds_since(*a));
    let usual = median(&mut intervals.collect::<Vec<_>>()).unwrap_or(0.0);
    let longest = LEAST_GAP.max(GAP * usual);
    measured.retain(|(id, _)| {
        let Some(time) = data.nodes.get(id).map(|node| node.time) else { return false };
        let (before, after) = (fixed.range(..=time).next_back(), fixed.range(time..).next());
        before.zip(after).is_some_and(|((a, _), (b, _))| b.seconds_since(*a) <= longest)
    });
    measured
}

/// The loss of ties to the fixed frame.
pub(super) fn loss(data: &OptimizationData, options: &OptimizationProblemOptions) -> Loss {
    if options.fixed_frame_pose_use_tolerant_loss {
        let (a, b) =
            (options.fixed_frame_pose_tolerant_loss_param_a, options.fixed_frame_pose_tolerant_loss_param_b);
        return Loss::Tolerant(a, b);
    }
    if data.sensor_policy.has_robust_fixes { Loss::Huber(OUTLIER) } else { Loss::None }
}

/// Pose of the frame of fixes in the map, by heading and position; none if there are too few fixes.
fn aligned(pairs: &[Pair]) -> Option<Rigid3> {
    if pairs.len() < MIN_FIXES {
        return None;
    }
    let judges: Vec<Pair> = pairs.iter().step_by(pairs.len().div_ceil(JUDGES)).copied().collect();
    let mut random = SplitMix64::new(1);
    let mut any = || judges.get((random.uniform() * judges.len() as f64) as usize);
    let mut best: Option<(f64, Rigid3)> = None;
    let far = 0.5 * extent(&judges);
    for _ in 0..TRIALS {
        let (Some(a), Some(b)) = (any(), any()) else { continue };
        let (of_map, of_fixes) = ((b.place - a.place).xy(), (b.fix - a.fix).xy());
        if of_map.norm() < far {
            continue;
        }
        let heading = of_map.y.atan2(of_map.x) - of_fixes.y.atan2(of_fixes.x);
        let pose = placed(&judges, heading)?;
        let score =
            median(&mut judges.iter().map(|pair| residual(pair, &pose).xy().norm()).collect::<Vec<_>>())?;
        if best.is_none_or(|(least, _)| score < least) {
            best = Some((score, pose));
        }
    }
    let (scale, mut pose) = best?;
    for _ in 0..10 {
        pose = refined(pairs, &pose, OUTLIER * scale.max(1e-3))?;
    }
    Some(pose)
}

/// Distance of nodes from their mean position, metres (median).
fn extent(pairs: &[Pair]) -> f64 {
    let middle = pairs.iter().map(|pair| pair.place.xy()).sum::<Vector2<f64>>() / pairs.len() as f64;
    median(&mut pairs.iter().map(|pair| (pair.place.xy() - middle).norm()).collect::<Vec<_>>()).unwrap_or(0.0)
}

/// The frame with this heading, at the median position of all fixes.
fn placed(pairs: &[Pair], heading: f64) -> Option<Rigid3> {
    let rotation = rotation_from_roll_pitch_yaw(0.0, 0.0, heading);
    let shifts: Vec<Vector3> = pairs.iter().map(|pair| pair.place - rotation * pair.fix).collect();
    let middle = |of: fn(&Vector3) -> f64| median(&mut shifts.iter().map(of).collect::<Vec<_>>());
    let place = Vector3::new(middle(|shift| shift.x)?, middle(|shift| shift.y)?, middle(|shift| shift.z)?);
    Some(Rigid3::from_parts(place.into(), rotation))
}

/// Residual of a fix in the map, metres.
fn residual(pair: &Pair, map_from_fixed: &Rigid3) -> Vector3 {
    pair.place - (map_from_fixed.rotation * pair.fix + map_from_fixed.translation.vector)
}

/// Least squares in closed form, each pair weighted by its residual (Geman and McClure).
fn refined(pairs: &[Pair], map_from_fixed: &Rigid3, scale: f64) -> Option<Rigid3> {
    let weight = |pair: &Pair| {
        let squared = residual(pair, map_from_fixed).xy().norm_squared() / (scale * scale);
        (1.0 + squared).powi(-2)
    };
    let weights: Vec<f64> = pairs.iter().map(weight).collect();
    let total: f64 = weights.iter().sum();
    let mean = |of: fn(&Pair) -> Vector3| {
        pairs.iter().zip(&weights).map(|(pair, weight)| of(pair) * *weight).sum::<Vector3>() / total
    };
    let (place, fix) = (mean(|pair| pair.place), mean(|pair| pair.fix));
    let (mut cosine, mut sine) = (0.0, 0.0);
    for (pair, weight) in pairs.iter().zip(&weights) {
        let (a, b) = ((pair.fix - fix).xy(), (pair.place - place).xy());
        cosine += weight * a.dot(&b);
        sine += weight * a.perp(&b);
    }
    let rotation = rotation_from_roll_pitch_yaw(0.0, 0.0, sine.atan2(cosine));
    let pose = Rigid3::from_parts((place - rotation * fix).into(), rotation);
    pose.translation.vector.iter().all(|v| v.is_finite()).then_some(pose)
}

/// Standard deviation of a fix along each axis, metres. It is enlarged so that all fixes together have their
/// true information: consecutive fixes share slow errors. None where fixes do not determine a heading, or
/// contradict the map.
fn error_of(pairs: &[Pair], map_from_fixed: &Rigid3) -> Option<f64> {
    let noise = scatter(pairs, map_from_fixed, 1)?.max(1e-3);
    let (mut variance, mut longest) = (noise * noise, None::<Lengths>);
    let mut lag = 2;
    while 4 * lag <= pairs.len() {
        let Some(lengths) = Lengths::of(pairs, lag) else { break };
        // The map rotates as it drifts, which is no error of fixes; where distances are mostly noise, they
        // are too long.
        let at_lag = lengths.variance.min(scatter(pairs, map_from_fixed, lag)?.powi(2));
        let slow = at_lag - CLEARLY_MORE * noise * noise;
        variance = variance.max(noise * noise + slow.max(0.0) * lag as f64);
        if longest.as_ref().is_none_or(|longest| lengths.length > longest.length) {
            longest = Some(lengths);
        }
        lag *= 2;
    }
    // Over short paths slow errors are as long as these.
    if longest.is_some_and(|lengths| lengths.contradict(noise)) {
        return None;
    }
    let (sigma, count) = (variance.sqrt(), pairs.len() as f64);
    (sigma < HEADING * extent(pairs) * count.sqrt()).then_some(sigma)
}

/// Change of the residuals of fixes over `lag` nodes, as the standard deviation along each axis of errors
/// that are independent at that lag, metres. Slower errors cancel, whether of the fixes or of the map.
fn scatter(pairs: &[Pair], map_from_fixed: &Rigid3, lag: usize) -> Option<f64> {
    let errors: Vec<Vector3> = pairs.iter().map(|pair| residual(pair, map_from_fixed)).collect();
    let steps = errors.iter().zip(errors.iter().skip(lag)).map(|(a, b)| b - a);
    let mut steps: Vec<f64> = steps.flat_map(|step| [step.x.abs(), step.y.abs()]).collect();
    Some(quantile(&mut steps, 0.5)? / (MEDIAN_DEVIATION * std::f64::consts::SQRT_2))
}

/// Distances between fixes that are a number of nodes apart, compared with the distances between these nodes.
struct Lengths {
    /// Distance of the nodes, metres (median).
    length: f64,
    /// Variance of fixes along each axis, m², beyond the error of the map.
    variance: f64,
    /// Difference of the distances, metres (median).
    difference: f64,
}

impl Lengths {
    /// None where the map measured too few.
    fn of(pairs: &[Pair], lag: usize) -> Option<Self> {
        // Number of pairs since the map last had to guess, including the present one.
        let mut known = 0;
        let is_known = |pair: &Pair| {
            known = if pair.is_guess { 0 } else { known + 1 };
            known > lag
        };
        let are_known: Vec<bool> = pairs.iter().map(is_known).collect();
        let ends = pairs.iter().zip(pairs.iter().skip(lag)).zip(are_known.iter().skip(lag));
        let two: Vec<(&Pair, &Pair)> = ends.filter(|(_, is_known)| **is_known).map(|(two, _)| two).collect();
        if two.len() < MIN_FIXES {
            return None;
        }
        let length = |a: &Vector3, b: &Vector3| (b - a).xy().norm();
        let mut lengths: Vec<f64> = two.iter().map(|(a, b)| length(&a.place, &b.place)).collect();
        let mut differences: Vec<f64> =
            two.iter().map(|(a, b)| (length(&a.fix, &b.fix) - length(&a.place, &b.place)).abs()).collect();
        let (length, difference) = (median(&mut lengths)?, median(&mut differences)?);
        let sigma = difference / (MEDIAN_DEVIATION * std::f64::consts::SQRT_2);
        let variance = (sigma * sigma - (MAP_ERROR * length).powi(2)).max(0.0);
        Some(Self { length, variance, difference })
    }

    /// Whether most fixes contradict the map.
    fn contradict(&self, noise: f64) -> bool {
        let by_noise = OUTLIER * std::f64::consts::SQRT_2 * noise;
        self.length > by_noise && self.difference > by_noise + CONTRADICTION * self.length
    }
}

#[cfg(test)]
mod tests;
