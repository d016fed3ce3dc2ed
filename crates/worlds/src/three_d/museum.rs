//! A museum: storeys of eight halls around an atrium, two stairwells, a ramp down to a garden.

use portolan_geometry::Vector3;

use super::SolidPlan;
use super::SolidStyle;
use super::draft::{Hole, SolidDraft};
use super::furnishing::{Hall, KeptFreePaths, furnish_outdoors};
use super::stairs::Stairwell;
use super::terrain::Terrain;
use crate::random::Random;
use crate::two_d::Material;

const OUTER_WALL: f64 = 0.3;
const INNER_WALL: f64 = 0.2;
const SLAB: f64 = 0.3;
/// Height of the garden relative to the ground floor, metres.
const GARDEN: f64 = -0.6;
const RAMP_SLOPE: f64 = 0.08;
const RAMP_WIDTH: f64 = 2.4;
/// Depth of the platform before the entrance, metres.
const PLATFORM: f64 = 2.5;

/// Cell (column, row) of a storey.
type Cell = (usize, usize);

/// The ring of halls, counter-clockwise from the entrance hall.
const RING: [Cell; 8] = [(1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1), (0, 0)];
const ENTRANCE: Cell = (1, 0);
const ATRIUM: Cell = (1, 1);

struct Museum {
    /// Coordinates of the lines between the cells, the outer faces included.
    xs: [f64; 4],
    ys: [f64; 4],
    storey: f64,
    storeys: usize,
    /// Middle waypoint of paths through each cell, by storey, column and row.
    centres: Vec<[[Vector3; 3]; 3]>,
    /// Positions of the doors along their walls, by storey: from each cell of the ring to the next.
    doors: Vec<[f64; 8]>,
    stairs: [Stairwell; 2],
    terrain: Terrain,
}

/// Draws a museum with everything in and around it.
pub(crate) fn draw_museum(style: &SolidStyle, seed: u64) -> SolidPlan {
    let mut random = Random::new(seed, "museum", 0);
    let museum = Museum::lay_out(style, &mut random);
    let mut plan = SolidPlan { loops: museum.loops(&mut random), ..SolidPlan::default() };
    let mut draft = SolidDraft::default();
    museum.draw_building(&mut draft, style, &mut random);
    plan.strolls = museum.strolls(&mut random);
    let mut free = KeptFreePaths::default();
    plan.loops.iter().chain(&plan.strolls).for_each(|path| free.add(path));
    for storey in 0..museum.storeys {
        for (column, row) in RING.into_iter().chain((storey == 0).then_some(ATRIUM)) {
            let hall = museum.hall((column, row), storey);
            hall.furnish(&mut draft, &free, &mut random, style.clutter);
        }
    }
    museum.hang_mirror(&mut draft);
    museum.draw_garden(&mut draft, &free, &mut random);
    plan.marks = museum.marks();
    plan.solids = draft.solids;
    plan
}

impl Museum {
    fn lay_out(style: &SolidStyle, random: &mut Random) -> Self {
        let [width, depth] = style.size;
        let storey = Stairwell::whole_storey(4.2);
        let room = 0.5 * Stairwell::length(storey) + 0.35;
        let (a, b) = (width * random.between(0.29, 0.35), width * random.between(0.65, 0.71));
        let (c, d) =
            (0.5 * depth - room - random.between(0.0, 0.5), 0.5 * depth + room + random.between(0.0, 0.5));
        let (xs, ys) = ([0.0, a, b, width], [0.0, c, d, depth]);
        let start_y = 0.5 * depth - 0.5 * Stairwell::length(storey);
        let stairs = [(width, 1.0), (0.0, -1.0)].map(|(wall_x, side)| Stairwell {
            wall_x: wall_x + side * 0.5 * OUTER_WALL,
            side,
            start_y,
            storey,
            storeys: style.storeys,
        });
        let centre = |column: usize, row: usize, level: f64, random: &mut Random| {
            let (x, y) = (0.5 * (xs[column] + xs[column + 1]), 0.5 * (ys[row] + ys[row + 1]));
            Vector3::new(x + random.between(-0.8, 0.8), y + random.between(-0.8, 0.8), level)
        };
        let (mut centres, mut doors) = (Vec::new(), Vec::new());
        for floor in 0..style.storeys {
            let level = floor as f64 * storey;
            let cells = [0, 1, 2].map(|c| [0, 1, 2].map(|r| centre(c, r, level, random)));
            centres.push(cells);
            let mut at = [0.0; 8];
            for (i, door) in at.iter_mut().enumerate() {
                let (from, to) = (RING[i], RING[(i + 1) % 8]);
                let (lines, n) = if from.0 == to.0 { (xs, from.0) } else { (ys, from.1) };
                let (low, high) = (lines[n] + 1.8, lines[n + 1] - 1.8);
                *door = 0.5 * (low + high) + (high - low).max(0.0) * random.between(-0.5, 0.5);
            }
            doors.push(at);
        }
        let flat = [-6.0, -PLATFORM + GARDEN / RAMP_SLOPE - 2.0, width + 6.0, depth + 2.0];
        let terrain = Terrain::new(random, GARDEN, 1.8, flat, 16.0);
        Self { xs, ys, storey, storeys: style.storeys, centres, doors, stairs, terrain }
    }

