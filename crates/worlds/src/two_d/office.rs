//! An office floor: a ring corridor with cross corridors, rooms along the façades and in the blocks
//! between the corridors.

use portolan_geometry::Vector2;

use super::draft::{Draft, Opening};
use super::furniture::Frame;
use super::plan::{FloorPlan, PlanStyle};
use super::rooms::{Door, Room, RoomKind, furnish_open_plan};
use super::shape::Material;
use crate::random::Random;

const OUTER_WALL: f64 = 0.3;
const CORRIDOR_WALL: f64 = 0.15;
const PARTITION: f64 = 0.12;

/// Which corridor a room opens to.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Corridor {
    Horizontal(usize),
    Vertical(usize),
}

/// Spans of the corridors across their direction, metres.
struct Layout {
    size: Vector2,
    /// West and east edge of each vertical corridor, from west to east.
    vertical: Vec<(f64, f64)>,
    /// South and north edge of each horizontal corridor, from south to north.
    horizontal: Vec<(f64, f64)>,
}

/// A row of rooms side by side along a corridor.
struct Strip {
    /// Frame with v = 0 on the corridor wall and u from 0 to `length`.
    frame: Frame,
    length: f64,
    depth: f64,
    /// The part of `length` that faces the corridor.
    front: (f64, f64),
    corridor: Corridor,
}

/// The floor that is being drawn.
struct Office<'a> {
    style: &'a PlanStyle,
    random: &'a mut Random,
    draft: Draft,
    plan: FloorPlan,
    /// Room, corridor, and position of its door along the corridor, metres.
    doors: Vec<(usize, Corridor, f64)>,
}

pub(super) fn draw(style: &PlanStyle, random: &mut Random) -> FloorPlan {
    let layout = Layout::new(style, random);
    let plan = FloorPlan { size: layout.size, ..FloorPlan::default() };
    let mut office = Office { style, random, draft: Draft::new(), plan, doors: Vec::new() };
    office.draw_outer_walls();
    for strip in layout.facade_strips() {
        office.draw_strip(&strip, 1.0);
    }
    for column in 0..layout.vertical.len() - 1 {
        for row in 0..layout.horizontal.len() - 1 {
            office.draw_block(&layout, column, row);
        }
    }
    office.connect(&layout);
    office.plan.shapes = office.draft.into_shapes();
    office.plan
}

impl Layout {
    fn new(style: &PlanStyle, random: &mut Random) -> Self {
        let size = Vector2::from(style.size);
        let typical_depth = (0.21 * size.y).clamp(3.6, 5.2);
        let mut depth = || typical_depth + random.between(-0.3, 0.3);
        let (west, east, south, north) = (depth(), depth(), depth(), depth());
        let corridor = if size.y < 21.0 { 1.9 } else { 2.2 };
        let vertical = corridors_across(west, size.x - east, corridor, 12.5, 2, random);
        let horizontal = corridors_across(south, size.y - north, corridor, 12.0, 1, random);
        Self { size, vertical, horizontal }
    }

    /// The rows of rooms along the outer walls. South and north take the corners.
    fn facade_strips(&self) -> [Strip; 4] {
        let (x, y) = (Vector2::x(), Vector2::y());
        let (west, east) = (self.vertical[0].0, self.vertical[self.vertical.len() - 1].1);
        let (south, north) = (self.horizontal[0].0, self.horizontal[self.horizontal.len() - 1].1);
        let frame = |ox, oy, u_axis, v_axis| Frame { origin: Vector2::new(ox, oy), u_axis, v_axis };
        let (last_row, last_column) = (self.horizontal.len() - 1, self.vertical.len() - 1);
        [
            Strip {
                frame: frame(0.0, south, x, -y),
                length: self.size.x,
                depth: south,
                front: (west, east),
                corridor: Corridor::Horizontal(0),
            },
            Strip {
                frame: frame(0.0, north, x, y),
                length: self.size.x,
                depth: self.size.y - north,
                front: (west, east),
                corridor: Corridor::Horizontal(last_row),
            },
            Strip {
                frame: frame(west, south, y, -x),
                length: north - south,
                depth: west,
                front: (0.0, north - south),
                corridor: Corridor::Vertical(0),
            },
            Strip {
                frame: frame(east, south, y, x),
                length: north - south,
                depth: self.size.x - east,
                front: (0.0, north - south),
                corridor: Corridor::Vertical(last_column),
            },
        ]
    }
}

