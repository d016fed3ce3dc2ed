//! A stairwell: two flights per storey with a landing between them, the path up, and the walls around.

use portolan_geometry::Vector3;

use super::draft::SolidDraft;
use crate::two_d::Material;

/// Height of a step, metres.
const RISE: f64 = 0.15;
/// Depth of a step, metres.
const RUN: f64 = 0.28;
/// Depth of a landing, metres.
const LANDING: f64 = 1.6;
/// Width of a flight, metres.
const FLIGHT: f64 = 1.7;
/// Gap between the flights, metres.
const GAP: f64 = 0.2;
const WALL: f64 = 0.3;
/// Width of the well, metres.
const WIDTH: f64 = 2.0 * FLIGHT + GAP;

/// A stairwell beside a wall that runs along y.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stairwell {
    /// Coordinate along x of the outer face of the wall.
    pub wall_x: f64,
    /// Side of the wall on which the well is: 1 or −1.
    pub side: f64,
    /// Coordinate along y at which the well begins.
    pub start_y: f64,
    /// Height of a storey, metres: an even number of steps.
    pub storey: f64,
    pub storeys: usize,
}

impl Stairwell {
    /// Length of a well along y for storeys of this height.
    pub fn length(storey: f64) -> f64 {
        2.0 * LANDING + Self::flight_length(storey)
    }

    /// The height nearest to this one that is an even number of steps.
    pub fn whole_storey(height: f64) -> f64 {
        2.0 * RISE * (height / (2.0 * RISE)).round()
    }

    fn steps(storey: f64) -> usize {
        (0.5 * storey / RISE).round() as usize
    }

    fn flight_length(storey: f64) -> f64 {
        Self::steps(storey) as f64 * RUN
    }

    /// Coordinate along y of its doors.
    pub fn door_y(&self) -> f64 {
        self.start_y + 0.5 * LANDING
    }

    fn point(&self, u: f64, v: f64, z: f64) -> Vector3 {
        Vector3::new(self.wall_x + self.side * u, self.start_y + v, z)
    }

    fn block(&self, draft: &mut SolidDraft, u: [f64; 2], v: [f64; 2], z: [f64; 2], material: Material) {
        let (a, b) = (self.point(u[0], v[0], z[0]), self.point(u[1], v[1], z[1]));
        draft.block(a.inf(&b).into(), a.sup(&b).into(), material);
    }

    /// Draws walls, landings, steps and railings.
    pub fn draw(&self, draft: &mut SolidDraft) {
        let length = Self::length(self.storey);
        let top = self.storey * self.storeys as f64;
        let walls = [0.0 - 0.5, top];
        self.block(draft, [0.0, WIDTH + WALL], [-WALL, 0.0], walls, Material::Wall);
        self.block(draft, [0.0, WIDTH + WALL], [length, length + WALL], walls, Material::Wall);
        self.block(draft, [WIDTH, WIDTH + WALL], [0.0, length], walls, Material::Wall);
        self.block(draft, [0.0, WIDTH], [0.0, length], [-0.5, 0.0], Material::Floor);
        self.block(draft, [0.0, WIDTH], [0.0, length], [top - 0.3, top], Material::Wall);
        for storey in 0..self.storeys {
            let level = storey as f64 * self.storey;
            if storey > 0 {
                self.block(draft, [0.0, WIDTH], [0.0, LANDING], [level - 0.25, level], Material::Floor);
            }
            if storey + 1 < self.storeys {
                self.draw_flights(draft, level);
            }
        }
    }

    fn draw_flights(&self, draft: &mut SolidDraft, level: f64) {
        let steps = Self::steps(self.storey);
        let (middle, half) = (LANDING + Self::flight_length(self.storey), 0.5 * self.storey);
        for k in 0..steps {
            let (run, rise) = (k as f64 * RUN, (k + 1) as f64 * RISE);
            let z = [level + rise - 0.3, level + rise];
            self.block(draft, [0.0, FLIGHT], [LANDING + run, LANDING + run + RUN], z, Material::Floor);
            let z = z.map(|z| z + half);
            self.block(draft, [FLIGHT + GAP, WIDTH], [middle - run - RUN, middle - run], z, Material::Floor);
        }
        let z = [level + half - 0.25, level + half];
        self.block(draft, [0.0, WIDTH], [middle, middle + LANDING], z, Material::Floor);
        for (u, low, high) in
            [(FLIGHT, level, level + half), (FLIGHT + GAP, level + self.storey, level + half)]
        {
            let corners = [
                self.point(u, LANDING, low + 0.1),
                self.point(u, middle, high + 0.1),
                self.point(u, middle, high + 1.0),
                self.point(u, LANDING, low + 1.0),
            ];
            draft.quad(corners, Material::Metal);
        }
    }

    /// The path from the door on storey `from` to the door on storey `from` + 1.
    pub fn path_up(&self, from: usize) -> Vec<Vector3> {
        let (low, high) = (from as f64 * self.storey, (from + 1) as f64 * self.storey);
        let (first, second) = (0.5 * FLIGHT, WIDTH - 0.5 * FLIGHT);
        let (start, end) = (LANDING, LANDING + Self::flight_length(self.storey));
        let (landing, half) = (0.5 * LANDING, 0.5 * (low + high));
        vec![
            self.point(first, landing, low),
            self.point(first, start - 0.2, low),
            self.point(first, end, half),
            self.point(first, end + landing, half),
            self.point(second, end + landing, half),
            self.point(second, end + 0.2, half),
            self.point(second, start, high),
            self.point(second, landing, high),
            self.point(first, landing, high),
        ]
    }
}
