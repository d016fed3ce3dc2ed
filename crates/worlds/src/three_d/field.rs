//! A field: open, nearly flat ground, with trees at its rim only.

use portolan_geometry::Vector3;

use super::SolidPlan;
use super::SolidStyle;
use super::draft::SolidDraft;
use super::terrain::Terrain;
use super::tree::draw_tree;
use crate::random::Random;

/// Height of the undulations, metres: slopes of less than a hundredth.
const UNDULATION: f64 = 0.1;
/// Semi-axes of the ellipse on which trees stand, as a fraction of the size of the field.
const RING: f64 = 0.5;
/// Maximum distance of paths from the middle along each axis, as a fraction of the size of the field.
const REACH: f64 = 0.28;
/// Edge of the triangles of the ground, metres.
const CELL: f64 = 3.0;

/// Draws a field.
pub(crate) fn draw_field(style: &SolidStyle, seed: u64) -> SolidPlan {
    let mut random = Random::new(seed, "field", 0);
    let [width, depth] = style.size;
    let middle = [0.5 * width, 0.5 * depth];
    let terrain =
        Terrain::new(&mut random, 0.0, UNDULATION, [middle[0], middle[1], middle[0], middle[1]], 6.0);
    let mut draft = SolidDraft::default();
    let margin = 0.25 * width.min(depth);
    let site = [-margin, -margin, width + margin, depth + margin];
    terrain.draw(&mut draft, site, CELL, [0.0; 4]);
    let first = random.between(0.0, std::f64::consts::TAU);
    let trees = (4.0 * style.clutter).round() as usize;
    let mut marks = Vec::new();
    for i in 0..trees {
        let share = (i as f64 + random.between(-0.2, 0.2)) / trees as f64;
        let (sine, cosine) = libm::sincos(first + std::f64::consts::TAU * share);
        let place = terrain.point(middle[0] + RING * width * cosine, middle[1] + RING * depth * sine);
        draw_tree(&mut draft, place, &mut random, 140);
        marks.push((place + Vector3::z(), Vector3::new(-cosine, -sine, 0.0)));
    }
    let loops: Vec<Vec<Vector3>> = [0, 2, 1, 3]
        .map(|quarter| petal(&terrain, middle, quarter, [REACH * width, REACH * depth], &mut random))
        .to_vec();
    SolidPlan { strolls: loops.clone(), loops, marks, solids: draft.solids }
}

/// A closed path from the middle out in one direction, around, and back.
fn petal(
    terrain: &Terrain,
    [x, y]: [f64; 2],
    quarter: usize,
    reach: [f64; 2],
    random: &mut Random,
) -> Vec<Vector3> {
    let start = 0.5 * std::f64::consts::PI * quarter as f64 + random.between(-0.2, 0.2);
    let opening = random.between(0.7, 1.2);
    let count = (reach[0] + reach[1]).ceil() as usize;
    let point = |i: usize| {
        let share = i as f64 / count as f64;
        let round = libm::sin(std::f64::consts::PI * share).max(0.0);
        let (sine, cosine) = libm::sincos(start + opening * share);
        terrain.point(x + reach[0] * round * cosine, y + reach[1] * round * sine)
    };
    (0..=count).map(point).collect()
}
