//! Collects the places that searches of the whole map propose, and decides when one of them is accepted.

use portolan_geometry::{Quaternion, Rigid3, Time, Vector3, normalize_angle, project_2d};
use rayon::prelude::*;

use crate::hypothesis::Hypothesis;
use crate::known_map::{Area, KnownMap};
use crate::recent::RecentScans;
use crate::settings::matching::WINDOW_SIGMAS;
use crate::settings::search::{
    ACCEPTED_FIT, ACCEPTED_SIGMAS, CONFIRMING_SEARCHES, FIRST_PAUSE, GIVEN_START_FIT, METRES_PER_RADIAN,
    MOST_PLACES, MOVED_METRES, PAUSE_FACTOR, REFUTED_BY, STANDING_FIT, STANDING_PAUSE, TENTATIVE_FIT,
};
use crate::state::Reason;

/// A start pose given by the user, or a position from a satellite fix.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GivenStart {
    pub map_from_scan: Rigid3,
    /// Standard deviations, metres and radians; the latter is [`ANY_HEADING`] where the heading is unknown.
    pub sigmas: (f64, f64),
    pub local_from_scan: Rigid3,
}

/// Standard deviation of an unknown heading, radians.
pub(crate) const ANY_HEADING: f64 = std::f64::consts::PI;

impl GivenStart {
    /// From a satellite fix between two poses in the local map, interpolated in time.
    pub fn of_fix(fix: &PositionFix, before: &TimedPose, now: &TimedPose) -> Self {
        let seconds = now.time.seconds_since(before.time);
        let share = if seconds > 0.0 { fix.time.seconds_since(before.time) / seconds } else { 1.0 };
        let [a, b] = [before, now].map(|at| at.local_from_scan.translation.vector);
        let place = a + share.clamp(0.0, 1.0) * (b - a);
        Self {
            map_from_scan: Rigid3::from_parts(fix.position.into(), Quaternion::identity()),
            sigmas: (fix.sigma_metres, ANY_HEADING),
            local_from_scan: Rigid3::from_parts(place.into(), now.local_from_scan.rotation),
        }
    }

    /// Area where a scanner of unknown heading may be by now, at this pose in the local map: three standard
    /// deviations plus the distance travelled since.
    pub fn area(&self, local_from_scan: &Rigid3) -> Area {
        let travelled = self.local_from_scan.translation.vector - local_from_scan.translation.vector;
        let centre = self.map_from_scan.translation.vector.xy();
        Area { centre, metres: WINDOW_SIGMAS * self.sigmas.0 + travelled.norm() }
    }

    /// Agreement of the start with a place, 0 to 1.
    pub fn agreement(&self, place: &Hypothesis, local_from_scan: &Rigid3) -> f64 {
        let map_from_local = place.belief.pose * local_from_scan.inverse();
        let start = map_from_local * self.local_from_scan;
        // Users read starts off a picture, which shows no heights.
        let (start, given) = (project_2d(&start), project_2d(&self.map_from_scan));
        let metres = (start.translation - given.translation).norm() / self.sigmas.0;
        let radians = normalize_angle(start.angle - given.angle).abs() / self.sigmas.1;
        // Three standard deviations are as good as one: users round.
        let beyond = (metres.hypot(radians) - WINDOW_SIGMAS).max(0.0);
        (-0.5 * beyond * beyond).exp()
    }
}

/// A satellite fix in the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionFix {
    /// Its time.
    pub time: Time,
    /// Position of the scanner in the map, metres; the height is ignored.
    pub position: Vector3,
    /// Standard deviation along each horizontal axis, metres.
    pub sigma_metres: f64,
}

/// Pose of a scan in the local map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TimedPose {
    pub time: Time,
    pub local_from_scan: Rigid3,
}

/// Decision between several places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Decision {
    Nothing,
    /// This place is the most likely.
    Tentative(usize, Reason),
    /// This place is accepted.
    Accepted(usize),
}

/// Places where the scanner may be.
#[derive(Clone, Debug, Default)]
pub(crate) struct Places {
    pub all: Vec<Hypothesis>,
    pub last_search: Option<Time>,
    searches: u32,
    /// Reason why the best place was not accepted at the last search.
    tentative_reason: Option<Reason>,
    /// Whether a scan was kept since the last search.
    is_new: bool,
}

