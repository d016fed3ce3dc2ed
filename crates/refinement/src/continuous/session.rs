//! What all methods share: points in the time of the trajectory, the report, the judgement at the end.

use nalgebra::Matrix6;
use portolan_geometry::{Rigid3, Time, Vector3};

use super::coverage::{Coverage, TimedPoints};
use super::report::{Method, RefineReport, Refined};
use super::{DenseTrajectory, OdometryNoise, information};
use crate::{PointStore, RefineError, Sharpness, SharpnessOptions, sharpness, spread_sample};

/// With a smaller share of points on planar patches something is wrong with the input.
const LEAST_PLANAR_SHARE: f64 = 0.2;

/// A refinement at work.
pub(crate) struct Session<'a> {
    pub points: TimedPoints<'a>,
    pub coverage: Coverage,
    pub trajectory: DenseTrajectory,
    /// What the surfaces determine, second by second; empty if the method does not know.
    pub information: Vec<Matrix6<f64>>,
    pub report: RefineReport,
}

impl<'a> Session<'a> {
    pub fn new(
        store: &'a PointStore,
        input: &[(Time, Rigid3)],
        method: Method,
        odometry: OdometryNoise,
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
            method,
            steps: Vec::new(),
            points: covered,
            points_outside_trajectory: store.points().len() - covered,
            left_out: store.left_out(),
            gaps: coverage.gaps.clone(),
            planar_share: None,
            sharpness_before: measure(points, &coverage, &trajectory),
            sharpness_after: None,
            odometry_found: odometry,
            largest_shift: 0.0,
            largest_turn: 0.0,
            undetermined: Vec::new(),
            kept_input: false,
            stopped: false,
            warnings: Vec::new(),
        };
        Ok(Self { points, coverage, trajectory, information: Vec::new(), report })
    }

    /// Calls `visit` with the points between two times that the trajectory covers: seconds, and place in the world.
    pub fn for_each_point(&self, [from, to]: [f64; 2], mut visit: impl FnMut(f64, Vector3)) {
        let matrices = self.trajectory.matrices_between(from, to);
        for interval in &self.coverage.intervals {
            let (from, to) = (from.max(interval[0]), to.min(interval[1]));
            if from < to {
                for point in self.points.between([from, to]) {
                    let seconds = self.points.seconds(point);
                    visit(seconds, Vector3::from(matrices.to_world(seconds, point.in_tracking)));
                }
            }
        }
    }

    /// Settles the gauge, judges the result, and keeps the input if that is sharper.
    pub fn finish(mut self) -> Refined {
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
        if let Some(share) = report.planar_share.filter(|share| *share < LEAST_PLANAR_SHARE) {
            report.warnings.push(format!(
                "only {:.0} % of the points lie on surfaces: is it the trajectory of this recording, of the frame \
                 the points are in, and of the same clock?",
                100.0 * share
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

fn no_overlap(store: &PointStore, input: &[(Time, Rigid3)]) -> RefineError {
    let (Some((first, last)), Some(start), Some(end)) = (store.span(), input.first(), input.last()) else {
        return RefineError::NoPoints;
    };
    let span = |from: Time, to: Time| format!("{:.3} to {:.3} s", from.unix_seconds(), to.unix_seconds());
    let (recorded, posed) = (last.seconds_since(first), end.0.seconds_since(start.0));
    let alike = (recorded - posed).abs() < 0.1 * recorded.max(posed);
    let hint = if alike {
        let shift = first.seconds_since(start.0);
        format!(" (they last equally long: {shift:.3} s added to the trajectory would fit)")
    } else {
        String::new()
    };
    RefineError::NoOverlap { points: span(first, last), trajectory: span(start.0, end.0), hint }
}
