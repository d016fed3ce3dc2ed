//! A warehouse: double rows of racks with pallets, aisles between them, a dock along one end.

use portolan_geometry::Vector2;

use super::draft::{Draft, Rect};
use super::furniture::{Frame, Furnisher};
use super::plan::{FloorPlan, PlanStyle};
use super::shape::Material;
use crate::random::Random;

/// Depth of a single rack, metres.
const RACK: f64 = 1.1;
/// Gap between the two racks of a row, metres.
const FLUE: f64 = 0.2;
/// Width of an aisle, metres.
const AISLE: f64 = 2.9;
/// Distance between uprights, metres.
const BAY: f64 = 2.7;
/// Width of the cross aisles, metres.
const CROSS_AISLE: f64 = 3.2;
/// Space in front of the doors at the east end, metres.
const DOCK: f64 = 6.0;

pub(super) fn draw(style: &PlanStyle, random: &mut Random) -> FloorPlan {
    let size = Vector2::from(style.size);
    let mut draft = Draft::new();
    let half = 0.15;
    let (low, high) = (Vector2::new(-half, -half), size + Vector2::new(half, half));
    for (start, end) in [
        (low, Vector2::new(high.x, low.y)),
        (Vector2::new(high.x, low.y), high),
        (high, Vector2::new(low.x, high.y)),
        (Vector2::new(low.x, high.y), low),
    ] {
        draft.wall(start, end, 2.0 * half, &[]);
    }
    let mut plan = FloorPlan { size, ..FloorPlan::default() };
    let blocks = rack_blocks(size.x);
    let rows = rack_rows(size.y);
    let frame = Frame { origin: Vector2::zeros(), u_axis: Vector2::x(), v_axis: Vector2::y() };
    let inside = Rect::new(0.0, 0.0, size.x, size.y);
    let mut furnisher = Furnisher::new(&mut draft, random, frame, inside);
    for row in &rows {
        for block in &blocks {
            draw_rack(&mut furnisher, block.0, block.1, row.0, style.clutter);
            draw_rack(&mut furnisher, block.0, block.1, row.0 + RACK + FLUE, style.clutter);
        }
    }
    draw_dock(&mut furnisher, size, style.clutter);
    connect(&mut plan, &blocks, &rows);
    plan.shapes = draft.into_shapes();
    plan
}

/// West and east end of the blocks of racks, divided by cross aisles.
fn rack_blocks(width: f64) -> Vec<(f64, f64)> {
    let available = width - CROSS_AISLE - DOCK;
    let count = (available / 24.0).round().max(1.0);
    let length = (available - (count - 1.0) * CROSS_AISLE) / count;
    let start = |i: f64| CROSS_AISLE + i * (length + CROSS_AISLE);
    (0..count as usize).map(|i| (start(i as f64), start(i as f64) + length)).collect()
}

/// South and north edge of the double rows.
fn rack_rows(height: f64) -> Vec<(f64, f64)> {
    let depth = 2.0 * RACK + FLUE;
    let count = ((height - AISLE) / (depth + AISLE)).floor().max(1.0);
    let aisle = (height - count * depth) / (count + 1.0);
    (0..count as usize)
        .map(|i| aisle + i as f64 * (depth + aisle))
        .map(|south| (south, south + depth))
        .collect()
}

/// One rack: uprights in front and behind at each bay border, up to three pallets in a bay.
fn draw_rack(furnisher: &mut Furnisher<'_>, west: f64, east: f64, south: f64, clutter: f64) {
    let bays = ((east - west) / BAY).floor().max(1.0) as usize;
    let bay = (east - west) / bays as f64;
    for i in 0..=bays {
        let u = (west + bay * i as f64).clamp(west + 0.05, east - 0.05);
        for v in [south + 0.05, south + RACK - 0.05] {
            furnisher.draft.aligned_box(
                Vector2::new(u - 0.05, v - 0.05),
                Vector2::new(u + 0.05, v + 0.05),
                Material::Metal,
            );
        }
    }
    for i in 0..bays {
        for slot in 0..3 {
            if !furnisher.random.chance((0.72 * clutter).min(1.0)) {
                continue;
            }
            let pitch = (bay - 0.1) / 3.0;
            let centre_u = west + bay * i as f64 + 0.05 + pitch * (f64::from(slot) + 0.5);
            let u = centre_u + furnisher.random.between(-0.02, 0.02);
            let v = south + 0.5 * RACK + furnisher.random.between(-0.12, 0.12);
            let half = Vector2::new((0.5 * pitch - 0.03).min(0.4), furnisher.random.between(0.35, 0.5));
            let middle = Vector2::new(u, v);
            furnisher.draft.aligned_box(middle - half, middle + half, Material::Furniture);
        }
    }
}

/// Stacks of pallets and a desk near the doors.
fn draw_dock(furnisher: &mut Furnisher<'_>, size: Vector2, clutter: f64) {
    for _ in 0..(size.y / 3.0 * clutter) as usize {
        let u = furnisher.random.between(size.x - 1.6, size.x - 1.25);
        let v = furnisher.random.between(0.3, size.y - 1.2);
        furnisher.try_box(Rect::new(u, v, u + 1.2, v + 0.8), Material::Furniture);
    }
    furnisher.desk(Rect::new(size.x - DOCK + 1.9, 0.05, size.x - DOCK + 3.5, 0.85));
}

/// Aisles run east to west between the rows, cross aisles at the ends of the blocks.
fn connect(plan: &mut FloorPlan, blocks: &[(f64, f64)], rows: &[(f64, f64)]) {
    let last_end = blocks.last().map_or(0.0, |b| b.1);
    let mut xs: Vec<f64> = blocks.iter().map(|b| b.0 - 0.5 * CROSS_AISLE).collect();
    xs.push(last_end + 0.5 * CROSS_AISLE);
    let mut south = 0.0;
    let mut ys = Vec::new();
    for row in rows {
        ys.push(0.5 * (south + row.0));
        south = row.1;
    }
    ys.push(0.5 * (south + plan.size.y));
    for (row, y) in ys.iter().enumerate() {
        for (column, x) in xs.iter().enumerate() {
            let here = plan.add_junction(format!("aisle {row} end {column}"), Vector2::new(*x, *y));
            if column > 0 {
                plan.add_passage(here - 1, here);
            }
            if row > 0 {
                plan.add_passage(here - xs.len(), here);
            }
        }
    }
}
