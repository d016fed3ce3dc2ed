//! How places are proposed, compared and believed (`search.rs`, `finder.rs`, `hypothesis.rs`, `rivals.rs`, `distinctness.rs`).
//!
//! The fit of a place is the fraction of beams that the map explains less that which it contradicts, in the mean over scans.

use portolan_matching::WantedPlaces;

use super::tracking::SLIP_WINDOW;
use crate::known_map::Window;

/// What a search of the whole map proposes in 2D: what scores at least this in coarse cells, and this fraction of the best. The
/// greedy search alone, so wide that it finds the best place, and most others, where corridors look alike; a quarter as wide misses
/// the best (docs/experiments/2026-11-localise.md).
pub(crate) const PROPOSALS_2D: WantedPlaces = WantedPlaces {
    min_score: 0.35,
    share_of_best: 0.75,
    separation: (0.8, 0.26),
    most: 24,
    most_points: 160,
    beam: 8192,
    lookups: 0,
};
/// Around a place where it is proposed in 2D, coarsely.
pub(crate) const AROUND_PROPOSAL_2D: Window = Window { metres: 0.3, radians: 0.06 };
/// So many of the places that are seen from above in 3D, which fit best after registration, are looked into.
pub(crate) const MOST_PROPOSALS_3D: usize = 8;
/// Around a place where it is proposed in 3D.
pub(crate) const AROUND_PROPOSAL_3D: Window = Window { metres: 0.8, radians: 0.12 };

/// What is known of a place that was just proposed: standard deviations, metres and radians.
pub(crate) const PROPOSED_SIGMAS: (f64, f64) = (0.1, 0.02);
/// Places nearer to each other are the same.
pub(crate) const SAME_PLACE: Window = Window { metres: 0.6, radians: 0.2 };
/// Places that are kept, at most.
pub(crate) const MOST_PLACES: usize = 32;
/// A place whose fit is worse than that of the best by so much is refuted.
pub(crate) const REFUTED_BY: f64 = 0.3;

/// A place is believed if it fits so well …
pub(crate) const BELIEVED_FIT: f64 = 0.4;
/// … and what was seen speaks for it against each other place by so many standard deviations: with a margin to the most that wrong
/// places reach which fit so, in parts of the building that the map does not know and in maps of another building. 2 believed
/// 103 right places where 2.5 believed 95, at a fit of 0.45 (docs/experiments/2026-11-believing-places.md).
pub(crate) const BELIEVED_SIGMAS: f64 = 2.5;
/// It has to fit better by so much for a scanner that stands, because one view says little; …
pub(crate) const STANDING_FIT: f64 = 0.2;
/// … after this way, metres, no more, …
pub(crate) const MOVED_METRES: f64 = 1.5;
/// … where a radian of turning counts as so many metres.
pub(crate) const METRES_PER_RADIAN: f64 = 0.5;
/// A place is believed after so many searches that proposed nothing better, and given up after as many in which another one is
/// better.
pub(crate) const CONFIRMING_SEARCHES: u32 = 2;
/// From this fit on a place is said to be tentative.
pub(crate) const TENTATIVE_FIT: f64 = 0.35;
/// By so much of the fit a place is preferred that lies where the start is said to be.
pub(crate) const GIVEN_START_FIT: f64 = 0.2;
/// A place agrees with the start that was given from this agreement on, which is 1 within three standard deviations.
pub(crate) const START_AGREEMENT: f64 = 0.5;

/// The map is searched again when something new was seen after this pause, seconds, …
pub(crate) const FIRST_PAUSE: f64 = 0.5;
/// … which grows by this factor with each search, …
pub(crate) const PAUSE_FACTOR: f64 = 1.25;
/// … up to this in 2D, seconds: as long as a search costs. Half as long found the same
/// (docs/experiments/2026-11-localise.md) …
pub(crate) const LONGEST_PAUSE_2D: f64 = 1.0;
/// … and to this in 3D.
pub(crate) const LONGEST_PAUSE_3D: f64 = 3.0;
/// A scanner that stands is taken to have been looked for once more after so many seconds in which scans went on fitting.
pub(crate) const STANDING_PAUSE: f64 = 3.0;

/// A start is looked around at if its heading is known to this standard deviation, radians; at any heading otherwise, …
pub(crate) const KNOWN_HEADING_SIGMA: f64 = 1.0;
/// … if the area where it may be is not wider than this, metres: of a wider one the search of the whole map is as good.
pub(crate) const WIDEST_START_AREA: f64 = 100.0;
/// A satellite fix of so long before the scan before is not where the scanner is, seconds.
pub(crate) const STALE_FIX: f64 = 0.5;

/// A place that was left for another one nearby is given up once that fits better over so many scans …
pub(crate) const RIVAL_SCANS: usize = 3;
/// … by so much.
pub(crate) const RIVAL_LEAD: f64 = 0.2;
/// Another place is better if it fits so well …
pub(crate) const BETTER_FIT: f64 = 0.45;
/// … and so much better.
pub(crate) const BETTER_BY: f64 = 0.12;

/// Places of a map are examined so far apart along the way, metres, …
pub(crate) const EXAMINED_SPACING: f64 = 2.0;
/// … and no more of them: farther apart in larger maps.
pub(crate) const MOST_EXAMINED: f64 = 2000.0;
/// Somewhere else is farther away than this. Who is told to be nearer than that finds the place by itself: scans that contradict are
/// looked for so far around.
pub(crate) const ELSEWHERE: Window =
    Window { metres: SLIP_WINDOW.metres, radians: 15.0 * std::f64::consts::PI / 180.0 };
