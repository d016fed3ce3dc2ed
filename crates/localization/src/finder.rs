//! Localises scans: finds poses in the known map for scans in the local map, by searching and tracking, and
//! detects when the place is lost.

use portolan_geometry::{Point3f, Rigid3, Time, to_f32};
use portolan_mapping::{MatchingResult, Space};
use portolan_sensor::PointCloud;

use crate::changes::{Change, ChangeCounter};
use crate::evidence::{Support, Verdict};
use crate::hypothesis::{Hypothesis, fit};
use crate::known_map::{KnownMap, Window};
use crate::pace::Pace;
use crate::paired::Discordant;
use crate::placed_scan::PlacedScan;
use crate::recent::{KeyScan, Offered, RecentScans};
use crate::rivals::Rivals;
use crate::search::{Decision, Due, GivenStart, Judge, Places, PositionFix, Searcher, TimedPose};
use crate::settings::matching::WINDOW_SIGMAS;
use crate::settings::search::{
    BETTER_BY, BETTER_FIT, CONFIRMING_SEARCHES, KNOWN_HEADING_SIGMA, STALE_FIX, START_AGREEMENT,
    WIDEST_START_AREA,
};
use crate::settings::tracking::{
    LOST_SIGMA, SLIP_FIT, SLIP_SIGMAS, SLIP_WINDOW, SURE_CHECK_METRES, SURE_CHECK_SECONDS,
    UNCERTAIN_CHECK_SECONDS,
};
use crate::state::{Estimate, Place, Reason, State};

/// A scan from local SLAM.
pub struct LocalScan<'a> {
    /// When it was taken.
    pub time: Time,
    /// Pose from local SLAM.
    pub local_from_tracking: Rigid3,
    /// Returns in the local map; empty if something hides the surroundings.
    pub returns: &'a PointCloud,
    /// Origin of its beams, in the local map.
    pub origin: Point3f,
    /// Whether local SLAM lost track before it.
    pub begins_anew: bool,
}

impl<'a> LocalScan<'a> {
    /// From a result of local SLAM.
    pub fn of<S: Space>(scan: &'a MatchingResult<S>) -> Self {
        Self {
            time: scan.time,
            local_from_tracking: scan.local_from_tracking,
            returns: &scan.range_data_in_local.returns,
            origin: scan.range_data_in_local.origin,
            begins_anew: scan.lost.as_ref().is_some_and(|lost| lost.bridge.is_none()),
        }
    }
}

/// What the finder does at present.
enum Mode {
    Searching {
        places: Places,
        /// Reason of the loss, if it was localised before.
        lost: Option<Reason>,
    },
    Tracking(Box<Track>),
}

/// A place that is accepted and tracked.
struct Track {
    place: Hypothesis,
    rivals: Rivals,
    support: Support,
    last_check: Time,
    metres_since_check: f64,
    beaten: u32,
    uncertain_reason: Reason,
}

/// The scan that is being processed.
struct Current<S> {
    time: Time,
    local_from_scan: Rigid3,
    motion: Rigid3,
    seconds: f64,
    scan: S,
    offered: Offered,
}

/// Localises scans in a map.
pub(crate) struct Finder<M: KnownMap> {
    searcher: Searcher<M>,
    recent: RecentScans<M::Scan>,
    mode: Mode,
    last: Option<TimedPose>,
    pace: Pace,
    start: Option<(Rigid3, (f64, f64))>,
    given_start: Option<GivenStart>,
    /// A satellite fix that is newer than all scans so far.
    fix: Option<PositionFix>,
    /// None where changes are not counted.
    changes: Option<Box<dyn ChangeCounter>>,
}

impl<M: KnownMap> Finder<M> {
    /// With the start given by the user, and its standard deviations in metres and radians.
    pub fn new(searcher: Searcher<M>, start: Option<(Rigid3, (f64, f64))>) -> Self {
        let mode = Mode::Searching { places: Places::default(), lost: None };
        Self {
            searcher,
            recent: RecentScans::default(),
            mode,
            last: None,
            pace: Pace::default(),
            start,
            given_start: None,
            fix: None,
            changes: None,
        }
    }

