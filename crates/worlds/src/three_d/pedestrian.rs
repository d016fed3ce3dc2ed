//! People: a trunk, a head and two swinging legs on a closed path.

use portolan_geometry::Vector3;

use super::primitive::{Body, Hit3, Ray3};
use crate::two_d::Material;

const LEG_HEIGHT: f64 = 0.85;
const LEG_RADIUS: f64 = 0.09;
const TRUNK_RADIUS: f64 = 0.2;
const TRUNK_HEIGHT: f64 = 0.65;
const HEAD_RADIUS: f64 = 0.12;
const HEAD_CENTRE: f64 = 1.64;
/// Distance of a leg from the middle of the body, to the side, metres.
const LEG_SIDE: f64 = 0.1;
/// Amplitude of the swing of a leg ahead and back, metres.
const LEG_SWING: f64 = 0.28;
/// Length of two steps, metres.
const STRIDE: f64 = 1.35;
/// Radius of the upright cylinder around the middle of a person that contains all parts, metres.
const GIRTH: f64 = 0.5;
const HEIGHT: f64 = 1.8;

/// A person who walks on a closed path without end.
#[derive(Clone, Debug)]
pub struct Pedestrian {
    /// Corners of the path on the ground; the last one repeats the first.
    corners: Vec<Vector3>,
    /// Length of the path up to each corner, metres.
    lengths: Vec<f64>,
    speed: f64,
    /// Position along the path at time 0, metres.
    offset: f64,
}

impl Pedestrian {
    /// A person who walks through the corners and back to the first at `speed` m/s, starting `offset`
    /// metres along the path; none if the path has no length.
    pub fn new(path: &[Vector3], speed: f64, offset: f64) -> Option<Self> {
        let mut corners = path.to_vec();
        corners.push(*path.first()?);
        let mut lengths = vec![0.0];
        let mut length = 0.0;
        for pair in corners.windows(2) {
            length += (pair[1] - pair[0]).norm();
            lengths.push(length);
        }
        (length > 0.1 && length.is_finite()).then_some(Self { corners, lengths, speed, offset })
    }

    /// Position on the ground, unit direction, and distance along the path at a time.
    fn place(&self, time: f64) -> (Vector3, Vector3, f64) {
        let total = self.lengths.last().copied().unwrap_or(1.0);
        let along = (self.offset + self.speed * time).rem_euclid(total);
        let after = self.lengths.partition_point(|l| *l <= along).clamp(1, self.corners.len() - 1);
        let (from, to) = (self.corners[after - 1], self.corners[after]);
        let length = self.lengths[after] - self.lengths[after - 1];
        let direction = if length > 0.0 { (to - from) / length } else { Vector3::x() };
        (from + direction * (along - self.lengths[after - 1]), direction, along)
    }

    /// Position on the ground at a time, metres.
    pub fn position(&self, time: f64) -> Vector3 {
        self.place(time).0
    }

    /// The person during `duration` seconds from `start` on.
    pub(super) fn walker(&self, start: f64, duration: f64) -> Walker {
        Walker { parts: [self.parts(start), self.parts(start + duration)] }
    }

    /// Positions on the ground of the left foot, the right foot and the middle.
    fn parts(&self, time: f64) -> [Vector3; 3] {
        let (place, direction, along) = self.place(time);
        let left = Vector3::new(-direction.y, direction.x, 0.0) * LEG_SIDE;
        let swing = direction * (LEG_SWING * libm::sin(std::f64::consts::TAU * along / STRIDE));
        [place + left + swing, place - left - swing, place]
    }
}

/// A person at the start and at the end of a short time.
#[derive(Clone, Debug)]
pub(super) struct Walker {
    parts: [[Vector3; 3]; 2],
}

impl Walker {
    pub fn is_within(&self, place: &Vector3, reach: f64) -> bool {
        (self.parts[0][2] - place).norm() <= reach
    }

    pub fn meet(&self, ray: &Ray3, limit: f64, share: f64) -> Option<Hit3> {
        let now = |part: usize| self.parts[0][part] + (self.parts[1][part] - self.parts[0][part]) * share;
        let middle = now(2);
        if !may_meet(ray, &middle, limit) {
            return None;
        }
        let up = |z: f64| Vector3::new(0.0, 0.0, z);
        let bodies = [
            Body::Cylinder { base: now(0), radius: LEG_RADIUS, height: LEG_HEIGHT },
            Body::Cylinder { base: now(1), radius: LEG_RADIUS, height: LEG_HEIGHT },
            Body::Cylinder { base: middle + up(LEG_HEIGHT), radius: TRUNK_RADIUS, height: TRUNK_HEIGHT },
            Body::Ball { centre: middle + up(HEAD_CENTRE), radius: HEAD_RADIUS },
        ];
        let met = bodies.iter().filter_map(|body| body.meet(ray, limit));
        let (range, normal) = met.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(Hit3 { range, normal, material: Material::Person })
    }
}

