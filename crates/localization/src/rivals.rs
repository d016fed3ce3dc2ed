//! Other hypotheses with which the accepted place is compared while it is tracked.

use portolan_geometry::Rigid3;

use crate::hypothesis::Hypothesis;
use crate::known_map::KnownMap;
use crate::search::Searcher;
use crate::settings::search::{BETTER_BY, BETTER_FIT, REFUTED_BY, RIVAL_LEAD, RIVAL_SCANS};

/// Another hypothesis about the pose of the scanner.
#[derive(Clone, Debug)]
struct Rival {
    place: Hypothesis,
    /// Number of scans kept since this place and the accepted one separated; none if they were never the
    /// same place.
    since: Option<usize>,
}

impl Rival {
    /// Lead in fit of the accepted place.
    fn behind(&self, accepted: &Hypothesis) -> f64 {
        accepted.lead_of_newest(&self.place, self.since.unwrap_or(usize::MAX))
    }

    fn is_refuted(&self, accepted: &Hypothesis) -> bool {
        match self.since {
            Some(scans) => {
                scans >= RIVAL_SCANS
                    && accepted.fit_of_newest(scans) >= BETTER_FIT
                    && self.behind(accepted) >= RIVAL_LEAD
            }
            None => self.behind(accepted) >= REFUTED_BY,
        }
    }

    fn is_uncertain(&self, accepted: &Hypothesis) -> bool {
        self.since.is_some() || self.behind(accepted) < 0.0
    }

    fn is_better(&self, accepted: &Hypothesis) -> bool {
        let scans = self.since.unwrap_or(usize::MAX);
        scans >= RIVAL_SCANS
            && self.place.fit() > BETTER_FIT
            && self.place.lead_of_newest(accepted, scans) > BETTER_BY
    }
}

/// Hypotheses that were not refuted when another one was accepted. They are tracked too, and judged by the
/// same scans.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rivals(Vec<Rival>);

impl Rivals {
    /// The candidates besides the accepted place.
    pub fn of(places: Vec<Hypothesis>) -> Self {
        Self(places.into_iter().map(|place| Rival { place, since: None }).collect())
    }

    /// Adds the pose from which the accepted place slipped away.
    pub fn add_left(&mut self, place: Hypothesis) {
        self.0.push(Rival { place, since: Some(0) });
    }

    /// Moves along with local SLAM.
    pub fn predict(&mut self, motion: &Rigid3, seconds: f64) {
        self.0.iter_mut().for_each(|rival| rival.place.predict(motion, seconds));
    }

    /// Matches a scan that is kept, and drops hypotheses that it refutes.
    pub fn match_scan<M: KnownMap>(
        &mut self,
        searcher: &Searcher<M>,
        scan: &M::Scan,
        oldest_left: bool,
        accepted: &Hypothesis,
    ) {
        searcher.match_scan(self.0.iter_mut().map(|rival| &mut rival.place), scan);
        for rival in &mut self.0 {
            rival.place.remember(oldest_left);
            rival.since = rival.since.map(|scans| scans + 1);
        }
        self.0.retain(|rival| !rival.place.is_same_place(accepted) && !rival.is_refuted(accepted));
    }

    /// Whether one of them makes the accepted place uncertain.
    pub fn is_uncertain(&self, accepted: &Hypothesis) -> bool {
        self.0.iter().any(|rival| rival.is_uncertain(accepted))
    }

    /// All of them, if one is better than the accepted place.
    pub fn take_over(&self, accepted: &Hypothesis) -> Option<Vec<Hypothesis>> {
        let is_beaten = self.0.iter().any(|rival| rival.is_better(accepted));
        is_beaten.then(|| self.0.iter().map(|rival| rival.place.clone()).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hypothesis::test_place;

    /// A place along x with these fits of scans, oldest first.
    #[test]
    fn a_place_that_was_left_is_a_rival_until_the_other_one_fits_and_leads() {
        let mut rivals = Rivals::default();
        let left = test_place(0.0, &[0.9, 0.9, 0.9, 0.2, 0.2, 0.2]);
        rivals.0.push(Rival { place: left.clone(), since: Some(3) });
        let poor = test_place(1.2, &[0.9, 0.9, 0.9, 0.4, 0.4, 0.4]);
        assert!(rivals.is_uncertain(&poor) && !rivals.0[0].is_refuted(&poor), "it leads, but does not fit");
        let good = test_place(1.2, &[0.9, 0.9, 0.9, 0.8, 0.8, 0.8]);
        assert!(rivals.0[0].is_refuted(&good));
        let just_now = Rival { place: left, since: Some(2) };
        assert!(!just_now.is_refuted(&good), "two scans are too few");
    }

    #[test]
    fn a_rival_with_a_better_recent_fit_makes_uncertain_and_takes_over_with_a_better_total_fit() {
        let accepted = test_place(0.0, &[0.8, 0.8, 0.8, 0.8, 0.5, 0.5, 0.5]);
        let entering = test_place(9.0, &[0.0, 0.0, 0.0, 0.2, 0.8, 0.8, 0.8]);
        let rivals = Rivals::of(vec![entering]);
        assert!(rivals.is_uncertain(&accepted) && rivals.take_over(&accepted).is_none());
        let worse = test_place(0.0, &[0.5, 0.5, 0.5, 0.5, 0.2, 0.2, 0.2]);
        let rivals = Rivals::of(vec![test_place(9.0, &[0.7; 7])]);
        assert_eq!(rivals.take_over(&worse).map(|places| places.len()), Some(1));
    }
}