    /// Counts contradictions between scans and map from now on.
    pub fn counting_changes(self) -> Self {
        Self { changes: Some(self.searcher.map.change_counter()), ..self }
    }

    /// Takes a satellite fix: while no place is known, the map is searched around it.
    pub fn add_fix(&mut self, fix: PositionFix) {
        // Keeps the first fix that waits: the newest of all fixes may always be ahead of the scans.
        if self.fix.is_none() && matches!(self.mode, Mode::Searching { .. }) {
            self.fix = Some(fix);
        }
    }

    /// Takes a scan.
    pub fn add(&mut self, scan: &LocalScan) -> Estimate {
        let local_from_scan = M::local_from_scan(&scan.local_from_tracking);
        let begins_anew = self.pace.is_jump(scan.time, &local_from_scan) || scan.begins_anew;
        let has_lost_track = begins_anew && matches!(self.mode, Mode::Tracking(_));
        if begins_anew {
            self.begin_anew();
        }
        if let Some((pose, sigmas)) = self.start.take() {
            let map_from_scan = M::local_from_scan(&pose);
            self.given_start = Some(GivenStart { map_from_scan, sigmas, local_from_scan });
        }
        self.reach_fix(&TimedPose { time: scan.time, local_from_scan });
        let current = self.current(scan, local_from_scan);
        let mode =
            std::mem::replace(&mut self.mode, Mode::Searching { places: Places::default(), lost: None });
        let (mode, state, reason) = match mode {
            searching if has_lost_track => (searching, State::Lost, Reason::LocalMapLost),
            mode if scan.returns.is_empty() => predicted_only(mode, &current),
            Mode::Searching { places, lost } => self.search(places, lost, &current),
            Mode::Tracking(track) => self.track(track, &current),
        };
        self.mode = mode;
        let place = self.place_of(state, &current, &scan.local_from_tracking);
        if state == State::Localised && current.offered != Offered::LeftOut {
            self.count_changes(scan, &current);
        }
        Estimate { time: scan.time, state, reason, local_from_tracking: scan.local_from_tracking, place }
    }

    /// Regions where scans contradicted the map, if they are counted.
    pub fn changes(&self) -> Vec<Change> {
        self.changes.as_ref().map_or_else(Vec::new, |counter| counter.changes())
    }

    /// The start or satellite fix that was searched around last: the pose in the map, and standard
    /// deviations in metres and radians.
    pub fn searched_start(&self) -> Option<(Rigid3, (f64, f64))> {
        self.given_start.map(|given_start| (given_start.map_from_scan, given_start.sigmas))
    }

    /// Uses the waiting fix once a scan has reached its time.
    fn reach_fix(&mut self, now: &TimedPose) {
        let Some(fix) = self.fix.filter(|fix| fix.time <= now.time) else { return };
        self.fix = None;
        let before = self.last.as_ref().unwrap_or(now);
        if before.time.seconds_since(fix.time) < STALE_FIX && matches!(self.mode, Mode::Searching { .. }) {
            self.given_start = Some(GivenStart::of_fix(&fix, before, now));
        }
    }

    /// The map and the threads that search it.
    pub fn searcher(&self) -> &Searcher<M> {
        &self.searcher
    }

    /// Compares a localised scan with the map.
    fn count_changes(&mut self, scan: &LocalScan, current: &Current<M::Scan>) {
        let (Mode::Tracking(track), Some(changes)) = (&self.mode, &mut self.changes) else { return };
        let belief = &track.place.belief;
        if belief.sigmas().0 > M::CERTAIN_PLACE {
            return;
        }
        let map_from_local = belief.pose * current.local_from_scan.inverse();
        let origin = map_from_local * scan.origin.cast::<f64>();
        changes.add(&PlacedScan {
            time: scan.time,
            origin: origin.coords,
            map_from_local,
            returns: &scan.returns.points,
        });
    }

