//! Registers a few sweeps to each other.

use std::ops::RangeInclusive;

use portolan_geometry::{Point3f, Rigid3, Vector2, Vector3, angle_axis_from_quaternion};
use portolan_spatial::reduce_indices;

use super::evidence::{Pair, Phases, Row, TurnTimes};
use super::target::{FEWER, LAST_GATE, LEAST_SCALE, Match, Surface, Target, scale_of, weight};
use crate::beam_elevation::{Raise, by_elevation};

/// Wanted number of points of a sweep after thinning.
const WANTED_SURFACE_POINTS: f32 = 12_000.0;
/// Number of points of a sweep that are matched in registration.
const MATCHED_POINTS: usize = 800;
/// Number of points of a sweep whose residuals are evaluated after registration.
const JUDGED_POINTS: usize = 2500;
/// Maximum number of points of a sweep that are used before thinning.
const MAX_POINTS: usize = 30_000;
/// Range below which points are taken for the platform, metres.
const NEAREST: f32 = 0.7;
/// The same as a fraction of the median range.
const NEAREST_SHARE: f32 = 0.12;
/// Range beyond which points are too sparse to have normals, metres.
const FARTHEST: f32 = 80.0;
/// Number of sweeps between a sweep and the earlier one that it is registered to. The surfaces seen then must
/// still be in view.
const LAGS: RangeInclusive<usize> = 2..=6;
/// Distance over which surfaces stay in view, as a fraction of the median range.
const IN_VIEW: f64 = 0.5;
/// Distance within which nearest points are paired for the first pose, metres.
const FIRST_GATE: f64 = 2.0;
/// Distance within which nearest points are paired at first for later poses, metres.
const GATE: f64 = 1.0;
/// Maximum distance of evaluated points from the surface, metres: the motion displaced them.
const JUDGED_GATE: f64 = 0.5;
/// Translations of the first sweep that are tried in each direction, metres.
const FIRST_TRANSLATIONS: [f64; 4] = [0.7, 1.4, 2.1, 2.8];
/// Distance within which two solutions are the same, metres.
const SAME_TRANSLATION: f64 = 0.2;
/// Maximum number of solutions that are followed further.
const CANDIDATES: usize = 6;
/// Number of sweeps after the first that are used for it.
const AHEAD: usize = 4;
/// Motion of points per sweep below which the lidar stands still, metres.
const STILL: f64 = 0.004;

/// A thinned sweep.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    /// In the frame of the lidar, metres.
    points: Vec<[f32; 3]>,
    pub phases: Vec<Phases>,
    median_range: f32,
}

/// Sweeps and how they were registered.
#[derive(Clone, Debug)]
pub(super) struct Followed {
    /// Surfaces at the points of each sweep. Motion within a sweep hardly turns them.
    surfaces: Vec<Vec<Surface>>,
    /// Poses of the lidar in the middle of each sweep, in the frame of the first.
    poses: Vec<Rigid3>,
    /// Number of sweeps between each sweep and the one that it was registered to.
    lag: usize,
    /// Residuals of each registration, for sweeps that were registered exactly `lag` sweeps back.
    pub pairs: Vec<Pair>,
}

/// Motion during one turn: translation and rotation vector in the frame of the lidar.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Twist {
    translation: Vector3,
    rotation: Vector3,
}

impl Twist {
    /// Displacement of a point with the lidar during one turn.
    fn of(&self, point: &Vector3) -> Vector3 {
        self.rotation.cross(point) + self.translation
    }

    /// Its components along a direction, by translation and by rotation.
    fn parts(&self, point: &Vector3, direction: &Vector3) -> Vector2 {
        Vector2::new(direction.dot(&self.translation), direction.dot(&self.rotation.cross(point)))
    }
}

impl Sample {
    /// Keeps one point for each voxel, whose edge is adapted from sweep to sweep.
    pub fn thinned(points: &[Point3f], phases: &[Phases], edge: &mut f32) -> Self {
        let stride = points.len().div_ceil(MAX_POINTS).max(1);
        let mut some: Vec<(f32, &Point3f, Phases)> = (points.iter().zip(phases).step_by(stride))
            .map(|(point, phase)| (point.coords.norm(), point, *phase))
            .collect();
        some.retain(|(range, ..)| range.is_finite() && *range > 0.0);
        let mut ranges: Vec<f32> = some.iter().map(|(range, ..)| *range).collect();
        let middle = ranges.len() / 2;
        let median_range = match ranges.is_empty() {
            true => 0.0,
            false => *ranges.select_nth_unstable_by(middle, f32::total_cmp).1,
        };
        let nearest = NEAREST.max(NEAREST_SHARE * median_range);
        some.retain(|(range, ..)| (nearest..FARTHEST).contains(range));
        let kept: Vec<[f32; 3]> = some.iter().map(|(_, point, _)| point.coords.into()).collect();
        if *edge <= 0.0 {
            *edge = 0.02 * median_range;
        }
        let chosen = reduce_indices(&kept, *edge, 1);
        let correction = (chosen.len() as f32 / WANTED_SURFACE_POINTS).sqrt().clamp(0.5, 2.0);
        *edge = (*edge * correction).clamp(0.01, 1.0);
        let chosen = chosen.iter().filter_map(|i| some.get(*i as usize));
        let (points, phases) =
            chosen.map(|(_, point, phase)| (<[f32; 3]>::from(point.coords), *phase)).unzip();
        Self { points, phases, median_range }
    }

