//! Furniture of halls and objects outdoors, away from the paths.

use portolan_geometry::Vector3;

use super::draft::SolidDraft;
use super::primitive::Body;
use super::tree::{draw_bush, draw_tree};
use crate::random::Random;
use crate::two_d::Material;

/// Paths that are kept free.
#[derive(Clone, Debug, Default)]
pub(super) struct KeptFreePaths {
    segments: Vec<[Vector3; 2]>,
}

impl KeptFreePaths {
    pub fn add(&mut self, path: &[Vector3]) {
        self.segments.extend(path.windows(2).map(|pair| [pair[0], pair[1]]));
    }

    /// Horizontal distance of a position from the nearest path on its storey, metres.
    pub fn distance(&self, place: &Vector3) -> f64 {
        let near = self
            .segments
            .iter()
            .filter(|s| s[0].z.min(s[1].z) - 1.5 < place.z && place.z < s[0].z.max(s[1].z) + 1.5);
        near.map(|s| horizontal_distance(place, s)).fold(f64::INFINITY, f64::min)
    }
}

fn horizontal_distance(place: &Vector3, [from, to]: &[Vector3; 2]) -> f64 {
    let (along, offset) = ((to - from).xy(), (place - from).xy());
    let share = (offset.dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
    (offset - along * share).norm()
}

/// A hall: a rectangle `[x0, y0, x1, y1]` on a storey.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hall {
    pub area: [f64; 4],
    pub level: f64,
    pub height: f64,
}

impl Hall {
    fn place(&self, random: &mut Random, margin: f64) -> Option<Vector3> {
        let [x0, y0, x1, y1] = self.area;
        let fits = x1 - x0 > 2.0 * margin && y1 - y0 > 2.0 * margin;
        fits.then(|| {
            let (x, y) = (random.between(x0 + margin, x1 - margin), random.between(y0 + margin, y1 - margin));
            Vector3::new(x, y, self.level)
        })
    }

    /// Furnishes the hall; `clutter` 1 is the usual density.
    pub fn furnish(&self, draft: &mut SolidDraft, free: &KeptFreePaths, random: &mut Random, clutter: f64) {
        let [x0, y0, x1, y1] = self.area;
        let tries = ((x1 - x0) * (y1 - y0) * 0.4 * clutter) as usize;
        let kind_of_hall = random.below(3);
        for _ in 0..tries {
            let kind = (random.below(6) + 2 * kind_of_hall) % 8;
            let radius: f64 = [0.35, 0.5, 0.8, 1.6, 0.9, 0.45, 0.7, 0.3][kind];
            let Some(place) = self.place(random, radius.min(1.2)) else { continue };
            if free.distance(&place) > radius + 0.55 {
                draw_exhibit(draft, kind, place, self.height, random);
            }
        }
        self.hang_pictures(draft, random, clutter);
        for _ in 0..((x1 - x0) * (y1 - y0) / 18.0) as usize {
            if let Some(place) = self.place(random, 1.0) {
                let low = place + Vector3::new(0.0, 0.0, self.height - random.between(0.5, 1.1));
                draft.turned_block(low, [0.6, 0.3, 0.12], random.between(0.0, 3.0), Material::Metal);
            }
        }
    }

    /// Hangs frames of random size on the four walls, at least 2.45 m above the floor.
    fn hang_pictures(&self, draft: &mut SolidDraft, random: &mut Random, clutter: f64) {
        let [x0, y0, x1, y1] = self.area;
        for (along, from, to, at, inward) in
            [(0, x0, x1, y0, 1.0), (0, x0, x1, y1, -1.0), (1, y0, y1, x0, 1.0), (1, y0, y1, x1, -1.0)]
        {
            for _ in 0..((to - from) * 0.4 * clutter) as usize {
                let middle = random.between(from + 0.8, (to - 0.8).max(from + 0.9));
                let (wide, low, high) =
                    (random.between(0.3, 0.8), random.between(2.45, 2.7), random.between(2.8, 3.6));
                let deep = random.between(0.04, 0.14);
                let (a, b) = (at.min(at + inward * deep), at.max(at + inward * deep));
                let (low, high) = (self.level + low, self.level + high.min(self.height - 0.2));
                let (min, max) = if along == 0 {
                    ([middle - wide, a, low], [middle + wide, b, high])
                } else {
                    ([a, middle - wide, low], [b, middle + wide, high])
                };
                draft.block(min, max, Material::Furniture);
            }
        }
    }
}

