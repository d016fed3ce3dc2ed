//! Continuous-time refinement: a trajectory is deformed, continuously in time and in all six degrees of
//! freedom, until all points placed by it fit together.
//!
//! 1. Points of short windows become planar patches (`surfels`).
//! 2. Coarse: patches of different windows are paired, far pairs first, and knots seconds apart are solved
//!    for. At first only windows that are near in time are paired, as there is little drift between them, then
//!    all.
//! 3. Fine: patches of all windows are grouped into planes. Knots a tenth of a second apart and all planes are
//!    solved for together, with the measurements of gyroscope, accelerometer, wheels and fixes, and, if requested,
//!    with extrinsics and clocks of the lidars.
//! 4. With the better trajectory patches are sharper; steps 1 and 3 are repeated until convergence.

mod block_tridiagonal;
mod cells;
mod coarse;
mod conjugate_gradients;
mod correction;
mod coverage;
mod dense_trajectory;
mod fine;
mod held_out;
mod information;
mod jumps;
mod knots;
mod long_shape;
mod motion_blocks;
mod motion_term;
mod mounting;
mod odometry;
mod options;
mod other_sensors;
mod pairs;
mod plane_equations;
mod planes;
mod regression;
mod report;
mod rounds;
mod session;
mod surfels;
mod suspicions;
mod time_base;
mod unary_term;
mod unknowns;

use portolan_geometry::{Rigid3, Time};

pub(crate) use conjugate_gradients::{TIGHT, conjugate_gradients};
pub use correction::SensorCorrection;
pub use dense_trajectory::{Correction, DenseTrajectory, PoseMatrices};
pub use held_out::{Agreement, CrossValidation};
pub use jumps::Jump;
pub use knots::Knots;
pub(crate) use motion_blocks::MotionBlocks;
pub use mounting::Mounting;
pub use odometry::OdometryNoise;
pub(crate) use odometry::{noise_found, odometry_terms};
pub use options::{ContinuousOptions, Gauge};
pub use other_sensors::OtherSensorsFound;
pub use report::{
    BeforeAndAfter, Method, PlacedPoint, RefineProgress, RefineReport, RefineStep, Refined, RoundSharpness,
    Undetermined,
};

pub(crate) use session::Session;

use crate::{MotionSensors, PointStore, RefineError};
use coarse::{agreement, coarse_step};
use held_out::{Part, Selection};
use odometry::motion_terms;
use rounds::Rounds;
use surfels::SurfelMap;

/// Ratio of one coarse reach to the one before.
const REACH_RATIO: f64 = 0.5;
/// The last coarse reach, about the thickness of a wall, metres.
const LAST_REACH: f64 = 0.12;
/// Maximum number of steps at one reach.
const COARSE_STEPS: usize = 5;
/// Shift, as a fraction of the reach, below which the steps at this reach end.
const COARSE_REST: f64 = 0.05;
/// Maximum difference of the numbers of windows that are paired at first.
const NEAR_IN_TIME: usize = 4;
/// Distance by which drift within a few seconds displaces surfaces at most, metres.
const NEAR_REACH: f64 = 0.5;
/// Noise of the motion after windows near in time have been aligned.
const AFTER_NEAR: OdometryNoise = OdometryNoise { translation: 0.02, rotation: 0.004 };
/// Fraction of far pairs that must fit for loops to count as closed; otherwise pairs are searched farther
/// apart.
const CLOSED: f64 = 0.7;
/// Factor by which the weight of fitting pairs must grow for the result of that search to be accepted.
const MUCH_BETTER: f64 = 1.03;
/// Ratio of planar points in windows of a quarter of the length above which the input is rough from one
/// second to the next; it is first smoothed with those short windows.
const ROUGH: f64 = 1.12;
/// Length of the short windows, as a fraction of the usual length.
const SHORT_WINDOW: f64 = 0.25;

/// Deforms a trajectory (`world_from_tracking` in strictly ascending order of time) until the points fit
/// together. `observe` is called before and after each step and stops the work by returning false; the state
/// reached is kept. The result is the same for any number of threads.
///
/// # Errors
/// Fails if there are no points, no surfaces, too few poses, or points and poses are of different times.
pub fn refine_continuous(
    points: &PointStore,
    input: &[(Time, Rigid3)],
    options: &ContinuousOptions,
    observe: &mut dyn FnMut(&RefineProgress) -> bool,
) -> Result<Refined, RefineError> {
    refine_continuous_with(points, &MotionSensors::default(), input, options, observe)
}

