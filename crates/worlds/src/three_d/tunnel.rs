//! A tunnel: the same smooth profile all along, with a slight bend. From the middle a lidar sees neither end.

use portolan_geometry::Vector3;

use super::SolidPlan;
use super::SolidStyle;
use super::draft::SolidDraft;
use crate::random::Random;
use crate::two_d::Material;

/// Length of the flat pieces of the walls, metres. On the narrowest bend they deviate from the arc by 4 mm.
const PIECE: f64 = 4.0;
/// Smallest and largest radius of the bend, metres.
const RADIUS: [f64; 2] = [500.0, 900.0];
/// Maximum distance of objects from an end, metres.
const END: f64 = 14.0;
/// Distance from the ends at which paths turn back, metres.
const TURNING_PLACE: f64 = 7.0;
/// Distance of the lane that is driven from the middle of the floor, as a fraction of the width.
const LANE: f64 = 0.2;
/// Distance along the tunnel over which the lane is reached from the middle, metres.
const MERGING: f64 = 12.0;
/// Distance between landmarks, metres.
const MARK_SPACING: f64 = 50.0;

/// The line along the middle of the floor: an arc.
struct Line {
    length: f64,
    /// 1/m, positive to the left.
    curvature: f64,
}

impl Line {
    /// Cosine and sine of the direction `along` metres from the beginning.
    fn direction(&self, along: f64) -> [f64; 2] {
        let (sine, cosine) = libm::sincos(self.curvature * (along - 0.5 * self.length));
        [cosine, sine]
    }

    /// A point `along` metres from the beginning, `left` of the middle and `up` above the floor.
    fn point(&self, along: f64, left: f64, up: f64) -> Vector3 {
        let [cosine, sine] = self.direction(along);
        let (x, y) = (sine / self.curvature, (1.0 - cosine) / self.curvature);
        Vector3::new(0.5 * self.length + x - left * sine, y + left * cosine, up)
    }

    /// Path from the middle on the right side to near an end, around, and back on the other side.
    fn path_to(&self, end: f64, width: f64) -> Vec<Vector3> {
        let middle = 0.5 * self.length;
        let (far, forward) = ((end - middle).abs(), (end - middle).signum());
        let lane = LANE * width;
        let out: Vec<f64> = (0..).map(|i| PIECE * f64::from(i)).take_while(|d| *d < far - lane).collect();
        let at = |distance: f64, left: f64| {
            let left = left * (distance / MERGING).min(1.0);
            self.point(middle + forward * distance, forward * left, 0.0)
        };
        let round = (0..=8).map(|i| {
            let (sine, cosine) = libm::sincos(std::f64::consts::PI * f64::from(i) / 8.0);
            at(far - lane + lane * sine, -lane * cosine)
        });
        let path = out.iter().map(|d| at(*d, -lane)).chain(round);
        path.chain(out.iter().rev().map(|d| at(*d, lane))).collect()
    }

    fn yaw(&self, along: f64) -> f64 {
        self.curvature * (along - 0.5 * self.length)
    }
}

/// Draws a tunnel; its length is the width of the world, and its width the depth of the world.
pub(crate) fn draw_tunnel(style: &SolidStyle, seed: u64) -> SolidPlan {
    let mut random = Random::new(seed, "tunnel", 0);
    let [length, width] = style.size;
    let side = if random.chance(0.5) { 1.0 } else { -1.0 };
    let line = Line { length, curvature: side / random.between(RADIUS[0], RADIUS[1]) };
    let height = (0.75 * width).clamp(2.6, 6.0);
    let mut draft = SolidDraft::default();
    draw_lining(&mut draft, &line, width, height);
    for end in [0.0, length] {
        draw_end(&mut draft, &line, (end, width, height), &mut random, style.clutter);
    }
    let marks = (0..=(length / MARK_SPACING) as usize).map(|i| {
        let along = (MARK_SPACING * i as f64).clamp(0.5, length - 0.5);
        let left = if i.is_multiple_of(2) { 1.0 } else { -1.0 };
        let [cosine, sine] = line.direction(along);
        let inward = Vector3::new(sine * left, -cosine * left, 0.0);
        (line.point(along, left * (0.5 * width - 0.01), 1.0), inward)
    });
    let aside = |path: &[Vector3]| -> Vec<Vector3> {
        path.iter().map(|p| p + Vector3::new(0.0, 0.3 * width, 0.0)).collect()
    };
    let loops = vec![line.path_to(length - TURNING_PLACE, width), line.path_to(TURNING_PLACE, width)];
    SolidPlan {
        strolls: loops.iter().map(|path| aside(path)).collect(),
        marks: marks.collect(),
        loops,
        solids: draft.solids,
    }
}

/// Floor, walls and a vault of three flat strips.
fn draw_lining(draft: &mut SolidDraft, line: &Line, width: f64, height: f64) {
    let half = 0.5 * width;
    let profile = [
        (half, 0.0, Material::Floor),
        (-half, 0.0, Material::Wall),
        (-half, 0.65 * height, Material::Wall),
        (-0.5 * half, height, Material::Wall),
        (0.5 * half, height, Material::Wall),
        (half, 0.65 * height, Material::Wall),
    ];
    let pieces = (line.length / PIECE).ceil() as usize;
    let along = |i: usize| line.length * i as f64 / pieces as f64;
    for i in 0..pieces {
        for (k, (left, up, material)) in profile.iter().enumerate() {
            let (next_left, next_up, _) = profile[(k + 1) % profile.len()];
            let corners = [
                line.point(along(i), *left, *up),
                line.point(along(i), next_left, next_up),
                line.point(along(i + 1), next_left, next_up),
                line.point(along(i + 1), *left, *up),
            ];
            draft.quad(corners, *material);
        }
    }
}

/// The wall at an end, and objects before it along the sides.
fn draw_end(
    draft: &mut SolidDraft,
    line: &Line,
    (end, width, height): (f64, f64, f64),
    random: &mut Random,
    clutter: f64,
) {
    let (half, yaw) = (0.5 * width, line.yaw(end));
    draft.turned_block(line.point(end, 0.0, 0.0), [0.2, width, height], yaw, Material::Wall);
    let inward = if end > 0.0 { -1.0 } else { 1.0 };
    for _ in 0..(4.0 * clutter).round() as usize {
        let along = end + inward * random.between(1.5, END);
        let left = if random.chance(0.5) { 1.0 } else { -1.0 };
        let deep = random.between(0.2, 0.1 * width).max(0.2);
        let foot = line.point(along, left * (half - 0.5 * deep), 0.0);
        let size = [random.between(0.4, 1.2), deep, random.between(0.8, 1.9)];
        draft.turned_block(foot, size, line.yaw(along), Material::Furniture);
    }
}
