//! How the scanner moves when recording begins, where no odometry tells.
//!
//! A robot mostly stands then, but a vehicle may be at speed, and one scan says nothing of that. So the first second is held back,
//! as in 3D: the second scan is looked for as far from the first as anything drives, scans are followed with each of the motions that
//! this leads to, and the one that explains them best, given how likely it was before, is believed (maximum a posteriori).

use std::f64::consts::TAU;

use portolan_config::TrajectoryBuilder2dOptions;
use portolan_geometry::{Duration, Rigid2, Time, Vector2};
use portolan_grids::scan_agreement;
use portolan_sensor::{ImuData, SynchronizedRanges};
use portolan_submaps::SearchWindow;

use super::LocalSlamExtras;
use super::front_end::FrontEnd;
use super::motion::{ACCELERATION, ANGULAR_ACCELERATION, Motion};
use super::posterior::{BeamEvidence, MotionPrior};
use super::prediction_error::PredictionSigmas;
use super::scan::Scan;
use super::tracking::{Found, Tracker};
use crate::{MOST_GATHERED_POINTS, MatchingResult, Planar};

/// So long the motion is watched before it is judged.
const WATCHED: Duration = Duration::from_ticks(10_000_000);
/// Scans farther apart than this, seconds, share too little at speed.
const LONGEST_INTERVAL: f64 = 0.4;
/// With fewer scans nothing is judged.
const FEWEST_SCANS: usize = 4;
/// Nothing that carries a planar scanner is faster, m/s.
const FASTEST: f64 = 30.0;
/// No scan is looked for farther from the one before, metres.
const FARTHEST: f64 = 4.0;
/// Half the edge of the squares that are searched one by one, metres, and how far the scanner may have turned, radians.
const SQUARE: SearchWindow = SearchWindow { linear: 0.5, angular: 0.08 };
/// A scan is followed if it is so near where the motion leads, metres and radians.
pub(super) const NEAR: SearchWindow = SearchWindow { linear: 0.2, angular: 0.1 };
/// So many motions are followed, beside none.
const FOLLOWED: usize = 4;
/// A motion is given up if, after some scans, it is less likely than another one after as many, by so many nats.
const SCANS_BEFORE_GIVEN_UP: usize = 3;
const GIVEN_UP: f64 = 50.0;
/// Motions that differ by less than this from scan to scan, metres, are the same.
const ALIKE: f64 = 0.15;
/// How well a scan tells a motion: metres and radians.
const MATCHED: PredictionSigmas = PredictionSigmas { translation: 0.05, rotation: 0.02 };
/// One recording in so many begins at speed, at any up to [`FASTEST`]; in others the speed has this standard deviation, m/s.
const AT_SPEED: f64 = 0.1;
const SLOW: f64 = 0.5;

/// A velocity in the plane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Velocity {
    /// m/s.
    pub linear: Vector2,
    /// rad/s.
    pub angular: f64,
}

impl Velocity {
    /// Where it leads in so many seconds.
    pub fn motion(&self, seconds: f64) -> Rigid2 {
        Rigid2 { translation: self.linear * seconds, angle: self.angular * seconds }
    }

    /// What leads there in so many seconds.
    fn to(motion: &Rigid2, seconds: f64) -> Self {
        Self { linear: motion.translation / seconds, angular: motion.normalized_angle() / seconds }
    }

    /// Logarithm of how likely it is before anything is measured, up to a constant.
    fn log_prior(&self) -> f64 {
        let speed = self.linear.norm();
        let slow = (-0.5 * (speed / SLOW).powi(2)).exp() / (TAU * SLOW * SLOW);
        let at_speed = 1.0 / (0.5 * TAU * FASTEST * FASTEST);
        ((1.0 - AT_SPEED) * slow + AT_SPEED * at_speed).ln()
    }
}

/// A measurement that is held back.
#[derive(Clone, Debug)]
pub(super) enum Held {
    Ranges(SynchronizedRanges),
    Imu(ImuData),
}

impl Held {
    /// Hands it on.
    pub fn given_to(self, front_end: &mut FrontEnd) -> Vec<MatchingResult<Planar>> {
        match self {
            Self::Ranges(ranges) => front_end.add_ranges(ranges),
            Self::Imu(data) => {
                front_end.add_imu(&data);
                Vec::new()
            }
        }
    }
}