    fn hall(&self, (column, row): Cell, storey: usize) -> Hall {
        let inset = 0.5 * INNER_WALL;
        let area = [
            self.xs[column] + inset,
            self.ys[row] + inset,
            self.xs[column + 1] - inset,
            self.ys[row + 1] - inset,
        ];
        let height = if (column, row) == ATRIUM { self.storey * self.storeys as f64 } else { self.storey };
        Hall { area, level: storey as f64 * self.storey, height: height - SLAB }
    }

    // Paths.

    fn centre(&self, (column, row): Cell, storey: usize) -> Vector3 {
        self.centres[storey][column][row]
    }

    /// Path straight through the door from ring cell `i` to the next one.
    fn through_door(&self, i: usize, storey: usize) -> [Vector3; 2] {
        let (from, to) = (RING[i], RING[(i + 1) % 8]);
        let (at, level) = (self.doors[storey][i], storey as f64 * self.storey);
        if from.0 == to.0 {
            let (line, offset) = (self.ys[from.1.max(to.1)], if to.1 > from.1 { 0.7 } else { -0.7 });
            [Vector3::new(at, line - offset, level), Vector3::new(at, line + offset, level)]
        } else {
            let (line, offset) = (self.xs[from.0.max(to.0)], if to.0 > from.0 { 0.7 } else { -0.7 });
            [Vector3::new(line - offset, at, level), Vector3::new(line + offset, at, level)]
        }
    }

    /// Path along the ring on a storey from cell number `from` through `count` doors, both ends included.
    fn along_ring(&self, from: usize, count: usize, storey: usize) -> Vec<Vector3> {
        let mut path = vec![self.centre(RING[from % 8], storey)];
        for i in from..from + count {
            path.extend(self.through_door(i % 8, storey));
            path.push(self.centre(RING[(i + 1) % 8], storey));
        }
        path
    }

    /// Path through the door of a stairwell, outwards.
    fn stair_door(&self, stairs: &Stairwell, storey: usize) -> [Vector3; 2] {
        let line = stairs.wall_x - stairs.side * 0.5 * OUTER_WALL;
        let (y, level) = (stairs.door_y(), storey as f64 * self.storey);
        [-0.7, 0.5].map(|u| Vector3::new(line + stairs.side * u, y, level))
    }

    /// Path from the entrance hall up the east stairs, around the north of a storey, and down the west
    /// stairs.
    fn upper_loop(&self, storey: usize) -> Vec<Vector3> {
        // The halls before the stairs are crossed straight to their doors.
        let mut path = self.along_ring(0, 2, 0);
        path.pop();
        path.extend(self.stair_door(&self.stairs[0], 0));
        (0..storey).for_each(|from| path.extend(self.stairs[0].path_up(from)));
        path.extend(self.stair_door(&self.stairs[0], storey).into_iter().rev());
        path.extend(self.along_ring(2, 4, storey).into_iter().skip(1));
        path.pop();
        let mut back = Vec::new();
        back.extend(self.stair_door(&self.stairs[1], 0));
        (0..storey).for_each(|from| back.extend(self.stairs[1].path_up(from)));
        back.extend(self.stair_door(&self.stairs[1], storey).into_iter().rev());
        path.extend(back.into_iter().rev());
        path.extend(self.along_ring(6, 2, 0).into_iter().skip(1));
        path
    }

    fn entrance_x(&self) -> f64 {
        0.5 * (self.xs[1] + self.xs[2])
    }

    fn terrace_x(&self) -> f64 {
        0.5 * (self.xs[2] + self.xs[3])
    }

