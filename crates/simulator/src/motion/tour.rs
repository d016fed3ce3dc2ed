//! Plans the tour of a walk: first a lap, then through every passage and into every open room, and home.

use portolan_geometry::Vector2;

use super::builder::{MotionLimits, Waypoint, turning_time};
use super::graph::PassageGraph;
use super::{Motion, Walk};
use portolan_worlds::Random;
use portolan_worlds::two_d::{ClearanceGrid, FloorPlan, PathCosts, PathSearch, Person};

/// Radius around the middle of a room in which its roomiest spot is visited, metres.
const SPOT_RADIUS: f64 = 1.3;
/// Maximum random offset from the middle of a junction along each axis, metres.
const JITTER: f64 = 0.3;

/// Inputs of a tour.
pub(crate) struct TourRequest<'a> {
    pub plan: &'a FloorPlan,
    pub grid: &'a ClearanceGrid,
    pub limits: MotionLimits,
    /// Distance from surfaces that turns keep, metres.
    pub needed_clearance: f64,
    /// Time to stand at the start and at the end, seconds.
    pub rest: f64,
    /// Maximum time of the whole walk, seconds; none for one full tour.
    pub duration: Option<f64>,
}

/// The walk of a tour that returns to its start. With a duration, the tour goes home early or starts over,
/// and the walk stands at the end until the time is over. If the time is too short for the first leg and
/// the path back, the walk takes longer. None if there is no place to go.
pub(crate) fn plan_tour(request: &TourRequest<'_>, random: &mut Random) -> Option<Walk> {
    let mut tour = Tour::begin(request, random)?;
    while tour.walk_once(random) {}
    let mut walk = tour.walk_home()?;
    let Some(duration) = request.duration else { return Some(walk) };
    while walk.duration() > duration && tour.drop_last_leg() {
        walk = tour.walk_home()?;
    }
    walk.push(super::walk::Span::Rest, duration - walk.duration());
    Some(walk)
}

/// People who walk between random places of the plan.
pub(crate) fn plan_people(
    plan: &FloorPlan,
    grid: &ClearanceGrid,
    count: usize,
    random: &mut Random,
) -> Vec<Person> {
    let mut people = Vec::new();
    let mut paths = PathSearch::new(grid);
    for _ in 0..8 * count {
        if people.len() == count || plan.places.is_empty() {
            break;
        }
        let mut spot = || {
            let place = &plan.places[random.below(plan.places.len())];
            let aside = Vector2::new(random.between(-0.6, 0.6), random.between(-0.6, 0.6));
            grid.nearest_free(&(place.position + aside), 1.5)
        };
        let Some(ends) = (0..3).map(|_| spot()).collect::<Option<Vec<Vector2>>>() else { continue };
        let Some(there) = paths.path(&ends[0], &ends[1]) else { continue };
        let Some(on) = paths.path(&ends[1], &ends[2]) else { continue };
        let corners: Vec<Vector2> = there.into_iter().chain(on.into_iter().skip(1)).collect();
        let speed = random.between(0.7, 1.4);
        people.extend(Person::new(corners, speed, random.between(0.0, 60.0)));
    }
    people
}

struct Tour<'a> {
    request: &'a TourRequest<'a>,
    /// Index of the junction where it begins and ends.
    home: usize,
    costs: PathCosts,
    paths: PathSearch<'a>,
    graph: PassageGraph,
    waypoints: Vec<Waypoint>,
    /// Number of waypoints after each leg.
    leg_ends: Vec<usize>,
    /// Estimated time for the waypoints so far, seconds.
    elapsed: f64,
}

impl<'a> Tour<'a> {
    /// Begins at the junction from which most others can be reached. Junctions are tried in random order,
    /// until one reaches more than half of them.
    fn begin(request: &'a TourRequest<'a>, random: &mut Random) -> Option<Self> {
        let plan = request.plan;
        let mut junctions: Vec<usize> = (0..plan.places.len()).filter(|i| !plan.places[*i].is_room).collect();
        random.shuffle(&mut junctions);
        let mut best: Option<(usize, usize, Vector2, PathCosts)> = None;
        for home in junctions.iter().copied() {
            let Some(spot) = request.grid.nearest_free(&plan.places[home].position, 1.0) else { continue };
            let costs = request.grid.distances_from(&spot);
            let is_reachable = |i: &&usize| {
                let near = request.grid.nearest_free(&plan.places[**i].position, 1.0);
                near.is_some_and(|p| costs.metres_to(request.grid, &p).is_some())
            };
            let reached = junctions.iter().filter(is_reachable).count();
            if best.as_ref().is_none_or(|(_, most, _, _)| reached > *most) {
                best = Some((home, reached, spot, costs));
            }
            if 2 * reached > junctions.len() {
                break;
            }
        }
        let (home, _, spot, costs) = best?;
        let waypoints = vec![Waypoint { position: spot, stop: None }];
        Some(Self {
            request,
            home,
            costs,
            paths: PathSearch::new(request.grid),
            graph: PassageGraph::new(plan),
            waypoints,
            leg_ends: Vec::new(),
            elapsed: 2.0 * request.rest,
        })
    }

