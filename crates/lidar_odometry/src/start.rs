//! The start of a trajectory: hypotheses of the first motion, judged by the sweeps that follow.

use crate::initialise::{FirstSweeps, RotationAt, Start};
use crate::motion_state::MotionState;
use crate::settings::OdometrySettings;
use crate::sweep::Sweep;
use crate::tracker::Tracker;

/// Waiting for the first sweeps.
#[derive(Clone, Debug)]
pub(crate) struct FirstMotion {
    pub motion: MotionState,
    /// The most likely first; empty before the second sweep.
    hypotheses: Vec<Start>,
}

impl FirstMotion {
    pub fn new(motion: MotionState) -> Self {
        Self { motion, hypotheses: Vec::new() }
    }

    /// How everything was moving at the first of these sweeps; none if more sweeps have to come before that is clear.
    /// `is_ended`: no more will.
    pub fn decide(&mut self, settings: &OdometrySettings, sweeps: &[Sweep], is_ended: bool) -> Option<Start> {
        let (first, second) = (sweeps.first()?, sweeps.get(1));
        if second.is_none() && !is_ended {
            return None;
        }
        if self.hypotheses.is_empty() {
            let measured = self.motion.measured_rotation();
            let rotation_at = measured.as_ref().map(|measured| measured as &RotationAt);
            self.hypotheses = FirstSweeps::hypotheses(first, second, rotation_at, settings);
        }
        let judges = settings.initialisation.judged_sweeps;
        match self.hypotheses.as_slice() {
            [] => None,
            [only] => Some(*only),
            _ if sweeps.len() < judges && !is_ended => None,
            all => Some(self.best(settings, &sweeps[..sweeps.len().min(judges)], all)),
        }
    }

    /// The hypothesis that the sweeps fit best; one that fits the first two less well has to be clearly better, because along
    /// a tunnel all fit alike.
    fn best(&self, settings: &OdometrySettings, sweeps: &[Sweep], all: &[Start]) -> Start {
        let fits = all.iter().map(|start| (*start, self.fit_of(settings, sweeps, *start)));
        let best = fits.reduce(|best, other| {
            let is_better = other.1 > settings.initialisation.clearly_better * best.1;
            if is_better { other } else { best }
        });
        best.map_or(all[0], |(start, _)| start)
    }

    /// How well sweeps fit in all if they are tracked from this start.
    fn fit_of(&self, settings: &OdometrySettings, sweeps: &[Sweep], start: Start) -> f64 {
        let Some((first, others)) = sweeps.split_first() else { return 0.0 };
        let (tracker, _) = Tracker::begin(settings, self.motion.clone(), first.clone(), start);
        tracker.total_fit(None, others)
    }
}
