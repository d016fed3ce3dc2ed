//! How places are proposed, compared and accepted (`search.rs`, `finder.rs`, `hypothesis.rs`, `rivals.rs`,
//! `distinctness.rs`).
//!
//! The fit of a place is the fraction of beams that the map explains minus the fraction that it contradicts,
//! averaged over scans.

use portolan_matching::WantedPlaces;

use super::tracking::SLIP_WINDOW;
use crate::known_map::Window;

/// Which places a search of the whole map proposes in 2D: those that reach a minimum score in coarse cells
/// and a fraction of the best score. The search is greedy alone. Its beam is so wide that it finds the best
/// place, and most others, where corridors look alike; a quarter of the width misses the best
/// (docs/experiments/2026-11-localise.md).
pub(crate) const PROPOSALS_2D: WantedPlaces = WantedPlaces {
    min_score: 0.35,
    share_of_best: 0.75,
    separation: (0.8, 0.26),
    most: 24,
    most_points: 160,
    beam: 8192,
    lookups: 0,
};
/// Window around a coarsely proposed place in which it is refined in 2D.
pub(crate) const AROUND_PROPOSAL_2D: Window = Window { metres: 0.3, radians: 0.06 };
/// Maximum number of proposed places in 3D: those from the search seen from above that fit best after
/// registration.
pub(crate) const MOST_PROPOSALS_3D: usize = 8;
/// Window around a proposed place in which it is refined in 3D.
pub(crate) const AROUND_PROPOSAL_3D: Window = Window { metres: 0.8, radians: 0.12 };

/// Standard deviations of a newly proposed place, metres and radians.
pub(crate) const PROPOSED_SIGMAS: (f64, f64) = (0.1, 0.02);
/// Distance below which two poses are the same place.
pub(crate) const SAME_PLACE: Window = Window { metres: 0.6, radians: 0.2 };
/// Maximum number of places that are kept.
pub(crate) const MOST_PLACES: usize = 32;
/// Difference to the fit of the best place above which a place is refuted.
pub(crate) const REFUTED_BY: f64 = 0.3;

/// Minimum fit of an accepted place, for a scanner that has moved.
pub(crate) const ACCEPTED_FIT: f64 = 0.4;
/// Minimum evidence for an accepted place against each other place, in standard deviations. It has a margin
/// to the highest evidence of wrong places with such a fit, in parts of the building that the map does not
/// know and in maps of another building. At a fit of 0.45, a threshold of 2 accepted 103 right places where
/// 2.5 accepted 95 (docs/experiments/2026-11-believing-places.md).
pub(crate) const ACCEPTED_SIGMAS: f64 = 2.5;
/// Additional fit that a scanner at rest needs, because one view is weak evidence. It falls linearly with
/// motion.
pub(crate) const STANDING_FIT: f64 = 0.2;
/// Distance travelled after which no additional fit is needed, metres.
pub(crate) const MOVED_METRES: f64 = 1.5;
/// Distance that counts as much as one radian of rotation here, metres.
pub(crate) const METRES_PER_RADIAN: f64 = 0.5;
/// Number of searches without a better proposal after which a place is accepted, and number of searches with
/// a better one after which it is given up.
pub(crate) const CONFIRMING_SEARCHES: u32 = 2;
/// Minimum fit of a place that is reported as tentative.
pub(crate) const TENTATIVE_FIT: f64 = 0.35;
/// Bonus to the fit of a place that agrees with the given start.
pub(crate) const GIVEN_START_FIT: f64 = 0.2;
/// Minimum agreement of a place with the given start; the agreement is 1 within three standard deviations.
pub(crate) const START_AGREEMENT: f64 = 0.5;

/// Pause after the first search before the map is searched again, if a scan was kept since, seconds.
pub(crate) const FIRST_PAUSE: f64 = 0.5;
/// Factor by which the pause grows with each search.
pub(crate) const PAUSE_FACTOR: f64 = 1.25;
/// Longest pause in 2D, seconds: the duration of a search. Half of it found the same
/// (docs/experiments/2026-11-localise.md).
pub(crate) const LONGEST_PAUSE_2D: f64 = 1.0;
/// Longest pause in 3D, seconds.
pub(crate) const LONGEST_PAUSE_3D: f64 = 3.0;
/// Time after which a search counts as repeated for a scanner at rest whose scans still fit, seconds.
pub(crate) const STANDING_PAUSE: f64 = 3.0;

/// Standard deviation of the heading of a given start up to which poses around it are tried, radians; above
/// it, all headings are searched.
pub(crate) const KNOWN_HEADING_SIGMA: f64 = 1.0;
/// Half width of the area of a given start up to which that area is searched, metres; for a larger one the
/// search of the whole map is as good.
pub(crate) const WIDEST_START_AREA: f64 = 100.0;
/// Age of a satellite fix, at the scan before it is used, from which it no longer gives the position of the
/// scanner, seconds.
pub(crate) const STALE_FIX: f64 = 0.5;

/// Number of scans over which a place that the pose slipped away from is compared before one of the two is
/// given up.
pub(crate) const RIVAL_SCANS: usize = 3;
/// Lead in fit at which the place that was left is refuted.
pub(crate) const RIVAL_LEAD: f64 = 0.2;
/// Minimum fit of another place to count as better.
pub(crate) const BETTER_FIT: f64 = 0.45;
/// Minimum lead in fit of another place to count as better.
pub(crate) const BETTER_BY: f64 = 0.12;

/// Distance between examined places of a map along its trajectories, metres.
pub(crate) const EXAMINED_SPACING: f64 = 2.0;
/// Maximum number of examined places: in larger maps they are farther apart.
pub(crate) const MOST_EXAMINED: f64 = 2000.0;
/// Distance beyond which a place counts as another place. A start given within this distance leads to the
/// right place by itself: contradicting scans are searched in this window.
pub(crate) const ELSEWHERE: Window =
    Window { metres: SLIP_WINDOW.metres, radians: 15.0 * std::f64::consts::PI / 180.0 };