    /// Adds one tour. True if there is time for another.
    fn walk_once(&mut self, random: &mut Random) -> bool {
        let legs_before = self.leg_ends.len();
        for place in self.graph.itinerary(self.home, random) {
            let Some(position) = self.spot_at(place, random) else { continue };
            let is_room = self.request.plan.places[place].is_room;
            let stop = (is_room && random.chance(0.6)).then(|| random.between(0.5, 4.0));
            if !self.go_to(Waypoint { position, stop }) {
                return false;
            }
        }
        self.request.duration.is_some() && self.leg_ends.len() > legs_before
    }

    /// Adds a leg; false if the time is over.
    fn go_to(&mut self, target: Waypoint) -> bool {
        let Some(leg) = self.leg_to(target) else { return true };
        let seconds = self.seconds_for(&leg);
        if let Some(duration) = self.request.duration
            && !self.leg_ends.is_empty()
            && self.elapsed + seconds + self.seconds_home(&target.position) > duration
        {
            return false;
        }
        self.elapsed += seconds;
        self.waypoints.extend(leg.into_iter().skip(1));
        self.leg_ends.push(self.waypoints.len());
        true
    }

    /// Time of a leg walked on its own, from rest to rest, and of turning towards it, seconds.
    fn seconds_for(&self, leg: &[Waypoint]) -> f64 {
        let limits = &self.request.limits;
        let alone = Walk::through(leg, limits, 0.0, self.clearance()).map_or(0.0, |walk| walk.duration());
        let before = self.waypoints.iter().rev().nth(1);
        match (before, self.waypoints.last(), leg.get(1)) {
            (Some(before), Some(here), Some(after)) => {
                alone + turning_time(&before.position, here, &after.position, limits)
            }
            _ => alone,
        }
    }

    fn clearance(&self) -> Option<(&'a ClearanceGrid, f64)> {
        Some((self.request.grid, self.request.needed_clearance))
    }

    /// Waypoints from the end of the tour so far to `target`, both included.
    fn leg_to(&mut self, target: Waypoint) -> Option<Vec<Waypoint>> {
        let here = self.waypoints.last()?.position;
        let path = self.paths.path(&here, &target.position)?;
        let mut leg: Vec<Waypoint> =
            path.into_iter().map(|position| Waypoint { position, stop: None }).collect();
        leg.last_mut()?.stop = target.stop;
        Some(leg)
    }

    /// A generous estimate of the time back to the start, seconds.
    fn seconds_home(&self, from: &Vector2) -> f64 {
        let metres = self.costs.metres_to(self.request.grid, from).unwrap_or(0.0);
        1.15 * metres / self.request.limits.speed + 4.0
    }

    /// The walk through all legs and back to the start.
    fn walk_home(&mut self) -> Option<Walk> {
        let mut waypoints = self.waypoints.clone();
        let start = *waypoints.first()?;
        let path_home = self.leg_to(start).unwrap_or_default();
        waypoints.extend(path_home.into_iter().skip(1));
        Walk::through(&waypoints, &self.request.limits, self.request.rest, self.clearance())
    }

    /// Removes the last leg, unless it is the only one.
    fn drop_last_leg(&mut self) -> bool {
        let (Some(_), Some(end)) = (self.leg_ends.pop(), self.leg_ends.last()) else { return false };
        self.waypoints.truncate(*end);
        true
    }

    /// Position to visit at a place: the roomiest spot near the middle of a room, a random one near the
    /// middle of a junction.
    fn spot_at(&self, place: usize, random: &mut Random) -> Option<Vector2> {
        let place = &self.request.plan.places[place];
        let grid = self.request.grid;
        if place.is_room {
            return grid.roomiest(&place.position, SPOT_RADIUS, &self.costs);
        }
        let aside = Vector2::new(random.between(-JITTER, JITTER), random.between(-JITTER, JITTER));
        let spot = grid.nearest_free(&(place.position + aside), 1.0)?;
        self.costs.metres_to(grid, &spot).map(|_| spot)
    }
}