fn draw_exhibit(draft: &mut SolidDraft, kind: usize, place: Vector3, height: f64, random: &mut Random) {
    let yaw = random.between(0.0, std::f64::consts::PI);
    let up = |z: f64| place + Vector3::new(0.0, 0.0, z);
    match kind {
        // A statue on a pedestal.
        0 => {
            let pedestal = random.between(0.5, 1.1);
            draft.turned_block(place, [0.6, 0.6, pedestal], yaw, Material::Wall);
            draft.column(up(pedestal), random.between(0.12, 0.22), 0.7, Material::Wall);
            draft.add(Body::Ball { centre: up(pedestal + 0.85), radius: 0.17 }, Material::Wall);
        }
        // A glass case with an exhibit.
        1 => {
            draft.turned_block(place, [0.8, 0.8, 0.9], yaw, Material::Furniture);
            draft.add(Body::Ball { centre: up(1.1), radius: random.between(0.08, 0.18) }, Material::Metal);
            draft.turned_block(up(0.9), [0.76, 0.76, 0.6], yaw, Material::Glass);
        }
        2 => draw_bench(draft, place, yaw),
        // A partition with pictures.
        3 => draft.turned_block(place, [0.16, random.between(1.6, 3.0), 2.6], yaw, Material::Wall),
        // A table with chairs.
        4 => {
            draft.column(place, 0.06, 0.72, Material::Metal);
            draft.column(up(0.72), 0.6, 0.04, Material::Furniture);
            for turn in 0..3 {
                let (sine, cosine) = libm::sincos(yaw + 2.1 * f64::from(turn));
                let seat = place + Vector3::new(cosine, sine, 0.0) * 0.75;
                draft.turned_block(
                    seat + Vector3::new(0.0, 0.0, 0.4),
                    [0.4, 0.4, 0.06],
                    yaw,
                    Material::Furniture,
                );
                draft.column(seat, 0.03, 0.4, Material::Metal);
            }
        }
        // A pillar up to the ceiling.
        5 => draft.column(place, random.between(0.2, 0.38), height, Material::Wall),
        // Shelves.
        6 => {
            for shelf in 0..5 {
                let z = 0.05 + 0.45 * f64::from(shelf);
                draft.turned_block(up(z), [0.35, 1.2, 0.03], yaw, Material::Furniture);
            }
            draft.turned_block(place, [0.04, 1.2, 1.9], yaw, Material::Furniture);
        }
        // A plant.
        _ => {
            draft.column(place, 0.2, 0.4, Material::Furniture);
            draw_bush(draft, up(0.4), random);
        }
    }
}

fn draw_bench(draft: &mut SolidDraft, place: Vector3, yaw: f64) {
    let (sine, cosine) = libm::sincos(yaw);
    draft.turned_block(place + Vector3::new(0.0, 0.0, 0.4), [1.5, 0.45, 0.06], yaw, Material::Furniture);
    for end in [-0.6, 0.6] {
        let foot = place + Vector3::new(cosine, sine, 0.0) * end;
        draft.turned_block(foot, [0.08, 0.4, 0.4], yaw, Material::Metal);
    }
}

/// A parked car.
pub(super) fn draw_car(draft: &mut SolidDraft, place: Vector3, yaw: f64, random: &mut Random) {
    let (length, wide) = (random.between(3.7, 4.8), random.between(1.65, 1.9));
    let up = |z: f64| place + Vector3::new(0.0, 0.0, z);
    draft.turned_block(up(0.22), [length, wide, 0.62], yaw, Material::Metal);
    draft.turned_block(
        up(0.84),
        [0.5 * length, 0.85 * wide, random.between(0.5, 0.75)],
        yaw,
        Material::Metal,
    );
    let (sine, cosine) = libm::sincos(yaw);
    for (along, across) in [(0.33, 0.42), (0.33, -0.42), (-0.33, 0.42), (-0.33, -0.42)] {
        let (u, v) = (along * length, across * wide);
        let foot = place + Vector3::new(u * cosine - v * sine, u * sine + v * cosine, 0.0);
        draft.turned_block(foot, [0.6, 0.2, 0.6], yaw, Material::Furniture);
    }
}

/// Trees, bushes, posts, benches and balls in a rectangle, away from paths and from the rectangles `built`.
pub(super) fn furnish_outdoors(
    draft: &mut SolidDraft,
    ground: &dyn Fn(f64, f64) -> Vector3,
    ([x0, y0, x1, y1], built): ([f64; 4], &[[f64; 4]]),
    free: &KeptFreePaths,
    random: &mut Random,
    trees: usize,
) {
    for i in 0..trees * 3 {
        let place = ground(random.between(x0, x1), random.between(y0, y1));
        let kind = i % 3;
        let room = [2.0, 1.4, 1.2][kind];
        let is_built = built.iter().any(|[a, b, c, d]| {
            (a - 2.0..c + 2.0).contains(&place.x) && (b - 2.0..d + 2.0).contains(&place.y)
        });
        if is_built || free.distance(&place) < room {
            continue;
        }
        match (kind, random.below(5)) {
            (0, _) => draw_tree(draft, place, random, 140),
            (1, 0..3) => draw_bush(draft, place, random),
            (1, _) => draft.column(place, 0.06, random.between(3.0, 5.0), Material::Metal),
            (_, 0) => draw_bench(draft, place, random.between(0.0, 3.0)),
            (_, 1) => {
                let size = random.between(0.2, 0.6);
                draft.add(Body::Ball { centre: place, radius: size }, Material::Wall);
            }
            _ => {}
        }
    }
}
