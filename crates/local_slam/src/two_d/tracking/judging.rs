//! Hypotheses of the pose of a scan, and the decision between them.

use portolan_geometry::Rigid2;
use portolan_grids::scan_agreement;
use portolan_sensor::PointCloud;
use portolan_submaps::{ScanMatch2d, SearchWindow};

use super::super::hypotheses::{Basis, Hypothesis, Judgement};
use super::super::motion::{Motion, wide_window};
use super::super::pose_status::{is_hardly_explained, refutes_place};
use super::super::posterior::MotionPrior;
use super::super::scan::Scan;
use super::super::unknown_motion::UnknownMotion;
use super::{Tracker, is_elsewhere};

impl Tracker {
    /// The match near the prediction, or a likelier pose: the prediction itself, or, where a better match
    /// is expected elsewhere, the match within the range that the scanner can have moved.
    pub(super) fn judged(
        &self,
        near: &Hypothesis,
        motion: Motion,
        (scan, cloud): (&Scan, &PointCloud),
        window: SearchWindow,
    ) -> (ScanMatch2d, Judgement) {
        let found = near.found;
        let agreement = scan_agreement(&scan.submap.grid, &found.pose, scan.cloud);
        let is_low = found.score.is_some_and(|score| self.usual_score.is_low(score));
        let is_wrong = agreement
            .as_ref()
            .is_some_and(|a| refutes_place(a) || !motion.is_measured() && self.looks_wrong(a));
        let is_sought = self.limit.is_none() && (is_low || is_wrong || near.is_at_edge(window));
        if let (true, true, Some(constant_velocity)) = (is_sought, motion.is_unknown(), near.otherwise) {
            return self.judged_unknown(near, constant_velocity, motion, (scan, cloud));
        }
        let wide = is_sought.then(|| self.search_wide((scan, cloud), near, wide_window(window, motion)));
        let prior = self.prior(near.around, motion);
        let is_questionable = scan.independent_measurements.are_few()
            && is_elsewhere(&(near.around.inverse() * found.pose))
            || agreement.as_ref().is_some_and(is_hardly_explained);
        if wide.is_none() && !is_questionable {
            return (found, Judgement::Near);
        }
        // A prediction without measurement is not independent evidence.
        let predicted = motion.is_measured().then_some(near.around);
        match (self.most_likely(&prior, [predicted, Some(found.pose), wide.map(|w| w.pose)], scan), wide) {
            (Some(0), _) => (ScanMatch2d { pose: near.around, ..found }, Judgement::Predicted),
            (Some(2), Some(wide)) => (wide, Judgement::Far),
            _ => (found, Judgement::Near),
        }
    }

    /// The likeliest match after a time without measurements: near the last pose, near the
    /// constant-velocity prediction, or in a wide window around either.
    fn judged_unknown(
        &self,
        stopped: &Hypothesis,
        constant_velocity: Rigid2,
        motion: Motion,
        (scan, cloud): (&Scan, &PointCloud),
    ) -> (ScanMatch2d, Judgement) {
        let window = self.window(&motion, &constant_velocity);
        let far = wide_window(window, motion);
        let searched = [(constant_velocity, window), (stopped.around, far), (constant_velocity, far)];
        let prior = UnknownMotion::new(&motion, stopped.around, constant_velocity);
        let likely = |found: &ScanMatch2d| {
            let agreement = scan_agreement(&scan.submap.grid, &found.pose, scan.cloud)?;
            let beams = self.beam_evidence.log_likelihood(&agreement, scan.independent_measurements);
            Some(prior.log_density(&found.pose) + beams)
        };
        let mut best = (stopped.found, Judgement::Near);
        for (around, window) in searched {
            let found = self.search((scan, cloud), around, window);
            if found.pose.is_finite() && likely(&found) > likely(&best.0) {
                best = (found, Judgement::Far);
            }
        }
        best
    }

    /// The best match in a wide window around the prediction, or around its alternative.
    fn search_wide(
        &self,
        scan: (&Scan, &PointCloud),
        near: &Hypothesis,
        window: SearchWindow,
    ) -> ScanMatch2d {
        let found = self.search(scan, near.around, window);
        match near.otherwise.map(|otherwise| self.search(scan, otherwise, window)) {
            Some(other) if other.score > found.score => other,
            _ => found,
        }
    }

