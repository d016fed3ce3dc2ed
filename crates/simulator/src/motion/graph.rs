//! Order in which a tour visits the places of a plan.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

use portolan_worlds::Random;
use portolan_worlds::two_d::{FloorPlan, Passage};

const UNREACHED: u64 = u64::MAX;

/// The passages of a plan as a graph of places.
#[derive(Clone, Debug)]
pub(crate) struct PassageGraph {
    passages: Vec<Passage>,
    /// Length of each passage, tenths of a millimetre.
    lengths: Vec<u64>,
    /// Passages of each place, with the place at the other end.
    neighbours: Vec<Vec<(usize, usize)>>,
}

/// Shortest paths along passages from one place.
struct ShortestPaths {
    from: usize,
    distances: Vec<u64>,
    previous: Vec<usize>,
}

impl PassageGraph {
    pub fn new(plan: &FloorPlan) -> Self {
        let mut neighbours = vec![Vec::new(); plan.places.len()];
        let mut lengths = Vec::new();
        for (index, passage) in plan.passages.iter().enumerate() {
            neighbours[passage.from].push((index, passage.to));
            neighbours[passage.to].push((index, passage.from));
            let along = plan.places[passage.to].position - plan.places[passage.from].position;
            lengths.push((along.norm() * 10_000.0) as u64);
        }
        Self { passages: plan.passages.clone(), lengths, neighbours }
    }

    /// Places in the order of a visit from `home`: the shortest lap first, so that a first loop closes
    /// early, then always the nearest passage not yet visited, with its rooms, until all are visited;
    /// finally home.
    pub fn itinerary(&self, home: usize, random: &mut Random) -> Vec<usize> {
        let mut places = self.shortest_lap(home, random);
        let mut unseen: BTreeSet<usize> = (0..self.passages.len()).collect();
        let mut here = home;
        while !unseen.is_empty() {
            let paths = self.paths_from(here, None);
            let mut ends: Vec<(usize, usize, usize)> = Vec::with_capacity(2 * unseen.len());
            for index in &unseen {
                let passage = &self.passages[*index];
                ends.push((*index, passage.from, passage.to));
                ends.push((*index, passage.to, passage.from));
            }
            random.shuffle(&mut ends);
            let nearest = ends.iter().min_by_key(|(_, entry, _)| paths.distances[*entry]);
            let Some(&(index, entry, exit)) = nearest.filter(|e| paths.distances[e.1] != UNREACHED) else {
                break;
            };
            places.extend(paths.to(entry));
            let rooms = &self.passages[index].rooms;
            if entry == self.passages[index].from {
                places.extend(rooms.iter());
            } else {
                places.extend(rooms.iter().rev());
            }
            places.push(exit);
            here = exit;
            unseen.remove(&index);
        }
        places.extend(self.paths_from(here, None).to(home));
        places
    }

    /// Places of the shortest cycle through `home`, which comes last; empty if there is none.
    fn shortest_lap(&self, home: usize, random: &mut Random) -> Vec<usize> {
        let mut best: Option<(u64, Vec<usize>)> = None;
        for (passage, next) in &self.neighbours[home] {
            let paths = self.paths_from(*next, Some(*passage));
            let length = paths.distances[home].saturating_add(self.lengths[*passage]);
            if length != UNREACHED && best.as_ref().is_none_or(|(shortest, _)| length < *shortest) {
                let mut lap = vec![*next];
                lap.extend(paths.to(home));
                best = Some((length, lap));
            }
        }
        let mut lap = best.map_or(Vec::new(), |(_, lap)| lap);
        if lap.pop().is_some() {
            if random.chance(0.5) {
                lap.reverse();
            }
            lap.push(home);
        }
        lap
    }

    /// Shortest paths by Dijkstra's algorithm, without one passage.
    fn paths_from(&self, from: usize, without: Option<usize>) -> ShortestPaths {
        let count = self.neighbours.len();
        let mut paths =
            ShortestPaths { from, distances: vec![UNREACHED; count], previous: vec![from; count] };
        paths.distances[from] = 0;
        let mut open = BinaryHeap::from([Reverse((0_u64, from))]);
        while let Some(Reverse((distance, at))) = open.pop() {
            if distance > paths.distances[at] {
                continue;
            }
            for (passage, next) in &self.neighbours[at] {
                let further = distance.saturating_add(self.lengths[*passage]);
                if Some(*passage) != without && further < paths.distances[*next] {
                    paths.distances[*next] = further;
                    paths.previous[*next] = at;
                    open.push(Reverse((further, *next)));
                }
            }
        }
        paths
    }
}

impl ShortestPaths {
    /// The places after the start up to `to`; empty if it cannot be reached.
    fn to(&self, to: usize) -> Vec<usize> {
        let mut path = Vec::new();
        let mut at = to;
        while at != self.from && self.distances[at] != UNREACHED {
            path.push(at);
            at = self.previous[at];
        }
        path.reverse();
        path
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Vector2;

    /// Two squares side by side with a room on the far side.
    fn two_loops() -> FloorPlan {
        let mut plan = FloorPlan::default();
        for (x, y) in [(0.0, 0.0), (10.0, 0.0), (22.0, 0.0), (0.0, 10.0), (10.0, 10.0), (22.0, 10.0)] {
            plan.add_junction(String::new(), Vector2::new(x, y));
        }
        let room = plan.add_room(String::new(), Vector2::new(25.0, 5.0));
        for (from, to) in [(0, 1), (1, 2), (3, 4), (4, 5), (0, 3), (1, 4), (2, 5)] {
            plan.add_passage(from, to);
        }
        plan.passages[6].rooms.push(room);
        plan
    }

    #[test]
    fn a_tour_sees_every_passage_and_room_and_comes_home() {
        let graph = PassageGraph::new(&two_loops());
        for seed in 0..20 {
            let mut random = Random::new(seed, "tour", 0);
            let places = graph.itinerary(0, &mut random);
            assert_eq!(places.last(), Some(&0));
            assert!(places.contains(&6), "the room");
            assert_eq!(places[3], 0, "the first lap is the small loop");
            let walked = |a: usize, b: usize| {
                let junctions: Vec<usize> =
                    [0].into_iter().chain(places.iter().copied()).filter(|p| *p != 6).collect();
                junctions.windows(2).any(|w| (w[0], w[1]) == (a, b) || (w[0], w[1]) == (b, a))
            };
            for (a, b) in [(0, 1), (1, 2), (3, 4), (4, 5), (0, 3), (1, 4), (2, 5)] {
                assert!(walked(a, b), "seed {seed} passage {a}-{b}: {places:?}");
            }
        }
    }
}
