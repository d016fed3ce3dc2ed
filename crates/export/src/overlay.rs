//! Draws trajectories, constraints and the scale bar over the background of a map picture.

use tiny_skia::{Color, FillRule, LineCap, LineJoin, Paint, PathBuilder, PixmapMut, Rect, Stroke, Transform};

use crate::colour::{Rgb, palette, rgb};
use crate::font::{draw_text, text_width};
use crate::path::ColouredLine;
use crate::raster::Frame;

/// Colours of start and end of a trajectory.
const START: Rgb = rgb(0x2ca02c);
const END: Rgb = rgb(0xd62728);
/// Colours of loop closures within a trajectory and between trajectories.
const LOOP: Rgb = rgb(0xe08214);
const LOOP_BETWEEN: Rgb = rgb(0x8073ac);
const WHITE: Rgb = rgb(0xffffff);
const INK: Rgb = rgb(0x20252b);

/// Sizes in the scale bar, in pixels of a picture of 1000 pixels: height of the text, height of the bar,
/// inner and outer margin.
const TEXT: f32 = 11.0;
const BAR: f32 = 5.0;
const PAD: f32 = 9.0;
const CORNER: f32 = 12.0;

/// The path of one trajectory in the map.
#[derive(Clone, Debug, PartialEq)]
pub struct TrajectoryLine {
    /// Index of its colour in the palette.
    pub index: usize,
    /// Map positions in order of time, metres.
    pub points: Vec<[f64; 2]>,
}

/// One constraint as a line from the submap's origin to the node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstraintLine {
    /// Map position of the submap, metres.
    pub from: [f64; 2],
    /// Map position of the node, metres.
    pub to: [f64; 2],
    /// Whether submap and node are of different trajectories.
    pub between_trajectories: bool,
}

/// An anti-aliased paint of one colour.
pub(crate) fn solid_paint(colour: Rgb, alpha: f32) -> Paint<'static> {
    let [r, g, b] = colour.map(|v| v.clamp(0.0, 1.0));
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    if let Some(colour) = Color::from_rgba(r, g, b, alpha) {
        paint.set_color(colour);
    }
    paint
}

fn pen(width: f32) -> Stroke {
    Stroke { width, line_cap: LineCap::Round, line_join: LineJoin::Round, ..Stroke::default() }
}

/// Draws all constraints as thin lines. `scale` is the scale of strokes: 1 for a picture of 1000 pixels.
pub fn draw_constraints(pixmap: &mut PixmapMut, frame: &Frame, constraints: &[ConstraintLine], scale: f32) {
    // The more lines, the more transparent: they must not cover the map.
    let alpha = (6.0 / (constraints.len() as f32).sqrt().max(1.0)).clamp(0.06, 0.7);
    for (between, colour) in [(false, LOOP), (true, LOOP_BETWEEN)] {
        let paint = solid_paint(colour, alpha);
        for constraint in constraints.iter().filter(|c| c.between_trajectories == between) {
            stroke_line(pixmap, frame, &[constraint.from, constraint.to], &paint, 0.8 * scale);
        }
    }
}

/// Draws trajectories in the colours of the palette, each with its start (green) and end (red).
pub fn draw_trajectories(pixmap: &mut PixmapMut, frame: &Frame, lines: &[TrajectoryLine], scale: f32) {
    for line in lines {
        // A light edge separates the line from walls.
        stroke_line(pixmap, frame, &line.points, &solid_paint(WHITE, 0.65), 4.6 * scale);
        stroke_line(pixmap, frame, &line.points, &solid_paint(palette(line.index), 0.92), 2.4 * scale);
    }
    for line in lines {
        // Of different sizes, so that both are visible where they coincide.
        let ends = [(line.points.last(), END, 6.0), (line.points.first(), START, 4.2)];
        for (point, colour, radius) in ends {
            if let Some(point) = point {
                let (x, y) = frame.pixel(*point);
                fill_circle(pixmap, x, y, (radius + 1.6) * scale, &solid_paint(WHITE, 0.95));
                fill_circle(pixmap, x, y, radius * scale, &solid_paint(colour, 1.0));
            }
        }
    }
}