    /// Index of the likeliest pose, the first of equal ones; none if the grid is a distance field.
    fn most_likely(&self, prior: &MotionPrior, poses: [Option<Rigid2>; 3], scan: &Scan) -> Option<usize> {
        let mut best: Option<(usize, f64)> = None;
        for (i, pose) in poses.into_iter().enumerate() {
            let Some(pose) = pose.filter(Rigid2::is_finite) else { continue };
            let agreement = scan_agreement(&scan.submap.grid, &pose, scan.cloud)?;
            let likely =
                prior.log_posterior(&pose, &agreement, (&self.beam_evidence, scan.independent_measurements));
            if best.is_none_or(|(_, most)| likely > most) {
                best = Some((i, likely));
            }
        }
        best.map(|(i, _)| i)
    }

    /// The best match over the hypotheses of the motion. Where odometry measured it: odometry works, it
    /// lagged and has caught up, or it fails and the velocity is constant. Elsewhere: the velocity is
    /// constant, or, after a long time without measurements, the scanner stopped.
    pub(super) fn search_hypotheses(
        &mut self,
        [prediction, constant_velocity]: [Rigid2; 2],
        motion: Motion,
        scan: (&Scan, &PointCloud),
        window: SearchWindow,
    ) -> Hypothesis {
        let around = |around, basis| Hypothesis {
            around,
            found: self.search(scan, around, window),
            basis,
            otherwise: None,
        };
        if !motion.is_measured() {
            let predicted = around(prediction, Basis::ConstantVelocity);
            if motion.is_unknown() {
                return Hypothesis { otherwise: Some(constant_velocity), ..predicted };
            }
            if motion.seconds <= self.gap {
                return predicted;
            }
            let stopped = around(motion.last, Basis::ConstantVelocity);
            return if stopped.found.score > predicted.found.score { stopped } else { predicted };
        }
        let predicted = around(prediction, Basis::Measured);
        let caught_up = self.catching_up.after(&motion.to(&prediction), motion.seconds);
        let caught_up = caught_up.map(|caught_up| around(caught_up, Basis::CaughtUp));
        let (measured, prior) = self.likelier(predicted, caught_up, motion, scan.0);
        let Some((constant_velocity, log_odds)) = self.odometry_failure.add_measured(motion, &prior) else {
            return measured;
        };
        let found =
            self.search(scan, constant_velocity.prediction, self.window_of(&constant_velocity.sigmas));
        let other = Hypothesis {
            around: constant_velocity.prediction,
            found,
            basis: Basis::ConstantVelocity,
            otherwise: None,
        };
        let likely = |prior, hypothesis| self.likely(prior, hypothesis, scan.0);
        let (Some(works), Some(fails)) = (likely(&prior, &measured), likely(&constant_velocity, &other))
        else {
            return measured;
        };
        if self.odometry_failure.fails(log_odds + fails - works) { other } else { measured }
    }

    /// The likelier one of the pose by odometry and that by odometry that has caught up, with its prior.
    fn likelier(
        &self,
        predicted: Hypothesis,
        caught_up: Option<Hypothesis>,
        motion: Motion,
        scan: &Scan,
    ) -> (Hypothesis, MotionPrior) {
        let prior = self.prior(predicted.around, motion);
        let Some(caught_up) = caught_up else { return (predicted, prior) };
        let other = MotionPrior { prediction: caught_up.around, ..prior };
        match (self.likely(&prior, &predicted, scan), self.likely(&other, &caught_up, scan)) {
            (Some(as_predicted), Some(later)) if later > as_predicted => {
                (Hypothesis { otherwise: Some(predicted.around), ..caught_up }, other)
            }
            _ => (predicted, prior),
        }
    }

    /// Log-posterior of a match, up to a constant; none if the grid is a distance field.
    fn likely(&self, prior: &MotionPrior, hypothesis: &Hypothesis, scan: &Scan) -> Option<f64> {
        let pose = hypothesis.found.pose;
        let agreement = scan_agreement(&scan.submap.grid, &pose, scan.cloud)?;
        Some(prior.log_posterior(&pose, &agreement, (&self.beam_evidence, scan.independent_measurements)))
    }
}
