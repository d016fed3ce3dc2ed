//! A car park: decks that look alike, joined by sloped ramps, open to the sides.

use portolan_geometry::Vector3;

use super::SolidPlan;
use super::SolidStyle;
use super::draft::SolidDraft;
use super::furnishing::{KeptFreePaths, draw_car, furnish_outdoors};
use super::terrain::Terrain;
use crate::random::Random;
use crate::two_d::Material;

const STOREY: f64 = 3.0;
const SLOPE: f64 = 0.14;
const SLAB: f64 = 0.25;
const RAMP_WIDTH: f64 = 4.0;
/// Coordinate along x at which ramps begin, metres.
const RAMP_START: f64 = 8.0;
/// Distance of the lanes from the walls, metres.
const LANE: f64 = 4.0;

struct Garage {
    size: [f64; 2],
    decks: usize,
    /// Coordinates along y of the middles of the ramps: up, down.
    ramps: [f64; 2],
    ramp_end: f64,
}

/// Draws a car park with its cars.
pub(crate) fn draw_garage(style: &SolidStyle, seed: u64) -> SolidPlan {
    let mut random = Random::new(seed, "garage", 0);
    let [width, depth] = style.size;
    let ramps = [0.5 * depth - 3.0, 0.5 * depth + 3.0];
    let garage =
        Garage { size: style.size, decks: style.storeys, ramps, ramp_end: RAMP_START + STOREY / SLOPE };
    let mut plan = SolidPlan { loops: garage.loops(), ..SolidPlan::default() };
    let mut free = KeptFreePaths::default();
    plan.loops.iter().for_each(|path| free.add(path));
    let mut draft = SolidDraft::default();
    for deck in 0..garage.decks {
        garage.draw_deck(&mut draft, deck);
        garage.park_cars(&mut draft, deck, &free, &mut random, style.clutter);
        let level = deck as f64 * STOREY;
        let corner = |x: f64, y: f64| Vector3::new(x, y, level);
        let stroll = [corner(2.5, 2.3), corner(width - 2.5, 2.3), corner(width - 2.5, 5.9), corner(2.5, 5.9)];
        plan.strolls.push(stroll.to_vec());
        plan.marks.extend([0.25, 0.75].map(|s| (corner(s * width, 0.01) + Vector3::z(), Vector3::y())));
    }
    let terrain = Terrain::new(&mut random, 0.0, 1.5, [-3.0, -3.0, width + 3.0, depth + 3.0], 12.0);
    let site = [-35.0, -35.0, width + 35.0, depth + 35.0];
    terrain.draw(&mut draft, site, 2.5, [0.0, 0.0, width, depth]);
    let ground = |x: f64, y: f64| terrain.point(x, y);
    furnish_outdoors(&mut draft, &ground, (site, &[[0.0, 0.0, width, depth]]), &free, &mut random, 30);
    for i in 0..4 {
        let (sine, cosine) = libm::sincos(1.57 * f64::from(i) + random.between(0.2, 1.2));
        let place =
            ground(0.5 * width + cosine * (0.5 * width + 20.0), 0.5 * depth + sine * (0.5 * depth + 20.0));
        let size = [random.between(8.0, 16.0), random.between(8.0, 12.0), random.between(6.0, 15.0)];
        draft.turned_block(
            place - Vector3::new(0.0, 0.0, 2.0),
            size,
            random.between(0.0, 1.5),
            Material::Wall,
        );
    }
    plan.solids = draft.solids;
    plan
}

impl Garage {
    /// Closed paths, which begin and end on the lowest deck before the ramps.
    fn loops(&self) -> Vec<Vec<Vector3>> {
        let [width, depth] = self.size;
        let (near, far, top) = (LANE, width - LANE, depth - LANE);
        let [up, down] = self.ramps;
        let at = |deck: usize, points: &[[f64; 2]]| -> Vec<Vector3> {
            points.iter().map(|[x, y]| Vector3::new(*x, *y, deck as f64 * STOREY)).collect()
        };
        let home = [near, up];
        let mut loops = Vec::new();
        for target in 1..self.decks {
            let mut path = at(0, &[home]);
            for deck in 0..target {
                path.extend(at(deck, &[[RAMP_START, up]]));
                path.extend(at(deck + 1, &[[self.ramp_end, up], [far, up - 1.0]]));
                if deck + 1 < target {
                    path.extend(at(deck + 1, &[[far, LANE], [near, LANE], [near, up]]));
                }
            }
            path.extend(at(target, &[[far, LANE], [near, LANE], [near, top], [far, top], [far, down + 1.0]]));
            for deck in (0..target).rev() {
                path.extend(at(deck + 1, &[[self.ramp_end, down]]));
                path.extend(at(deck, &[[RAMP_START, down]]));
                if deck > 0 {
                    path.extend(at(deck, &[[near, down], [near, top], [far, top], [far, down + 1.0]]));
                }
            }
            path.extend(at(0, &[[near, down], home]));
            loops.push(path);
        }
        let ground = [home, [near, LANE], [far, LANE], [far, top], [near, top], [near, down], home];
        loops.insert(usize::from(!loops.is_empty()), at(0, &ground));
        loops
    }

