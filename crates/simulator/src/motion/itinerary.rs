//! Selects the loops that are walked within the available time, and computes the position along them.

use portolan_geometry::Vector3;

use super::smooth;
use portolan_worlds::Random;

/// Time to reach walking speed, and to stop, seconds.
const START_TIME: f64 = 1.6;
/// Time to turn around on the spot, seconds.
const TURN_TIME: f64 = 3.5;
/// Maximum factor by which the speed is raised to fit one more loop in.
const HURRY: f64 = 1.12;
/// Minimum length of a path out and back, one way, metres.
const SHORTEST_OUTING: f64 = 3.0;

/// A path that is walked without a stop.
#[derive(Clone, Debug)]
struct Stroke {
    points: Vec<Vector3>,
    /// Distance along the path at each point, metres.
    lengths: Vec<f64>,
    start_time: f64,
    duration: f64,
}

/// Strokes with rests between them.
#[derive(Clone, Debug)]
pub(crate) struct Itinerary {
    strokes: Vec<Stroke>,
    home: Vector3,
    speed: f64,
    duration: f64,
}

/// Inputs of an itinerary.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ItineraryRequest<'a> {
    /// Closed paths from the same place.
    pub loops: &'a [Vec<Vector3>],
    /// m/s.
    pub speed: f64,
    /// Time to stand at the start and at the end, seconds.
    pub rest: f64,
    /// Total time, seconds; none to walk every loop once.
    pub duration: Option<f64>,
    /// Whether to stand all the time.
    pub standing: bool,
}

/// Position along the path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    /// On the ground, metres.
    pub position: Vector3,
    /// Distance walked, metres.
    pub walked: f64,
}

impl Itinerary {
    pub fn plan(request: &ItineraryRequest<'_>, random: &mut Random) -> Option<Self> {
        let home = *request.loops.first()?.first()?;
        let mut plan = Self { strokes: Vec::new(), home, speed: request.speed, duration: request.rest };
        let loops: Vec<Stroke> = request.loops.iter().map(|route| Stroke::new(route.clone())).collect();
        let Some(duration) = request.duration else {
            if !request.standing {
                plan.push(joined(&loops));
            }
            plan.duration += request.rest;
            return Some(plan);
        };
        if !request.standing {
            plan.fill(&loops, duration - request.rest, random);
        }
        plan.duration = duration;
        Some(plan)
    }

    /// As many loops as fit, then a path out and back again.
    fn fill(&mut self, loops: &[Stroke], end: f64, random: &mut Random) {
        let available = |speed: f64, from: f64| (end - from - START_TIME) * speed;
        let (mut chosen, mut length) = (Vec::new(), 0.0);
        let mut next = 0;
        while let Some(candidate) = loops.get(next % loops.len().max(1)) {
            let longer = length + candidate.length();
            if longer > HURRY * available(self.speed, self.duration) || next > 100_000 {
                break;
            }
            length = longer;
            chosen.push(candidate.clone());
            next += 1;
        }
        if !chosen.is_empty() {
            self.speed = self.speed.max(length / available(1.0, self.duration));
            self.push(joined(&chosen));
        }
        let spare = end - self.duration - 2.0 * START_TIME - TURN_TIME;
        let out = 0.5 * spare * self.speed;
        if let (true, Some(route)) = (out > SHORTEST_OUTING, loops.get(next % loops.len().max(1))) {
            let outing = route.prefix(out * random.between(0.97, 1.0));
            let mut back = outing.points.clone();
            back.reverse();
            if self.strokes.is_empty() {
                self.push(outing);
            } else {
                // The walk goes on without a stop.
                let last = self.strokes.pop().map(|last| joined(&[last, outing]));
                self.duration = last.as_ref().map_or(self.duration, |last| last.start_time);
                last.into_iter().for_each(|last| self.push(last));
            }
            self.duration += TURN_TIME;
            self.push(Stroke::new(back));
        }
    }

    fn push(&mut self, mut stroke: Stroke) {
        stroke.start_time = self.duration;
        stroke.duration = stroke.length() / self.speed + START_TIME;
        if stroke.length() < 2.0 * START_TIME * self.speed {
            // Too short to reach full speed.
            stroke.duration = 3.0 * START_TIME;
        }
        self.duration += stroke.duration;
        self.strokes.push(stroke);
    }

    /// Total time, seconds.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Position at a time, seconds.
    pub fn place(&self, time: f64) -> Place {
        let mut walked = 0.0;
        let mut position = self.home;
        for stroke in &self.strokes {
            if time < stroke.start_time {
                break;
            }
            let along = stroke.along(time - stroke.start_time);
            walked += along;
            position = stroke.at(along);
        }
        Place { position, walked }
    }