/// Corridors of the given width between `low` and `high`: one at each end and more in between, so that
/// blocks of about `block` metres, at least `least_blocks` of them, are between the corridors.
fn corridors_across(
    low: f64,
    high: f64,
    width: f64,
    block: f64,
    least_blocks: usize,
    random: &mut Random,
) -> Vec<(f64, f64)> {
    let blocks = ((high - low) / (block + width)).round().max(least_blocks as f64) as usize;
    let pitch = (high - low - width) / blocks as f64;
    let shift = (0.08 * pitch).min(1.0);
    (0..=blocks)
        .map(|i| {
            let inner = i > 0 && i < blocks;
            let start = low + pitch * i as f64 + if inner { random.between(-shift, shift) } else { 0.0 };
            (start, start + width)
        })
        .collect()
}

impl Office<'_> {
    fn draw_outer_walls(&mut self) {
        let half = 0.5 * OUTER_WALL;
        let (w, h) = (self.plan.size.x, self.plan.size.y);
        self.draw_facade_columns();
        for (x0, y0, x1, y1) in [
            (-OUTER_WALL, -half, w + OUTER_WALL, -half),
            (-OUTER_WALL, h + half, w + OUTER_WALL, h + half),
            (-half, 0.0, -half, h),
            (w + half, 0.0, w + half, h),
        ] {
            self.draft.wall(Vector2::new(x0, y0), Vector2::new(x1, y1), OUTER_WALL, &[]);
        }
    }

    /// Columns of the façade stand out into the rooms at a constant pitch.
    fn draw_facade_columns(&mut self) {
        let size = self.plan.size;
        let (width, depth) = (self.random.between(0.3, 0.45), self.random.between(0.1, 0.25));
        for (length, axis, across, far) in
            [(size.x, Vector2::x(), Vector2::y(), size.y), (size.y, Vector2::y(), Vector2::x(), size.x)]
        {
            let columns = (length / 5.4).round();
            for i in 1..columns as usize {
                let at = axis * (length * i as f64 / columns);
                for offset in [0.5 * depth, far - 0.5 * depth] {
                    let centre = at + across * offset;
                    self.draft.solid_box(centre, Vector2::new(width, depth), axis, Material::Wall);
                }
            }
        }
    }

    /// A block between four corridors: rooms back to back, or one open-plan area.
    fn draw_block(&mut self, layout: &Layout, column: usize, row: usize) {
        let (x0, x1) = (layout.vertical[column].1, layout.vertical[column + 1].0);
        let (y0, y1) = (layout.horizontal[row].1, layout.horizontal[row + 1].0);
        let south_west = Vector2::new(x0, y0);
        let size = Vector2::new(x1 - x0, y1 - y0);
        let along_x = Frame { origin: south_west, u_axis: Vector2::x(), v_axis: Vector2::y() };
        if size.y > 6.0 && self.random.chance(0.35) {
            self.draw_open_plan(along_x, size, Corridor::Horizontal(row));
            return;
        }
        for x in [x0, x1] {
            self.draft.wall(Vector2::new(x, y0), Vector2::new(x, y1), CORRIDOR_WALL, &[]);
        }
        let two_rows = size.y > 6.4;
        let split = if two_rows { size.y * self.random.between(0.44, 0.56) } else { size.y };
        // A block with smaller rooms, mostly locked: stairs, lifts, toilets.
        let scale = if self.random.chance(0.3) { 0.65 } else { 1.0 };
        let front = (0.0, size.x);
        let south = Strip {
            frame: along_x,
            length: size.x,
            depth: split,
            front,
            corridor: Corridor::Horizontal(row),
        };
        self.draw_strip(&south, scale);
        let middle = along_x.moved(0.0, split);
        let thickness = if two_rows { PARTITION } else { CORRIDOR_WALL };
        self.draft.wall(middle.origin, middle.point(size.x, 0.0), thickness, &[]);
        if two_rows {
            let frame = Frame { origin: Vector2::new(x0, y1), v_axis: -Vector2::y(), ..along_x };
            let corridor = Corridor::Horizontal(row + 1);
            self.draw_strip(&Strip { frame, length: size.x, depth: size.y - split, front, corridor }, scale);
        }
    }

    /// Walls only near the corners of the block, low clusters of desks inside.
    fn draw_open_plan(&mut self, frame: Frame, size: Vector2, corridor: Corridor) {
        let entrance = self.random.between(0.3, 0.7) * size.x;
        let half = 1.5_f64.min(0.25 * size.x);
        let gap = [Opening { from: entrance - half, to: entrance + half }];
        self.draft.wall(frame.origin, frame.point(size.x, 0.0), CORRIDOR_WALL, &gap);
        if self.random.chance(0.5) || self.style.glass <= 0.0 {
            self.draft.wall(frame.point(0.0, size.y), frame.point(size.x, size.y), CORRIDOR_WALL, &gap);
        } else {
            self.draft.wall(frame.point(0.0, size.y), frame.point(entrance, size.y), CORRIDOR_WALL, &[]);
            self.draft.glass_front(frame.point(entrance, size.y), frame.point(size.x, size.y));
        }
        let side = 0.3 * size.y;
        for u in [0.0, size.x] {
            let gaps = [Opening { from: side, to: size.y - side }];
            let openings: &[Opening] = if u > 0.0 && self.random.chance(0.5) { &[] } else { &gaps };
            self.draft.wall(frame.point(u, 0.0), frame.point(u, size.y), CORRIDOR_WALL, openings);
        }
        furnish_open_plan(&mut self.draft, self.random, frame, size, self.style.clutter);
        let room = self.plan.add_room("open plan".to_owned(), frame.point(0.5 * size.x, 0.5 * size.y));
        self.doors.push((room, corridor, frame.point(entrance, 0.0).x));
    }

    /// Rooms of random width side by side, with their doors, front wall and partitions.
    fn draw_strip(&mut self, strip: &Strip, scale: f64) {
        let borders = self.room_borders(strip, scale);
        let mut openings = Vec::new();
        for pair in borders.windows(2) {
            let (from, to) = (pair[0], pair[1]);
            let room = self.plan_room(strip, from, to);
            if to < strip.length - 1e-9 {
                let (start, end) = (strip.frame.point(to, 0.0), strip.frame.point(to, strip.depth));
                self.draft.wall(start, end, PARTITION, &[]);
            }
            openings.extend(self.draw_front(strip, &room, from, to));
            self.add_room(strip, &room, from);
            room.furnish(&mut self.draft, self.random, self.style.clutter);
        }
        let end = strip.frame.point(strip.length, 0.0);
        self.draft.wall(strip.frame.origin, end, CORRIDOR_WALL, &openings);
        self.furnish_corridor(strip, &openings);
    }

    /// Borders of the rooms along the strip; the first and last room include the parts without a corridor.
    fn room_borders(&mut self, strip: &Strip, scale: f64) -> Vec<f64> {
        let available = strip.front.1 - strip.front.0;
        let mut widths = Vec::new();
        let mut total = 0.0;
        while total < available - 1.2 {
            let width = match self.random.below(10) {
                0..=3 => self.random.between(2.7, 3.5),
                4..=7 => self.random.between(3.8, 5.0),
                _ => self.random.between(5.4, 7.4),
            };
            widths.push(width * scale.max(2.2 / width));
            total += width * scale.max(2.2 / width);
        }
        let stretch = available / total;
        let mut borders = vec![0.0];
        let mut at = strip.front.0;
        for width in widths.iter().take(widths.len().saturating_sub(1)) {
            at += width * stretch;
            borders.push(at);
        }
        borders.push(strip.length);
        borders
    }

    fn plan_room(&mut self, strip: &Strip, from: f64, to: f64) -> Room {
        let width = to - from;
        let facing = (from.max(strip.front.0) - from + 0.2, to.min(strip.front.1) - from - 0.2);
        let kind = Room::kind_for(width, self.random);
        let door_width =
            if kind == RoomKind::Meeting && width > 6.0 { 1.3 } else { self.random.between(0.88, 1.0) };
        let room_for_door = facing.1 - facing.0 - door_width;
        let door = (room_for_door > 0.0).then(|| {
            let hinged_left = self.random.chance(0.5);
            let inset = self.random.between(0.0, 0.35 * room_for_door);
            let edge = if hinged_left { facing.0 + inset } else { facing.1 - door_width - inset };
            let is_closed = self.random.chance(self.style.closed_doors);
            Door { centre: edge + 0.5 * door_width, width: door_width, is_closed, hinged_left }
        });
        Room { frame: strip.frame.moved(from, 0.0), width, depth: strip.depth, door, kind }
    }

    /// The gaps of the corridor wall at this room: its door, or a whole glass front with the door in it.
    fn draw_front(&mut self, strip: &Strip, room: &Room, from: f64, to: f64) -> Vec<Opening> {
        let Some(door) = room.door else { return Vec::new() };
        let (left, right) = (from + door.centre - 0.5 * door.width, from + door.centre + 0.5 * door.width);
        let inside_front = from >= strip.front.0 - 1e-9 && to <= strip.front.1 + 1e-9;
        let glass = inside_front && room.width > 3.6 && self.random.chance(self.style.glass);
        if !glass {
            return vec![Opening { from: left, to: right }];
        }
        let (start, end) = (from + 0.3, to - 0.3);
        self.draft.glass_front(strip.frame.point(start, 0.0), strip.frame.point(left.max(start), 0.0));
        self.draft.glass_front(strip.frame.point(right.min(end), 0.0), strip.frame.point(end, 0.0));
        vec![Opening { from: start.min(left), to: end.max(right) }]
    }

    fn add_room(&mut self, strip: &Strip, room: &Room, from: f64) {
        let Some(door) = room.door else { return };
        if door.is_closed {
            return;
        }
        let name = format!("room {}", self.doors.len() + 1);
        let place = self.plan.add_room(name, room.centre());
        let at_door = strip.frame.point(from + door.centre, 0.0);
        let along = match strip.corridor {
            Corridor::Horizontal(_) => at_door.x,
            Corridor::Vertical(_) => at_door.y,
        };
        self.doors.push((place, strip.corridor, along));
    }

    /// Pilasters, cabinets, plants and extinguishers on the corridor side of the front wall.
    fn furnish_corridor(&mut self, strip: &Strip, openings: &[Opening]) {
        let face = -0.5 * CORRIDOR_WALL;
        let mut at = strip.front.0 + 0.8;
        while at < strip.front.1 - 1.5 {
            let width = self.random.between(0.7, 1.3);
            let near_gap = openings.iter().any(|o| o.from < at + width + 0.15 && o.to > at - 0.15);
            if near_gap || !self.random.chance(0.28 * self.style.clutter) {
                at += 0.9;
                continue;
            }
            let (u_axis, middle) = (strip.frame.u_axis, at + 0.5 * width);
            match self.random.below(5) {
                0 => self.draft.circle(strip.frame.point(middle, face - 0.24), 0.2, Material::Furniture),
                1 => self.draft.circle(strip.frame.point(middle, face - 0.1), 0.08, Material::Metal),
                2 => {
                    let centre = strip.frame.point(middle, face - 0.06);
                    self.draft.solid_box(centre, Vector2::new(0.4, 0.12), u_axis, Material::Wall);
                }
                _ => {
                    let centre = strip.frame.point(middle, face - 0.2);
                    self.draft.solid_box(centre, Vector2::new(width, 0.38), u_axis, Material::Furniture);
                }
            }
            at += width + self.random.between(0.8, 3.0);
        }
    }

    /// Junctions where corridors cross, passages between neighbours, rooms along the passages.
    fn connect(&mut self, layout: &Layout) {
        let middle = |span: &(f64, f64)| 0.5 * (span.0 + span.1);
        let xs: Vec<f64> = layout.vertical.iter().map(middle).collect();
        let ys: Vec<f64> = layout.horizontal.iter().map(middle).collect();
        let first = self.plan.places.len();
        let junction = |column: usize, row: usize| first + row * xs.len() + column;
        for (row, y) in ys.iter().enumerate() {
            for (column, x) in xs.iter().enumerate() {
                self.plan.add_junction(format!("junction {column}/{row}"), Vector2::new(*x, *y));
            }
        }
        self.doors.sort_by(|a, b| a.2.total_cmp(&b.2));
        for row in 0..ys.len() {
            self.connect_corridor(Corridor::Horizontal(row), &xs, |column| junction(column, row));
        }
        for column in 0..xs.len() {
            self.connect_corridor(Corridor::Vertical(column), &ys, |row| junction(column, row));
        }
    }

    fn connect_corridor(&mut self, corridor: Corridor, stops: &[f64], junction: impl Fn(usize) -> usize) {
        for i in 0..stops.len() - 1 {
            let low = if i == 0 { f64::NEG_INFINITY } else { stops[i] };
            let high = if i + 2 == stops.len() { f64::INFINITY } else { stops[i + 1] };
            self.plan.add_passage(junction(i), junction(i + 1));
            let here =
                self.doors.iter().filter(|(_, c, along)| *c == corridor && (low..high).contains(along));
            let rooms: Vec<usize> = here.map(|(room, _, _)| *room).collect();
            if let Some(passage) = self.plan.passages.last_mut() {
                passage.rooms = rooms;
            }
        }
    }
}