/// Whether the map has to be searched at a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Due {
    Nothing,
    /// The search would repeat the last one and find the same, so it only counts as made.
    Repetition,
    Search,
}

/// A map with threads to search in it.
pub(crate) struct Searcher<M> {
    pub map: M,
    pub pool: rayon::ThreadPool,
}

impl<M: KnownMap> Searcher<M> {
    /// Places in an area, or in the whole map, where the recent scans fit, at any heading; the best first.
    /// Places like one that is `known` already are left out.
    pub fn propose(
        &self,
        recent: &RecentScans<M::Scan>,
        area: Option<Area>,
        known: &(dyn Fn(&Rigid3) -> bool + Sync),
    ) -> Vec<Hypothesis> {
        let mut found: Vec<Hypothesis> = self.pool.install(|| {
            let proposed = self.map.propose(&self.map.joint(recent), area, known);
            proposed.par_iter().filter_map(|pose| Hypothesis::along(&self.map, recent, pose)).collect()
        });
        found.sort_by(|a, b| b.fit().total_cmp(&a.fit()));
        found
    }

    /// Matches a scan at all places.
    pub fn match_scan<'a>(&self, places: impl Iterator<Item = &'a mut Hypothesis>, scan: &M::Scan) {
        let places: Vec<&mut Hypothesis> = places.collect();
        self.pool.install(|| places.into_par_iter().for_each(|place| place.match_scan(&self.map, scan)));
    }
}

impl Places {
    /// All places that fit anywhere, as after enough searches for a decision.
    pub fn of_complete_search(all: Vec<Hypothesis>) -> Self {
        Self { all, searches: CONFIRMING_SEARCHES, ..Self::default() }
    }

    /// Whether the whole map is to be searched again; `longest_pause` is the longest pause between searches,
    /// seconds.
    pub fn due(&mut self, time: Time, is_new: bool, longest_pause: f64) -> Due {
        self.is_new |= is_new;
        let Some(last) = self.last_search else { return Due::Search };
        let (waited, pause) =
            (time.seconds_since(last), FIRST_PAUSE * PAUSE_FACTOR.powi(self.searches.min(20) as i32));
        match self.is_new {
            true if waited >= pause.min(longest_pause) => Due::Search,
            false if waited >= STANDING_PAUSE => Due::Repetition,
            _ => Due::Nothing,
        }
    }

    /// Merges the proposals of a search.
    pub fn merge(&mut self, proposed: Vec<Hypothesis>, time: Time) {
        (self.last_search, self.is_new) = (Some(time), false);
        self.searches += 1;
        for place in proposed {
            match self.all.iter_mut().find(|known| known.is_same_place(&place)) {
                Some(known) if known.fit() < place.fit() => *known = place,
                Some(_) => {}
                None => self.all.push(place),
            }
        }
    }

    /// Drops places that have become the same, and places that are refuted by the best.
    pub fn prune(&mut self) {
        self.all.sort_by(|a, b| b.fit().total_cmp(&a.fit()));
        let mut kept: Vec<Hypothesis> = Vec::new();
        for place in std::mem::take(&mut self.all) {
            let is_refuted = kept.first().is_some_and(|best| best.lead(&place) > REFUTED_BY);
            if kept.len() < MOST_PLACES && !is_refuted && !kept.iter().any(|k| k.is_same_place(&place)) {
                kept.push(place);
            }
        }
        self.all = kept;
    }

    /// Decides on a place. A place is accepted only right after a search: only then is it known that nothing
    /// else fits.
    pub fn decide(&mut self, judge: &Judge, was_searched: bool) -> Decision {
        let rated =
            self.all.iter().enumerate().map(|(i, place)| (i, place, place.fit() + judge.start_bonus(place)));
        let best = rated.max_by(|(i, _, a), (j, _, b)| a.total_cmp(b).then(j.cmp(i)));
        let Some((best, place, _)) = best else { return Decision::Nothing };
        if place.fit() < TENTATIVE_FIT {
            return Decision::Nothing;
        }
        if was_searched {
            let mut others = self.all.iter().filter(|other| !other.is_same_place(place));
            let (travelled, turn) = judge.motion;
            let moved = ((travelled + METRES_PER_RADIAN * turn) / MOVED_METRES).min(1.0);
            let fits = place.fit().min(place.fit_lately() + judge.start_bonus(place))
                >= ACCEPTED_FIT + STANDING_FIT * (1.0 - moved);
            self.tentative_reason = if !others.all(|other| judge.is_preferred(place, other)) {
                Some(Reason::SeveralPlacesFit)
            } else if self.searches < CONFIRMING_SEARCHES || !fits {
                Some(Reason::TooLittleSeen)
            } else {
                None
            };
        }
        match self.tentative_reason {
            None if was_searched => Decision::Accepted(best),
            tentative_reason => Decision::Tentative(best, tentative_reason.unwrap_or(Reason::TooLittleSeen)),
        }
    }
}

