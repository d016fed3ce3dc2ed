//! Drawing floor plans: walls with thickness and openings, boxes, round things, panes.

use portolan_geometry::Vector2;

use super::shape::{Material, Shape};

/// A gap in a wall, metres from its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opening {
    /// Its beginning.
    pub from: f64,
    /// Its end.
    pub to: f64,
}

/// An axis-parallel rectangle, metres in the map frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rect {
    pub low: Vector2,
    pub high: Vector2,
}

impl Rect {
    pub fn new(x0: f64, y0: f64, x1: f64, y1: f64) -> Self {
        Self { low: Vector2::new(x0, y0), high: Vector2::new(x1, y1) }
    }

    pub fn size(&self) -> Vector2 {
        self.high - self.low
    }

    pub fn centre(&self) -> Vector2 {
        (self.low + self.high) * 0.5
    }

    pub fn grown(&self, margin: f64) -> Self {
        let m = Vector2::new(margin, margin);
        Self { low: self.low - m, high: self.high + m }
    }

    pub fn overlaps(&self, other: &Self) -> bool {
        self.low.x < other.high.x
            && other.low.x < self.high.x
            && self.low.y < other.high.y
            && other.low.y < self.high.y
    }

    pub fn contains(&self, other: &Self) -> bool {
        self.low.x <= other.low.x
            && self.low.y <= other.low.y
            && self.high.x >= other.high.x
            && self.high.y >= other.high.y
    }
}

/// A floor plan that is being drawn.
#[derive(Clone, Debug, Default)]
pub struct Draft {
    shapes: Vec<Shape>,
}

impl Draft {
    /// An empty plan.
    pub fn new() -> Self {
        Self::default()
    }

    /// The surfaces drawn.
    pub fn into_shapes(self) -> Vec<Shape> {
        self.shapes
    }

    /// A box of the given size around `centre`, its first side along the unit vector `axis`.
    pub fn solid_box(&mut self, centre: Vector2, size: Vector2, axis: Vector2, material: Material) {
        let half_along = axis * (0.5 * size.x);
        let half_across = Vector2::new(-axis.y, axis.x) * (0.5 * size.y);
        let corners = [
            centre - half_along - half_across,
            centre + half_along - half_across,
            centre + half_along + half_across,
            centre - half_along + half_across,
        ];
        for i in 0..4 {
            self.shapes.push(Shape::segment(corners[i], corners[(i + 1) % 4], material));
        }
    }

    /// An axis-parallel box between two corners.
    pub fn aligned_box(&mut self, low: Vector2, high: Vector2, material: Material) {
        self.solid_box((low + high) * 0.5, high - low, Vector2::x(), material);
    }

    /// A circle: a pillar, pot or leg.
    pub fn circle(&mut self, centre: Vector2, radius: f64, material: Material) {
        self.shapes.push(Shape::circle(centre, radius, material));
    }

    /// A surface without thickness.
    pub fn segment(&mut self, start: Vector2, end: Vector2, material: Material) {
        self.shapes.push(Shape::segment(start, end, material));
    }

    /// A wall from `start` to `end`, `thickness` metres thick, with gaps where the openings are (in
    /// any order, overlaps allowed).
    pub fn wall(&mut self, start: Vector2, end: Vector2, thickness: f64, openings: &[Opening]) {
        for (from, to) in solid_pieces((end - start).norm(), openings) {
            let axis = (end - start).normalize();
            let centre = start + axis * (0.5 * (from + to));
            self.solid_box(centre, Vector2::new(to - from, thickness), axis, Material::Wall);
        }
    }

    /// A glass front from `start` to `end`: panes about 1.2 m wide between metal mullions.
    pub fn glass_front(&mut self, start: Vector2, end: Vector2) {
        let length = (end - start).norm();
        if length < 0.1 {
            return;
        }
        let axis = (end - start) / length;
        let panes = (length / 1.2).round().max(1.0) as usize;
        for i in 0..=panes {
            let post = start + axis * (length * i as f64 / panes as f64);
            self.solid_box(post, Vector2::new(0.05, 0.08), axis, Material::Metal);
            if i < panes {
                let next = start + axis * (length * (i + 1) as f64 / panes as f64);
                self.segment(post + axis * 0.025, next - axis * 0.025, Material::Glass);
            }
        }
    }
}

/// The parts of `0..length` between the openings.
fn solid_pieces(length: f64, openings: &[Opening]) -> Vec<(f64, f64)> {
    let mut sorted = openings.to_vec();
    sorted.sort_by(|a, b| a.from.total_cmp(&b.from));
    let mut pieces = Vec::new();
    let mut at = 0.0_f64;
    for opening in sorted {
        if opening.from > at + 1e-9 {
            pieces.push((at, opening.from.min(length)));
        }
        at = at.max(opening.to);
    }
    if at < length - 1e-9 {
        pieces.push((at, length));
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn openings_cut_walls() {
        let openings = [Opening { from: 4.0, to: 5.0 }, Opening { from: 0.0, to: 1.0 }];
        assert_eq!(solid_pieces(6.0, &openings), [(1.0, 4.0), (5.0, 6.0)]);
        assert_eq!(solid_pieces(6.0, &[]), [(0.0, 6.0)]);
        assert!(solid_pieces(6.0, &[Opening { from: -1.0, to: 7.0 }]).is_empty());
        let mut draft = Draft::new();
        draft.wall(Vector2::zeros(), Vector2::new(6.0, 0.0), 0.2, &openings);
        assert_eq!(draft.into_shapes().len(), 8);
    }
}
