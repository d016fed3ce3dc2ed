//! Draws trajectories over pictures of points (`formats.md` §6.4).

use tiny_skia::{FillRule, LineCap, LineJoin, PathBuilder, PixmapMut, Stroke, Transform};

use crate::colour::{Rgb, palette};
use crate::overlay::solid_paint;

const WIDTH: f32 = 4.0;
const RADIUS: f32 = 6.0;
const ALPHA: f32 = 0.7;
const START: Rgb = [0.0, 1.0, 0.0];
const END: Rgb = [1.0, 0.0, 0.0];

/// Draws a trajectory through pixels, with a green start and a red end.
pub(super) fn draw_trajectory(canvas: &mut PixmapMut, index: usize, pixels: &[[f32; 2]]) {
    let (Some(first), Some(last)) = (pixels.first(), pixels.last()) else { return };
    let mut builder = PathBuilder::new();
    builder.move_to(first[0], first[1]);
    pixels.iter().skip(1).for_each(|[x, y]| builder.line_to(*x, *y));
    let stroke =
        Stroke { width: WIDTH, line_cap: LineCap::Butt, line_join: LineJoin::Miter, ..Stroke::default() };
    if let Some(path) = builder.finish() {
        canvas.stroke_path(&path, &solid_paint(palette(index), ALPHA), &stroke, Transform::identity(), None);
    }
    for ([x, y], colour) in [(first, START), (last, END)] {
        if let Some(path) = PathBuilder::from_circle(*x, *y, RADIUS) {
            let paint = solid_paint(colour, ALPHA);
            canvas.fill_path(&path, &paint, FillRule::Winding, Transform::identity(), None);
        }
    }
}