    /// Whether the given start agrees with the known place; none while no place is known.
    pub fn start_agrees(&self) -> Option<bool> {
        let (given_start, last) = (self.given_start.as_ref()?, self.last.as_ref()?);
        let Mode::Tracking(track) = &self.mode else { return None };
        Some(given_start.agreement(&track.place, &last.local_from_scan) > START_AGREEMENT)
    }

    /// Starts anew after local SLAM lost track: earlier scans cannot be related to later ones.
    fn begin_anew(&mut self) {
        self.recent.clear();
        self.last = None;
        self.given_start = None;
        let lost = match &self.mode {
            Mode::Tracking(_) => Some(Reason::LocalMapLost),
            Mode::Searching { lost, .. } => *lost,
        };
        self.mode = Mode::Searching { places: Places::default(), lost };
    }

    fn current(&mut self, scan: &LocalScan, local_from_scan: Rigid3) -> Current<M::Scan> {
        let scan_from_local = to_f32(&local_from_scan.inverse());
        let seen = self.searcher.map.scan(&scan.returns.transformed(&scan_from_local));
        let last = self.last.replace(TimedPose { time: scan.time, local_from_scan });
        let motion = last.map_or_else(Rigid3::identity, |l| l.local_from_scan.inverse() * local_from_scan);
        let seconds = last.map_or(0.0, |l| scan.time.seconds_since(l.time));
        let offered = match scan.returns.is_empty() {
            true => Offered::LeftOut,
            false => self.recent.offer(KeyScan { time: scan.time, local_from_scan, scan: seen.clone() }),
        };
        Current { time: scan.time, local_from_scan, motion, seconds, scan: seen, offered }
    }

    fn search(
        &mut self,
        places: Places,
        lost: Option<Reason>,
        current: &Current<M::Scan>,
    ) -> (Mode, State, Reason) {
        let mut places = places;
        places.all.iter_mut().for_each(|place| place.predict(&current.motion, current.seconds));
        if let Offered::Kept { oldest_left } = current.offered {
            self.searcher.match_scan(places.all.iter_mut(), &current.scan);
            places.all.iter_mut().for_each(|place| place.remember(oldest_left));
        }
        let is_new = current.offered != Offered::LeftOut;
        let due = places.due(current.time, is_new, M::LONGEST_PAUSE);
        match due {
            Due::Search => places.merge(self.propose(current, &places.all), current.time),
            Due::Repetition => places.merge(Vec::new(), current.time),
            Due::Nothing => {}
        }
        places.prune();
        let decision = self.decide(&mut places, current, due != Due::Nothing);
        match decision {
            Decision::Accepted(best) => {
                let track = Track {
                    place: places.all.swap_remove(best),
                    rivals: Rivals::of(places.all),
                    support: Support::full(),
                    last_check: current.time,
                    metres_since_check: 0.0,
                    beaten: 0,
                    uncertain_reason: Reason::ScansContradict,
                };
                (Mode::Tracking(Box::new(track)), State::Localised, Reason::ScansFit)
            }
            Decision::Tentative(best, reason) => {
                places.all.swap(0, best);
                (Mode::Searching { places, lost }, State::Tentative, reason)
            }
            Decision::Nothing => {
                let state = if lost.is_some() { State::Lost } else { State::Searching };
                (Mode::Searching { places, lost }, state, lost.unwrap_or(Reason::NoPlaceFits))
            }
        }
    }

    /// Decides on a place, right after a search or between searches.
    fn decide(&self, places: &mut Places, current: &Current<M::Scan>, was_searched: bool) -> Decision {
        let agreement_with_start = |place: &Hypothesis| {
            self.given_start
                .as_ref()
                .map_or(0.0, |given_start| given_start.agreement(place, &current.local_from_scan))
        };
        let evidence = |place: &Hypothesis, other: &Hypothesis| {
            Discordant::between(&self.searcher.map, &self.recent, [place, other]).deviations()
        };
        let judge = Judge {
            motion: self.recent.motion(),
            agreement_with_start: &agreement_with_start,
            evidence: &evidence,
        };
        places.decide(&judge, was_searched)
    }