    fn ramp_end(&self) -> f64 {
        -PLATFORM + GARDEN / RAMP_SLOPE
    }

    /// Path out of the entrance, down the ramp, through the garden and up the steps of the terrace.
    fn garden_loop(&self, random: &mut Random) -> Vec<Vector3> {
        let (x, terrace, end) = (self.entrance_x(), self.terrace_x(), self.ramp_end());
        let mut path = vec![self.centre(ENTRANCE, 0)];
        path.extend(
            [[0.8, 0.0], [-0.8, 0.0], [-PLATFORM, 0.0], [end, GARDEN]].map(|[y, z]| Vector3::new(x, y, z)),
        );
        let outer = random.between(5.0, 8.0);
        let mut corners = vec![[x - 1.0, end - 2.0], [x - random.between(3.0, 6.0), end - outer]];
        corners.push([x + 3.0, end - outer - random.between(4.0, 7.0)]);
        corners.push([terrace + 2.0, end - outer + 1.0]);
        corners.push([terrace, -3.2]);
        for pair in corners.windows(2) {
            for i in 0..6 {
                let share = f64::from(i) / 6.0;
                let [px, py] = [0, 1].map(|k| pair[0][k] + (pair[1][k] - pair[0][k]) * share);
                path.push(self.terrain.point(px, py));
            }
        }
        path.extend(
            [[-3.2, GARDEN], [-1.9, GARDEN], [-0.7, 0.0], [0.8, 0.0]]
                .map(|[y, z]| Vector3::new(terrace, y, z)),
        );
        path.push(self.centre((2, 0), 0));
        path.extend(self.through_door(0, 0).into_iter().rev());
        path.push(self.centre(ENTRANCE, 0));
        path
    }

    /// Path through the atrium to the north and back through the east halls.
    fn atrium_loop(&self) -> Vec<Vector3> {
        let x = self.entrance_x();
        let mut path = vec![self.centre(ENTRANCE, 0)];
        path.extend([-0.7, 0.7].map(|d| Vector3::new(x, self.ys[1] + d, 0.0)));
        path.push(self.centre(ATRIUM, 0));
        path.extend([-0.7, 0.7].map(|d| Vector3::new(x, self.ys[2] + d, 0.0)));
        let mut east = self.along_ring(0, 4, 0);
        east.reverse();
        path.extend(east);
        path
    }

    /// All loops from the entrance hall, in the order of the tour.
    fn loops(&self, random: &mut Random) -> Vec<Vec<Vector3>> {
        let mut loops = Vec::new();
        if self.storeys > 1 {
            loops.push(self.upper_loop(1));
        }
        loops.push(self.garden_loop(random));
        loops.push(self.along_ring(0, 8, 0));
        loops.extend((2..self.storeys).map(|storey| self.upper_loop(storey)));
        loops.push(self.atrium_loop());
        for path in &mut loops {
            if random.chance(0.3) {
                path.reverse();
            }
        }
        loops
    }

    fn strolls(&self, random: &mut Random) -> Vec<Vec<Vector3>> {
        let mut strolls = Vec::new();
        for storey in 0..self.storeys {
            for cell in RING.into_iter().chain((storey == 0).then_some(ATRIUM)) {
                if random.chance(0.5) {
                    continue;
                }
                let [x0, y0, x1, y1] = self.hall(cell, storey).area;
                let inset = random.between(1.0, 1.5).min(0.3 * (x1 - x0).min(y1 - y0));
                let corner = |x: f64, y: f64| Vector3::new(x, y, storey as f64 * self.storey);
                let (a, b, c, d) = (x0 + inset, y0 + inset, x1 - inset, y1 - inset);
                strolls.push(vec![corner(a, b), corner(c, b), corner(c, d), corner(a, d), corner(a, b)]);
            }
        }
        random.shuffle(&mut strolls);
        strolls
    }

    // Building.

    fn draw_building(&self, draft: &mut SolidDraft, style: &SolidStyle, random: &mut Random) {
        let ([x0, _, _, x1], [y0, _, _, y1]) = (self.xs, self.ys);
        let void = [self.xs[1], self.ys[1], self.xs[2], self.ys[2]];
        draft.block([x0, y0, GARDEN - 0.5], [x1, y1, 0.0], Material::Floor);
        for storey in 1..self.storeys {
            draft.floor([x0, y0, x1, y1], storey as f64 * self.storey, SLAB, Some(void), Material::Floor);
        }
        let top = self.storeys as f64 * self.storey;
        draft.floor([x0, y0, x1, y1], top, SLAB, Some(void), Material::Wall);
        draft.block([void[0], void[1], top - 0.04], [void[2], void[3], top - 0.02], Material::Glass);
        for storey in 0..self.storeys {
            self.draw_outer_walls(draft, storey, style, random);
            self.draw_inner_walls(draft, storey, random);
        }
        self.stairs.iter().for_each(|stairs| stairs.draw(draft));
    }

