//! Continuous-time refinement: a trajectory is bent, continuously in time and in all six degrees of freedom,
//! until everything that was seen from it fits together.
//!
//! 1. Points of short windows become planar patches (`surfels`).
//! 2. Coarse: patches of different windows are paired, far pairs first, and knots seconds apart are solved
//!    for.
//! 3. Fine: patches of all windows are grouped into planes; knots a tenth of a second apart and all planes are
//!    solved for together.
//! 4. With the better trajectory patches are sharper; steps 1 and 3 are repeated until nothing moves.

mod block_tridiagonal;
mod cells;
mod coarse;
mod coverage;
mod dense_trajectory;
mod fine;
mod information;
mod knots;
mod odometry;
mod options;
mod pairs;
mod plane_equations;
mod planes;
mod report;
mod session;
mod surfels;

use portolan_geometry::{Rigid3, Time, angular_distance};

pub use dense_trajectory::{Correction, DenseTrajectory, PoseMatrices};
pub use knots::Knots;
pub use odometry::OdometryNoise;
pub(crate) use odometry::odometry_terms;
pub use options::ContinuousOptions;
pub use report::{Method, RefineProgress, RefineReport, RefineStep, Refined, Undetermined};

pub(crate) use session::Session;

use crate::{PointStore, RefineError};
use coarse::coarse_step;
use fine::fine_step;
use surfels::SurfelMap;

/// Each coarse reach is so much of the one before; the last is about as wide as a wall.
const REACH_RATIO: f64 = 0.5;
const LAST_REACH: f64 = 0.12;
/// Most steps at one reach, and the share of the reach below which a shift ends them.
const COARSE_STEPS: usize = 5;
const COARSE_REST: f64 = 0.05;
/// Seconds between the knots of the first fine round.
const FIRST_SPACING: f64 = 0.5;
/// Gap between planes in the first fine round and later, metres.
const GAPS: [f64; 2] = [0.15, 0.10];
/// Steps of a fine round.
const FINE_STEPS: usize = 3;
/// Rounds end when the root mean square movement of a round is below this, metres and radians.
const RESTS: (f64, f64) = (0.001, 0.0005);
/// Usual number of fine rounds, for progress.
const USUAL_ROUNDS: f64 = 4.0;
/// Bends a trajectory (`world_from_tracking` in strictly ascending order of time) until the points fit
/// together. `observe` is called after each step and stops by returning false; what is reached is kept. The
/// result is the same for any number of threads.
///
/// # Errors
/// Fails if there are no points, no surfaces, too few poses, or points and poses are of different times.
pub fn refine_continuous(
    points: &PointStore,
    input: &[(Time, Rigid3)],
    options: &ContinuousOptions,
    observe: &mut dyn FnMut(&RefineProgress) -> bool,
) -> Result<Refined, RefineError> {
    options.check()?;
    let session = Session::new(points, input, Method::Continuous(*options), options.odometry)?;
    let mut run = Run { session, options, observe };
    run.coarse()?;
    run.fine()?;
    Ok(run.session.finish())
}

/// A refinement at work.
struct Run<'a> {
    session: Session<'a>,
    options: &'a ContinuousOptions,
    observe: &'a mut dyn FnMut(&RefineProgress) -> bool,
}

