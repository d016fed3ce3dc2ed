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
mod surfels;

use nalgebra::Matrix6;
use portolan_geometry::{Rigid3, Time, angular_distance};

pub use dense_trajectory::{Correction, DenseTrajectory, PoseMatrices};
pub use knots::Knots;
pub use odometry::OdometryNoise;
pub use options::ContinuousOptions;
pub use report::{RefineProgress, RefineReport, RefineStep, Refined, Undetermined};

use crate::{PointStore, RefineError, Sharpness, SharpnessOptions, sharpness, spread_sample};
use coarse::coarse_step;
use coverage::{Coverage, TimedPoints};
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
/// With a smaller share of points on planar patches something is wrong with the input.
const LEAST_PLANAR_SHARE: f64 = 0.2;

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
    let mut run = Run::new(points, input, options, observe)?;
    run.coarse()?;
    run.fine()?;
    Ok(run.finish())
}

/// A refinement at work.
struct Run<'a> {
    points: TimedPoints<'a>,
    coverage: Coverage,
    options: &'a ContinuousOptions,
    observe: &'a mut dyn FnMut(&RefineProgress) -> bool,
    trajectory: DenseTrajectory,
    information: Vec<Matrix6<f64>>,
    report: RefineReport,
}

impl<'a> Run<'a> {
    fn new(
        store: &'a PointStore,
        input: &[(Time, Rigid3)],
        options: &'a ContinuousOptions,
        observe: &'a mut dyn FnMut(&RefineProgress) -> bool,
    ) -> Result<Self, RefineError> {
        let trajectory = DenseTrajectory::new(input)?;
        let offset = store.start().seconds_since(trajectory.start());
        let points = TimedPoints { points: store.points(), offset };
        let coverage = Coverage::of(input);
        let covered = coverage.count(points);
        if covered == 0 {
            return Err(no_overlap(store, input));
        }
        let report = RefineReport {
            options: *options,
            steps: Vec::new(),
            points: covered,
            points_outside_trajectory: store.points().len() - covered,
            left_out: store.left_out(),
            gaps: coverage.gaps.clone(),
            planar_share: 0.0,
            sharpness_before: measure(points, &coverage, &trajectory),
            sharpness_after: None,
            odometry_found: options.odometry,
            largest_shift: 0.0,
            largest_turn: 0.0,
            undetermined: Vec::new(),
            kept_input: false,
            stopped: false,
            warnings: Vec::new(),
        };
        Ok(Self { points, coverage, options, observe, trajectory, information: Vec::new(), report })
    }

    fn extract(&mut self) -> Result<SurfelMap, RefineError> {
        let map = SurfelMap::extract(self.points, &self.coverage, &self.trajectory, self.options.window);
        if map.surfels.is_empty() {
            return Err(RefineError::NoSurfaces(self.report.points));
        }
        self.report.planar_share =
            map.surfels.iter().map(|s| s.count).sum::<f64>() / map.looked_at.max(1) as f64;
        Ok(map)
    }