/// The same with measurements of other motion sensors.
///
/// # Errors
/// As [`refine_continuous`]; and if the requested gauge cannot be determined from the sensors.
pub fn refine_continuous_with(
    points: &PointStore,
    sensors: &MotionSensors,
    input: &[(Time, Rigid3)],
    options: &ContinuousOptions,
    observe: &mut dyn FnMut(&RefineProgress) -> bool,
) -> Result<Refined, RefineError> {
    options.check()?;
    options.gauge.check(sensors)?;
    let mut session = Session::new(points, input, Method::Continuous(*options), options.odometry)?;
    session.look_for_suspicions();
    if options.calibrate_lidars && session.sensor_names.len() < 2 {
        session
            .report
            .warnings
            .push("there is only one lidar: there is nothing to calibrate it against".to_owned());
    }
    let input = session.trajectory.input_matrices();
    let mut run = Run { session, sensors, options, observe, input, part: Part::Fitted };
    run.coarse()?;
    let mut rounds = Rounds::new(&mut run);
    rounds.run()?;
    if rounds.cross_validate() {
        rounds.end()?;
    }
    let (found, world_from_fixed) = (rounds.others.found, rounds.others.world_from_fixed);
    run.session.report.other_sensors = found;
    run.session.judge_mountings(sensors);
    Ok(run.session.finish(|trajectory, anchor| {
        options.gauge.apply(trajectory, anchor, &found, world_from_fixed.as_ref());
    }))
}

/// Settings of a coarse stage.
struct Stage {
    /// Length of the windows and spacing of the knots, seconds.
    window: f64,
    /// Maximum difference of the numbers of paired windows.
    horizon: Option<usize>,
    /// Maximum distance of pairs at first, metres.
    reach: f64,
}

/// Ever shorter reaches, down to [`LAST_REACH`].
fn reaches(first: f64) -> Vec<f64> {
    let stages = ((first / LAST_REACH).ln() / -REACH_RATIO.ln()).ceil().max(0.0) as i32 + 1;
    (0..stages).map(|stage| (first * REACH_RATIO.powi(stage)).max(LAST_REACH)).collect()
}

/// Name of the work before steps, which takes a while.
const SURFACES: &str = "looking for surfaces";

/// Maximum distance of the pairs that decide whether loops are closed, metres.
fn self_gate(reach: f64) -> f64 {
    reach.min(NEAR_REACH)
}

/// A refinement in progress.
struct Run<'a, 'b> {
    session: Session<'a>,
    sensors: &'b MotionSensors,
    options: &'b ContinuousOptions,
    observe: &'b mut dyn FnMut(&RefineProgress) -> bool,
    /// The poses of the input.
    input: PoseMatrices,
    /// The points in which patches are searched.
    part: Part,
}

impl Run<'_, '_> {
    fn extract(&mut self, window: f64) -> Result<SurfelMap, RefineError> {
        let map = self.surfels(window, self.part);
        let session = &mut self.session;
        if map.surfels.is_empty() {
            return Err(RefineError::NoSurfaces(session.report.points));
        }
        session.report.planar_fraction = Some(map.planar_share());
        Ok(map)
    }

    fn surfels(&self, window: f64, part: Part) -> SurfelMap {
        let session = &self.session;
        let selection = Selection { part, input: &self.input };
        let points = session.points_for_surfaces();
        SurfelMap::extract(&points, selection, &session.coverage, &session.trajectory, window)
    }

    /// Evaluates the result by the points that were held out of the fit. Returns whether it is better than
    /// the input.
    fn cross_validate(&mut self) -> bool {
        if self.session.report.stopped {
            return true;
        }
        let map = self.surfels(self.options.window, Part::HeldOut);
        let session = &mut self.session;
        let found = held_out::judge(&map, &session.points.corrections, &session.trajectory);
        let is_refused = found.as_ref().is_some_and(|found| found.is_refused);
        if is_refused {
            session.keep_input(
                "held-out surfaces agree less with the result than with the input, so the \
                 input was kept",
            );
        }
        session.report.cross_validation = found;
        !is_refused
    }

    /// Aligns windows: first those near in time, between which there is little drift, then all.
    fn coarse(&mut self) -> Result<(), RefineError> {
        let (window, noise) = (self.options.window, self.options.odometry);
        let near = self.options.reach.min(NEAR_REACH);
        if !self.begin(SURFACES, 0.0) {
            return Ok(());
        }
        let mut map = self.extract(window)?;
        if !self.begin(SURFACES, 0.0) {
            return Ok(());
        }
        let short = self.extract(SHORT_WINDOW * window)?;
        let input = self.session.trajectory.clone();
        if short.planar_share() > ROUGH * map.planar_share() {
            let stage = Stage { window: SHORT_WINDOW * window, horizon: Some(2 * NEAR_IN_TIME), reach: near };
            self.draw(&short, &stage, &input, noise, [0.0, 0.1])?;
            map = self.extract(window)?;
        }
        drop(short);
        let stage = Stage { window, horizon: Some(NEAR_IN_TIME), reach: near };
        self.draw(&map, &stage, &input, noise, [0.1, 0.2])?;
        self.close_loops()
    }