impl Run<'_> {
    fn extract(&mut self) -> Result<SurfelMap, RefineError> {
        let session = &mut self.session;
        let map =
            SurfelMap::extract(session.points, &session.coverage, &session.trajectory, self.options.window);
        if map.surfels.is_empty() {
            return Err(RefineError::NoSurfaces(session.report.points));
        }
        session.report.planar_share =
            Some(map.surfels.iter().map(|s| s.count).sum::<f64>() / map.looked_at.max(1) as f64);
        Ok(map)
    }

    /// Draws windows together, from far to near.
    fn coarse(&mut self) -> Result<(), RefineError> {
        let map = self.extract()?;
        let knots = Knots::new(self.session.trajectory.duration(), self.options.window);
        let stages =
            ((self.options.reach / LAST_REACH).ln() / -REACH_RATIO.ln()).ceil().max(0.0) as usize + 1;
        for stage in 0..stages {
            let reach = (self.options.reach * REACH_RATIO.powi(stage as i32)).max(LAST_REACH);
            for _ in 0..COARSE_STEPS {
                let step =
                    coarse_step(&map, &mut self.session.trajectory, &knots, self.options.odometry, reach)?;
                let record = RefineStep {
                    stage: "coarse",
                    knot_spacing: knots.spacing(),
                    reach,
                    terms: step.pairs,
                    rms: step.rms,
                    shift: step.shift,
                };
                let share = 0.4 * (stage + 1) as f64 / stages as f64;
                if !self.record(record, share) {
                    return Ok(());
                }
                if step.shift < COARSE_REST * reach {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Solves for all knots and planes, with ever sharper patches, until nothing moves.
    fn fine(&mut self) -> Result<(), RefineError> {
        for round in 0..self.options.max_rounds {
            if self.session.report.stopped {
                return Ok(());
            }
            let first = round == 0;
            let spacing =
                if first { FIRST_SPACING.max(self.options.knot_spacing) } else { self.options.knot_spacing };
            let knots = Knots::new(self.session.trajectory.duration(), spacing);
            let before = self.session.trajectory.clone();
            let map = self.extract()?;
            for step in 0..FINE_STEPS {
                let gap = GAPS[usize::from(!first)];
                let done = fine_step(
                    &map,
                    &mut self.session.trajectory,
                    &knots,
                    self.session.report.odometry_found,
                    gap,
                )?;
                self.session.information = done.information;
                let record = RefineStep {
                    stage: "fine",
                    knot_spacing: knots.spacing(),
                    reach: gap,
                    terms: done.clusters,
                    rms: done.rms,
                    shift: done.shift,
                };
                let rounds = round as f64 + (step + 1) as f64 / FINE_STEPS as f64;
                if !self.record(record, 0.4 + 0.6 * (rounds / USUAL_ROUNDS).min(0.99)) {
                    return Ok(());
                }
            }
            if !first {
                self.session.report.odometry_found = odometry::noise_found(&self.session.trajectory, &knots);
                let (shift, turn) = movement(&before, &self.session.trajectory);
                if shift < RESTS.0 && turn < RESTS.1 {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Notes a step and tells it; whether to go on.
    fn record(&mut self, step: RefineStep, share: f64) -> bool {
        self.session.report.steps.push(step);
        let stage = match step.stage {
            "coarse" => format!("drift within {:.2} m", step.reach),
            _ => format!("knots every {:.1} s", step.knot_spacing),
        };
        let go_on = (self.observe)(&RefineProgress { stage, share, rms: step.rms, shift: step.shift });
        self.session.report.stopped |= !go_on;
        go_on
    }
}

/// Root mean square shift (metres) and turn (radians) between two states of one trajectory, without what both
/// have in common as one body.
fn movement(before: &DenseTrajectory, after: &DenseTrajectory) -> (f64, f64) {
    let seconds = |i: usize| i as f64 * 0.1;
    let count = (before.duration() / 0.1) as usize + 1;
    // The whole may move freely; the middle is taken as fixed.
    let middle = 0.5 * before.duration();
    let common = before.pose(middle) * after.pose(middle).inverse();
    let (mut shift, mut turn) = (0.0, 0.0);
    for i in 0..count {
        let (a, b) = (before.pose(seconds(i)), common * after.pose(seconds(i)));
        shift += (a.translation.vector - b.translation.vector).norm_squared();
        turn += angular_distance(&a.rotation, &b.rotation).powi(2);
    }
    ((shift / count as f64).sqrt(), (turn / count as f64).sqrt())
}