    /// A point and its phases.
    fn point(&self, index: usize) -> Option<(Vector3, Phases)> {
        let point = Vector3::from(self.points.get(index)?.map(f64::from));
        Some((point, *self.phases.get(index)?))
    }

    /// The sample with all beams raised.
    pub fn raised(&self, raise: &Raise) -> Self {
        let point = |p: &[f32; 3]| raise.point(&Point3f::from(*p)).coords.into();
        Self { points: self.points.iter().map(point).collect(), ..self.clone() }
    }

    /// The points de-skewed with these times.
    fn deskewed(&self, times: Option<TurnTimes>, twist: &Twist) -> Vec<[f32; 3]> {
        let Some(times) = times else { return self.points.clone() };
        let moved = |(p, phases): (&[f32; 3], &Phases)| {
            let point = Vector3::from(p.map(f64::from));
            (point + twist.of(&point) * times.share(*phases)).cast::<f32>().into()
        };
        self.points.iter().zip(&self.phases).map(moved).collect()
    }
}

/// About `wanted` points, spread over the sweep.
fn spread(points: &[[f32; 3]], wanted: usize) -> Vec<(usize, Vector3)> {
    let stride = points.len().div_ceil(wanted).max(1);
    let some = points.iter().enumerate().step_by(stride);
    some.map(|(index, point)| (index, Vector3::from(point.map(f64::from)))).collect()
}

/// Whether the lidar stood still from the first of these sweeps to the last.
pub(super) fn stands(samples: &[Sample]) -> bool {
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else { return true };
    let mut target = Target::new(first.points.clone(), None);
    let found = target.register(&spread(&last.points, MATCHED_POINTS), Rigid3::identity(), LAST_GATE);
    let Some(pose) = found else { return false };
    let sweeps = samples.len() as f64 - 1.0;
    let turn = angle_axis_from_quaternion(&pose.rotation).norm() * f64::from(last.median_range);
    (pose.translation.vector.norm() + turn) / sweeps < STILL
}

/// Registers each sweep to an earlier one. With `times` the sweeps are de-skewed, by the motion found
/// `before`.
pub(super) fn follow(
    samples: &[Sample],
    times: Option<TurnTimes>,
    before: Option<&Followed>,
) -> Option<Followed> {
    let twists = before.map_or_else(|| vec![Twist::default(); samples.len()], Followed::twists);
    let deskewed: Vec<Vec<[f32; 3]>> =
        samples.iter().zip(&twists).map(|(s, twist)| s.deskewed(times, twist)).collect();
    follow_deskewed(samples, deskewed, before)
}

fn follow_deskewed(
    samples: &[Sample],
    deskewed: Vec<Vec<[f32; 3]>>,
    before: Option<&Followed>,
) -> Option<Followed> {
    let judged: Vec<_> = deskewed.iter().map(|points| spread(points, JUDGED_POINTS)).collect();
    let sources: Vec<_> = deskewed.iter().map(|points| spread(points, MATCHED_POINTS)).collect();
    let surfaces = |sweep: usize| before.and_then(|before| before.surfaces.get(sweep));
    let mut targets: Vec<Target> =
        deskewed.into_iter().enumerate().map(|(sweep, p)| Target::new(p, surfaces(sweep))).collect();
    let mut poses = vec![Rigid3::identity()];
    let mut matched = Vec::new();
    let mut lag = before.map_or(1, |before| before.lag);
    for (sweep, (source, judged)) in sources.iter().zip(&judged).enumerate().skip(1) {
        let to = sweep.saturating_sub(lag);
        let guess = match (before, poses.as_slice()) {
            (Some(before), _) => *before.poses.get(sweep)?,
            (None, [.., last_but_one, last]) => last * (last_but_one.inverse() * last),
            (None, _) => first_pose(targets.first_mut()?, &sources)?,
        };
        let gate = if before.is_some() { LAST_GATE } else { GATE };
        let (target, first_from_target) = (targets.get_mut(to)?, *poses.get(to)?);
        let pose = target.register(source, first_from_target.inverse() * guess, gate)?;
        poses.push(first_from_target * pose);
        // Consecutive sweeps see surfaces under the same azimuth.
        if sweep == 1 && before.is_none() {
            lag = lag_in_view(&pose, samples.first()?.median_range);
        }
        if sweep - to == lag {
            matched.push((to, sweep, pose, target.matches(judged, &pose, JUDGED_GATE, &[])));
        }
    }
    let surfaces = targets.into_iter().map(|target| target.surfaces).collect();
    let mut followed = Followed { surfaces, poses, lag, pairs: Vec::new() };
    let twists = followed.twists();
    let side = |sweep: usize| Some((samples.get(sweep)?, twists.get(sweep)?));
    for (to, from, pose, matches) in &matched {
        followed.pairs.push(pair([side(*from)?, side(*to)?], pose, matches));
    }
    Some(followed)
}

