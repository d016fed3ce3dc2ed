//! Detects that the pose is lost: scans contradict the map for longer than people and doors explain.

use portolan_geometry::Time;
use portolan_grids::ScanAgreement;

/// Fraction of all beams that contradict the map from which on a scan does not fit: more than people and
/// doors explain, and less than scans of another place reach (docs/experiments/2026-11-lost-and-late.md).
const CONTRADICTED: f32 = 0.4;
/// The same limit where odometry measured the motion, with a maximum fraction of explained beams, and a
/// minimum fraction of beams that pass through walls. People and moved objects hide walls, but no beam
/// passes through one (docs/experiments/2026-11-carried-2d.md).
const CONTRADICTED_WITH_ODOMETRY: f32 = 0.35;
const EXPLAINED: f32 = 0.4;
const THROUGH_WALLS: f32 = 0.05;
/// Minimum number of contradicting scans in a row, and their minimum duration, seconds, for the pose to be
/// lost.
const SCANS: u32 = 5;
const SECONDS: f64 = 1.0;

/// Agreement of the map with a scan at its match.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    pub agreement: ScanAgreement,
    /// Whether odometry measured the motion to this pose.
    pub is_measured: bool,
    /// Whether the agreement is closer to that of wrong poses than to that of correct ones in this
    /// recording.
    pub looks_wrong: bool,
}

impl Fit {
    /// Whether it does not confirm a guess: it looks wrong or, where the motion was unmeasured, most of
    /// the scan is unknown to the map.
    pub fn is_poor(&self) -> bool {
        self.looks_wrong || !self.is_measured && is_hardly_explained(&self.agreement)
    }
}

/// State of trust in the pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum PoseStatus {
    /// Scans fit the map.
    #[default]
    Confirmed,
    /// Scans have contradicted the map since then. They are not inserted.
    Suspect {
        /// Time of the first one.
        since: Time,
        /// Number of these scans.
        scans: u32,
        /// Whether the pose of the first one is a guess: it fits badly, and only far from its pose by
        /// odometry or after a time without measurements. The scanner may be at a place outside the map.
        is_elsewhere: bool,
    },
    /// The pose is lost.
    Lost {
        /// Time of the first contradicting scan.
        since: Time,
    },
}

impl PoseStatus {
    /// State after one more scan, with its agreement with the map; none if there is no map to compare
    /// with.
    pub fn after(self, time: Time, fit: Option<Fit>) -> Self {
        match fit.is_some_and(|fit| self.is_contradicted_by(&fit)) {
            true => self.after_contradiction(time, false),
            false => Self::Confirmed,
        }
    }

    /// State after one more scan that fits badly even at its best match, and only far from its pose by
    /// odometry or after a time without measurements: none of the searched poses is correct then.
    pub fn after_guess(self, time: Time) -> Self {
        self.after_contradiction(time, true)
    }

    fn after_contradiction(self, time: Time, is_guess: bool) -> Self {
        let (since, scans, is_elsewhere) = match self {
            Self::Suspect { since, scans, is_elsewhere } => (since, scans + 1, is_elsewhere),
            Self::Confirmed | Self::Lost { .. } => (time, 1, is_guess),
        };
        if scans >= SCANS && time.seconds_since(since) >= SECONDS {
            return Self::Lost { since };
        }
        Self::Suspect { since, scans, is_elsewhere }
    }

    /// Whether a scan does not fit. Where odometry measured the motion more evidence is needed: scans of a
    /// new room may contradict what was seen of it through a door, and those among people contradict
    /// everything; odometry bridges them.
    fn is_contradicted_by(self, fit: &Fit) -> bool {
        let Fit { agreement, is_measured, .. } = fit;
        let is_guess = matches!(self, Self::Suspect { is_elsewhere: true, .. });
        let fits_nothing = match self {
            _ if !is_measured => agreement.contradicted() >= CONTRADICTED,
            Self::Suspect { .. } => fits_badly(agreement),
            Self::Confirmed | Self::Lost { .. } => refutes_place(agreement),
        };
        fits_nothing || is_guess && fit.is_poor()
    }
}

/// Whether so few beams are explained that the map does not constrain the pose of the scan.
pub(super) fn is_hardly_explained(agreement: &ScanAgreement) -> bool {
    agreement.explained < EXPLAINED
}

