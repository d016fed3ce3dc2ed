//! Rooms of an office floor: their doors and furniture.

use portolan_geometry::Vector2;

use super::draft::{Draft, Rect};
use super::furniture::{Frame, Furnisher, Wall};
use super::shape::Material;
use crate::random::Random;

/// Purpose of a room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RoomKind {
    Office,
    Meeting,
    Storage,
    Kitchen,
}

/// A door, in the frame of its room.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Door {
    /// Middle of the opening along the corridor wall.
    pub centre: f64,
    pub width: f64,
    pub is_closed: bool,
    /// Whether the hinges are at the side of smaller u.
    pub hinged_left: bool,
}

/// A room with its corridor wall along v = 0, u from 0 to `width`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Room {
    pub frame: Frame,
    pub width: f64,
    pub depth: f64,
    pub door: Option<Door>,
    pub kind: RoomKind,
}

/// Half the thickness of walls around rooms, metres.
const HALF_WALL: f64 = 0.075;
/// Thickness of a door leaf, metres.
const LEAF: f64 = 0.04;

impl Room {
    /// The middle of the room, in the map.
    pub fn centre(&self) -> Vector2 {
        self.frame.point(0.5 * self.width, 0.5 * self.depth)
    }

    /// A random kind of room that suits the width, metres.
    pub fn kind_for(width: f64, random: &mut Random) -> RoomKind {
        match width {
            w if w < 2.9 && random.chance(0.6) => RoomKind::Storage,
            w if w > 4.6 && random.chance(0.5) => RoomKind::Meeting,
            w if w > 3.5 && random.chance(0.12) => RoomKind::Kitchen,
            _ => RoomKind::Office,
        }
    }

    /// Draws the door leaf and the furniture.
    pub fn furnish(&self, draft: &mut Draft, random: &mut Random, clutter: f64) {
        self.draw_door(draft, random);
        let inside =
            Rect::new(HALF_WALL, HALF_WALL, self.width - HALF_WALL, self.depth - HALF_WALL).grown(-0.02);
        let mut furnisher = Furnisher::new(draft, random, self.frame, inside);
        if let Some(door) = self.door {
            let half = 0.5 * door.width;
            // The swing of the leaf, and the path from the door to the middle.
            let swing = door.width + 0.1;
            furnisher.reserve(Rect::new(door.centre - half - 0.1, 0.0, door.centre + half + 0.1, swing));
            furnisher.reserve(Rect::new(door.centre - 0.45, 0.0, door.centre + 0.45, 0.5 * self.depth));
        }
        let middle = Vector2::new(0.5 * self.width, 0.5 * self.depth);
        furnisher.reserve(Rect::new(middle.x - 0.4, middle.y - 0.4, middle.x + 0.4, middle.y + 0.1));
        match self.kind {
            RoomKind::Office => furnish_office(&mut furnisher, clutter),
            RoomKind::Meeting => {
                furnish_meeting(&mut furnisher, self.door.map_or(0.5 * self.width, |d| d.centre))
            }
            RoomKind::Storage => furnish_storage(&mut furnisher, clutter),
            RoomKind::Kitchen => furnish_kitchen(&mut furnisher, clutter),
        }
    }

    fn draw_door(&self, draft: &mut Draft, random: &mut Random) {
        let Some(door) = self.door else { return };
        let half = 0.5 * door.width;
        if door.is_closed {
            let middle = self.frame.point(door.centre, 0.0);
            draft.solid_box(middle, Vector2::new(door.width, LEAF), self.frame.u_axis, Material::Door);
            return;
        }
        if random.chance(0.12) {
            return; // Taken off its hinges.
        }
        let side = if door.hinged_left { -1.0 } else { 1.0 };
        let hinge = self.frame.point(door.centre + side * (half - 0.5 * LEAF), HALF_WALL);
        let (sine, cosine) = libm::sincos(random.between(1.2, 1.75));
        let axis = self.frame.u_axis * (-side * cosine) + self.frame.v_axis * sine;
        let length = door.width - 0.04;
        draft.solid_box(hinge + axis * (0.5 * length), Vector2::new(length, LEAF), axis, Material::Door);
    }
}

/// Desks at the window, chairs, cabinets along a side wall, a bin.
fn furnish_office(room: &mut Furnisher<'_>, clutter: f64) {
    let Rect { low, high } = room.inside;
    let desks = (room.inside.size().x / 2.2).floor().max(1.0);
    let spacing = room.inside.size().x / desks;
    let mut middle = low.x + 0.5 * spacing;
    while middle < high.x {
        let u = middle + room.random.between(-0.1, 0.1);
        let back = high.y - room.random.between(0.05, 0.7).min(0.25 * room.inside.size().y);
        if room.desk(Rect::new(u - 0.8, back - 0.8, u + 0.8, back)) {
            let v = back - 1.15 + room.random.between(-0.12, 0.2);
            let beside = u + room.random.between(-0.35, 0.35);
            room.office_chair(beside, v);
        }
        middle += spacing;
    }
    let side = if room.random.chance(0.5) { Wall::Left } else { Wall::Right };
    room.row_of_boxes(side, 0.42, 0.5 * clutter);
    if room.random.chance(0.35 * clutter) {
        room.row_of_boxes(Wall::Front, 0.42, 0.4);
    }
    if room.random.chance(0.6 * clutter) {
        let u = room.random.between(low.x + 0.2, high.x - 0.2);
        let v = high.y - room.random.between(0.2, 1.2);
        room.try_circle(u, v, 0.13, Material::Furniture);
    }
    if room.random.chance(0.3 * clutter) {
        let (u, v) = (low.x + 0.25, high.y - 0.25);
        room.try_circle(u, v, 0.2, Material::Furniture);
    }
}

