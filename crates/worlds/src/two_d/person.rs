//! People who walk to and fro, seen by the lidar as two legs.

use portolan_geometry::Vector2;

use super::shape::{Hit, Material, Ray, Shape, cross};

/// Leg radius at shin height, metres.
const LEG_RADIUS: f64 = 0.065;
/// Distance of a leg from the middle of the body, to the side, metres.
const HALF_STANCE: f64 = 0.11;
/// Amplitude of the swing of a foot ahead of the body and back, metres.
const SWING: f64 = 0.28;
/// Length of a full cycle of steps, metres.
const STRIDE: f64 = 1.35;
/// Radius around the middle of the body that contains both legs, metres.
const PERSON_RADIUS: f64 = 0.4;
/// Approximate distance that people keep from the middle of the robot, metres.
const KEEP_CLEAR: f64 = 0.75;
/// Distance from the robot below which people step aside, metres.
const NOTICE: f64 = 2.5;

/// A person who walks along a polyline to its end and back, without end.
#[derive(Clone, Debug)]
pub struct Person {
    corners: Vec<Vector2>,
    /// Distance from the start to each corner, metres.
    distances: Vec<f64>,
    speed: f64,
    head_start: f64,
}

impl Person {
    /// A person who walks along `corners` at `speed` m/s, at time 0 `head_start` metres from the first
    /// corner. With a single corner the person stands still; none without corners.
    pub fn new(corners: Vec<Vector2>, speed: f64, head_start: f64) -> Option<Self> {
        let mut distances = vec![0.0];
        let mut total = 0.0;
        for pair in corners.windows(2) {
            total += (pair[1] - pair[0]).norm();
            distances.push(total);
        }
        (!corners.is_empty()).then_some(Self { corners, distances, speed, head_start })
    }

    /// Middle of the body and walking direction without stepping aside.
    fn undisturbed(&self, time: f64) -> (Vector2, Vector2) {
        let total = self.distances.last().copied().unwrap_or(0.0);
        if total <= 0.0 {
            return (self.corners[0], Vector2::x());
        }
        let cycle = (self.head_start + self.speed * time).rem_euclid(2.0 * total);
        let (along, sign) = if cycle <= total { (cycle, 1.0) } else { (2.0 * total - cycle, -1.0) };
        let next = self.distances.partition_point(|d| *d <= along).clamp(1, self.distances.len() - 1);
        let (from, to) = (self.corners[next - 1], self.corners[next]);
        let length = self.distances[next] - self.distances[next - 1];
        let direction = if length > 0.0 { (to - from) / length } else { Vector2::x() };
        (from + direction * (along - self.distances[next - 1]), direction * sign)
    }

    /// Middle of the body at `time` seconds while the robot is at `robot`: people step aside.
    pub fn position(&self, time: f64, robot: &Vector2) -> Vector2 {
        step_aside(self.undisturbed(time), robot)
    }

    /// Both legs at `time` seconds while the robot is at `robot`.
    pub fn legs(&self, time: f64, robot: &Vector2) -> [Shape; 2] {
        let (middle, direction) = self.undisturbed(time);
        let centre = step_aside((middle, direction), robot);
        let side = Vector2::new(-direction.y, direction.x) * HALF_STANCE;
        let phase = (self.head_start + self.speed * time) * std::f64::consts::TAU / STRIDE;
        let ahead = direction * (SWING * libm::sin(phase));
        [centre + side + ahead, centre - side - ahead]
            .map(|foot| Shape::circle(foot, LEG_RADIUS, Material::Person))
    }
}

/// Moves a person radially away from the robot. The new distance is a continuous function of the old one,
/// from [`KEEP_CLEAR`] at 0 to [`NOTICE`] at [`NOTICE`].
fn step_aside((middle, direction): (Vector2, Vector2), robot: &Vector2) -> Vector2 {
    let away = middle - robot;
    let distance = away.norm();
    if distance >= NOTICE {
        return middle;
    }
    let nearness = 1.0 - distance / NOTICE;
    let wanted = (distance * distance + KEEP_CLEAR * KEEP_CLEAR * nearness * nearness).sqrt();
    let outwards = if distance > 1e-9 { away / distance } else { Vector2::new(-direction.y, direction.x) };
    robot + outwards * wanted
}

/// The people whom the beams of one scan may meet.
#[derive(Clone, Debug, Default)]
pub struct NearbyPeople<'a> {
    /// A person, the position in the middle of the scan, and the maximum distance of a leg from there,
    /// metres.
    people: Vec<(&'a Person, Vector2, f64)>,
}

impl<'a> NearbyPeople<'a> {
    /// People within `reach` metres of the robot, which is at `robot` at `time`, for beams fired at most
    /// `half_sweep` seconds before or after.
    pub fn around(people: &'a [Person], time: f64, half_sweep: f64, robot: &Vector2, reach: f64) -> Self {
        let near = people.iter().filter_map(|person| {
            let position = person.position(time, robot);
            let distance = (position - robot).norm();
            // A person about to collide with the robot may step aside in any direction.
            let moves = if distance < 2.0 * KEEP_CLEAR { f64::INFINITY } else { 3.0 * half_sweep };
            (distance < reach).then_some((person, position, PERSON_RADIUS + moves))
        });
        Self { people: near.collect() }
    }

    /// The nearest leg that a ray meets at `time` seconds while the robot is at `robot`.
    pub fn cast(&self, ray: &Ray, time: f64, robot: &Vector2) -> Option<Hit> {
        let mut nearest: Option<Hit> = None;
        for (person, position, radius) in &self.people {
            let to_person = position - ray.origin;
            if cross(&ray.direction, &to_person).abs() > *radius || ray.direction.dot(&to_person) < -radius {
                continue;
            }
            for hit in person.legs(time, robot).iter().filter_map(|leg| leg.intersect(ray)) {
                if nearest.is_none_or(|best| hit.range < best.range) {
                    nearest = Some(hit);
                }
            }
        }
        nearest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn walking_person() -> Person {
        let corners = vec![Vector2::new(0.0, 0.0), Vector2::new(10.0, 0.0), Vector2::new(10.0, 5.0)];
        Person::new(corners, 1.0, 2.0).unwrap()
    }

    #[test]
    fn walks_to_the_end_and_back() {
        let far = Vector2::new(-100.0, 0.0);
        let person = walking_person();
        assert!((person.position(0.0, &far) - Vector2::new(2.0, 0.0)).norm() < 1e-12);
        assert!((person.position(10.0, &far) - Vector2::new(10.0, 2.0)).norm() < 1e-12);
        assert!((person.position(14.0, &far) - Vector2::new(10.0, 4.0)).norm() < 1e-12);
        assert!((person.position(28.0, &far) - Vector2::new(0.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn never_walks_through_the_robot() {
        let person = walking_person();
        let robot = Vector2::new(5.0, 0.01);
        for i in 0..4000 {
            let time = f64::from(i) * 0.01;
            let [left, right] = person.legs(time, &robot);
            assert!(left.distance(&robot) > 0.25 && right.distance(&robot) > 0.25);
            let moved = person.position(time + 0.01, &robot) - person.position(time, &robot);
            assert!(moved.norm() < 0.08 || (person.position(time, &robot) - robot).norm() < 0.8);
        }
    }
}