fn fits_badly(agreement: &ScanAgreement) -> bool {
    agreement.contradicted() >= CONTRADICTED_WITH_ODOMETRY && is_hardly_explained(agreement)
}

/// Whether the map shows that the scan was not taken at this pose, whatever moved meanwhile.
pub fn refutes_place(agreement: &ScanAgreement) -> bool {
    fits_badly(agreement) && agreement.through_solid >= THROUGH_WALLS
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(agreement: Option<ScanAgreement>, is_measured: bool, looks_wrong: bool) -> Option<Fit> {
        agreement.map(|agreement| Fit { agreement, is_measured, looks_wrong })
    }

    #[test]
    fn a_door_is_no_loss_and_a_second_of_another_place_is_one() {
        let agreement = |explained: f32| {
            Some(ScanAgreement { explained, in_free_space: 0.9 - explained, through_solid: 0.0 })
        };
        let at = |i: i64| Time::from_ticks(2_000_000 * i);
        let mut status = PoseStatus::Confirmed;
        for i in 0..4 {
            status = status.after(at(i), fit(agreement(0.1), false, false));
        }
        assert_eq!(status, PoseStatus::Suspect { since: at(0), scans: 4, is_elsewhere: false });
        assert_eq!(status.after(at(4), fit(agreement(0.8), false, false)), PoseStatus::Confirmed);
        assert_eq!(status.after(at(4), fit(None, false, false)), PoseStatus::Confirmed);
        status = status.after(at(4), fit(agreement(0.1), false, false));
        assert_eq!(status, PoseStatus::Suspect { since: at(0), scans: 5, is_elsewhere: false });
        assert_eq!(status.after(at(5), fit(agreement(0.1), false, false)), PoseStatus::Lost { since: at(0) });
    }

    #[test]
    fn a_guessed_pose_needs_scans_that_fit() {
        let at = |i: i64| Time::from_ticks(2_000_000 * i);
        let agreement = |explained| Some(ScanAgreement { explained, in_free_space: 0.3, through_solid: 0.1 });
        let mut status = PoseStatus::Confirmed.after_guess(at(0));
        assert_eq!(status, PoseStatus::Suspect { since: at(0), scans: 1, is_elsewhere: true });
        assert_eq!(status.after(at(1), fit(agreement(0.6), true, false)), PoseStatus::Confirmed);
        for i in 1..=5 {
            status = status.after(at(i), fit(agreement(0.45), true, true));
        }
        assert_eq!(status, PoseStatus::Lost { since: at(0) });
        // The same where the motion was unmeasured, or most of the scan is new.
        let status_after = |explained: f32, looks_wrong| {
            (1..=5).fold(PoseStatus::Confirmed.after_guess(at(0)), |status, i| {
                let agreement = ScanAgreement { explained, in_free_space: 0.3, through_solid: 0.05 };
                status.after(at(i), fit(Some(agreement), false, looks_wrong))
            })
        };
        assert_eq!(
            [status_after(0.45, true), status_after(0.3, false)],
            [PoseStatus::Lost { since: at(0) }; 2]
        );
        assert_eq!(status_after(0.45, false), PoseStatus::Confirmed);
        // Otherwise more evidence is needed.
        let door = PoseStatus::Confirmed.after(at(0), fit(agreement(0.1), true, true));
        assert_eq!(door, PoseStatus::Suspect { since: at(0), scans: 1, is_elsewhere: false });
        assert_eq!(door.after(at(1), fit(agreement(0.45), true, true)), PoseStatus::Confirmed);
    }

    #[test]
    fn odometry_is_trusted_among_people_but_not_where_beams_pass_walls() {
        let at = |i: i64| Time::from_ticks(2_000_000 * i);
        let status_after = |through_solid: f32| {
            let agreement = ScanAgreement { explained: 0.1, in_free_space: 0.6, through_solid };
            (0..10).map(at).fold(PoseStatus::Confirmed, |b, time| match b {
                PoseStatus::Lost { .. } => b,
                _ => b.after(time, fit(Some(agreement), true, false)),
            })
        };
        assert_eq!(status_after(0.0), PoseStatus::Confirmed);
        assert_eq!(status_after(0.2), PoseStatus::Lost { since: at(0) });
    }
}
