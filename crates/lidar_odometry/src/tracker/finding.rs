//! Finds the hypothesis of its motion under which a sweep fits best.

use super::Tracker;
use crate::issues::{Issue, Issues};
use crate::poles::{RecentPoles, SeenPoles};
use crate::predict::{Prediction, Reason, Registered};
use crate::remembered::{self, Finding};
use crate::sweep::Sweep;
use crate::sweep_registration::Target;
use crate::wide_search::WideSearch;

/// The hypothesis under which a sweep fits best.
pub(super) struct Found {
    pub best: Registered,
    /// Poles relative to the end of the sweep, if they are registered.
    pub poles: Option<SeenPoles>,
}

impl Tracker {
    /// Registers the hypotheses of the motion, and accepts the one that fits best. Where even that fits
    /// worse than the sweeps before, the platform may have moved differently than predicted, and a wide
    /// search follows. If an IMU measured the motion, there is none: something else is in front of the
    /// scanner then.
    pub(super) fn best_hypothesis(
        &mut self,
        sweep: &Sweep,
        prediction: &Prediction,
        issues: &mut Issues,
    ) -> Found {
        let found = self.best_prediction(sweep, prediction, issues);
        if prediction.is_measured_by_imu() || !self.fits.is_poor(&found.best.registered.sweep_fit()) {
            return found;
        }
        let map = self.local_map.older();
        let planes = map.planes.now();
        let search = WideSearch {
            settings: &self.settings,
            registration: &self.registration,
            target: &Target { local_from_map: &map.local_from_map, planes: &planes, poles: None },
            fits: &self.fits,
            before: &self.last_fitting,
        };
        let best = search.best(sweep, prediction, found.best);
        // Poles were extracted for the prediction.
        let poles = found.poles.filter(|_| best.reason != Some(Reason::OtherMotion));
        Found { best, poles }
    }

    /// The best one of the predicted hypotheses.
    fn best_prediction(&mut self, sweep: &Sweep, prediction: &Prediction, issues: &mut Issues) -> Found {
        let map = self.local_map.older();
        let question = self.memory.question(|question| {
            remembered::ask(&mut self.seen, sweep, &prediction.segment);
            question.add_word(self.seen.value());
        });
        let known = self.memory.recall(question);
        let to_register = if known.is_some() {
            None
        } else {
            self.poles.prepare(sweep, &prediction.segment, &map.local_from_map.inverse())
        };
        let registration = &self.registration;
        let Finding { sampled, reason, found } = known.unwrap_or_else(|| {
            let poles = to_register.as_ref();
            let sample = registration.sample(sweep);
            let planes = map.planes.now();
            let target = Target { local_from_map: &map.local_from_map, planes: &planes, poles };
            let best = prediction.best(|segment| registration.register(&sample, segment, &target));
            let (reason, found) = (best.reason, best.registered.found);
            let finding = Finding { sampled: sample.len() as u64, reason, found };
            self.memory.keep(question, &finding);
            finding
        });
        let segment = prediction.segment_of(reason).clone();
        let registered = registration.registered(&segment, &map.local_from_map, found);
        self.registration.adapt(sampled);
        self.registration.learn(&segment, &registered);
        if reason == Some(Reason::GyroscopeFails) {
            issues.count(Issue::GyroscopeOverruled);
        }
        let to_end = &registered.to_end;
        let poles = match to_register {
            Some(poles) => Some(poles.seen_from_end(to_end)),
            None if !RecentPoles::are_wanted(&prediction.segment) => None,
            None => Some(SeenPoles::unpicked(sweep, &prediction.segment, to_end)),
        };
        Found { best: Registered { segment, registered, reason }, poles }
    }
}