/// Draws lines, each in its colour, the last on top. A line with a single position is drawn as a dot.
pub fn draw_coloured(pixmap: &mut PixmapMut, frame: &Frame, lines: &[ColouredLine], scale: f32) {
    for line in lines {
        stroke_line(pixmap, frame, &line.points, &solid_paint(WHITE, 0.65), 4.6 * scale);
    }
    for line in lines {
        let paint = solid_paint(line.colour, 0.95);
        stroke_line(pixmap, frame, &line.points, &paint, 2.6 * scale);
        if let [point] = line.points[..] {
            let (x, y) = frame.pixel(point);
            fill_circle(pixmap, x, y, 1.6 * scale, &paint);
        }
    }
}

/// Strokes a line through map positions. Positions less than half a pixel apart are merged. The line is
/// interrupted where a position is not finite or far outside of the picture.
fn stroke_line(pixmap: &mut PixmapMut, frame: &Frame, points: &[[f64; 2]], paint: &Paint, width: f32) {
    let mut builder = PathBuilder::new();
    let mut last: Option<(f32, f32)> = None;
    for (i, point) in points.iter().enumerate() {
        let (x, y) = frame.pixel(*point);
        if !(x.is_finite() && y.is_finite() && x.abs() < 1e6 && y.abs() < 1e6) {
            last = None;
            continue;
        }
        match last {
            None => builder.move_to(x, y),
            Some((a, b)) if (x - a).hypot(y - b) < 0.5 && i + 1 < points.len() => continue,
            Some(_) => builder.line_to(x, y),
        }
        last = Some((x, y));
    }
    if let Some(path) = builder.finish() {
        pixmap.stroke_path(&path, paint, &pen(width), Transform::identity(), None);
    }
}

fn fill_circle(pixmap: &mut PixmapMut, x: f32, y: f32, radius: f32, paint: &Paint) {
    if let Some(path) = PathBuilder::from_circle(x, y, radius) {
        pixmap.fill_path(&path, paint, FillRule::Winding, Transform::identity(), None);
    }
}

/// Draws a line of text on a plate in the upper left corner, if it fits.
pub fn draw_title(pixmap: &mut PixmapMut, title: &str, scale: f32) {
    let (width, height) = (text_width(title, TEXT * scale) + 2.0 * PAD * scale, (TEXT + 2.0 * PAD) * scale);
    let margin = CORNER * scale;
    if title.is_empty() || width + 2.0 * margin > pixmap.width() as f32 {
        return;
    }
    fill_rounded(pixmap, [margin, margin, width, height], 4.0 * scale, &solid_paint(WHITE, 0.82));
    let (x, base) = (margin + PAD * scale, margin + (PAD + TEXT) * scale);
    draw_text(pixmap, title, x, base, TEXT * scale, &solid_paint(INK, 1.0));
}

/// A bar of a round length with its length as text above it, in one corner of the picture.
pub struct ScaleBar {
    label: String,
    scale: f32,
    /// Length of the bar, pixels.
    bar: f32,
    width: f32,
    height: f32,
}

impl ScaleBar {
    /// A bar of about a sixth of the width; none if it does not fit.
    pub fn new(frame: &Frame, scale: f32) -> Option<Self> {
        let length = round_length(0.18 * frame.width as f64 * frame.resolution)?;
        let bar = (length / frame.resolution) as f32;
        let label = length_label(length);
        let width = bar.max(text_width(&label, TEXT * scale)) + 2.0 * PAD * scale;
        let height = (TEXT + BAR + 2.7 * PAD) * scale;
        let (most_x, most_y) = (frame.width as f32, frame.height as f32);
        let fits = width + 2.0 * CORNER * scale < most_x && height + 2.0 * CORNER * scale < most_y;
        fits.then_some(Self { label, scale, bar, width, height })
    }

    /// Possible rectangles of the bar: left, top, width and height in pixels; the preferred one first.
    pub fn places(&self, frame: &Frame) -> [[f32; 4]; 4] {
        let margin = CORNER * self.scale;
        let right = frame.width as f32 - margin - self.width;
        let bottom = frame.height as f32 - margin - self.height;
        [(margin, bottom), (right, bottom), (margin, margin), (right, margin)]
            .map(|(x, y)| [x, y, self.width, self.height])
    }