/// Whether the ray comes near the upright cylinder that contains the person.
fn may_meet(ray: &Ray3, middle: &Vector3, limit: f64) -> bool {
    let (x, y) = (middle.x - ray.origin.x, middle.y - ray.origin.y);
    let (dx, dy) = (ray.direction.x, ray.direction.y);
    let horizontal = dx * dx + dy * dy;
    let along = x * dx + y * dy;
    let aside = x * dy - y * dx;
    if aside * aside > GIRTH * GIRTH * horizontal || (along < 0.0 && x * x + y * y > GIRTH * GIRTH) {
        return false;
    }
    let nearest = along / horizontal.max(1e-12);
    let slack = GIRTH / horizontal.max(1e-12).sqrt();
    if nearest - slack > limit {
        return false;
    }
    let z = ray.origin.z + ray.direction.z * nearest;
    let dz = (ray.direction.z * slack).abs();
    z + dz >= middle.z && z - dz <= middle.z + HEIGHT
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Random;

    #[test]
    fn people_go_round_and_are_met_where_they_are() {
        let path = [Vector3::zeros(), Vector3::new(4.0, 0.0, 0.0), Vector3::new(4.0, 3.0, 0.0)];
        let person = Pedestrian::new(&path, 1.0, 0.0).unwrap();
        assert!((person.position(4.0) - path[1]).norm() < 1e-12);
        assert!((person.position(12.0 + 1.0) - Vector3::x()).norm() < 1e-9);
        let walker = person.walker(2.0, 0.1);
        let ray = Ray3 { origin: Vector3::new(2.0, -5.0, 1.2), direction: Vector3::y() };
        assert!((walker.meet(&ray, 20.0, 0.0).unwrap().range - (5.0 - TRUNK_RADIUS)).abs() < 1e-12);
        let later = walker.meet(&ray, 20.0, 1.0).unwrap().range;
        assert!((later - (5.0 - (TRUNK_RADIUS * TRUNK_RADIUS - 0.01_f64).sqrt())).abs() < 1e-9);
        assert!(Pedestrian::new(&path[..1], 1.0, 0.0).is_none() && Pedestrian::new(&[], 1.0, 0.0).is_none());
    }

    #[test]
    fn the_coarse_test_misses_no_person() {
        let path = [Vector3::zeros(), Vector3::new(4.0, 1.0, 0.0)];
        let person = Pedestrian::new(&path, 1.2, 0.3).unwrap();
        let mut random = Random::new(9, "people", 0);
        let mut met = 0;
        for i in 0..20_000 {
            let walker = person.walker(f64::from(i) * 0.01, 0.1);
            let origin =
                Vector3::new(random.between(-3.0, 6.0), random.between(-3.0, 3.0), random.between(0.0, 3.0));
            let target = walker.parts[0][2]
                + Vector3::new(random.gaussian(), random.gaussian(), 1.0 + random.gaussian());
            let ray = Ray3 { origin, direction: (target - origin).normalize() };
            let [left, right, middle] = walker.parts[0];
            let exact = [
                Body::Cylinder { base: left, radius: LEG_RADIUS, height: LEG_HEIGHT },
                Body::Cylinder { base: right, radius: LEG_RADIUS, height: LEG_HEIGHT },
                Body::Cylinder {
                    base: middle + Vector3::new(0.0, 0.0, LEG_HEIGHT),
                    radius: TRUNK_RADIUS,
                    height: TRUNK_HEIGHT,
                },
                Body::Ball { centre: middle + Vector3::new(0.0, 0.0, HEAD_CENTRE), radius: HEAD_RADIUS },
            ];
            let exact = exact.iter().filter_map(|b| b.meet(&ray, 50.0)).map(|m| m.0).min_by(f64::total_cmp);
            assert_eq!(walker.meet(&ray, 50.0, 0.0).map(|h| h.range), exact);
            met += usize::from(exact.is_some());
        }
        assert!(met > 1000);
    }
}
