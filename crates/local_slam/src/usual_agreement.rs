//! How scans of a recording agree with the map where they were taken, and what loop closures have to be like by that measure.
//!
//! Scans that are metres apart, noisy ones and those in which readings are missing draw thin walls, of which even a scan in
//! its right place explains less. Loop closures are measured by what local SLAM reaches on the way.

use portolan_grids::ScanAgreement;

/// At a wrong place this share of the beams is explained, and this share of what is known is contradicted …
pub const AT_WRONG_PLACES: Shares = Shares { explained: 0.25, contradiction: 0.5 };
/// … and at a right one, in recordings that the limits were chosen for.
pub const AT_RIGHT_PLACES: Shares = Shares { explained: 0.8, contradiction: 1.0 / 12.0 };
/// What was measured counts as much as what is expected after so many scans.
const EXPECTED_SCANS: f32 = 10.0;
/// A scan says something if the map knows this share of its beams.
const KNOWN: f32 = 0.5;

/// How a map agrees with a scan.
#[derive(Clone, Copy, Debug)]
pub struct Shares {
    /// Of all beams.
    pub explained: f32,
    /// Of the beams about which the map knows something.
    pub contradiction: f32,
}

/// What a match in a submap has to be like to be believed, besides its score. A mean probability depends on how
/// often the cells of the submap were seen; how many beams it explains and contradicts does not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchAcceptance {
    /// Least fraction of beams that must end at something that the submap knows.
    pub min_explained: f32,
    /// Largest fraction of beams that contradict the submap in all about which it knows something.
    pub max_contradiction: f32,
}

impl Default for MatchAcceptance {
    fn default() -> Self {
        Self { min_explained: 0.0, max_contradiction: 1.0 }
    }
}

impl MatchAcceptance {
    /// Whether to believe a match; one that cannot be judged is believed.
    pub fn accepts(&self, agreement: Option<ScanAgreement>) -> bool {
        agreement
            .is_none_or(|a| a.explained >= self.min_explained && a.contradiction() <= self.max_contradiction)
    }
}

/// Means over the scans of a recording, each compared with the map without it.
#[derive(Clone, Copy, Debug)]
pub struct UsualAgreement {
    scans: f32,
    mean: Shares,
}

impl Default for UsualAgreement {
    fn default() -> Self {
        Self { scans: EXPECTED_SCANS, mean: AT_RIGHT_PLACES }
    }
}

impl UsualAgreement {
    /// Takes how the map agreed with one more scan.
    pub fn add(&mut self, agreement: &ScanAgreement) {
        if agreement.explained + agreement.contradicted() < KNOWN {
            return;
        }
        self.scans += 1.0;
        self.mean.explained += (agreement.explained - self.mean.explained) / self.scans;
        self.mean.contradiction += (agreement.contradiction() - self.mean.contradiction) / self.scans;
    }

    /// Whether a scan agrees with the map less as scans of this recording do at their places than as scans do at wrong ones.
    pub fn looks_wrong(&self, agreement: &ScanAgreement) -> bool {
        let wrong = AT_WRONG_PLACES;
        agreement.explained < (wrong.explained + self.mean.explained) / 2.0
            && agreement.contradiction() > (wrong.contradiction + self.mean.contradiction) / 2.0
    }

    /// Limits that lie between wrong and right places of this recording as the wanted ones do between those of the
    /// recordings that they were chosen for; never stricter than wanted.
    pub fn acceptance(&self, wanted: MatchAcceptance) -> MatchAcceptance {
        let (wrong, right) = (AT_WRONG_PLACES, AT_RIGHT_PLACES);
        let explained = (self.mean.explained - wrong.explained) / (right.explained - wrong.explained);
        let contradiction =
            (wrong.contradiction - self.mean.contradiction) / (wrong.contradiction - right.contradiction);
        let between = |wrong: f32, share: f32, wanted: f32| wrong + share.max(0.0) * (wanted - wrong);
        MatchAcceptance {
            min_explained: between(wrong.explained, explained, wanted.min_explained)
                .min(wanted.min_explained),
            max_contradiction: between(wrong.contradiction, contradiction, wanted.max_contradiction)
                .max(wanted.max_contradiction),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WANTED: MatchAcceptance = MatchAcceptance { min_explained: 0.65, max_contradiction: 0.15 };

    fn after(scans: usize, explained: f32, in_free_space: f32) -> MatchAcceptance {
        let mut usual = UsualAgreement::default();
        let agreement = ScanAgreement { explained, in_free_space, through_solid: 0.0 };
        (0..scans).for_each(|_| usual.add(&agreement));
        usual.acceptance(WANTED)
    }

    #[test]
    fn limits_follow_what_the_recording_reaches_and_are_never_stricter_than_wanted() {
        assert_eq!(after(0, 0.0, 0.0), WANTED);
        assert_eq!(after(500, 0.95, 0.03), WANTED);
        let noisy = after(500, 0.55, 0.2);
        assert!((0.42..0.5).contains(&noisy.min_explained), "{noisy:?}");
        assert!((0.28..0.34).contains(&noisy.max_contradiction), "{noisy:?}");
    }

    #[test]
    fn scans_of_new_places_and_of_nothing_do_not_open_the_door() {
        assert_eq!(after(500, 0.1, 0.1), WANTED);
        let hopeless = after(500, 0.1, 0.9);
        assert!(hopeless.min_explained > 0.24 && hopeless.max_contradiction < 0.51, "{hopeless:?}");
    }

    #[test]
    fn where_everything_is_accepted_it_stays_so() {
        let any = MatchAcceptance::default();
        assert_eq!(UsualAgreement::default().acceptance(any), any);
    }
}
