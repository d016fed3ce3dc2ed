//! Furniture in the plane of a lidar, a hand's width above the floor: mostly legs.

use portolan_geometry::Vector2;

use super::draft::{Draft, Rect};
use super::shape::Material;
use crate::random::Random;

/// A frame of the plan: `u` along a corridor wall, `v` away from the corridor into the room.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    pub origin: Vector2,
    pub u_axis: Vector2,
    pub v_axis: Vector2,
}

impl Frame {
    /// The point in the map with these coordinates in the frame.
    pub fn point(&self, u: f64, v: f64) -> Vector2 {
        self.origin + self.u_axis * u + self.v_axis * v
    }

    /// The same frame with another origin.
    pub fn moved(&self, u: f64, v: f64) -> Self {
        Self { origin: self.point(u, v), ..*self }
    }
}

/// Puts furniture into a room without letting it overlap.
pub(crate) struct Furnisher<'a> {
    pub draft: &'a mut Draft,
    pub random: &'a mut Random,
    pub frame: Frame,
    /// Area inside the walls, in the frame.
    pub inside: Rect,
    taken: Vec<Rect>,
}

impl<'a> Furnisher<'a> {
    pub fn new(draft: &'a mut Draft, random: &'a mut Random, frame: Frame, inside: Rect) -> Self {
        Self { draft, random, frame, inside, taken: Vec::new() }
    }

    /// Keeps an area free.
    pub fn reserve(&mut self, area: Rect) {
        self.taken.push(area);
    }

    /// Takes the area if it is free and inside the room.
    pub fn claim(&mut self, area: Rect) -> bool {
        let free = self.inside.grown(1e-9).contains(&area) && !self.taken.iter().any(|t| t.overlaps(&area));
        if free {
            self.taken.push(area);
        }
        free
    }

    /// A box that fills `area` less a small random gap, if the area is free.
    pub fn try_box(&mut self, area: Rect, material: Material) -> bool {
        let is_free = self.claim(area);
        if is_free {
            let gap = self.random.between(0.005, 0.03);
            let size = area.size() - Vector2::new(gap, gap);
            let centre = area.centre();
            let middle = self.frame.point(centre.x, centre.y);
            self.draft.solid_box(middle, size, self.frame.u_axis, material);
        }
        is_free
    }

    /// A circle, if its area is free.
    pub fn try_circle(&mut self, u: f64, v: f64, radius: f64, material: Material) -> bool {
        let is_free = self.claim(Rect::new(u - radius, v - radius, u + radius, v + radius));
        if is_free {
            self.draft.circle(self.frame.point(u, v), radius, material);
        }
        is_free
    }

    /// Four legs near the corners of `area`; the area must have been claimed.
    pub fn legs(&mut self, area: Rect, radius: f64) {
        for (u, v) in [
            (area.low.x, area.low.y),
            (area.high.x, area.low.y),
            (area.high.x, area.high.y),
            (area.low.x, area.high.y),
        ] {
            self.draft.circle(self.frame.point(u, v), radius, Material::Metal);
        }
    }

    /// A desk: four legs and, under one end, a pedestal of drawers. `v` is the side at the wall.
    pub fn desk(&mut self, area: Rect) -> bool {
        if !self.claim(area) {
            return false;
        }
        self.legs(area.grown(-0.06), 0.025);
        if self.random.chance(0.75) {
            let at_left = self.random.chance(0.5);
            let u = if at_left { area.low.x + 0.32 } else { area.high.x - 0.32 };
            let middle = self.frame.point(u, area.centre().y);
            let size = if area.size().x >= area.size().y {
                Vector2::new(0.42, (area.size().y - 0.2).clamp(0.3, 0.6))
            } else {
                Vector2::new(0.42, 0.55)
            };
            self.draft.solid_box(middle, size, self.frame.u_axis, Material::Furniture);
        }
        true
    }

    /// An office chair: a gas spring and five castors, turned at random.
    pub fn office_chair(&mut self, u: f64, v: f64) -> bool {
        if !self.claim(Rect::new(u - 0.28, v - 0.28, u + 0.28, v + 0.28)) {
            return false;
        }
        let middle = self.frame.point(u, v);
        self.draft.circle(middle, 0.035, Material::Metal);
        let turn = self.random.between(0.0, std::f64::consts::TAU);
        for castor in 0..5 {
            let (sine, cosine) = libm::sincos(turn + f64::from(castor) * std::f64::consts::TAU / 5.0);
            self.draft.circle(middle + Vector2::new(cosine, sine) * 0.26, 0.03, Material::Metal);
        }
        true
    }

    /// A chair with four thin legs, turned a little.
    pub fn chair(&mut self, u: f64, v: f64) -> bool {
        if !self.claim(Rect::new(u - 0.24, v - 0.24, u + 0.24, v + 0.24)) {
            return false;
        }
        let middle = self.frame.point(u, v);
        let (sine, cosine) = libm::sincos(self.random.between(-0.4, 0.4));
        let axis = self.frame.u_axis * cosine + self.frame.v_axis * sine;
        let across = Vector2::new(-axis.y, axis.x);
        for (along, side) in [(0.19, 0.19), (-0.19, 0.19), (-0.19, -0.19), (0.19, -0.19)] {
            self.draft.circle(middle + axis * along + across * side, 0.0125, Material::Metal);
        }
        true
    }

    /// Boxes of the given depth side by side along one wall, each with some probability.
    pub fn row_of_boxes(&mut self, wall: Wall, depth: f64, probability: f64) {
        let length = match wall {
            Wall::Left | Wall::Right => self.inside.size().y,
            Wall::Back | Wall::Front => self.inside.size().x,
        };
        let mut at = self.random.between(0.0, 0.3);
        loop {
            let width = [0.8, 1.0, 1.2][self.random.below(3)];
            if at + width > length {
                return;
            }
            if self.random.chance(probability) {
                self.try_box(self.along_wall(wall, at, at + width, depth), Material::Furniture);
            }
            at += width;
        }
    }

    /// The area from `from` to `to` along a wall and `depth` into the room.
    pub fn along_wall(&self, wall: Wall, from: f64, to: f64, depth: f64) -> Rect {
        let Rect { low, high } = self.inside;
        match wall {
            Wall::Left => Rect::new(low.x, low.y + from, low.x + depth, low.y + to),
            Wall::Right => Rect::new(high.x - depth, low.y + from, high.x, low.y + to),
            Wall::Back => Rect::new(low.x + from, high.y - depth, low.x + to, high.y),
            Wall::Front => Rect::new(low.x + from, low.y, low.x + to, low.y + depth),
        }
    }
}

/// A wall of a room, seen from its door.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wall {
    Left,
    Right,
    Back,
    Front,
}
