//! The fine rounds: knots, planes and sensors are solved for, with ever sharper patches, until convergence.

use portolan_geometry::{Vector3, angular_distance};

use super::conjugate_gradients::{LOOSE, TIGHT};
use super::fine::{FineProblem, FineStep, fine_step};
use super::held_out::Part;
use super::mounting::Mounting;
use super::odometry::{noise_found, odometry_terms};
use super::other_sensors::OtherSensors;
use super::report::RefineStep;
use super::surfels::SurfelMap;
use super::unknowns::{PER_SENSOR, PRIOR, SensorUnknowns, capped_deviations};
use super::{DenseTrajectory, Knots, Run, SURFACES};
use crate::RefineError;

/// Seconds between the knots of the first round.
const FIRST_SPACING: f64 = 0.5;
/// Distance that separates planes, in the first round and later, metres.
const GAPS: [f64; 2] = [0.15, 0.10];
/// Maximum number of steps of a round.
const STEPS: usize = 3;
/// Shift of the knots below which a round ends earlier, metres.
const STEPS_REST: f64 = 0.0005;
/// Root mean square movement of a round below which rounds end, metres and radians; sensors must be at rest, too.
const RESTS: (f64, f64) = (0.001, 0.0005);
/// Movement of a sensor above which rounds go on: metres, radians, seconds.
const SENSOR_RESTS: [f64; 3] = [0.001, 0.0003, 0.0005];
/// Maximum number of final rounds with all points, which start from the result of the rounds with most
/// points.
const LAST_ROUNDS: usize = 2;
/// Usual number of rounds, for progress.
const USUAL_ROUNDS: f64 = 4.0;

/// Fraction of the work that is done after this number of rounds.
fn progress(rounds: f64) -> f64 {
    0.4 + 0.6 * (rounds / USUAL_ROUNDS).min(0.99)
}

/// The rounds of a run.
pub(super) struct Rounds<'r, 'a, 'b> {
    run: &'r mut Run<'a, 'b>,
    pub others: OtherSensors<'b>,
    /// Sensors that are calibrated.
    sensors: SensorUnknowns,
    /// Estimates of their corrections so far.
    found: Vec<[f64; PER_SENSOR]>,
}

impl<'r, 'a, 'b> Rounds<'r, 'a, 'b> {
    pub fn new(run: &'r mut Run<'a, 'b>) -> Self {
        let others = OtherSensors::new(run.sensors, run.session.trajectory.start());
        let calibrate = run.options.calibrate_lidars;
        let sensors = if calibrate { all_but_the_first(run) } else { SensorUnknowns::default() };
        let found = vec![[0.0; PER_SENSOR]; sensors.sensors.len()];
        Self { run, others, sensors, found }
    }

    /// Rounds with the fitted points, until convergence.
    pub fn run(&mut self) -> Result<(), RefineError> {
        self.rounds(0, self.run.options.max_rounds)?;
        Ok(())
    }

    /// Evaluates the result by held-out points. Returns whether it is better than the input.
    pub fn cross_validate(&mut self) -> bool {
        self.run.cross_validate()
    }

    /// Final rounds with all points, including those that were held out of the fit.
    pub fn end(&mut self) -> Result<(), RefineError> {
        self.run.part = Part::All;
        match self.rounds(self.run.options.max_rounds, LAST_ROUNDS)? {
            Some((map, knots)) => self.judge_sensors(&map, &knots),
            None => Ok(()),
        }
    }

    /// Rounds that are counted from `first` on. Returns patches and knots of the last one, unless it was
    /// stopped.
    fn rounds(&mut self, first: usize, number: usize) -> Result<Option<(SurfelMap, Knots)>, RefineError> {
        let options = self.run.options;
        let mut last = None;
        for round in first..first + number {
            if self.run.session.report.stopped || !self.run.begin(SURFACES, progress(round as f64)) {
                return Ok(None);
            }
            let is_first = round == 0;
            let spacing =
                if is_first { FIRST_SPACING.max(options.knot_spacing) } else { options.knot_spacing };
            let knots = Knots::new(self.run.session.trajectory.duration(), spacing);
            let before = self.run.session.trajectory.clone();
            let map = self.run.extract(options.window)?;
            if !self.run.begin(SURFACES, progress(round as f64)) {
                return Ok(None);
            }
            let sensors_moved = self.steps(&map, &knots, round)?;
            if self.run.session.report.stopped {
                return Ok(None);
            }
            self.run.session.measure_round();
            last = Some((map, knots));
            if !is_first {
                let session = &mut self.run.session;
                if let Some((_, knots)) = &last {
                    session.report.odometry_found = noise_found(&session.trajectory, knots);
                }
                let (shift, turn) = movement(&before, &session.trajectory);
                if shift < RESTS.0 && turn < RESTS.1 && !sensors_moved {
                    break;
                }
            }
        }
        Ok(last)
    }

