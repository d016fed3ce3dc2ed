//! Warns of probable errors of the input, and suggests corrections.

use super::mounting::{self, Mounting};
use super::report::Method;
use super::session::Session;
use super::time_base::{self, TimeBase};
use crate::MotionSensors;

/// Fraction of points on planar patches below which the input is suspect.
const LEAST_PLANAR_SHARE: f64 = 0.2;
/// Number of standard deviations from which a calibration is significant.
const SIGNIFICANT: f64 = 6.0;
/// Decrease of the entropy from which the input counts as belonging to this recording.
const SHARPENED: f64 = 0.3;
/// Interval from which poses are sparse, seconds.
const SPARSE: f64 = 0.04;
/// Fraction of points outside the trajectory above which a warning is given.
const OUTSIDE: f64 = 0.05;

impl Session<'_> {
    fn warn(&mut self, text: String) {
        self.report.warnings.push(text);
    }

    /// Before the refinement: checks whether the trajectory belongs to the points.
    pub fn look_for_suspicions(&mut self) {
        match time_base::test_time_base(&self.points, &self.trajectory, 0.0, 0.0) {
            TimeBase::Fits => {}
            TimeBase::FitsWith(delay) => self.warn(format!(
                "wrong time base? The points fit together better with {delay:.3} s added to the stamps of the \
                 trajectory (--time-offset {delay:.3})"
            )),
            TimeBase::FitsNowhere => self.fits_nowhere = true,
        }
    }

    /// Adds the estimated mounting of a lidar.
    pub fn note_sensor(&mut self, mounting: Mounting, calibrated: bool) {
        let significant = mounting.significant(SIGNIFICANT);
        if !calibrated && significant.contains(&true) {
            let words = mounting.words(significant);
            self.warn(format!(
                "wrong extrinsics or clock? {} seems to be {words} against {}; --calibrate would correct it",
                name(&mounting.name),
                name(self.sensor_names.first().map_or("", |n| n))
            ));
        }
        if calibrated && !mounting.undetermined.is_empty() {
            self.warn(format!(
                "the motion does not determine the calibration of {}: {}; do not rely on that",
                name(&mounting.name),
                mounting.undetermined.join(", ")
            ));
        }
        self.report.calibrated |= calibrated;
        self.report.mountings.push(mounting);
    }

    /// Compares the motion of the result with those of the input and of the IMU.
    pub fn judge_mountings(&mut self, sensors: &MotionSensors) {
        if let Some(mounting) = mounting::of_input(&self.trajectory, &self.coverage.gaps) {
            let significant = mounting.significant(SIGNIFICANT);
            let mut warnings = Vec::new();
            if significant[0] || significant[1] {
                let words = mounting.words([significant[0], significant[1], false]);
                warnings.push(format!(
                    "wrong extrinsics? The motion of the input fits the points better with the sensors {words} in the \
                     tracking frame"
                ));
            }
            if significant[2] {
                let delay = mounting.delay;
                warnings.push(format!(
                    "wrong time base? The motion of the input fits the points better with {delay:.3} s added to its stamps \
                     (--time-offset {delay:.3})"
                ));
            }
            warnings.into_iter().for_each(|text| self.warn(text));
        }
        let imu = mounting::of_imu(&self.trajectory, sensors, self.trajectory.start());
        if let Some(imu) = &imu {
            let mut significant = imu.significant(SIGNIFICANT);
            // Between sparse poses the velocity is not accurate enough to determine the position of an
            // accelerometer.
            significant[0] &= self.coverage.usual_step < SPARSE;
            if significant.contains(&true) {
                let words = imu.words(significant);
                self.warn(format!(
                    "wrong extrinsics or clock? The IMU seems to be {words} in the tracking frame"
                ));
            }
        }
        self.report.imu = imu;
    }

    /// At the end: warns of the parts of the input that could not be used.
    pub fn warn_of_input(&mut self) {
        let report = &self.report;
        let mut warnings = Vec::new();
        let sharpened = match (&report.sharpness_before, &report.sharpness_after) {
            (Some(before), Some(after)) => before.mean_map_entropy - after.mean_map_entropy,
            _ => 0.0,
        };
        // The sharpness that was optimised proves nothing by itself: held-out surfaces must agree.
        let is_validated = match report.method {
            Method::Continuous(_) => report.cross_validation.as_ref().is_some_and(|v| !v.is_refused),
            Method::SemiRigid(_) => true,
        };
        if self.fits_nowhere && (sharpened < SHARPENED || !is_validated) {
            warnings.push(
                "the trajectory makes the points no sharper than if the sensors had stood still: is it that of another \
                 recording, of another frame, or of another clock?"
                    .to_owned(),
            );
        }
        if let Some(share) = report.planar_fraction.filter(|share| *share < LEAST_PLANAR_SHARE) {
            warnings.push(format!(
                "only {:.0} % of the points lie on surfaces: is it the trajectory of this recording, of the frame \
                 the points are in, and of the same clock?",
                100.0 * share
            ));
        }
        let all = report.points_outside_trajectory + report.points;
        if report.points_outside_trajectory as f64 > OUTSIDE * all as f64 {
            let [start, end] = self.uncovered_ends;
            let gaps: f64 = report.gaps.iter().map(|g| g[1] - g[0]).sum();
            let mut parts = Vec::new();
            if start > 0.05 {
                parts.push(format!("begins {start:.1} s later"));
            }
            if end > 0.05 {
                parts.push(format!("ends {end:.1} s earlier"));
            }
            match report.gaps.len() {
                0 => {}
                1 => parts.push(format!("has a gap of {gaps:.1} s")),
                count => parts.push(format!("has {count} gaps of {gaps:.1} s together")),
            }
            warnings.push(format!(
                "the trajectory is shorter than the recording: {} of {all} points were not used; it {}",
                report.points_outside_trajectory,
                parts.join(", ")
            ));
        }
        for sensor in report.sensors.iter().filter(|s| s.empty_sweeps > 0) {
            warnings.push(format!(
                "{} of {} sweeps of {} are empty",
                sensor.empty_sweeps,
                sensor.sweeps + sensor.empty_sweeps,
                name(&sensor.name)
            ));
        }
        warnings.into_iter().for_each(|text| self.warn(text));
    }
}

fn name(sensor: &str) -> &str {
    if sensor.is_empty() { "the lidar" } else { sensor }
}