/// Criteria for places besides their fit.
pub(crate) struct Judge<'a> {
    /// Distance and rotation over which scans were kept, metres and radians.
    pub motion: (f64, f64),
    /// Agreement of a place with the given start or satellite fix, 0 to 1.
    pub agreement_with_start: &'a dyn Fn(&Hypothesis) -> f64,
    /// Evidence for the first of two places from the scans, in standard deviations.
    pub evidence: &'a dyn Fn(&Hypothesis, &Hypothesis) -> f64,
}

impl Judge<'_> {
    fn start_bonus(&self, place: &Hypothesis) -> f64 {
        GIVEN_START_FIT * (self.agreement_with_start)(place)
    }

    /// Whether one place is preferred to another one with enough evidence. Full agreement with the given
    /// start counts as much as all the evidence required from scans.
    fn is_preferred(&self, place: &Hypothesis, other: &Hypothesis) -> bool {
        let agreement_with_start = (self.agreement_with_start)(place) - (self.agreement_with_start)(other);
        (self.evidence)(place, other) + ACCEPTED_SIGMAS * agreement_with_start >= ACCEPTED_SIGMAS
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hypothesis::test_place;
    use portolan_geometry::Duration;

    #[test]
    fn the_map_is_searched_again_only_for_something_new() {
        let at = |seconds: f64| Time::from_ticks(0) + Duration::from_seconds(seconds);
        let mut places = Places::default();
        assert_eq!(places.due(at(0.0), true, 1.0), Due::Search);
        places.merge(Vec::new(), at(0.0));
        assert_eq!(places.due(at(0.3), true, 1.0), Due::Nothing, "searches are some time apart");
        assert_eq!(places.due(at(0.7), false, 1.0), Due::Search, "for the scan that was kept since");
        places.merge(Vec::new(), at(0.7));
        assert_eq!(places.due(at(3.0), false, 1.0), Due::Nothing);
        assert_eq!(places.due(at(3.8), false, 1.0), Due::Repetition, "a scanner that stands");
    }

    fn decide(fits: &[f32], other: &[f32], agreement_with_start: f64, deviations: f64) -> Decision {
        let all = vec![test_place(0.0, fits), test_place(9.0, other)];
        let mut places = Places::of_complete_search(all);
        places.prune();
        let agreement_with_start =
            |place: &Hypothesis| if place.is_at(&Rigid3::identity()) { agreement_with_start } else { 0.0 };
        places.decide(
            &Judge {
                motion: (4.0, 0.0),
                agreement_with_start: &agreement_with_start,
                evidence: &|_, _| deviations,
            },
            true,
        )
    }

    #[test]
    fn a_place_is_not_accepted_on_little_evidence() {
        let tentative = Decision::Tentative(0, Reason::SeveralPlacesFit);
        assert_eq!(decide(&[0.8; 12], &[0.7; 12], 0.0, ACCEPTED_SIGMAS), Decision::Accepted(0));
        assert_eq!(decide(&[0.8; 12], &[0.7; 12], 0.0, 0.8 * ACCEPTED_SIGMAS), tentative);
        assert_eq!(
            decide(&[0.8; 12], &[0.7; 12], 0.5, 0.8 * ACCEPTED_SIGMAS),
            Decision::Accepted(0),
            "and told"
        );
        assert_eq!(decide(&[0.8; 12], &[0.2; 12], 0.0, 0.0), Decision::Accepted(0), "the other is refuted");
        let mut left = [0.8; 12];
        left[9..].fill(0.3);
        let too_little_seen = Decision::Tentative(0, Reason::TooLittleSeen);
        assert_eq!(
            decide(&left, &[0.2; 12], 0.0, ACCEPTED_SIGMAS),
            too_little_seen,
            "the scanner leaves what is known"
        );
    }
}