    /// Aligns all windows. The trajectory reached so far is now the reference of the motion, with less noise
    /// than the input. If loops are not closed from near, the search is repeated with the full reach, for
    /// larger drift.
    fn close_loops(&mut self) -> Result<(), RefineError> {
        let window = self.options.window;
        if !self.begin(SURFACES, 0.2) {
            return Ok(());
        }
        let map = self.extract(window)?;
        let before = self.session.trajectory.clone();
        let near = Stage { window, horizon: None, reach: self.options.reach.min(NEAR_REACH) };
        self.draw(&map, &near, &before, AFTER_NEAR, [0.2, 0.3])?;
        let agreement = |run: &Self| {
            let session = &run.session;
            agreement(&map, &session.points.corrections, &session.trajectory, self_gate(run.options.reach))
        };
        if !self.begin("comparing passes", 0.3) {
            return Ok(());
        }
        let (share, weight) = agreement(self);
        if self.options.reach <= NEAR_REACH || share > CLOSED {
            return Ok(());
        }
        let from_near = std::mem::replace(&mut self.session.trajectory, before.clone());
        let far = Stage { window, horizon: None, reach: self.options.reach };
        self.draw(&map, &far, &before, AFTER_NEAR, [0.3, 0.4])?;
        if agreement(self).1 < MUCH_BETTER * weight {
            self.session.trajectory = from_near;
        }
        Ok(())
    }

    /// Steps at ever shorter reach, constrained by the motion of `reference`.
    fn draw(
        &mut self,
        map: &SurfelMap,
        stage: &Stage,
        reference: &DenseTrajectory,
        noise: OdometryNoise,
        share: [f64; 2],
    ) -> Result<(), RefineError> {
        if self.session.report.stopped {
            return Ok(());
        }
        let knots = Knots::new(self.session.trajectory.duration(), stage.window);
        let reaches = reaches(stage.reach);
        for (i, reach) in reaches.iter().enumerate() {
            for _ in 0..COARSE_STEPS {
                let session = &mut self.session;
                let motion = motion_terms(|s| reference.pose(s), &session.trajectory, &knots, noise);
                let corrections = &session.points.corrections;
                let trajectory = &mut session.trajectory;
                let step =
                    coarse_step(map, corrections, trajectory, &knots, &motion, (*reach, stage.horizon))?;
                let record = RefineStep {
                    stage: if stage.horizon.is_some() { "near in time" } else { "coarse" },
                    knot_spacing: knots.spacing(),
                    reach: *reach,
                    terms: step.pairs,
                    rms: step.rms,
                    shift: step.shift,
                };
                let done = (i + 1) as f64 / reaches.len() as f64;
                if !self.record(record, share[0] + (share[1] - share[0]) * done) {
                    return Ok(());
                }
                if step.shift < COARSE_REST * reach {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Reports the begin of work that takes a while; returns whether to go on.
    fn begin(&mut self, stage: &str, share: f64) -> bool {
        let last = self.session.report.steps.last();
        let (rms, shift) = (last.map(|step| step.rms), last.map(|step| step.shift));
        self.report_progress(stage.to_owned(), share, (rms, shift))
    }

    /// Reports the progress; returns whether to go on. After a stop the observer is not asked again.
    fn report_progress(
        &mut self,
        stage: String,
        share: f64,
        (rms, shift): (Option<f64>, Option<f64>),
    ) -> bool {
        let report = &mut self.session.report;
        if report.stopped {
            return false;
        }
        let entropy = report.sharpness_by_round.last().map(|s| s.mean_map_entropy);
        report.stopped |= !(self.observe)(&RefineProgress { stage, share, rms, shift, entropy });
        !report.stopped
    }

    /// Records and reports a step; returns whether to go on.
    fn record(&mut self, step: RefineStep, share: f64) -> bool {
        self.session.report.steps.push(step);
        let stage = match step.stage {
            "fine" => format!("knots every {:.1} s", step.knot_spacing),
            "coarse" => format!("drift within {:.2} m", step.reach),
            _ => format!("drift within {:.2} m of the seconds before", step.reach),
        };
        self.report_progress(stage, share, (Some(step.rms), Some(step.shift)))
    }
}
