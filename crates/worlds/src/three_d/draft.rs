//! Drawing in 3D: boxes, walls with openings, floors with holes.

use portolan_geometry::Vector3;

use super::primitive::{Body, Solid};
use crate::two_d::Material;

/// Solids of a world that is being drawn.
#[derive(Clone, Debug, Default)]
pub struct SolidDraft {
    /// The solids drawn so far.
    pub solids: Vec<Solid>,
}

/// A hole in a wall: start and end along the wall, then start and end above its foot, metres.
pub(super) type Hole = [f64; 4];

impl SolidDraft {
    /// Adds a body.
    pub fn add(&mut self, body: Body, material: Material) {
        self.solids.push(Solid { body, material });
    }

    /// An axis-parallel box between two corners; nothing if it has no extent.
    pub fn block(&mut self, min: [f64; 3], max: [f64; 3], material: Material) {
        let (min, max) = (Vector3::from(min), Vector3::from(max));
        let half = (max - min) * 0.5;
        if half.min() > 1e-9 {
            self.add(Body::Box { centre: (min + max) * 0.5, half, turn: [1.0, 0.0] }, material);
        }
    }

    /// A box of this size that stands at `foot`, rotated by a yaw in radians.
    pub fn turned_block(&mut self, foot: Vector3, size: [f64; 3], yaw: f64, material: Material) {
        let half = Vector3::from(size) * 0.5;
        let (sine, cosine) = libm::sincos(yaw);
        let centre = foot + Vector3::new(0.0, 0.0, half.z);
        self.add(Body::Box { centre, half, turn: [cosine, sine] }, material);
    }

    /// An upright cylinder that stands at `foot`.
    pub fn column(&mut self, foot: Vector3, radius: f64, height: f64, material: Material) {
        self.add(Body::Cylinder { base: foot, radius, height }, material);
    }

    /// A flat quadrilateral; its corners are in order around it.
    pub fn quad(&mut self, corners: [Vector3; 4], material: Material) {
        let [a, b, c, d] = corners;
        self.add(Body::Triangle { corner: a, edges: [b - a, c - a] }, material);
        self.add(Body::Triangle { corner: a, edges: [c - a, d - a] }, material);
    }

    /// A wall along x (`along` = 0) or y (1) from `from` to `to`, with its middle at `at` on the other
    /// axis, from height `foot` to `top`, with holes.
    pub(super) fn wall(
        &mut self,
        along: usize,
        (from, to, at): (f64, f64, f64),
        (foot, top): (f64, f64),
        thickness: f64,
        holes: &[Hole],
        material: Material,
    ) {
        let mut piece = |a: f64, b: f64, low: f64, high: f64| {
            let (side, other) = (at - 0.5 * thickness, at + 0.5 * thickness);
            let (min, max) = if along == 0 {
                ([a, side, low], [b, other, high])
            } else {
                ([side, a, low], [other, b, high])
            };
            self.block(min, max, material);
        };
        let mut holes = holes.to_vec();
        holes.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let mut done = from;
        for [start, end, low, high] in holes {
            piece(done, start, foot, top);
            piece(start, end, foot, foot + low);
            piece(start, end, foot + high, top);
            done = end;
        }
        piece(done, to, foot, top);
    }

    /// A floor over a rectangle `[x0, y0, x1, y1]`, its upper side at `level`, without the rectangle
    /// `hole`.
    pub(super) fn floor(
        &mut self,
        [x0, y0, x1, y1]: [f64; 4],
        level: f64,
        thickness: f64,
        hole: Option<[f64; 4]>,
        material: Material,
    ) {
        let mut slab = |a: [f64; 2], b: [f64; 2]| {
            self.block([a[0], a[1], level - thickness], [b[0], b[1], level], material);
        };
        let Some([hx0, hy0, hx1, hy1]) = hole else {
            slab([x0, y0], [x1, y1]);
            return;
        };
        slab([x0, y0], [x1, hy0]);
        slab([x0, hy1], [x1, y1]);
        slab([x0, hy0], [hx0, hy1]);
        slab([hx1, hy0], [x1, hy1]);
    }
}