    /// Draws it in one of these rectangles.
    pub fn draw(&self, pixmap: &mut PixmapMut, [left, top, width, height]: [f32; 4]) {
        let scale = self.scale;
        fill_rounded(pixmap, [left, top, width, height], 4.0 * scale, &solid_paint(WHITE, 0.82));
        let (x, base) = (left + PAD * scale, top + height - PAD * scale);
        let thickness = BAR * scale;
        let ink = solid_paint(INK, 1.0);
        draw_text(pixmap, &self.label, x, base - thickness - 0.7 * PAD * scale, TEXT * scale, &ink);
        fill_rect(pixmap, [x, base - thickness, self.bar, thickness], &ink);
        // The second half is hollow, so that the bar shows two lengths.
        let edge = 1.2 * scale;
        let hollow =
            [x + 0.5 * self.bar, base - thickness + edge, 0.5 * self.bar - edge, thickness - 2.0 * edge];
        fill_rect(pixmap, hollow, &solid_paint(WHITE, 1.0));
    }
}

/// The largest of 1, 2, 5, 10, 20, … metres (or fractions) that is not longer than `target`.
pub(crate) fn round_length(target: f64) -> Option<f64> {
    if !(target.is_finite() && target > 1e-6) {
        return None;
    }
    let power = 10_f64.powf(target.log10().floor());
    // With a tolerance, because the logarithm may be rounded down.
    let steps = [10.0, 5.0, 2.0, 1.0];
    steps.into_iter().map(|s| s * power).find(|l| *l <= target * (1.0 + 1e-9))
}

pub(crate) fn length_label(metres: f64) -> String {
    if metres >= 1000.0 {
        format!("{} km", (metres / 1000.0 * 1e6).round() / 1e6)
    } else if metres >= 1.0 {
        format!("{} m", (metres * 1e6).round() / 1e6)
    } else if metres >= 0.01 {
        format!("{} cm", (metres * 100.0 * 1e6).round() / 1e6)
    } else {
        format!("{} mm", (metres * 1000.0 * 1e6).round() / 1e6)
    }
}

fn fill_rect(pixmap: &mut PixmapMut, [x, y, width, height]: [f32; 4], paint: &Paint) {
    if let Some(rect) = Rect::from_xywh(x, y, width, height) {
        pixmap.fill_rect(rect, paint, Transform::identity(), None);
    }
}

fn fill_rounded(pixmap: &mut PixmapMut, [x, y, width, height]: [f32; 4], radius: f32, paint: &Paint) {
    let r = radius.min(width / 2.0).min(height / 2.0);
    let mut b = PathBuilder::new();
    b.move_to(x + r, y);
    b.line_to(x + width - r, y);
    b.quad_to(x + width, y, x + width, y + r);
    b.line_to(x + width, y + height - r);
    b.quad_to(x + width, y + height, x + width - r, y + height);
    b.line_to(x + r, y + height);
    b.quad_to(x, y + height, x, y + height - r);
    b.line_to(x, y + r);
    b.quad_to(x, y, x + r, y);
    b.close();
    if let Some(path) = b.finish() {
        pixmap.fill_path(&path, paint, FillRule::Winding, Transform::identity(), None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_have_round_lengths() {
        for (target, length, label) in [
            (18.0, 10.0, "10 m"),
            (20.0, 20.0, "20 m"),
            (999.0, 500.0, "500 m"),
            (1000.0, 1000.0, "1 km"),
            (0.73, 0.5, "50 cm"),
            (0.2, 0.2, "20 cm"),
            (0.001, 0.001, "1 mm"),
        ] {
            let found = round_length(target).unwrap();
            assert!((found - length).abs() < 1e-9 * length, "{target}: {found}");
            assert_eq!(length_label(found), label);
        }
        assert_eq!([0.0, f64::NAN, f64::INFINITY, -1.0].map(round_length), [None; 4]);
    }
}