    /// Start and end times of the turns between strokes, seconds.
    pub fn turns(&self) -> Vec<(f64, f64)> {
        let ends = self.strokes.windows(2);
        ends.map(|pair| (pair[0].start_time + pair[0].duration, pair[1].start_time)).collect()
    }
}

/// One stroke made of several, each of which ends where the next one begins.
fn joined(strokes: &[Stroke]) -> Stroke {
    let mut points: Vec<Vector3> = strokes.iter().flat_map(|s| s.points.iter().copied()).collect();
    points.dedup_by(|a, b| (*a - *b).norm() < 1e-6);
    let start_time = strokes.first().map_or(0.0, |s| s.start_time);
    Stroke { start_time, ..Stroke::new(points) }
}

impl Stroke {
    fn new(mut points: Vec<Vector3>) -> Self {
        points.dedup_by(|a, b| (*a - *b).norm() < 1e-6);
        let mut lengths = vec![0.0];
        let mut length = 0.0;
        for pair in points.windows(2) {
            length += (pair[1] - pair[0]).norm();
            lengths.push(length);
        }
        Self { points, lengths, start_time: 0.0, duration: 0.0 }
    }

    fn length(&self) -> f64 {
        self.lengths.last().copied().unwrap_or(0.0)
    }

    fn at(&self, along: f64) -> Vector3 {
        let Some(last) = self.points.len().checked_sub(1).filter(|last| *last > 0) else {
            return self.points.first().copied().unwrap_or_default();
        };
        let after = self.lengths.partition_point(|l| *l <= along).clamp(1, last);
        let (from, to) = (self.lengths[after - 1], self.lengths[after]);
        let share = ((along - from) / (to - from).max(1e-12)).clamp(0.0, 1.0);
        self.points[after - 1] + (self.points[after] - self.points[after - 1]) * share
    }

    fn prefix(&self, length: f64) -> Self {
        let mut points: Vec<Vector3> =
            self.points.iter().zip(&self.lengths).filter(|(_, l)| **l < length).map(|(p, _)| *p).collect();
        points.push(self.at(length));
        Self::new(points)
    }

    /// Distance along the stroke at this time after its start, metres: the speed rises smoothly at the
    /// start and falls at the end.
    fn along(&self, elapsed: f64) -> f64 {
        let elapsed = elapsed.clamp(0.0, self.duration);
        let ramp = START_TIME.min(0.5 * self.duration);
        let speed = self.length() / (self.duration - ramp).max(1e-9);
        let rising = |t: f64| speed * ramp * smooth::area((t / ramp).clamp(0.0, 1.0));
        if elapsed < ramp {
            rising(elapsed)
        } else if elapsed > self.duration - ramp {
            self.length() - rising(self.duration - elapsed)
        } else {
            0.5 * speed * ramp + speed * (elapsed - ramp)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(side: f64) -> Vec<Vector3> {
        [[0.0, 0.0], [side, 0.0], [side, side], [0.0, side], [0.0, 0.0]]
            .map(|[x, y]| Vector3::new(x, y, 0.0))
            .to_vec()
    }

    #[test]
    fn the_time_is_filled_and_the_tour_ends_at_the_start() {
        let loops = [square(10.0), square(20.0)];
        for duration in [8.0, 20.0, 44.0, 60.0, 120.0, 500.0] {
            let request = ItineraryRequest {
                loops: &loops,
                speed: 1.2,
                rest: 2.0,
                duration: Some(duration),
                standing: false,
            };
            let plan = Itinerary::plan(&request, &mut Random::new(1, "plan", 0)).unwrap();
            assert_eq!(plan.duration(), duration);
            let end = plan.place(duration);
            assert!((end.position - plan.home).norm() < 1e-6, "{duration}: {end:?}");
            assert!(end.walked > 0.75 * (duration - 10.0), "{duration}: {}", end.walked);
            let mut before = plan.place(0.0);
            for i in 1..(duration * 20.0) as usize {
                let now = plan.place(i as f64 / 20.0);
                let step = (now.position - before.position).norm();
                assert!(
                    step <= 0.05 * 1.2 * HURRY * 1.02 && now.walked >= before.walked,
                    "{duration} {i} {step}"
                );
                before = now;
            }
        }
        let request =
            ItineraryRequest { loops: &loops, speed: 1.0, rest: 2.0, duration: None, standing: false };
        let plan = Itinerary::plan(&request, &mut Random::new(1, "plan", 0)).unwrap();
        assert!((plan.place(plan.duration()).walked - 120.0).abs() < 1e-6);
        let request = ItineraryRequest { standing: true, duration: Some(60.0), ..request };
        assert_eq!(
            Itinerary::plan(&request, &mut Random::new(1, "plan", 0)).unwrap().place(30.0).walked,
            0.0
        );
    }
}
