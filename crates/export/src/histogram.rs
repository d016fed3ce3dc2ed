//! Draws histograms as pictures.

use tiny_skia::{Color, Paint, PathBuilder, Pixmap, PixmapMut, Rect, Stroke, Transform};

use crate::colour::{Rgb, rgb};
use crate::font::{draw_text, text_width};
use crate::picture::Picture;
use crate::raster::Frame;

/// Size of one panel, pixels.
const WIDTH: f32 = 720.0;
const HEIGHT: f32 = 360.0;
/// Margins for labels around the bars: left, right, top, bottom.
const MARGIN: [f32; 4] = [64.0, 20.0, 48.0, 48.0];
const LABEL: f32 = 12.0;
const BARS: usize = 40;

const INK: Rgb = rgb(0x20252b);
const FAINT: Rgb = rgb(0xd5d9de);
const BAR: Rgb = rgb(0x3b6ea5);
const MEDIAN: Rgb = rgb(0xd62728);

/// One histogram: non-negative values with a title.
#[derive(Clone, Debug, PartialEq)]
pub struct HistogramPanel<'a> {
    /// Quantity with its unit: `translational error, m`.
    pub title: &'a str,
    /// The values; those that are not finite are left out.
    pub values: &'a [f64],
}

/// Draws histograms one below the other, each from zero to a round number that is above 95 percent of the
/// values, with the median marked. Larger values are counted in the last bar. None without panels.
pub fn draw_histograms(panels: &[HistogramPanel]) -> Option<Picture> {
    let height = HEIGHT * panels.len() as f32;
    let mut pixmap = Pixmap::new(WIDTH as u32, height as u32)?;
    pixmap.fill(Color::WHITE);
    let mut canvas = pixmap.as_mut();
    for (i, panel) in panels.iter().enumerate() {
        draw_panel(&mut canvas, panel, HEIGHT * i as f32);
    }
    let frame = Frame {
        width: WIDTH as usize,
        height: height as usize,
        resolution: 1.0,
        upper_left: [0.0, f64::from(height)],
    };
    // Every pixel is opaque, so premultiplied colours equal the colours.
    let rgb = pixmap.data().chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    Some(Picture { frame, rgb })
}

/// Counts in equal steps from zero; the last one includes larger values.
struct Bars {
    end: f64,
    counts: Vec<usize>,
    median: f64,
    max: f64,
    total: usize,
}

impl Bars {
    fn of(values: &[f64]) -> Option<Self> {
        let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted.get((share * (sorted.len() as f64 - 1.0)).round() as usize).copied();
        let end = round_up(at(0.95)?.max(1e-9));
        let mut counts = vec![0; BARS];
        for value in &sorted {
            let bar = ((value / end * BARS as f64) as usize).min(BARS - 1);
            counts[bar] += 1;
        }
        Some(Self { end, counts, median: at(0.5)?, max: at(1.0)?, total: sorted.len() })
    }
}

/// Rounds up to 1, 2 or 5 times a power of ten.
fn round_up(value: f64) -> f64 {
    let power = 10_f64.powf(value.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|m| m * power);
    steps.into_iter().find(|s| *s >= value * (1.0 - 1e-9)).unwrap_or(10.0 * power)
}

fn draw_panel(canvas: &mut PixmapMut, panel: &HistogramPanel, top: f32) {
    let [left, right, above, below] = MARGIN;
    let (x0, x1) = (left, WIDTH - right);
    let (y0, y1) = (top + above, top + HEIGHT - below);
    let Some(bars) = Bars::of(panel.values) else {
        draw_text(canvas, &format!("{}: no values", panel.title), x0, top + 28.0, LABEL, &paint(INK));
        return;
    };
    let title =
        format!("{}: {} values, median {:.3}, largest {:.3}", panel.title, bars.total, bars.median, bars.max);
    draw_text(canvas, &title, x0, top + 28.0, LABEL, &paint(INK));
    let tallest = bars.counts.iter().copied().max().unwrap_or(1).max(1);
    let top_count = round_up(tallest as f64);
    let x = |value: f64| x0 + (x1 - x0) * (value / bars.end).clamp(0.0, 1.0) as f32;
    let y = |count: f64| y1 - (y1 - y0) * (count / top_count) as f32;
    for i in 0..=4 {
        let share = f64::from(i) / 4.0;
        line(canvas, [x0, y(top_count * share), x1, y(top_count * share)], FAINT, 1.0);
        let label = format!("{}", (top_count * share * 100.0).round() / 100.0);
        let left = x0 - 8.0 - text_width(&label, LABEL);
        draw_text(canvas, &label, left, y(top_count * share) + LABEL / 2.0, LABEL, &paint(INK));
        let label = number(bars.end * share) + if i == 4 && bars.max > bars.end { "+" } else { "" };
        let left = x(bars.end * share) - text_width(&label, LABEL) / 2.0;
        draw_text(canvas, &label, left, y1 + 10.0 + LABEL, LABEL, &paint(INK));
    }
    let width = (x1 - x0) / BARS as f32;
    for (i, count) in bars.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
        // At least one pixel, so that the smallest bar is visible.
        let height = (y1 - y(*count as f64)).max(1.0);
        if let Some(rect) = Rect::from_xywh(x0 + width * i as f32 + 0.5, y1 - height, width - 1.0, height) {
            canvas.fill_rect(rect, &paint(BAR), Transform::identity(), None);
        }
    }
    line(canvas, [x(bars.median), y0, x(bars.median), y1], MEDIAN, 1.5);
    line(canvas, [x0, y1, x1, y1], INK, 1.5);
}

/// Formats a number with few digits.
fn number(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn paint(colour: Rgb) -> Paint<'static> {
    let [r, g, b] = colour;
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    if let Some(colour) = Color::from_rgba(r, g, b, 1.0) {
        paint.set_color(colour);
    }
    paint
}

fn line(canvas: &mut PixmapMut, [x0, y0, x1, y1]: [f32; 4], colour: Rgb, width: f32) {
    let mut path = PathBuilder::new();
    path.move_to(x0, y0);
    path.line_to(x1, y1);
    if let Some(path) = path.finish() {
        let stroke = Stroke { width, ..Stroke::default() };
        canvas.stroke_path(&path, &paint(colour), &stroke, Transform::identity(), None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_are_round() {
        let ends = [0.93, 1.0, 1.2, 2.1, 7.0, 0.034, 450.0].map(round_up);
        let expected = [1.0, 1.0, 2.0, 5.0, 10.0, 0.05, 500.0];
        assert!(ends.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{ends:?}");
    }

    #[test]
    fn every_value_is_in_a_bar() {
        let values: Vec<f64> = (0..1000).map(|i| f64::from(i) * 0.01).chain([f64::NAN, 1e6]).collect();
        let Some(bars) = Bars::of(&values) else { panic!("no bars") };
        assert_eq!((bars.counts.iter().sum::<usize>(), bars.total, bars.end), (1001, 1001, 10.0));
        assert!(Bars::of(&[]).is_none());
    }

    #[test]
    fn panels_are_drawn_below_each_other() {
        let panel = HistogramPanel { title: "error, m", values: &[0.1, 0.2, 0.2, 0.4] };
        let empty = HistogramPanel { title: "nothing", values: &[] };
        let Some(picture) = draw_histograms(&[panel, empty]) else { panic!("no picture") };
        assert_eq!((picture.frame.width, picture.frame.height), (720, 720));
        assert!(picture.rgb.chunks(3).any(|p| p == [0x3b, 0x6e, 0xa5]));
        assert!(draw_histograms(&[]).is_none());
    }
}
