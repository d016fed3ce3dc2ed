//! A park: hills, trees, bushes, and winding paths; a few houses around.

use portolan_geometry::Vector3;

use super::SolidPlan;
use super::SolidStyle;
use super::draft::SolidDraft;
use super::furnishing::{KeptFreePaths, furnish_outdoors};
use super::terrain::Terrain;
use crate::random::Random;
use crate::two_d::Material;

/// Approximate distance between the points of a path, metres.
const STEP: f64 = 1.0;

/// Draws a park.
pub(crate) fn draw_park(style: &SolidStyle, seed: u64) -> SolidPlan {
    let mut random = Random::new(seed, "park", 0);
    let [width, depth] = style.size;
    let middle = [0.5 * width, 0.5 * depth];
    let home = [middle[0] - 2.0, middle[1] - 2.0, middle[0] + 2.0, middle[1] + 2.0];
    let terrain = Terrain::new(&mut random, 0.0, 2.2, home, 14.0);
    let mut plan = SolidPlan::default();
    for quarter in [0, 2, 1, 3] {
        plan.loops.push(petal(&terrain, middle, quarter, [0.46 * width, 0.46 * depth], &mut random));
    }
    plan.strolls = plan.loops.iter().map(|path| shifted(&terrain, path)).collect();
    let mut free = KeptFreePaths::default();
    plan.loops.iter().for_each(|path| free.add(path));
    let mut draft = SolidDraft::default();
    let site = [-25.0, -25.0, width + 25.0, depth + 25.0];
    terrain.draw(&mut draft, site, 1.5, [0.0; 4]);
    let trees = (width * depth * 0.009 * style.clutter) as usize;
    let ground = |x: f64, y: f64| terrain.point(x, y);
    furnish_outdoors(&mut draft, &ground, (site, &[]), &free, &mut random, trees);
    for i in 0..6 {
        let (sine, cosine) = libm::sincos(1.05 * f64::from(i) + random.between(-0.2, 0.2));
        let place = ground(middle[0] + cosine * (middle[0] + 14.0), middle[1] + sine * (middle[1] + 14.0));
        let size = [random.between(7.0, 16.0), random.between(7.0, 11.0), random.between(6.0, 13.0)];
        let foot = place - Vector3::new(0.0, 0.0, 2.5);
        draft.turned_block(foot, size, random.between(0.0, 1.5), Material::Wall);
        plan.marks.push((
            place + Vector3::new(-cosine, -sine, 0.0) * 8.0 + Vector3::z(),
            Vector3::new(-cosine, -sine, 0.0),
        ));
    }
    // A kiosk by the middle.
    let kiosk = ground(middle[0] + 5.0, middle[1] + 0.5);
    if free.distance(&kiosk) > 2.5 {
        draft.turned_block(kiosk, [2.4, 2.4, 2.6], 0.4, Material::Wall);
    }
    plan.solids = draft.solids;
    plan
}

/// A closed path from the middle into one quarter and back.
fn petal(
    terrain: &Terrain,
    [x, y]: [f64; 2],
    quarter: usize,
    reach: [f64; 2],
    random: &mut Random,
) -> Vec<Vector3> {
    let start = 0.5 * std::f64::consts::PI * quarter as f64;
    let wobble =
        [random.between(0.05, 0.14), random.between(0.0, std::f64::consts::TAU), random.between(0.78, 0.95)];
    let count = ((reach[0] + reach[1]) * 1.6 / STEP) as usize;
    let point = |i: usize| {
        let share = i as f64 / count as f64;
        let angle = start + 0.5 * std::f64::consts::PI * (0.06 + 0.88 * share);
        // A petal of a rose: out and back, with bends.
        let round = libm::sin(std::f64::consts::PI * share).max(0.0).sqrt();
        let bends = 1.0 + wobble[0] * libm::sin(14.0 * share + wobble[1]);
        let (sine, cosine) = libm::sincos(angle);
        let radius = round * bends.min(1.1) * wobble[2] / 1.1;
        terrain.point(x + reach[0] * radius * cosine, y + reach[1] * radius * sine)
    };
    (0..=count).map(point).collect()
}

/// A path beside another one.
fn shifted(terrain: &Terrain, path: &[Vector3]) -> Vec<Vector3> {
    path.iter().map(|p| terrain.point(p.x + 1.7, p.y + 1.3)).collect()
}
