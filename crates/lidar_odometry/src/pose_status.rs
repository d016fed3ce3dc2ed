//! Detects that the pose is lost: sweeps fit the map far worse than those before them did, or they fit
//! nothing while no sensor measures the motion.
//!
//! The expected fit of a sweep is that of the sweeps before it, since surroundings change slowly from one
//! to the next. A sweep of another place is on planes by chance alone: fewer points are, and those are
//! spread over the whole width of the loss. A sweep that sees something new through a door has fewer
//! points on planes, too, but they are close to the planes.

use std::collections::VecDeque;

use portolan_geometry::Time;
use portolan_numeric::median;

use crate::settings::LossSettings;

/// State of trust in the pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum PoseStatus {
    /// Sweeps fit the map.
    #[default]
    Confirmed,
    /// Sweeps have contradicted the map. They are not inserted.
    Suspect {
        /// End of the first one.
        since: Time,
        /// Number of these sweeps.
        sweeps: usize,
    },
    /// The pose is lost.
    Lost {
        /// End of the first sweep that contradicted the map.
        since: Time,
    },
}

/// Fit of a sweep to planes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SweepFit {
    /// Fraction of the points on planes, reduced by their distance from them; 0 where it does not fit.
    pub fit: f64,
    /// Root mean square distance of points from their planes, metres; none where it does not fit.
    pub rms: Option<f64>,
}

/// Measurements that support the pose at the end of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Support {
    pub fit: SweepFit,
    /// Whether odometry, an accelerometer, a zero-velocity update or another map measures the motion.
    pub is_measured: bool,
}

impl Support {
    /// Whether the pose is unmeasured: constant velocity is assumed.
    fn is_guess(&self) -> bool {
        self.fit.rms.is_none() && !self.is_measured
    }
}

/// Compares each sweep with those before it.
#[derive(Clone, Debug)]
pub(crate) struct FitMonitor {
    settings: LossSettings,
    /// Fits of the last sweeps that fitted.
    recent: VecDeque<SweepFit>,
    /// Which of the last sweeps were guesses.
    guesses: VecDeque<bool>,
    status: PoseStatus,
}

impl FitMonitor {
    pub fn new(settings: &LossSettings) -> Self {
        let (recent, guesses) = (VecDeque::new(), VecDeque::new());
        Self { settings: settings.clone(), recent, guesses, status: PoseStatus::Confirmed }
    }

    /// State after one more sweep. A map that is warming up fits whatever it was made of: there is no
    /// usual fit yet.
    pub fn after(&mut self, end: Time, support: Support, is_warming_up: bool) -> PoseStatus {
        let is_chance = self.is_chance(&support);
        if is_warming_up && !is_chance {
            self.status = PoseStatus::Confirmed;
            return self.status;
        }
        let settings = &self.settings;
        let contradicts = is_chance || self.is_poor(&support.fit);
        self.status = match (contradicts, self.status) {
            (false, _) => PoseStatus::Confirmed,
            (true, PoseStatus::Suspect { since, sweeps })
                if 2 * (sweeps + 1) >= settings.sweeps && end.seconds_since(since) >= settings.seconds =>
            {
                PoseStatus::Lost { since }
            }
            (true, PoseStatus::Suspect { since, sweeps }) => {
                PoseStatus::Suspect { since, sweeps: sweeps + 1 }
            }
            (true, _) => PoseStatus::Suspect { since: end, sweeps: 1 },
        };
        if self.status == PoseStatus::Confirmed {
            self.recent.push_back(support.fit);
            if self.recent.len() > 2 * settings.sweeps {
                self.recent.pop_front();
            }
        }
        self.status
    }

    /// Whether so many of the last sweeps were guesses that one that fits does so by chance. A few guesses
    /// do not count: sparse sweeps have to be accumulated before there are planes.
    fn is_chance(&mut self, support: &Support) -> bool {
        self.guesses.push_back(support.is_guess());
        if self.guesses.len() > self.settings.sweeps {
            self.guesses.pop_front();
        }
        let guesses = self.guesses.iter().filter(|guess| **guess).count();
        2 * guesses > self.settings.sweeps
    }

    /// Whether a sweep with this fit sees mostly surroundings that are not in the map.
    pub fn is_mostly_new(&self, fit: f64) -> bool {
        let usual_fit = median(&mut self.recent.iter().map(|f| f.fit).collect::<Vec<f64>>());
        usual_fit.is_some_and(|usual_fit| fit < self.settings.poor_fit_ratio * usual_fit)
    }