/// What a front end does besides mapping.
#[derive(Clone, Debug)]
pub(super) enum Role {
    /// Nothing.
    Mapping,
    /// It says which motions the second scan may show.
    Proposing(Vec<Velocity>),
    /// It tells how likely all is after each scan (logarithm).
    Judged(Vec<f64>),
}

impl Role {
    /// Whether what becomes of its map does not matter.
    pub fn is_trial(&self) -> bool {
        !matches!(self, Self::Mapping)
    }

    /// Takes note of a scan that was found.
    pub fn note(
        &mut self,
        tracker: &Tracker,
        (prediction, found): (Rigid2, &Found),
        motion: Motion,
        scan: Option<Scan>,
    ) {
        let Some(scan) = scan else { return };
        match self {
            Self::Mapping => {}
            Self::Proposing(proposed) if proposed.is_empty() => *proposed = proposals(tracker, motion, &scan),
            Self::Proposing(_) => {}
            Self::Judged(likely) => {
                let before = likely.last().copied().unwrap_or(0.0);
                likely.push(before + log_likelihood(prediction, found, motion, &scan));
            }
        }
    }
}

/// The motions that lead to where a scan fits best, in each of the squares that it may be in.
fn proposals(tracker: &Tracker, motion: Motion, scan: &Scan) -> Vec<Velocity> {
    let reach = (FASTEST * motion.seconds).min(FARTHEST);
    let rings = ((reach - SQUARE.linear) / (2.0 * SQUARE.linear)).ceil().max(0.0) as i32;
    let evidence = BeamEvidence::default();
    let mut found: Vec<(f64, Rigid2)> = Vec::new();
    for (i, j) in (-rings..=rings).flat_map(|i| (-rings..=rings).map(move |j| (i, j))) {
        let off = 2.0 * SQUARE.linear * Vector2::new(f64::from(i), f64::from(j));
        let around = motion.last * Rigid2 { translation: off, angle: 0.0 };
        let pose = tracker.search_freely(scan, around, SQUARE);
        let Some(agreement) = scan_agreement(&scan.submap.grid, &pose, scan.cloud) else { return Vec::new() };
        found.push((evidence.log_likelihood(&agreement, scan.witnesses), pose));
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut motions: Vec<Rigid2> = Vec::new();
    for (_, pose) in found {
        let step = motion.to(&pose);
        let is_new = |other: &Rigid2| (other.translation - step.translation).norm() > ALIKE;
        if step.translation.norm() > ALIKE && motions.iter().all(is_new) {
            motions.push(step);
        }
    }
    motions.iter().take(FOLLOWED).map(|step| Velocity::to(step, motion.seconds)).collect()
}

/// Logarithm of how likely a scan is where it was found, which is near where it was predicted.
fn log_likelihood(prediction: Rigid2, found: &Found, motion: Motion, scan: &Scan) -> f64 {
    let square = motion.seconds.powi(2);
    let sigmas = PredictionSigmas {
        translation: MATCHED.translation.hypot(ACCELERATION * square),
        rotation: MATCHED.rotation.hypot(ANGULAR_ACCELERATION * square),
    };
    let prior = MotionPrior { prediction, sigmas };
    let beams = found
        .agreement
        .map_or(0.0, |agreement| BeamEvidence::default().log_likelihood(&agreement, scan.witnesses));
    prior.log_density(&found.pose) + beams
}

/// Whether measurements are held back until the motion at the start is known.
pub(super) struct Start {
    options: TrajectoryBuilder2dOptions,
    extras: LocalSlamExtras,
    phase: Phase,
}

enum Phase {
    /// Held back meanwhile.
    Open(Vec<Held>),
    /// The motion is known, or odometry tells it.
    Closed,
}

impl Start {
    /// Before anything was measured. A front end that searches as far as its options say searches no farther at the start.
    pub fn new(options: &TrajectoryBuilder2dOptions, extras: LocalSlamExtras, is_adaptive: bool) -> Self {
        let phase = if is_adaptive { Phase::Open(Vec::new()) } else { Phase::Closed };
        Self { options: options.clone(), extras, phase }
    }

    pub fn is_open(&self) -> bool {
        matches!(self.phase, Phase::Open(_))
    }

    /// Holds back a measurement.
    pub fn hold(&mut self, measurement: Held) {
        if let Phase::Open(held) = &mut self.phase {
            held.push(measurement);
        }
    }

    /// Whether enough is held back.
    pub fn is_ready(&self) -> bool {
        let times = self.scan_times();
        let (Some(first), Some(last)) = (times.first(), times.last()) else { return false };
        *last - *first >= WATCHED || self.points() >= MOST_GATHERED_POINTS || is_sparse(&times)
    }

    fn held(&self) -> &[Held] {
        match &self.phase {
            Phase::Open(held) => held,
            Phase::Closed => &[],
        }
    }

    fn scan_times(&self) -> Vec<Time> {
        let ranges = |held: &Held| match held {
            Held::Ranges(ranges) => Some(ranges.time),
            Held::Imu(_) => None,
        };
        self.held().iter().filter_map(ranges).collect()
    }

    fn points(&self) -> usize {
        let points = |held: &Held| match held {
            Held::Ranges(ranges) => ranges.points.len(),
            Held::Imu(_) => 0,
        };
        self.held().iter().map(points).sum()
    }

    /// Odometry tells the motion: gives back what was held, if anything was to be.
    pub fn close(&mut self) -> Option<Vec<Held>> {
        match std::mem::replace(&mut self.phase, Phase::Closed) {
            Phase::Open(held) => Some(held),
            Phase::Closed => None,
        }
    }

    /// Nothing tells the motion any more.
    pub fn reopen(&mut self) {
        self.phase = Phase::Open(Vec::new());
    }

    /// The motion that explains best what was held back, and that.
    pub fn decided(&mut self) -> (Velocity, Vec<Held>) {
        let velocity = self.likeliest();
        (velocity, self.close().unwrap_or_default())
    }

    fn likeliest(&self) -> Velocity {
        let times = self.scan_times();
        let still = Velocity::default();
        if times.len() < FEWEST_SCANS || is_sparse(&times) {
            return still;
        }
        let mut best = self.judged(still, &[]);
        let mut velocity = still;
        for proposed in self.proposed() {
            let other = self.judged(proposed, &best);
            // Beams say whether a pose is right rather than wrong: a motion that they speak against is none.
            if other.len() >= best.len() && other.last() > best.last() && other.last() > Some(&0.0) {
                (best, velocity) = (other, proposed);
            }
        }
        velocity
    }

    /// The motions that the first two scans may show.
    fn proposed(&self) -> Vec<Velocity> {
        let found = |role: &Role| matches!(role, Role::Proposing(found) if !found.is_empty());
        match self.followed(Velocity::default(), Role::Proposing(Vec::new()), found) {
            Some(Role::Proposing(proposed)) => proposed,
            _ => Vec::new(),
        }
    }

    /// How likely all is with a motion, after each scan, as long as it is not much less likely than with another one.
    fn judged(&self, velocity: Velocity, best: &[f64]) -> Vec<f64> {
        let is_given_up = |role: &Role| {
            let Role::Judged(likely) = role else { return true };
            let other = best.get(likely.len().wrapping_sub(1));
            likely.len() > SCANS_BEFORE_GIVEN_UP
                && likely.last() < other.map(|other| other - GIVEN_UP).as_ref()
        };
        match self.followed(velocity, Role::Judged(vec![velocity.log_prior()]), is_given_up) {
            Some(Role::Judged(likely)) => likely,
            _ => Vec::new(),
        }
    }

    /// What becomes of a front end in a role that takes what is held back, until it has done enough.
    fn followed(&self, velocity: Velocity, role: Role, is_enough: impl Fn(&Role) -> bool) -> Option<Role> {
        let mut front_end = FrontEnd::new(&self.options, self.extras, velocity, role).ok()?;
        for measurement in self.held() {
            measurement.clone().given_to(&mut front_end);
            if is_enough(&front_end.role) {
                break;
            }
        }
        Some(front_end.role)
    }
}

/// Whether scans are too far apart for a motion to be followed.
fn is_sparse(times: &[Time]) -> bool {
    matches!(times, [first, second, ..] if second.seconds_since(*first) > LONGEST_INTERVAL)
}