    /// Draws windows together, from far to near.
    fn coarse(&mut self) -> Result<(), RefineError> {
        let map = self.extract()?;
        let knots = Knots::new(self.trajectory.duration(), self.options.window);
        let stages =
            ((self.options.reach / LAST_REACH).ln() / -REACH_RATIO.ln()).ceil().max(0.0) as usize + 1;
        for stage in 0..stages {
            let reach = (self.options.reach * REACH_RATIO.powi(stage as i32)).max(LAST_REACH);
            for _ in 0..COARSE_STEPS {
                let step = coarse_step(&map, &mut self.trajectory, &knots, self.options.odometry, reach)?;
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
            if self.report.stopped {
                return Ok(());
            }
            let first = round == 0;
            let spacing =
                if first { FIRST_SPACING.max(self.options.knot_spacing) } else { self.options.knot_spacing };
            let knots = Knots::new(self.trajectory.duration(), spacing);
            let before = self.trajectory.clone();
            let map = self.extract()?;
            for step in 0..FINE_STEPS {
                let gap = GAPS[usize::from(!first)];
                let done = fine_step(&map, &mut self.trajectory, &knots, self.report.odometry_found, gap)?;
                self.information = done.information;
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
                self.report.odometry_found = odometry::noise_found(&self.trajectory, &knots);
                let (shift, turn) = movement(&before, &self.trajectory);
                if shift < RESTS.0 && turn < RESTS.1 {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Notes a step and tells it; whether to go on.
    fn record(&mut self, step: RefineStep, share: f64) -> bool {
        self.report.steps.push(step);
        let stage = match step.stage {
            "coarse" => format!("drift within {:.2} m", step.reach),
            _ => format!("knots every {:.1} s", step.knot_spacing),
        };
        let go_on = (self.observe)(&RefineProgress { stage, share, rms: step.rms, shift: step.shift });
        self.report.stopped |= !go_on;
        go_on
    }

    /// Settles the gauge, judges the result, and keeps the input if that is sharper.
    fn finish(mut self) -> Refined {
        self.trajectory.anchor_first_pose();
        let report = &mut self.report;
        report.sharpness_after = measure(self.points, &self.coverage, &self.trajectory);
        if let (Some(before), Some(after)) = (&report.sharpness_before, &report.sharpness_after) {
            let error = before.entropy_standard_error.hypot(after.entropy_standard_error);
            if after.mean_map_entropy > before.mean_map_entropy + 2.0 * error {
                self.trajectory.reset();
                report.kept_input = true;
                report.sharpness_after = report.sharpness_before;
                report.warnings.push(
                    "the refined cloud was less sharp than the original, so the input was kept".to_owned(),
                );
            }
        }
        (report.largest_shift, report.largest_turn) = self.trajectory.largest_correction();
        report.undetermined = information::undetermined(&self.information);
        if report.planar_share < LEAST_PLANAR_SHARE {
            report.warnings.push(format!(
                "only {:.0} % of the points lie on surfaces: is it the trajectory of this recording, of the frame \
                 the points are in, and of the same clock?",
                100.0 * report.planar_share
            ));
        }
        if report.points_outside_trajectory * 20 > report.points {
            report.warnings.push(format!(
                "{} of {} points lie before, after or in gaps of the trajectory and were not used",
                report.points_outside_trajectory,
                report.points_outside_trajectory + report.points
            ));
        }
        Refined { trajectory: self.trajectory, report: self.report }
    }
}

/// Sharpness of the points along a trajectory.
fn measure(points: TimedPoints, coverage: &Coverage, trajectory: &DenseTrajectory) -> Option<Sharpness> {
    let options = SharpnessOptions::default();
    let matrices = trajectory.matrices();
    let total = coverage.count(points);
    let mut chosen = spread_sample(total, options.max_points).into_iter().peekable();
    let mut cloud = Vec::with_capacity(total.min(options.max_points));
    let mut first = 0;
    for interval in &coverage.intervals {
        let part = points.between(*interval);
        while let Some(index) = chosen.next_if(|i| (*i as usize) < first + part.len()) {
            let point = &part[index as usize - first];
            cloud.push(matrices.to_world(points.seconds(point), point.in_tracking));
        }
        first += part.len();
    }
    sharpness(&cloud, options)
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

fn no_overlap(store: &PointStore, input: &[(Time, Rigid3)]) -> RefineError {
    let (Some((first, last)), Some(start), Some(end)) = (store.span(), input.first(), input.last()) else {
        return RefineError::NoPoints;
    };
    let span = |from: Time, to: Time| format!("{:.3} to {:.3} s", from.unix_seconds(), to.unix_seconds());
    let (recorded, posed) = (last.seconds_since(first), end.0.seconds_since(start.0));
    let alike = (recorded - posed).abs() < 0.1 * recorded.max(posed);
    let hint = if alike {
        format!(
            " (they last equally long: {:.3} s added to the trajectory would fit)",
            first.seconds_since(start.0)
        )
    } else {
        String::new()
    };
    RefineError::NoOverlap { points: span(first, last), trajectory: span(start.0, end.0), hint }
}