    /// A wall with holes; those that begin above the floor are windows, with panes.
    fn walls(
        &self,
        draft: &mut SolidDraft,
        along: usize,
        (from, to, at): (f64, f64, f64),
        storey: usize,
        thickness: f64,
        holes: &[Hole],
    ) {
        let foot = storey as f64 * self.storey;
        let top = if storey + 1 == self.storeys { foot + self.storey } else { foot + self.storey - SLAB };
        draft.wall(along, (from, to, at), (foot, top), thickness, holes, Material::Wall);
        for [start, end, low, high] in holes.iter().filter(|hole| hole[2] > 0.0) {
            let (min, max) = if along == 0 {
                ([*start, at - 0.005, foot + low], [*end, at + 0.005, foot + high])
            } else {
                ([at - 0.005, *start, foot + low], [at + 0.005, *end, foot + high])
            };
            draft.block(min, max, Material::Glass);
        }
    }

    fn draw_outer_walls(
        &self,
        draft: &mut SolidDraft,
        storey: usize,
        style: &SolidStyle,
        random: &mut Random,
    ) {
        let window = |from: f64, to: f64, random: &mut Random| -> Option<Hole> {
            let middle = random.between(from + 1.6, (to - 1.6).max(from + 1.7));
            let half = random.between(0.5, 1.4).min(0.5 * (to - from) - 0.3);
            let (low, high) = (random.between(0.5, 1.2), random.between(2.2, 3.0));
            (half > 0.2 && random.chance(2.0 * style.glass)).then_some([
                middle - half,
                middle + half,
                low,
                high,
            ])
        };
        let door = |middle: f64, half: f64| Some([middle - half, middle + half, 0.0, 2.4]);
        for (n, at) in [(0, self.ys[0]), (3, self.ys[3])] {
            let mut holes: Vec<Hole> = Vec::new();
            for column in 0..3 {
                holes.extend(match (n, storey, column) {
                    (0, 0, 1) => door(self.entrance_x(), 1.2),
                    (0, 0, 2) => door(self.terrace_x(), 0.9),
                    _ => window(self.xs[column], self.xs[column + 1], random),
                });
            }
            self.walls(draft, 0, (self.xs[0] - 0.15, self.xs[3] + 0.15, at), storey, OUTER_WALL, &holes);
        }
        for (stairs, at) in self.stairs.iter().zip([self.xs[3], self.xs[0]]) {
            let mut holes: Vec<Hole> = Vec::new();
            for row in 0..3 {
                holes.extend(match row {
                    1 => door(stairs.door_y(), 0.65),
                    _ => window(self.ys[row], self.ys[row + 1], random),
                });
            }
            self.walls(draft, 1, (self.ys[0], self.ys[3], at), storey, OUTER_WALL, &holes);
        }
    }

    fn draw_inner_walls(&self, draft: &mut SolidDraft, storey: usize, random: &mut Random) {
        let mut door = |i: usize| {
            let half = random.between(0.75, 1.3);
            let at = self.doors[storey][i];
            [at - half, at + half, 0.0, 2.3]
        };
        // Holes as (0 for a wall along x, 1 along y; number of its line; the hole). First the doors of the
        // ring.
        let mut holes: Vec<(usize, usize, Hole)> = Vec::new();
        for i in 0..8 {
            let (from, to) = (RING[i], RING[(i + 1) % 8]);
            holes.push(if from.0 == to.0 {
                (0, from.1.max(to.1), door(i))
            } else {
                (1, from.0.max(to.0), door(i))
            });
        }
        for line in 1..3 {
            let (ax, bx, ay, by) = (self.xs[1], self.xs[2], self.ys[1], self.ys[2]);
            let x = self.entrance_x();
            // Towards the atrium: passages on the ground floor, panes above.
            holes.push((
                0,
                line,
                if storey == 0 { [x - 1.3, x + 1.3, 0.0, 2.6] } else { [ax + 0.8, bx - 0.8, 0.9, 2.6] },
            ));
            holes.push((1, line, [ay + 0.9, by - 0.9, 0.9, 2.6]));
        }
        for along in 0..2 {
            for line in 1..3 {
                let here: Vec<Hole> =
                    holes.iter().filter(|(a, l, _)| (*a, *l) == (along, line)).map(|(_, _, h)| *h).collect();
                let (span, at) = if along == 0 { (self.xs, self.ys[line]) } else { (self.ys, self.xs[line]) };
                self.walls(draft, along, (span[0], span[3], at), storey, INNER_WALL, &here);
            }
        }
    }

