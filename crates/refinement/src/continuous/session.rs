//! State shared by all methods: points in the time of the trajectory, the report, and the final checks.

use nalgebra::Matrix6;
use portolan_geometry::{Duration, Rigid3, Time, Vector3};

use super::correction::Corrections;
use super::coverage::{Coverage, TimedPoints};
use super::report::{Method, RefineReport, Refined, RoundSharpness};
use super::time_base::{self, TimeBase};
use super::{DenseTrajectory, OdometryNoise, information};
use super::{held_out, long_shape};
use crate::{MAX_SENSORS, PointStore, RefineError, StoredPoint};
use portolan_spatial::{Sharpness, SharpnessOptions, sharpness, spread_sample};

/// Number of points with which the sharpness of a round is measured.
const ROUND_POINTS: usize = 100_000;
/// Number of neighbourhoods for that.
const ROUND_QUERIES: usize = 5_000;

/// A refinement in progress.
pub(crate) struct Session<'a> {
    pub points: TimedPoints<'a>,
    /// The points in which surfaces are searched, if not all.
    thinned: Option<Vec<StoredPoint>>,
    pub coverage: Coverage,
    pub trajectory: DenseTrajectory,
    /// Information of the surfaces, second by second; empty if the method does not compute it.
    pub information: Vec<Matrix6<f64>>,
    pub report: RefineReport,
    /// Names of the sensors.
    pub sensor_names: Vec<String>,
    /// Positions of the sensors in the tracking frame.
    pub sensor_origins: Vec<Vector3>,
    /// Seconds without trajectory at the beginning and at the end of the points.
    pub uncovered_ends: [f64; 2],
    /// Whether the input seems to belong to another recording.
    pub fits_nowhere: bool,
}

impl<'a> Session<'a> {
    pub fn new(
        store: &'a PointStore,
        input: &[(Time, Rigid3)],
        method: Method,
        odometry: OdometryNoise,
    ) -> Result<Self, RefineError> {
        check_poses(input)?;
        let trajectory = DenseTrajectory::new(input)?;
        let offset = store.start().seconds_since(trajectory.start());
        let sensors = store.sensors().len().clamp(1, MAX_SENSORS);
        let corrections = Corrections::default();
        let points = TimedPoints { points: store.points(), offset, sensors, corrections };
        let coverage = Coverage::of(input);
        let covered = coverage.count(&points);
        if covered == 0 {
            return Err(no_overlap(store, &points, &trajectory));
        }
        let ends =
            [store.points().first(), store.points().last()].map(|p| p.map_or(0.0, |p| points.seconds(p)));
        let uncovered_ends = [-ends[0], ends[1] - trajectory.duration()].map(|s| s.max(0.0));
        let report = RefineReport {
            points: covered,
            points_outside_trajectory: store.points().len() - covered,
            left_out: store.left_out(),
            gaps: coverage.gaps.clone(),
            jumps: trajectory.jumps().to_vec(),
            sharpness_before: measure(&points, &coverage, &trajectory, SharpnessOptions::default()),
            sensors: store.sensors().to_vec(),
            ..RefineReport::new(method, odometry)
        };
        let sensor_names = store.sensors().iter().map(|s| s.name.clone()).collect();
        let origins = store.sensors().iter().take(MAX_SENSORS).map(|s| Vector3::from(s.origin_in_tracking));
        let thinned = points.thinned();
        let mut session = Self {
            points,
            thinned,
            coverage,
            trajectory,
            information: Vec::new(),
            report,
            sensor_names,
            sensor_origins: origins.collect(),
            uncovered_ends,
            fits_nowhere: false,
        };
        session.measure_round();
        Ok(session)
    }

