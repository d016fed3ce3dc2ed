//! Agreement of the scans of a recording with the map at their own poses, and limits for loop closures
//! derived from it.
//!
//! Sparse scans metres apart, noisy scans and scans with missing readings make thin walls, of which even a
//! scan at its correct pose explains fewer. Loop closures are therefore measured against what local SLAM
//! reaches in the same recording.

use portolan_grids::ScanAgreement;

/// Fractions at wrong poses.
pub const AT_WRONG_PLACES: Shares = Shares { explained: 0.25, contradiction: 0.5 };
/// Fractions at correct poses, in the recordings that the limits were chosen for.
pub const AT_RIGHT_PLACES: Shares = Shares { explained: 0.8, contradiction: 1.0 / 12.0 };
/// Weight of the expected agreement, in scans: after this number of scans the measured agreement counts as
/// much.
const EXPECTED_SCANS: f32 = 10.0;
/// Fraction of its beams that the map must know for a scan to count.
const KNOWN: f32 = 0.5;

/// Fractions of the beams of a scan by agreement with the map.
#[derive(Clone, Copy, Debug)]
pub struct Shares {
    /// Explained beams, of all beams.
    pub explained: f32,
    /// Contradicting beams, of those in known cells.
    pub contradiction: f32,
}

/// Criteria to accept a match in a submap, besides its score. A mean probability depends on how often the
/// cells of the submap were seen; the fractions of explained and of contradicting beams do not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchAcceptance {
    /// Minimum fraction of beams that end at a surface of the submap.
    pub min_explained: f32,
    /// Maximum fraction of contradicting beams among those in known cells.
    pub max_contradiction: f32,
}

impl Default for MatchAcceptance {
    fn default() -> Self {
        Self { min_explained: 0.0, max_contradiction: 1.0 }
    }
}

impl MatchAcceptance {
    /// Whether to accept a match; one without agreement to judge it by is accepted.
    pub fn accepts(&self, agreement: Option<ScanAgreement>) -> bool {
        agreement
            .is_none_or(|a| a.explained >= self.min_explained && a.contradiction() <= self.max_contradiction)
    }
}

/// Mean fractions over the scans of a recording, each compared with the map without it.
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
    /// Adds the agreement of the map with one more scan.
    pub fn add(&mut self, agreement: &ScanAgreement) {
        if agreement.explained + agreement.contradicted() < KNOWN {
            return;
        }
        self.scans += 1.0;
        self.mean.explained += (agreement.explained - self.mean.explained) / self.scans;
        self.mean.contradiction += (agreement.contradiction() - self.mean.contradiction) / self.scans;
    }

    /// Whether the agreement of a scan is closer to that of wrong poses than to that of the scans of this
    /// recording at their poses.
    pub fn looks_wrong(&self, agreement: &ScanAgreement) -> bool {
        let wrong = AT_WRONG_PLACES;
        agreement.explained < (wrong.explained + self.mean.explained) / 2.0
            && agreement.contradiction() > (wrong.contradiction + self.mean.contradiction) / 2.0
    }

    /// Limits for this recording: the wanted ones, interpolated to its fractions at wrong and correct
    /// poses instead of those of the recordings that they were chosen for. They are never stricter than
    /// wanted.
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
    fn limits_follow_the_agreement_of_the_recording_up_to_those_wanted() {
        assert_eq!(after(0, 0.0, 0.0), WANTED);
        assert_eq!(after(500, 0.95, 0.03), WANTED);
        let noisy = after(500, 0.55, 0.2);
        assert!((0.42..0.5).contains(&noisy.min_explained), "{noisy:?}");
        assert!((0.28..0.34).contains(&noisy.max_contradiction), "{noisy:?}");
    }

    #[test]
    fn scans_of_new_or_wrong_places_hardly_relax_the_limits() {
        assert_eq!(after(500, 0.1, 0.1), WANTED);
        let hopeless = after(500, 0.1, 0.9);
        assert!(hopeless.min_explained > 0.24 && hopeless.max_contradiction < 0.51, "{hopeless:?}");
    }

    #[test]
    fn limits_that_accept_everything_are_kept() {
        let any = MatchAcceptance::default();
        assert_eq!(UsualAgreement::default().acceptance(any), any);
    }
}