    fn draw_deck(&self, draft: &mut SolidDraft, deck: usize) {
        let [width, depth] = self.size;
        let level = deck as f64 * STOREY;
        let [up, down] = self.ramps;
        let half = 0.5 * RAMP_WIDTH;
        let (low, high) = (up - half, down + half);
        if deck == 0 {
            draft.block([0.0, 0.0, -0.5], [width, depth, 0.0], Material::Floor);
        } else {
            // A hole above both ramps, and the strip of floor between them.
            let hole = [RAMP_START + 4.0, low, self.ramp_end, high];
            draft.floor([0.0, 0.0, width, depth], level, SLAB, Some(hole), Material::Floor);
            draft.block([hole[0], up + half, level - SLAB], [hole[2], down - half, level], Material::Floor);
        }
        if deck + 1 < self.decks {
            for middle in self.ramps {
                let corner = |x: f64, dy: f64, z: f64| Vector3::new(x, middle + dy, z);
                let (top, end) = (level + STOREY, self.ramp_end);
                let surface = [
                    corner(RAMP_START, -half, level),
                    corner(end, -half, top),
                    corner(end, half, top),
                    corner(RAMP_START, half, level),
                ];
                draft.quad(surface, Material::Floor);
                for side in [-half, half] {
                    let curb = Vector3::new(0.0, 0.0, 0.8);
                    let (a, b) = (corner(RAMP_START, side, level), corner(end, side, top));
                    draft.quad([a, b, b + curb, a + curb], Material::Wall);
                }
            }
        }
        let parapet = [level, level + 1.1];
        for (min, max) in [
            ([0.0, -0.2], [width, 0.0]),
            ([0.0, depth], [width, depth + 0.2]),
            ([-0.2, 0.0], [0.0, depth]),
            ([width, 0.0], [width + 0.2, depth]),
        ] {
            draft.block([min[0], min[1], parapet[0]], [max[0], max[1], parapet[1]], Material::Wall);
        }
        if deck + 1 < self.decks {
            self.draw_pillars(draft, level);
        }
    }

    fn draw_pillars(&self, draft: &mut SolidDraft, level: f64) {
        let [width, depth] = self.size;
        let columns = (width / 8.0).round().max(2.0) as usize;
        for column in 0..=columns {
            let x = 0.3 + (width - 0.6) * column as f64 / columns as f64;
            for y in [0.3, 6.6, self.ramps[0] - 2.4, self.ramps[1] + 2.4, depth - 6.6, depth - 0.3] {
                // Not on the crossings between the lanes.
                let crossing = (1.0..7.0).contains(&x) || (width - 7.0..width - 1.0).contains(&x);
                if !crossing || y < 1.0 || y > depth - 1.0 {
                    let foot = Vector3::new(x, y, level);
                    draft.turned_block(foot, [0.4, 0.4, STOREY - SLAB], 0.0, Material::Wall);
                }
            }
        }
    }

    fn park_cars(
        &self,
        draft: &mut SolidDraft,
        deck: usize,
        free: &KeptFreePaths,
        random: &mut Random,
        clutter: f64,
    ) {
        let [width, depth] = self.size;
        let slots = ((width - 16.0) / 2.6).max(0.0) as usize;
        for slot in 0..slots {
            for y in [-2.0 + LANE - 0.2, LANE + 4.6, depth - LANE - 4.6, depth - LANE + 2.2] {
                let x = 8.0 + 2.6 * (slot as f64 + 0.5) + random.between(-0.2, 0.2);
                let yaw = 0.5 * std::f64::consts::PI + random.between(-0.06, 0.06);
                let place = Vector3::new(x, y, deck as f64 * STOREY);
                let is_taken = random.chance(0.45 * clutter);
                if is_taken && free.distance(&place) > 1.6 && y > 0.0 && y < depth {
                    draw_car(draft, place, yaw, random);
                }
            }
        }
    }
}