    /// The points in which surfaces are searched, with current corrections.
    pub fn points_for_surfaces(&self) -> TimedPoints<'_> {
        let points = self.thinned.as_deref().unwrap_or(self.points.points);
        TimedPoints { points, corrections: self.points.corrections.clone(), ..self.points }
    }

    /// Measures the current sharpness of the cloud.
    pub fn measure_round(&mut self) {
        let options = SharpnessOptions {
            max_points: ROUND_POINTS,
            queries: ROUND_QUERIES,
            ..SharpnessOptions::default()
        };
        let measured = measure(&self.points, &self.coverage, &self.trajectory, options);
        let steps = self.report.steps.len();
        self.report.sharpness_by_round.extend(measured.map(|s| RoundSharpness {
            steps,
            mean_map_entropy: s.mean_map_entropy,
            mean_plane_variance: s.mean_plane_variance,
        }));
    }

    /// Calls `visit` with the points for surfaces between two times that the trajectory covers: seconds,
    /// position in the tracking frame, position in the world.
    pub fn for_each_point(&self, [from, to]: [f64; 2], mut visit: impl FnMut(f64, [f32; 3], Vector3)) {
        let points = self.points_for_surfaces();
        let matrices = self.trajectory.matrices_between(from, to);
        for interval in &self.coverage.intervals {
            let (from, to) = (from.max(interval[0]), to.min(interval[1]));
            if from < to {
                for point in points.between([from, to]) {
                    let (seconds, in_tracking) = points.place(point);
                    visit(seconds, in_tracking, Vector3::from(matrices.to_world(seconds, in_tracking)));
                }
            }
        }
    }

    /// Restores the input, and reports why.
    pub fn keep_input(&mut self, why: &str) {
        self.trajectory.reset();
        self.points.corrections = Corrections::default();
        let report = &mut self.report;
        (report.kept_input, report.calibrated) = (true, false);
        report.sharpness_after = report.sharpness_before;
        report.warnings.push(why.to_owned());
    }

    /// Checks the result, keeps the input if that is sharper, and lets `settle` move the whole (which then
    /// begins at the first pose of the input, moved there by the given transform).
    pub fn finish(mut self, settle: impl FnOnce(&mut DenseTrajectory, &Rigid3)) -> Refined {
        self.report.long_shape_held_seconds = long_shape::keep(&mut self.trajectory);
        if let Some(validation) = self.report.cross_validation.as_ref().filter(|v| !v.is_refused) {
            held_out::keep_input(&mut self.trajectory, &validation.refused);
        }
        if !self.trajectory.is_valid() {
            self.keep_input("the refinement ended with poses that are not finite, so the input was kept");
        }
        let anchor = self.trajectory.anchor_first_pose();
        self.report.sharpness_after =
            measure(&self.points, &self.coverage, &self.trajectory, SharpnessOptions::default());
        if let (Some(before), Some(after)) = (&self.report.sharpness_before, &self.report.sharpness_after) {
            let error = before.entropy_standard_error.hypot(after.entropy_standard_error);
            if after.mean_map_entropy > before.mean_map_entropy + 2.0 * error {
                self.keep_input("the refined cloud was less sharp than the original, so the input was kept");
            }
        }
        let report = &mut self.report;
        (report.largest_translation, report.largest_rotation) = self.trajectory.largest_correction();
        report.undetermined = information::undetermined(&self.information);
        for free in &mut report.undetermined {
            free.direction = (anchor.rotation * Vector3::from(free.direction)).into();
        }
        self.warn_of_input();
        settle(&mut self.trajectory, &anchor);
        Refined {
            trajectory: self.trajectory,
            report: self.report,
            corrections: self.points.corrections,
            intervals: self.coverage.intervals,
        }
    }
}

/// Sharpness of the points along a trajectory.
fn measure(
    points: &TimedPoints,
    coverage: &Coverage,
    trajectory: &DenseTrajectory,
    options: SharpnessOptions,
) -> Option<Sharpness> {
    let matrices = trajectory.matrices();
    let total = coverage.count(points);
    let mut chosen = spread_sample(total, options.max_points).into_iter().peekable();
    let mut cloud = Vec::with_capacity(total.min(options.max_points));
    let mut first = 0;
    for interval in &coverage.intervals {
        let part = points.between(*interval);
        while let Some(index) = chosen.next_if(|i| (*i as usize) < first + part.len()) {
            let point = &part[index as usize - first];
            let (seconds, in_tracking) = points.place(point);
            cloud.push(matrices.to_world(seconds, in_tracking));
        }
        first += part.len();
    }
    sharpness(&cloud, options)
}

/// Poses must be finite and ascend in time.
fn check_poses(input: &[(Time, Rigid3)]) -> Result<(), RefineError> {
    let is_bad = |i: &usize| {
        let pose = &input[*i].1;
        let finite = pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite());
        !finite || (*i > 0 && input[*i].0 <= input[*i - 1].0)
    };
    match (0..input.len()).find(is_bad) {
        Some(i) => Err(RefineError::BadPose(i)),
        None => Ok(()),
    }
}

fn no_overlap(store: &PointStore, points: &TimedPoints, trajectory: &DenseTrajectory) -> RefineError {
    let Some((first, last)) = store.span() else { return RefineError::NoPoints };
    let (start, posed) = (trajectory.start(), trajectory.duration());
    let end = start + Duration::from_seconds(posed);
    let span = |from: Time, to: Time| format!("{:.3} to {:.3} s", from.unix_seconds(), to.unix_seconds());
    let recorded = last.seconds_since(first);
    // Offset between the beginnings and offset between the ends.
    let (a, b) = (first.seconds_since(start), last.seconds_since(end));
    let found = time_base::test_time_base(points, trajectory, 0.5 * (a + b), 0.5 * (a - b).abs() + 2.0);
    let hint = match found {
        TimeBase::FitsWith(delay) => {
            format!(" ({delay:.3} s added to the stamps of the trajectory make the points fit together)")
        }
        _ if (recorded - posed).abs() < 0.1 * recorded.max(posed) => {
            format!(
                " (both have the same duration: {a:.3} s added to the stamps of the trajectory would align them)"
            )
        }
        _ => String::new(),
    };
    RefineError::NoOverlap { points: span(first, last), trajectory: span(start, end), hint }
}
