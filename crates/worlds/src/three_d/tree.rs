//! Trees: a trunk and a crown of many leaves, between which a beam may pass.

use portolan_geometry::Vector3;

use super::draft::SolidDraft;
use super::primitive::Body;
use crate::random::Random;
use crate::two_d::Material;

/// Draws a tree with about `leaves` leaves (as triangles of a quarter of a metre).
pub(super) fn draw_tree(draft: &mut SolidDraft, foot: Vector3, random: &mut Random, leaves: usize) {
    let height = random.between(4.0, 8.5);
    let trunk = random.between(0.1, 0.25);
    draft.column(foot - Vector3::new(0.0, 0.0, 0.3), trunk, 0.6 * height + 0.3, Material::Bark);
    let crown = Vector3::new(0.0, 0.0, 0.68 * height);
    let (across, up) = (random.between(0.22, 0.34) * height, 0.3 * height);
    for _ in 0..leaves {
        let mut place = Vector3::new(random.gaussian(), random.gaussian(), random.gaussian());
        let length = place.norm().max(1e-9);
        // More leaves outside than inside.
        let radius = random.between(0.45, 1.0);
        place *= radius / length;
        let centre = foot + crown + Vector3::new(place.x * across, place.y * across, place.z * up);
        let mut edge = || Vector3::new(random.gaussian(), random.gaussian(), 0.6 * random.gaussian()) * 0.22;
        draft.add(Body::Triangle { corner: centre, edges: [edge(), edge()] }, Material::Foliage);
    }
}

/// Draws a bush: leaves near the ground.
pub(super) fn draw_bush(draft: &mut SolidDraft, foot: Vector3, random: &mut Random) {
    let (across, height) = (random.between(0.4, 0.9), random.between(0.5, 1.2));
    for _ in 0..40 {
        let (a, r) = (random.between(0.0, std::f64::consts::TAU), random.uniform().sqrt() * across);
        let (sine, cosine) = libm::sincos(a);
        let centre = foot + Vector3::new(r * cosine, r * sine, random.between(0.05, height));
        let mut edge = || Vector3::new(random.gaussian(), random.gaussian(), random.gaussian()) * 0.14;
        draft.add(Body::Triangle { corner: centre, edges: [edge(), edge()] }, Material::Foliage);
    }
}
