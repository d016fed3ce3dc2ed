//! A large hall: rows of pillars, kiosks, benches, a counter, a glass front on one side.

use portolan_geometry::Vector2;

use super::draft::{Draft, Opening, Rect};
use super::furniture::{Frame, Furnisher};
use super::plan::{FloorPlan, PlanStyle};
use super::shape::Material;
use crate::random::Random;

const OUTER_WALL: f64 = 0.4;

pub(super) fn draw(style: &PlanStyle, random: &mut Random) -> FloorPlan {
    let size = Vector2::from(style.size);
    let mut draft = Draft::new();
    draw_outer_walls(&mut draft, size, style.glass, random);
    let mut plan = FloorPlan { size, ..FloorPlan::default() };
    let (columns, rows) = add_junctions(&mut plan, random);
    let frame = Frame { origin: Vector2::zeros(), u_axis: Vector2::x(), v_axis: Vector2::y() };
    let inside = Rect::new(0.0, 0.0, size.x, size.y);
    let mut furnisher = Furnisher::new(&mut draft, random, frame, inside);
    for place in &plan.places {
        let p = place.position;
        furnisher.reserve(Rect::new(p.x, p.y, p.x, p.y).grown(0.8));
    }
    let bays = size.component_div(&Vector2::new(columns as f64, rows as f64));
    draw_pillars(&mut furnisher, bays, columns, rows);
    draw_things(&mut furnisher, size, style.clutter);
    plan.shapes = draft.into_shapes();
    plan
}

/// One side has a glass front with a door gap, the others solid walls with pilasters.
fn draw_outer_walls(draft: &mut Draft, size: Vector2, glass: f64, random: &mut Random) {
    let half = 0.5 * OUTER_WALL;
    let (w, h) = (size.x + OUTER_WALL, size.y + half);
    let front = if glass > 0.0 { vec![Opening { from: 0.3 * w, to: 0.7 * w }] } else { Vec::new() };
    let corner = Vector2::new(-OUTER_WALL, -half);
    draft.wall(corner, Vector2::new(w, -half), OUTER_WALL, &front);
    if let Some(gap) = front.first() {
        draft.glass_front(corner + Vector2::x() * gap.from, corner + Vector2::x() * gap.to);
    }
    draft.wall(Vector2::new(-OUTER_WALL, h), Vector2::new(w, h), OUTER_WALL, &[]);
    for x in [-half, size.x + half] {
        draft.wall(Vector2::new(x, 0.0), Vector2::new(x, size.y), OUTER_WALL, &[]);
    }
    let mut x = random.between(2.0, 4.0);
    while x < size.x - 1.0 {
        draft.aligned_box(Vector2::new(x, size.y - 0.25), Vector2::new(x + 0.5, size.y), Material::Wall);
        x += random.between(4.0, 7.5);
    }
}

/// Junctions in a grid, about 11 m apart, each with a small random offset.
fn add_junctions(plan: &mut FloorPlan, random: &mut Random) -> (usize, usize) {
    let columns = (plan.size.x / 11.0).round().max(2.0) as usize;
    let rows = (plan.size.y / 11.0).round().max(2.0) as usize;
    for row in 0..rows {
        for column in 0..columns {
            let x = plan.size.x * (column as f64 + 0.5) / columns as f64 + random.between(-1.5, 1.5);
            let y = plan.size.y * (row as f64 + 0.5) / rows as f64 + random.between(-1.5, 1.5);
            let here = plan.add_junction(format!("spot {column}/{row}"), Vector2::new(x, y));
            if column > 0 {
                plan.add_passage(here - 1, here);
            }
            if row > 0 {
                plan.add_passage(here - columns, here);
            }
        }
    }
    (columns, rows)
}

/// Pillars at the corners of the bays: all round or all square.
fn draw_pillars(furnisher: &mut Furnisher<'_>, bays: Vector2, columns: usize, rows: usize) {
    let is_round = furnisher.random.chance(0.5);
    for column in 1..columns {
        for row in 1..rows {
            let (u, v) = (bays.x * column as f64, bays.y * row as f64);
            if is_round {
                furnisher.try_circle(u, v, 0.4, Material::Wall);
            } else {
                furnisher.try_box(Rect::new(u, v, u, v).grown(0.35), Material::Wall);
            }
        }
    }
}

/// Kiosks, benches, planters and litter bins, in number proportional to the area.
fn draw_things(furnisher: &mut Furnisher<'_>, size: Vector2, clutter: f64) {
    let tries = (size.x * size.y / 55.0 * clutter) as usize;
    for _ in 0..tries {
        let u = furnisher.random.between(1.0, size.x - 1.0);
        let v = furnisher.random.between(1.0, size.y - 1.0);
        match furnisher.random.below(8) {
            0 => draw_kiosk(furnisher, u, v),
            1..=3 => {
                let length = furnisher.random.between(1.5, 2.4);
                let area = Rect::new(u, v, u + length, v + 0.5);
                if furnisher.claim(area) {
                    furnisher.legs(area.grown(-0.08), 0.03);
                }
            }
            4 | 5 => {
                let side = furnisher.random.between(0.5, 1.1);
                furnisher.try_box(Rect::new(u, v, u + side, v + side), Material::Furniture);
            }
            _ => {
                furnisher.try_circle(u, v, 0.22, Material::Metal);
            }
        }
    }
}

/// A stand with a counter in front.
fn draw_kiosk(furnisher: &mut Furnisher<'_>, u: f64, v: f64) {
    let (width, depth) = (furnisher.random.between(2.0, 4.0), furnisher.random.between(1.5, 2.5));
    if furnisher.try_box(Rect::new(u, v, u + width, v + depth), Material::Furniture) {
        let front = furnisher.random.between(0.9, 1.2);
        furnisher.try_box(Rect::new(u, v - front - 0.5, u + 0.6 * width, v - front), Material::Furniture);
    }
}
