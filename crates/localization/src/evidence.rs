//! Tracks whether scans continue to support the place: combines their verdicts, with hysteresis and time
//! limits.

use portolan_geometry::Time;
use portolan_grids::ScanAgreement;

use crate::settings::evidence::{
    CONTRADICTING_FRACTION, LEAST_KNOWN_FRACTION, MAX_CHANGE_PER_SCAN, MOST_CONTRADICTED, QUESTIONED_SUPPORT,
    SCANS_TO_LOSE, SECONDS_TO_CONTRADICT, SECONDS_TO_SUPPORT, SECONDS_WITHOUT_VERDICT, SUPPORTING_FRACTION,
    SURE_SUPPORT, UNSURE_SUPPORT,
};

/// Verdict of a scan about a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    Supports,
    /// It neither fits well nor contradicts.
    Mixed,
    /// The map knows too little there.
    Unknown,
    Contradicts,
}

impl Verdict {
    pub fn of(agreement: &ScanAgreement) -> Self {
        let known = agreement.explained + agreement.contradicted();
        match agreement.contradiction() {
            _ if known < LEAST_KNOWN_FRACTION => Self::Unknown,
            c if c >= CONTRADICTING_FRACTION => Self::Contradicts,
            c if c <= MOST_CONTRADICTED && agreement.explained >= SUPPORTING_FRACTION => Self::Supports,
            _ => Self::Mixed,
        }
    }
}

/// Support for the place from recent scans, 0 to 1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Support {
    level: f64,
    is_sure: bool,
    /// Number of contradicting scans since the last supporting one, and the time of the first.
    against: Option<(u32, Time)>,
    last: Option<Time>,
}

impl Support {
    pub fn full() -> Self {
        Self { level: 1.0, is_sure: true, against: None, last: None }
    }

    pub fn add(&mut self, verdict: Verdict, time: Time) {
        let seconds = self.last.map_or(0.1, |last| time.seconds_since(last)).max(0.02);
        self.last = Some(time);
        let step = |whole: f64| (seconds / whole).min(MAX_CHANGE_PER_SCAN);
        self.level += match verdict {
            Verdict::Supports => step(SECONDS_TO_SUPPORT),
            Verdict::Mixed | Verdict::Unknown => -step(SECONDS_WITHOUT_VERDICT),
            Verdict::Contradicts => -step(SECONDS_TO_CONTRADICT),
        };
        self.level = self.level.clamp(0.0, 1.0);
        self.against = match (verdict, self.against) {
            (Verdict::Contradicts, Some((count, since))) => Some((count + 1, since)),
            (Verdict::Contradicts, None) => Some((1, time)),
            (Verdict::Supports, _) => None,
            (_, against) => against,
        };
        self.judge();
    }

    /// Lowers support so far that the place is no longer certain.
    pub fn lower_to_unsure(&mut self) {
        self.level = self.level.min(QUESTIONED_SUPPORT);
        self.judge();
    }

    fn judge(&mut self) {
        self.is_sure = if self.is_sure { self.level >= UNSURE_SUPPORT } else { self.level >= SURE_SUPPORT };
    }

    pub fn is_sure(&self) -> bool {
        self.is_sure
    }

    /// Time since which scans contradict the place, if they have done so long enough to lose it.
    pub fn contradicted_since(&self) -> Option<Time> {
        self.against.filter(|(count, _)| self.level <= 0.0 && *count >= SCANS_TO_LOSE).map(|(_, since)| since)
    }

    pub fn is_contradicted(&self) -> bool {
        self.against.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Duration;

    fn at(seconds: f64) -> Time {
        Time::from_ticks(0) + Duration::from_seconds(seconds)
    }

    #[test]
    fn a_wrong_place_is_left_within_bounds_of_time() {
        let mut support = Support::full();
        let (mut unsure, mut lost) = (None, None);
        for i in 0..60 {
            support.add(Verdict::Contradicts, at(0.1 * f64::from(i)));
            unsure = unsure.or((!support.is_sure()).then_some(i));
            lost = lost.or(support.contradicted_since().map(|_| i));
        }
        assert!(unsure.is_some_and(|i| (5..=11).contains(&i)), "{unsure:?}");
        assert!(lost.is_some_and(|i| (12..=20).contains(&i)), "{lost:?}");
        assert_eq!(support.contradicted_since(), Some(at(0.0)));
    }

    #[test]
    fn sparse_scans_count_as_scans_and_a_door_is_no_loss() {
        let mut support = Support::full();
        (0..4).for_each(|i| support.add(Verdict::Contradicts, at(60.0 * f64::from(i))));
        assert!(support.contradicted_since().is_none() && !support.is_sure());
        let mut support = Support::full();
        (0..5).for_each(|i| support.add(Verdict::Contradicts, at(0.1 * f64::from(i))));
        assert!(support.is_sure());
        support.add(Verdict::Supports, at(0.5));
        assert!(!support.is_contradicted());
    }

    #[test]
    fn support_becomes_sure_at_a_higher_level_than_unsure() {
        let mut support = Support::full();
        support.lower_to_unsure();
        assert!(!support.is_sure());
        let back = (1..40).find(|i| {
            support.add(Verdict::Supports, at(0.1 * f64::from(*i)));
            support.is_sure()
        });
        assert!(back.is_some_and(|i| (4..=8).contains(&i)), "{back:?}");
    }
}
