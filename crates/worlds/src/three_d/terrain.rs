//! Ground outdoors: smooth hills from waves of random direction, flat where something is built.

use portolan_geometry::Vector3;

use super::draft::SolidDraft;
use super::primitive::Body;
use crate::random::Random;
use crate::two_d::Material;

/// A wave: its vector (radians per metre), phase and height (metres).
#[derive(Clone, Copy, Debug)]
struct Wave {
    k: [f64; 2],
    phase: f64,
    height: f64,
}

/// Hilly ground.
#[derive(Clone, Debug)]
pub struct Terrain {
    level: f64,
    waves: Vec<Wave>,
    /// Built-up rectangle `[x0, y0, x1, y1]`: flat there; hills have their full height `fade` metres away.
    flat: [f64; 4],
    fade: f64,
}

impl Terrain {
    /// Ground at `level` with hills of about `height` metres.
    pub fn new(random: &mut Random, level: f64, height: f64, flat: [f64; 4], fade: f64) -> Self {
        let mut wave = |longest: f64, share: f64| {
            let (sine, cosine) = libm::sincos(random.between(0.0, std::f64::consts::TAU));
            let k = std::f64::consts::TAU / (longest * random.between(0.7, 1.3));
            let phase = random.between(0.0, std::f64::consts::TAU);
            Wave { k: [k * cosine, k * sine], phase, height: height * share }
        };
        let waves = [(55.0, 0.6), (38.0, 0.45), (23.0, 0.25), (11.0, 0.1), (6.0, 0.04), (3.1, 0.02)];
        let waves = waves.iter().map(|(longest, share)| wave(*longest, *share)).collect();
        Self { level, waves, flat, fade }
    }

    /// Height of the ground, metres.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        let [x0, y0, x1, y1] = self.flat;
        let (dx, dy) = ((x0 - x).max(x - x1).max(0.0), (y0 - y).max(y - y1).max(0.0));
        let share = ((dx * dx + dy * dy).sqrt() / self.fade).min(1.0);
        let share = share * share * (3.0 - 2.0 * share);
        let hills: f64 = self
            .waves
            .iter()
            .map(|wave| wave.height * libm::sin(wave.k[0] * x + wave.k[1] * y + wave.phase))
            .sum();
        self.level + share * hills
    }

    /// The point of the ground at x, y.
    pub fn point(&self, x: f64, y: f64) -> Vector3 {
        Vector3::new(x, y, self.height(x, y))
    }

    /// Draws the ground over a rectangle as triangles `cell` metres wide, without the hole
    /// `[x0, y0, x1, y1]` (whole cells inside it are left out).
    pub(super) fn draw(&self, draft: &mut SolidDraft, [x0, y0, x1, y1]: [f64; 4], cell: f64, hole: [f64; 4]) {
        let (columns, rows) = (((x1 - x0) / cell).ceil() as usize, ((y1 - y0) / cell).ceil() as usize);
        for row in 0..rows {
            for column in 0..columns {
                let (x, y) = (x0 + column as f64 * cell, y0 + row as f64 * cell);
                if x >= hole[0] && x + cell <= hole[2] && y >= hole[1] && y + cell <= hole[3] {
                    continue;
                }
                let [a, b, c, d] = [(0.0, 0.0), (cell, 0.0), (cell, cell), (0.0, cell)]
                    .map(|(dx, dy)| self.point(x + dx, y + dy));
                draft.add(Body::Triangle { corner: a, edges: [b - a, c - a] }, Material::Ground);
                draft.add(Body::Triangle { corner: a, edges: [c - a, d - a] }, Material::Ground);
            }
        }
    }
}