    /// A mirror on the north wall of the hall in the north-east, ground floor.
    fn hang_mirror(&self, draft: &mut SolidDraft) {
        let [x0, _, x1, y1] = self.hall((2, 2), 0).area;
        let (middle, y) = (0.5 * (x0 + x1), y1 - 0.05);
        draft.block([middle - 1.2, y - 0.02, 0.4], [middle + 1.2, y, 2.4], Material::Mirror);
    }

    fn draw_garden(&self, draft: &mut SolidDraft, free: &KeptFreePaths, random: &mut Random) {
        let (x, end) = (self.entrance_x(), self.ramp_end());
        let half = 0.5 * RAMP_WIDTH;
        draft.block([x - half, -PLATFORM, GARDEN - 0.3], [x + half, -0.15, 0.0], Material::Floor);
        let corner = |dx: f64, y: f64, z: f64| Vector3::new(x + dx, y, z);
        let (a, b) = (corner(-half, -PLATFORM, 0.0), corner(half, -PLATFORM, 0.0));
        let (c, d) = (corner(half, end, GARDEN), corner(-half, end, GARDEN));
        draft.quad([a, b, c, d], Material::Floor);
        for (top, foot, dx) in [(a, d, -half), (b, c, half)] {
            draft.quad([top, foot, foot, corner(dx, -PLATFORM, GARDEN)], Material::Floor);
            let rail = Vector3::new(0.0, 0.0, 0.9);
            draft.quad([top + rail, foot + rail, foot + rail * 1.07, top + rail * 1.07], Material::Metal);
            draft.column(foot, 0.03, 0.95, Material::Metal);
            draft.column(corner(dx, -PLATFORM, 0.0), 0.03, 0.95, Material::Metal);
        }
        for step in 0..4 {
            let (y, z) = (-0.15 - 0.3 * f64::from(4 - step), GARDEN + 0.15 * f64::from(step + 1));
            let (low, high) = (self.terrace_x() - 1.3, self.terrace_x() + 1.3);
            draft.block([low, y, GARDEN - 0.3], [high, -0.15, z.min(0.0)], Material::Floor);
        }
        let ([x0, _, _, x1], [y0, _, _, y1]) = (self.xs, self.ys);
        let site = [x0 - 40.0, y0 - 45.0, x1 + 40.0, y1 + 30.0];
        let building = [x0 - 0.5, y0 - 0.5, x1 + 0.5, y1 + 0.5];
        self.terrain.draw(draft, site, 2.0, building);
        let built = [[x0 - 4.5, y0, x1 + 4.5, y1], [x - half, end, x + half, 0.0]];
        let ground = |x: f64, y: f64| self.terrain.point(x, y);
        furnish_outdoors(draft, &ground, (site, &built), free, random, 60);
        // Houses around.
        for i in 0..5 {
            let angle = 1.25 * f64::from(i) + random.between(-0.2, 0.2);
            let (sine, cosine) = libm::sincos(angle);
            let place =
                ground(0.5 * x1 + cosine * (0.5 * x1 + 34.0), 0.5 * y1 - 8.0 + sine * (0.5 * y1 + 31.0));
            let size = [random.between(8.0, 14.0), random.between(7.0, 10.0), random.between(5.0, 12.0)];
            draft.turned_block(
                place - Vector3::new(0.0, 0.0, 2.0),
                size,
                random.between(0.0, 1.5),
                Material::Wall,
            );
        }
    }

    /// A landmark in each hall, on its north wall.
    fn marks(&self) -> Vec<(Vector3, Vector3)> {
        let mut marks = Vec::new();
        for storey in 0..self.storeys {
            for cell in RING {
                let hall = self.hall(cell, storey);
                let [x0, _, x1, y1] = hall.area;
                let place = Vector3::new(x0 + 0.35 * (x1 - x0), y1 - 0.02, hall.level + 1.7);
                marks.push((place, -Vector3::y()));
            }
        }
        marks
    }
}