fn lag_in_view(motion_of_sweep: &Rigid3, median_range: f32) -> usize {
    let sweeps = IN_VIEW * f64::from(median_range) / motion_of_sweep.translation.vector.norm().max(1e-3);
    (sweeps as usize).clamp(*LAGS.start(), *LAGS.end())
}

/// Pose of the second sweep in the frame of the first. A car may be fast already, and rings on the ground
/// look alike from anywhere. Of several motions the one is taken whose continuation explains the following
/// sweeps best.
fn first_pose(target: &mut Target, sources: &[Vec<(usize, Vector3)>]) -> Option<Rigid3> {
    let few: Vec<Vec<_>> =
        sources.iter().take(1 + AHEAD).map(|s| s.iter().step_by(FEWER).copied().collect()).collect();
    let second = few.get(1)?;
    let directions = [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y()];
    let translations =
        FIRST_TRANSLATIONS.iter().flat_map(|length| directions.map(|direction| direction * *length));
    let guesses = std::iter::once(Vector3::zeros()).chain(translations);
    let mut found: Vec<(f64, Rigid3)> = Vec::new();
    for guess in guesses {
        let guess = Rigid3::from_parts(guess.into(), Default::default());
        found.extend(target.registered(second, guess, FIRST_GATE));
    }
    found.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    let mut candidates: Vec<(f64, Rigid3)> = Vec::new();
    for (fit, pose) in found {
        let is_new = |(_, other): &(f64, Rigid3)| {
            (other.inverse() * pose).translation.vector.norm() > SAME_TRANSLATION
        };
        if candidates.iter().all(is_new) && candidates.len() < CANDIDATES {
            candidates.push((fit, pose));
        }
    }
    let judged = candidates.into_iter().filter_map(|(_, first)| {
        let (mut before, mut last, mut fit) = (Rigid3::identity(), first, 0.0);
        for source in few.iter().skip(2) {
            let guess = last * (before.inverse() * last);
            let (fits, pose) = target.registered(source, guess, GATE)?;
            (before, last, fit) = (last, pose, fits);
        }
        Some((fit, first))
    });
    judged.max_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, pose)| pose)
}

fn pair([from, to]: [(&Sample, &Twist); 2], pose: &Rigid3, matches: &[Match]) -> Pair {
    let scale = scale_of(matches);
    let row = |m: &Match| {
        let (source, source_phases) = from.0.point(m.source)?;
        let (target, target_phases) = to.0.point(m.target as usize)?;
        let in_source = pose.rotation.inverse() * m.normal;
        Some(Row {
            jacobian: m.jacobian(),
            residual: m.residual,
            weight: weight(m.residual, scale),
            phases: [source_phases, target_phases],
            gains: [from.1.parts(&source, &in_source), -to.1.parts(&target, &m.normal)],
            by_elevation: in_source.dot(&by_elevation(&source)) - m.normal.dot(&by_elevation(&target)),
            direction: m.place.y.atan2(m.place.x) as f32,
        })
    };
    Pair {
        rows: matches.iter().filter_map(row).collect(),
        explained: matches.iter().map(|m| weight(m.residual, 2.0 * LEAST_SCALE)).sum(),
    }
}

impl Followed {
    /// Only the motion: surfaces are to be computed anew.
    pub fn without_surfaces(&self) -> Self {
        Self { surfaces: Vec::new(), poses: self.poses.clone(), lag: self.lag, pairs: Vec::new() }
    }

    /// The motion in each sweep, from the sweeps on both sides.
    fn twists(&self) -> Vec<Twist> {
        let last = self.poses.len().saturating_sub(1);
        let twist = |sweep: usize| {
            let (a, b) = (sweep.saturating_sub(1), (sweep + 1).min(last));
            let motion = self.poses.get(a)?.inverse() * self.poses.get(b)?;
            let sweeps = (b - a).max(1) as f64;
            Some(Twist {
                translation: motion.translation.vector / sweeps,
                rotation: angle_axis_from_quaternion(&motion.rotation) / sweeps,
            })
        };
        (0..=last).filter_map(twist).collect()
    }
}