    /// Whether a sweep contradicts the map: it fits much worse than those before it, and its points are
    /// off the planes. It moved differently than predicted, or is elsewhere.
    pub fn is_poor(&self, fit: &SweepFit) -> bool {
        let settings = &self.settings;
        if self.recent.len() < settings.sweeps {
            return false;
        }
        let usual_fit = median(&mut self.recent.iter().map(|f| f.fit).collect::<Vec<f64>>());
        let usual_rms = median(&mut self.recent.iter().filter_map(|f| f.rms).collect::<Vec<f64>>());
        let (Some(usual_fit), Some(usual_rms)) = (usual_fit, usual_rms) else { return false };
        let is_off_planes = fit.rms.is_none_or(|rms| rms > settings.poor_rms_ratio * usual_rms);
        usual_fit >= settings.least_usual_fit
            && fit.fit < settings.poor_fit_ratio * usual_fit
            && is_off_planes
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::Duration;

    use super::*;

    /// State after sweeps with these fits, ten a second.
    fn statuses_after(fits: &[(f64, f64)]) -> Vec<PoseStatus> {
        let mut monitor = FitMonitor::new(&LossSettings::default());
        let at = |i: usize| Time::from_ticks(0) + Duration::from_seconds(0.1 * i as f64);
        let fit = |&(fit, rms): &(f64, f64)| SweepFit { fit, rms: (rms > 0.0).then_some(rms) };
        let support = |f| Support { fit: fit(f), is_measured: true };
        fits.iter().enumerate().map(|(i, f)| monitor.after(at(i), support(f), false)).collect()
    }

    #[test]
    fn a_second_of_sweeps_of_another_place_is_a_loss() {
        for elsewhere in [(0.08, 0.13), (0.0, 0.0)] {
            let statuses = statuses_after(&[&[(0.4, 0.065); 20][..], &[elsewhere; 12]].concat());
            assert!(statuses[..20].iter().all(|b| *b == PoseStatus::Confirmed), "{statuses:?}");
            let since = Time::from_ticks(20_000_000);
            assert_eq!(statuses[20], PoseStatus::Suspect { since, sweeps: 1 });
            assert_eq!(statuses[29], PoseStatus::Suspect { since, sweeps: 10 });
            assert_eq!(statuses[30], PoseStatus::Lost { since });
        }
    }

    #[test]
    fn doors_single_sweeps_and_open_country_are_no_loss() {
        let sure = |fits: &[(f64, f64)]| statuses_after(fits).iter().all(|b| *b == PoseStatus::Confirmed);
        // A new room: few points on planes, but close to them.
        assert!(sure(&[&[(0.5, 0.03); 20][..], &[(0.15, 0.04); 30]].concat()));
        // Among trees there are hardly any planes.
        assert!(sure(&[&[(0.08, 0.09); 20][..], &[(0.0, 0.0); 30]].concat()));
        // At the beginning there is no usual fit.
        assert!(sure(&[&[(0.5, 0.03); 5][..], &[(0.05, 0.13); 30]].concat()[..7]));
        let statuses =
            statuses_after(&[&[(0.4, 0.065); 20][..], &[(0.05, 0.13); 9], &[(0.4, 0.065); 2]].concat());
        assert!(statuses.iter().all(|b| !matches!(b, PoseStatus::Lost { .. })));
        assert_eq!(statuses[29..], [PoseStatus::Confirmed; 2]);
    }

    #[test]
    fn a_second_of_unmeasured_motion_is_a_loss() {
        let statuses =
            |is_measured: bool, is_warming_up: bool, fits_at: fn(usize) -> bool| -> Vec<PoseStatus> {
                let mut monitor = FitMonitor::new(&LossSettings::default());
                let at = |i: usize| Time::from_ticks(0) + Duration::from_seconds(0.1 * i as f64);
                let support = |i| {
                    let fits = fits_at(i);
                    let fit = SweepFit { fit: if fits { 0.1 } else { 0.0 }, rms: fits.then_some(0.1) };
                    Support { fit, is_measured }
                };
                (0..60).map(|i| monitor.after(at(i), support(i), is_warming_up)).collect()
            };
        let is_lost = |statuses: &[PoseStatus]| statuses.iter().any(|b| matches!(b, PoseStatus::Lost { .. }));
        for is_warming_up in [false, true] {
            assert!(is_lost(&statuses(false, is_warming_up, |_| false)));
            // Now and then one fits, by chance.
            assert!(is_lost(&statuses(false, is_warming_up, |i| i % 3 == 0)));
            assert!(!is_lost(&statuses(false, is_warming_up, |i| i % 8 != 0)));
            assert!(!is_lost(&statuses(true, is_warming_up, |_| false)));
        }
    }
}
