//! A world with people, and the returns of beams: panes give a return or are passed at random, and mirrors
//! show mirror images.

use portolan_geometry::Vector3;

use super::bvh::Hierarchy;
use super::pedestrian::{Pedestrian, Walker};
use super::primitive::{Hit3, Ray3, Solid};
use crate::random::Random;
use crate::two_d::Material;

/// Maximum number of surfaces that a beam hits; a beam that passes as many panes and mirrors has no return.
const MAX_SURFACES: usize = 8;
/// Fraction of light that a mirror reflects.
const MIRROR_SHARE: f64 = 0.9;
/// Fraction of light that passes a pane, there and back.
const PANE_SHARE: f64 = 0.8;

/// Fixed solids and people who walk.
#[derive(Clone, Debug)]
pub struct SolidWorld {
    fixed: Hierarchy,
    people: Vec<Pedestrian>,
}

/// Return of a beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Echo {
    /// Length of the path of the light, one way, metres.
    pub range: f64,
    /// Cosine of the angle between beam and normal at the surface that scattered it back, in [0, 1].
    pub cosine: f64,
    /// Fraction of the light that is scattered back there, reduced by panes and mirrors on the path.
    pub albedo: f64,
    /// Material of the surface.
    pub material: Material,
}

/// The people near a position during a short time.
#[derive(Clone, Debug, Default)]
pub struct Moment {
    walkers: Vec<Walker>,
}

impl SolidWorld {
    /// Builds the hierarchy of the solids.
    pub fn new(solids: Vec<Solid>, people: Vec<Pedestrian>) -> Self {
        Self { fixed: Hierarchy::new(solids), people }
    }

    /// All fixed solids.
    pub fn fixed(&self) -> &Hierarchy {
        &self.fixed
    }

    /// The people who walk.
    pub fn people(&self) -> &[Pedestrian] {
        &self.people
    }

    /// The people within `reach` metres of `place` from `start` for `duration` seconds.
    pub fn moment(&self, place: &Vector3, reach: f64, start: f64, duration: f64) -> Moment {
        let walkers = self.people.iter().map(|person| person.walker(start, duration));
        Moment { walkers: walkers.filter(|walker| walker.is_within(place, reach + 2.0)).collect() }
    }

    /// The first surface that a beam hits, of any material; `share` is the fraction of the moment that has
    /// passed, 0 to 1.
    pub fn cast(&self, ray: &Ray3, limit: f64, moment: &Moment, share: f64) -> Option<Hit3> {
        let mut nearest = self.fixed.cast(ray, limit);
        for walker in &moment.walkers {
            let limit = nearest.map_or(limit, |hit| hit.range);
            if let Some(hit) = walker.meet(ray, limit, share) {
                nearest = Some(hit);
            }
        }
        nearest
    }

    /// The return of a beam within `limit` metres. With `chance`, panes give a return at random, most
    /// likely at normal incidence, and are passed otherwise; without it they are always passed. Mirrors
    /// reflect the beam, and the surface that it then hits seems to be behind them.
    pub fn echo(
        &self,
        ray: &Ray3,
        limit: f64,
        (moment, share): (&Moment, f64),
        mut chance: Option<&mut Random>,
    ) -> Option<Echo> {
        let (mut ray, mut travelled, mut light) = (*ray, 0.0, 1.0);
        for _ in 0..MAX_SURFACES {
            let hit = self.cast(&ray, limit - travelled, moment, share)?;
            let cosine = -hit.normal.dot(&ray.direction);
            let echo = Echo {
                range: travelled + hit.range,
                cosine: cosine.clamp(0.0, 1.0),
                albedo: light * hit.material.albedo(),
                material: hit.material,
            };
            let onward = match hit.material {
                Material::Mirror => {
                    light *= MIRROR_SHARE;
                    ray.direction + hit.normal * (2.0 * cosine)
                }
                Material::Glass => {
                    let is_seen = chance.as_mut().is_some_and(|random| random.chance(pane_return(cosine)));
                    if is_seen {
                        return Some(echo);
                    }
                    light *= PANE_SHARE;
                    ray.direction
                }
                _ => return Some(echo),
            };
            travelled += hit.range;
            ray = Ray3 { origin: ray.at(hit.range), direction: onward };
        }
        None
    }
}

/// Probability that a pane gives a return: by dust at any angle, and by its own reflection near normal
/// incidence.
fn pane_return(cosine: f64) -> f64 {
    let c4 = cosine * cosine * cosine * cosine;
    let c16 = c4 * c4 * c4 * c4;
    0.05 + 0.75 * c16 * c16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::three_d::SolidDraft;

    #[test]
    fn a_mirror_shows_the_wall_behind_the_lidar() {
        let mut draft = SolidDraft::default();
        draft.block([2.0, -1.0, 0.0], [2.1, 1.0, 2.0], Material::Mirror);
        draft.block([-3.1, -1.0, 0.0], [-3.0, 1.0, 2.0], Material::Wall);
        let world = SolidWorld::new(draft.solids, Vec::new());
        let ray = Ray3 { origin: Vector3::new(0.0, 0.0, 1.0), direction: Vector3::x() };
        let echo = world.echo(&ray, 50.0, (&Moment::default(), 0.0), None).unwrap();
        assert!((echo.range - 7.0).abs() < 1e-12 && echo.material == Material::Wall);
        assert!((echo.albedo - 0.9 * Material::Wall.albedo()).abs() < 1e-12);
        assert!(world.echo(&ray, 6.9, (&Moment::default(), 0.0), None).is_none());
    }

    #[test]
    fn panes_are_seen_head_on_and_passed_aslant() {
        let mut draft = SolidDraft::default();
        draft.block([2.0, -50.0, -50.0], [2.01, 50.0, 50.0], Material::Glass);
        draft.block([5.0, -50.0, -50.0], [5.1, 50.0, 50.0], Material::Wall);
        let world = SolidWorld::new(draft.solids, Vec::new());
        let mut random = Random::new(1, "panes", 0);
        let mut seen = |direction: Vector3| {
            let ray = Ray3 { origin: Vector3::zeros(), direction: direction.normalize() };
            let echoes = (0..1000)
                .filter_map(|_| world.echo(&ray, 100.0, (&Moment::default(), 0.0), Some(&mut random)));
            echoes.filter(|echo| echo.material == Material::Glass).count()
        };
        assert!((700..900).contains(&seen(Vector3::x())));
        assert!((20..90).contains(&seen(Vector3::new(1.0, 1.0, 0.0))));
        let ray = Ray3 { origin: Vector3::zeros(), direction: Vector3::x() };
        let through = world.echo(&ray, 100.0, (&Moment::default(), 0.0), None).unwrap();
        assert!((through.range - 5.0).abs() < 1e-12);
    }
}
