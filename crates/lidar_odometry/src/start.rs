//! The start of a trajectory: hypotheses of the first motion, judged by the sweeps that follow.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Duration, Vector3, to_f32};
use portolan_recall::Memory;
use portolan_sensor::RangeData;

use crate::hypotheses::{self, Other};
use crate::initialise::{FirstSweeps, RotationAt, Start};
use crate::issues::Issues;
use crate::motion_state::MotionState;
use crate::pose_status::PoseStatus;
use crate::settings::OdometrySettings;
use crate::settings::constants::initialise::VELOCITY_CORRECTIONS;
use crate::start_velocity::FirstSweepsPlaced;
use crate::sweep::Sweep;
use crate::tracker::{RegisteredSweep, Tracker};

/// State while it waits for the first sweeps.
#[derive(Clone, Debug)]
pub(crate) struct FirstMotion {
    pub motion: MotionState,
    /// Hypotheses, the most likely first; empty before the second sweep.
    hypotheses: Vec<Start>,
}

/// A trajectory that has started.
pub(crate) struct StartedTrajectory {
    pub tracker: Tracker,
    /// The first sweep, and those after it that are already registered.
    pub registered: Vec<RegisteredSweep>,
    /// Issues of these sweeps.
    pub issues: Issues,
}

/// Inputs of a trial of hypotheses of the first motion.
struct Trial<'a> {
    settings: &'a OdometrySettings,
    motion: &'a MotionState,
    memory: &'a Memory,
    first: &'a Sweep,
    /// The sweeps after the first one, by whose fit hypotheses are judged.
    judges: &'a [Sweep],
}

/// A hypothesis with which sweeps were tracked.
struct Judged {
    start: Start,
    started: StartedTrajectory,
    /// Total fit of the sweeps.
    fit: f64,
}

impl FirstMotion {
    pub fn new(motion: MotionState) -> Self {
        Self { motion, hypotheses: Vec::new() }
    }

    /// Begins with the motion at the first of these sweeps; none if more sweeps are needed to decide it.
    /// `is_ended`: no more will come.
    pub fn decide(
        &mut self,
        settings: &OdometrySettings,
        memory: &Memory,
        sweeps: &[Sweep],
        is_ended: bool,
    ) -> Option<StartedTrajectory> {
        let (first, second) = (sweeps.first()?, sweeps.get(1));
        if second.is_none() && !is_ended {
            return None;
        }
        if self.hypotheses.is_empty() {
            let measured = self.motion.measured_rotation();
            let rotation_at = measured.as_ref().map(|measured| measured as &RotationAt);
            self.hypotheses = FirstSweeps::hypotheses(first, second, rotation_at, settings);
        }
        let judging = settings.loss.sweeps.max(1);
        let judges = &sweeps[1..sweeps.len().min(judging)];
        let trial = Trial { settings, motion: &self.motion, memory, first, judges };
        match self.hypotheses.as_slice() {
            [] => None,
            [only] if !only.is_open() => Some(trial.begin(*only)),
            _ if sweeps.len() < judging && !is_ended => None,
            [likeliest, others @ ..] => Some(trial.best(*likeliest, others)),
        }
    }
}

/// Degenerate directions of planes: the direction of motion, and the one perpendicular to it.
fn directions(tracker: &Tracker, velocity: na::Vector2<f64>) -> Vec<na::Vector2<f64>> {
    let open = tracker.open_horizontally();
    match velocity.try_normalize(1.0) {
        Some(along) if open.len() == 2 => vec![along, na::Vector2::new(-along.y, along.x)],
        _ => open,
    }
}

impl Trial<'_> {
    fn begin(&self, start: Start) -> StartedTrajectory {
        let (mut tracker, registered) =
            Tracker::begin(self.settings, self.motion.clone(), self.first.clone(), start);
        tracker.remember_with(self.memory);
        StartedTrajectory { tracker, registered: vec![registered], issues: Issues::default() }
    }

    /// Begins with the hypothesis under which the sweeps fit best; the likeliest one is that under which
    /// the first two fit best.
    fn best(&self, likeliest: Start, others: &[Start]) -> StartedTrajectory {
        let Some(first) = self.judged(likeliest, f64::NEG_INFINITY) else { return self.begin(likeliest) };
        let clearly_better = self.settings.hypotheses.better_over_sweeps;
        let others = others.iter().map(|start| Other { motion: *start, clearly_better });
        let mut best =
            hypotheses::best(first, others, |judged| judged.fit, |start, least| self.judged(start, least));
        for _ in 0..VELOCITY_CORRECTIONS {
            let Some(corrected) = self.corrected(&best) else { break };
            best = corrected;
        }
        if self.is_final(&best.started) { self.with_clouds(best.started) } else { self.begin(best.start) }
    }

    /// Begins with another velocity along a degenerate direction, if all sweeps together determine it, and
    /// fit about as well then.
    fn corrected(&self, judged: &Judged) -> Option<Judged> {
        let StartedTrajectory { tracker, registered, .. } = &judged.started;
        if registered.iter().any(|sweep| sweep.observability.translation_is_measured) {
            return None;
        }
        let placed = FirstSweepsPlaced::new(registered, self.settings);
        let change = directions(tracker, judged.start.velocity().xy()).into_iter().find_map(|direction| {
            placed.velocity_error(&direction).map(|error| Vector3::new(direction.x, direction.y, 0.0) * error)
        })?;
        let least = judged.fit / self.settings.hypotheses.better_over_sweeps;
        self.judged(judged.start.faster_by(&change), least)
    }

    /// Tracks the sweeps from a start; none if they do not fit better than `least`. Of their clouds only
    /// those are kept that cannot be recomputed.
    fn judged(&self, start: Start, least: f64) -> Option<Judged> {
        let StartedTrajectory { mut tracker, mut registered, mut issues } = self.begin(start);
        let fit = tracker.fit_better(least, None, self.judges, &mut issues, |mut judge| {
            (judge.sweep.points, judge.in_local) = (Vec::new(), RangeData::default());
            registered.push(judge);
        })?;
        Some(Judged { start, started: StartedTrajectory { tracker, registered, issues }, fit })
    }

    fn with_clouds(&self, mut started: StartedTrajectory) -> StartedTrajectory {
        for (registered, judge) in started.registered.iter_mut().skip(1).zip(self.judges) {
            registered.sweep.points.clone_from(&judge.points);
            registered.in_local = registered.deskewed.transformed(&to_f32(&registered.local_from_tracking));
        }
        started
    }

    /// Whether the poses of the sweeps would be the same if they were registered one by one, with a
    /// fallback map: they would if each of them fits, and none comes after a gap.
    fn is_final(&self, started: &StartedTrajectory) -> bool {
        let fits = |sweep: &RegisteredSweep| sweep.status == PoseStatus::Confirmed && sweep.fit > 0.0;
        let gap = Duration::from_seconds(self.settings.hypotheses.long_gap);
        let ends = started.registered.iter().map(|registered| registered.sweep.end);
        let follow_closely = ends.clone().zip(ends.skip(1)).all(|(before, end)| end - before <= gap);
        follow_closely && started.registered.iter().skip(1).all(fits)
    }
}