    /// Proposes places where the recent scans fit, predicted to the current scan.
    fn propose(&self, current: &Current<M::Scan>, known: &[Hypothesis]) -> Vec<Hypothesis> {
        let Some(newest) = self.recent.iter().next_back() else { return Vec::new() };
        let motion = newest.local_from_scan.inverse() * current.local_from_scan;
        let is_known = |pose: &Rigid3| known.iter().any(|place| place.is_at(&(*pose * motion)));
        let mut found = self.searcher.propose(&self.recent, None, &is_known);
        if let Some(given_start) = &self.given_start {
            found.extend(self.propose_given_start(given_start, &newest.local_from_scan, &is_known));
        }
        found.iter_mut().for_each(|place| place.predict(&motion, 0.0));
        found
    }

    /// Proposes places where the recent scans fit around the given start or satellite fix.
    fn propose_given_start(
        &self,
        given_start: &GivenStart,
        local_from_scan: &Rigid3,
        is_known: &(dyn Fn(&Rigid3) -> bool + Sync),
    ) -> Vec<Hypothesis> {
        if given_start.sigmas.1 > KNOWN_HEADING_SIGMA {
            let area =
                Some(given_start.area(local_from_scan)).filter(|area| area.metres <= WIDEST_START_AREA);
            return area
                .map_or_else(Vec::new, |area| self.searcher.propose(&self.recent, Some(area), is_known));
        }
        let near = given_start.map_from_scan * given_start.local_from_scan.inverse() * local_from_scan;
        let window = Window {
            metres: WINDOW_SIGMAS * given_start.sigmas.0,
            radians: WINDOW_SIGMAS * given_start.sigmas.1,
        };
        let map = &self.searcher.map;
        let settled = map.refine_pose(&map.joint(&self.recent), &near, window);
        Hypothesis::along(map, &self.recent, &settled).into_iter().collect()
    }

    fn track(&mut self, track: Box<Track>, current: &Current<M::Scan>) -> (Mode, State, Reason) {
        let mut track = track;
        let map = &self.searcher.map;
        track.place.predict(&current.motion, current.seconds);
        track.rivals.predict(&current.motion, current.seconds);
        track.place.match_scan(map, &current.scan);
        let verdict = Verdict::of(&track.place.agreement);
        if verdict == Verdict::Contradicts {
            let wide = map.find(&current.scan, &track.place.belief.pose, SLIP_WINDOW);
            let is_better = fit(&wide.agreement) > fit(&track.place.agreement) + SLIP_FIT;
            if is_better && Verdict::of(&wide.agreement) == Verdict::Supports {
                track.rivals.add_left(track.place.clone());
                track.place.move_to(&wide, SLIP_SIGMAS);
                track.support.lower_to_unsure();
            }
        }
        track.support.add(verdict, current.time);
        if let Offered::Kept { oldest_left } = current.offered {
            track.place.remember(oldest_left);
            track.rivals.match_scan(&self.searcher, &current.scan, oldest_left, &track.place);
        }
        track.metres_since_check += current.motion.translation.vector.norm();
        if let Some(since) = track.support.contradicted_since() {
            self.recent.forget_before(since);
            return lost(Reason::ScansContradict);
        }
        if track.place.belief.sigmas().0 > LOST_SIGMA {
            return lost(Reason::OutsideTheMap);
        }
        match verdict {
            Verdict::Unknown if !track.support.is_contradicted() => {
                track.uncertain_reason = Reason::OutsideTheMap
            }
            Verdict::Contradicts => track.uncertain_reason = Reason::ScansContradict,
            _ => {}
        }
        if let Some(rivals) = track.rivals.take_over(&track.place) {
            return replaced(&track.place, rivals, current.time);
        }
        if track.is_check_due(current.time) {
            let rivals = self.propose(current, std::slice::from_ref(&track.place));
            if track.is_beaten(&rivals, current.time) {
                return replaced(&track.place, rivals, current.time);
            }
        }
        let (state, reason) = match track.support.is_sure() {
            true if track.rivals.is_uncertain(&track.place) => (State::Uncertain, Reason::SeveralPlacesFit),
            true => (State::Localised, Reason::ScansFit),
            false => (State::Uncertain, track.uncertain_reason),
        };
        (Mode::Tracking(track), state, reason)
    }