    /// The steps of one round. Returns whether a sensor still moves at the end.
    fn steps(&mut self, map: &SurfelMap, knots: &Knots, round: usize) -> Result<bool, RefineError> {
        let gap = GAPS[usize::from(round > 0)];
        let mut moved = false;
        for step in 0..STEPS {
            let sensors = self.sensors.clone();
            let tolerance = if step + 1 < STEPS { LOOSE } else { TIGHT };
            let done = self.solve(map, knots, gap, &sensors, (tolerance, false))?;
            let session = &mut self.run.session;
            session.trajectory.apply(knots, &done.knots);
            moved = false;
            for (i, increment) in done.sensors.iter().enumerate() {
                let origin = sensors.origins[i];
                session.points.corrections.apply(increment.sensor, &increment.value, &origin);
                for (k, (sum, value)) in self.found[i].iter_mut().zip(increment.value).enumerate() {
                    *sum += value;
                    moved |= value.abs() > SENSOR_RESTS[k / 3];
                }
            }
            session.information = done.information;
            let record = RefineStep {
                stage: "fine",
                knot_spacing: knots.spacing(),
                reach: gap,
                terms: done.clusters,
                rms: done.rms,
                shift: done.shift,
            };
            let rounds = round as f64 + (step + 1) as f64 / STEPS as f64;
            let continues = self.run.record(record, progress(rounds));
            if !continues || (done.shift < STEPS_REST && !moved) {
                break;
            }
        }
        Ok(moved)
    }

    fn solve(
        &mut self,
        map: &SurfelMap,
        knots: &Knots,
        gap: f64,
        sensors: &SensorUnknowns,
        (tolerance, covariance): (f64, bool),
    ) -> Result<FineStep, RefineError> {
        let session = &self.run.session;
        let (mut motion, moments) = self.others.terms(&session.trajectory, knots);
        motion.extend(odometry_terms(&session.trajectory, knots, session.report.odometry_found));
        fine_step(&FineProblem {
            map,
            corrections: &session.points.corrections,
            trajectory: &session.trajectory,
            knots,
            motion: &motion,
            moments: &moments,
            sensors,
            gap,
            tolerance,
            covariance,
        })
    }

    /// One more step with covariances, which is not applied: the result of the calibration, or what it would
    /// be.
    fn judge_sensors(&mut self, map: &SurfelMap, knots: &Knots) -> Result<(), RefineError> {
        let sensors = all_but_the_first(self.run);
        if sensors.is_empty() {
            return Ok(());
        }
        let done = self.solve(map, knots, GAPS[1], &sensors, (TIGHT, true))?;
        let calibrated = !self.sensors.is_empty();
        for (i, increment) in done.sensors.iter().enumerate() {
            let so_far = self.found.get(i).copied().unwrap_or_default();
            let value =
                std::array::from_fn(|k| so_far[k] + increment.value[k] * f64::from(u8::from(!calibrated)));
            let deviation = capped_deviations(&increment.covariance.unwrap_or_default());
            let name = self.run.session.sensor_names[increment.sensor].clone();
            let mounting = Mounting::new(&name, value, deviation, PRIOR);
            self.run.session.note_sensor(mounting, calibrated);
        }
        Ok(())
    }
}

/// All sensors with points except the first, relative to which the others are calibrated.
fn all_but_the_first(run: &Run) -> SensorUnknowns {
    let sensors: Vec<usize> = (1..run.session.sensor_origins.len()).collect();
    let origins: Vec<Vector3> = sensors.iter().map(|s| run.session.sensor_origins[*s]).collect();
    SensorUnknowns { sensors, origins }
}

/// Root mean square translation (metres) and rotation (radians) between two states of one trajectory, without
/// their common rigid motion.
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