/// A long table with chairs around it, on the side of the room away from the door.
fn furnish_meeting(room: &mut Furnisher<'_>, door: f64) {
    let Rect { low, high } = room.inside;
    let size = room.inside.size();
    let (length, depth) = ((size.x - 2.6).clamp(1.4, 4.8), 1.1);
    let shift = if door < 0.5 * (low.x + high.x) { 0.25 } else { -0.25 };
    let u = 0.5 * (low.x + high.x) + shift;
    let v = (low.y + 0.66 * size.y).min(high.y - 0.5 * depth - 0.75);
    let table = Rect::new(u - 0.5 * length, v - 0.5 * depth, u + 0.5 * length, v + 0.5 * depth);
    if room.claim(table) {
        if room.random.chance(0.5) {
            room.legs(table.grown(-0.12), 0.035);
        } else {
            for share in [0.22, 0.78] {
                let middle = room.frame.point(table.low.x + share * length, v);
                room.draft.solid_box(middle, Vector2::new(0.08, 0.6), room.frame.u_axis, Material::Metal);
            }
        }
    }
    let seats = (length / 0.7).floor().max(1.0) as usize;
    for seat in 0..seats {
        let along = table.low.x + length * (seat as f64 + 0.5) / seats as f64;
        for (near, v) in [(table.low.y, -1.0), (table.high.y, 1.0)] {
            let out = room.random.between(0.26, 0.45);
            let beside = along + room.random.between(-0.06, 0.06);
            room.chair(beside, near + v * out);
        }
    }
    room.row_of_boxes(Wall::Back, 0.35, 0.15);
}

/// Shelves along the walls, boxes on the floor.
fn furnish_storage(room: &mut Furnisher<'_>, clutter: f64) {
    room.row_of_boxes(Wall::Left, 0.4, 0.8);
    room.row_of_boxes(Wall::Right, 0.4, 0.6);
    room.row_of_boxes(Wall::Back, 0.4, 0.7);
    for _ in 0..(4.0 * clutter) as usize {
        let (width, depth) = (room.random.between(0.25, 0.6), room.random.between(0.25, 0.5));
        let u = room.random.between(room.inside.low.x, room.inside.high.x - width);
        let v = room.random.between(room.inside.low.y, room.inside.high.y - depth);
        room.try_box(Rect::new(u, v, u + width, v + depth), Material::Furniture);
    }
}

/// A counter along the back, a fridge, a round table with chairs.
fn furnish_kitchen(room: &mut Furnisher<'_>, clutter: f64) {
    let Rect { low, high } = room.inside;
    let width = room.inside.size().x;
    room.try_box(room.along_wall(Wall::Back, 0.0, width - 0.75, 0.6), Material::Furniture);
    room.try_box(room.along_wall(Wall::Back, width - 0.7, width - 0.02, 0.68), Material::Metal);
    let (u, v) = (low.x + 0.32 * width, 0.5 * (low.y + high.y) + 0.55);
    if room.try_circle(u, v, 0.25, Material::Metal) {
        for turn in 0..3 {
            let (sine, cosine) = libm::sincos(0.4 + f64::from(turn) * 2.1);
            room.chair(u + 0.75 * cosine, v + 0.75 * sine);
        }
    }
    if room.random.chance(0.7 * clutter) {
        room.try_circle(high.x - 0.3, low.y + 0.3, 0.2, Material::Furniture);
    }
}

/// An area of desk clusters with screens between them, where most walls are missing.
pub(crate) fn furnish_open_plan(
    draft: &mut Draft,
    random: &mut Random,
    frame: Frame,
    size: Vector2,
    clutter: f64,
) {
    let inside = Rect::new(0.0, 0.0, size.x, size.y).grown(-0.1);
    let mut room = Furnisher::new(draft, random, frame, inside);
    let columns = ((size.x - 1.0) / 4.6).floor().max(1.0);
    let rows = ((size.y - 1.0) / 4.4).floor().max(1.0);
    for column in 0..columns as usize {
        for row in 0..rows as usize {
            let u = size.x * (column as f64 + 0.5) / columns + room.random.between(-0.15, 0.15);
            let v = size.y * (row as f64 + 0.5) / rows + room.random.between(-0.15, 0.15);
            draw_cluster(&mut room, u, v);
            if (row + column) % 2 == 0 {
                let (pillar_u, pillar_v) = (u + 0.5 * size.x / columns, v + 0.5 * size.y / rows);
                let area = Rect::new(pillar_u - 0.2, pillar_v - 0.2, pillar_u + 0.2, pillar_v + 0.2);
                room.try_box(area, Material::Wall);
            }
        }
    }
    for _ in 0..(6.0 * clutter) as usize {
        let u = room.random.between(0.4, size.x - 0.4);
        let v = room.random.between(0.4, size.y - 0.4);
        let radius = room.random.between(0.12, 0.22);
        room.try_circle(u, v, radius, Material::Furniture);
    }
}

/// Two by two desks face to face with a screen between them.
fn draw_cluster(room: &mut Furnisher<'_>, u: f64, v: f64) {
    for (du, dv) in [(-0.82, -0.42), (0.82, -0.42), (-0.82, 0.42), (0.82, 0.42)] {
        let area = Rect::new(u + du - 0.8, v + dv - 0.4, u + du + 0.8, v + dv + 0.4);
        if room.desk(area) {
            let beside = u + du + room.random.between(-0.3, 0.3);
            let out = if dv < 0.0 { -1.0 } else { 1.0 };
            let distance = room.random.between(0.7, 1.0);
            room.office_chair(beside, v + dv + out * distance);
        }
    }
    let screen = Vector2::new(3.2, 0.03);
    room.draft.solid_box(room.frame.point(u, v), screen, room.frame.u_axis, Material::Furniture);
}