    fn place_of(
        &self,
        state: State,
        current: &Current<M::Scan>,
        local_from_tracking: &Rigid3,
    ) -> Option<Place> {
        let place = match (&self.mode, state) {
            (Mode::Tracking(track), _) => &track.place,
            (Mode::Searching { places, .. }, State::Tentative) => places.all.first()?,
            _ => return None,
        };
        let map_from_local = place.belief.pose * current.local_from_scan.inverse();
        Some(Place {
            map_from_tracking: map_from_local * local_from_tracking,
            covariance: place.belief.covariance(),
            agreement: place.agreement,
        })
    }
}

/// Predicts after a scan without returns: only local SLAM measures the motion.
fn predicted_only<S>(mode: Mode, current: &Current<S>) -> (Mode, State, Reason) {
    let reason = Reason::PlaceHidden;
    match mode {
        Mode::Searching { mut places, lost } => {
            places.all.iter_mut().for_each(|place| place.predict(&current.motion, current.seconds));
            let state = match (places.all.is_empty(), lost) {
                (false, _) => State::Tentative,
                (true, Some(_)) => State::Lost,
                (true, None) => State::Searching,
            };
            (Mode::Searching { places, lost }, state, reason)
        }
        Mode::Tracking(mut track) => {
            track.place.predict(&current.motion, current.seconds);
            track.rivals.predict(&current.motion, current.seconds);
            track.support.add(Verdict::Unknown, current.time);
            track.uncertain_reason = reason;
            if track.place.belief.sigmas().0 > LOST_SIGMA {
                return lost(reason);
            }
            let state = if track.support.is_sure() { State::Localised } else { State::Uncertain };
            (Mode::Tracking(track), state, reason)
        }
    }
}

fn lost(reason: Reason) -> (Mode, State, Reason) {
    (Mode::Searching { places: Places::default(), lost: Some(reason) }, State::Lost, reason)
}

/// Gives up the accepted place because another one fits better: both become candidates again.
fn replaced(accepted: &Hypothesis, better: Vec<Hypothesis>, time: Time) -> (Mode, State, Reason) {
    let mut places = Places::default();
    places.merge(better, time);
    places.merge(vec![accepted.clone()], time);
    let reason = Reason::AnotherPlaceFitsBetter;
    (Mode::Searching { places, lost: Some(reason) }, State::Lost, reason)
}

impl Track {
    fn is_check_due(&self, time: Time) -> bool {
        let waited = time.seconds_since(self.last_check);
        if self.support.is_sure() && self.beaten == 0 {
            waited >= SURE_CHECK_SECONDS && self.metres_since_check >= SURE_CHECK_METRES
        } else {
            waited >= UNCERTAIN_CHECK_SECONDS
        }
    }

    /// Compares the place with others that a search proposed; returns whether it is given up.
    fn is_beaten(&mut self, rivals: &[Hypothesis], time: Time) -> bool {
        (self.last_check, self.metres_since_check) = (time, 0.0);
        let own = self.place.fit();
        let is_better = |rival: &Hypothesis| {
            !rival.is_same_place(&self.place) && rival.fit() > BETTER_FIT && rival.fit() > own + BETTER_BY
        };
        if !rivals.iter().any(is_better) {
            self.beaten = 0;
            return false;
        }
        self.beaten += 1;
        self.support.lower_to_unsure();
        self.uncertain_reason = Reason::AnotherPlaceFitsBetter;
        self.beaten >= CONFIRMING_SEARCHES
    }
}
