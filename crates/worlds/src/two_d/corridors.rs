//! A ring of smooth corridor without doors: along its sides a lidar does not constrain the position.

use portolan_geometry::Vector2;

use super::draft::Draft;
use super::plan::{FloorPlan, PlanStyle};
use super::shape::Material;

/// Width of the corridor, metres.
const WIDTH: f64 = 2.4;

pub(super) fn draw(style: &PlanStyle) -> FloorPlan {
    let size = Vector2::from(style.size);
    let mut draft = Draft::new();
    let inset = Vector2::new(WIDTH, WIDTH);
    draft.aligned_box(Vector2::zeros(), size, Material::Wall);
    draft.aligned_box(inset, size - inset, Material::Wall);
    let mut plan = FloorPlan { shapes: draft.into_shapes(), size, ..FloorPlan::default() };
    let half = 0.5 * WIDTH;
    let corners =
        [(half, half), (size.x - half, half), (size.x - half, size.y - half), (half, size.y - half)];
    for (i, (x, y)) in corners.into_iter().enumerate() {
        plan.add_junction(format!("corner {i}"), Vector2::new(x, y));
    }
    for i in 0..4 {
        plan.add_passage(i, (i + 1) % 4);
    }
    plan
}
