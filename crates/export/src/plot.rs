//! Draws plots as SVG: lines over an axis, and histograms side by side. They need no external fonts, scripts
//! or files.

use std::fmt::Write;

use crate::html::escape;

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 260.0;
/// Margins for labels: left, right, top, bottom.
const MARGIN: [f64; 4] = [64.0, 16.0, 30.0, 42.0];
/// Approximate number of ticks along an axis.
const TICKS: f64 = 6.0;

/// A line of a plot.
#[derive(Clone, Debug, PartialEq)]
pub struct PlotLine<'a> {
    /// Name in the legend.
    pub name: &'a str,
    /// Any CSS colour.
    pub colour: &'a str,
    /// Points in ascending order of x.
    pub points: Vec<[f64; 2]>,
}

/// Labels of a plot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlotLabels<'a> {
    /// Title above the plot.
    pub title: &'a str,
    /// Label of the x axis, with unit.
    pub x: &'a str,
    /// Label of the y axis, with unit.
    pub y: &'a str,
}

/// Draws lines. Points that are not finite are left out.
pub fn line_plot(labels: PlotLabels, lines: &[PlotLine]) -> String {
    let all = || lines.iter().flat_map(|l| &l.points).filter(|p| p.iter().all(|v| v.is_finite()));
    let range = |k: usize| {
        all().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p[k]), high.max(p[k])))
    };
    let (x, mut y) = (range(0), range(1));
    // The y axis includes zero, so that changes are shown in proportion.
    y = (y.0.min(0.0), y.1.max(0.0));
    let axes = Axes::new(x, y);
    let mut svg = axes.start(labels, &lines.iter().map(|l| (l.name, l.colour)).collect::<Vec<_>>());
    for line in lines {
        let mut path = String::new();
        for point in line.points.iter().filter(|p| p.iter().all(|v| v.is_finite())) {
            let command = if path.is_empty() { 'M' } else { 'L' };
            let _ = write!(path, "{command}{:.1} {:.1}", axes.x(point[0]), axes.y(point[1]));
        }
        let colour = escape(line.colour);
        let _ = write!(svg, "<path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.4\"/>");
    }
    svg + "</svg>"
}

/// Counts of a histogram.
#[derive(Clone, Debug, PartialEq)]
pub struct PlotBars<'a> {
    /// Counted quantity.
    pub name: &'a str,
    /// Any CSS colour.
    pub colour: &'a str,
    /// Counts in equal steps from zero.
    pub counts: &'a [u32],
}

/// Draws histograms side by side, in steps of `step` from zero; the last step includes larger values.
pub fn bar_plot(labels: PlotLabels, step: f64, bars: &[PlotBars]) -> String {
    let steps = bars.iter().map(|b| b.counts.len()).max().unwrap_or(0);
    let most = bars.iter().flat_map(|b| b.counts).copied().max().unwrap_or(0);
    let axes = Axes::new((0.0, step * steps as f64), (0.0, f64::from(most)));
    let mut svg = axes.start(labels, &bars.iter().map(|b| (b.name, b.colour)).collect::<Vec<_>>());
    let width = (axes.x(step) - axes.x(0.0)) / bars.len().max(1) as f64;
    for (number, bars) in bars.iter().enumerate() {
        for (place, count) in bars.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let (left, top) =
                (axes.x(step * place as f64) + width * number as f64, axes.y(f64::from(*count)));
            let _ = write!(
                svg,
                "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{}\"/>",
                (width - 0.6).max(0.4),
                axes.y(0.0) - top,
                escape(bars.colour)
            );
        }
    }
    svg + "</svg>"
}

/// Ranges of the axes; they map values to the drawing.
struct Axes {
    x: (f64, f64),
    y: (f64, f64),
}

impl Axes {
    fn new(x: (f64, f64), y: (f64, f64)) -> Self {
        Self { x: widened(x), y: widened(y) }
    }

    fn x(&self, value: f64) -> f64 {
        MARGIN[0] + (WIDTH - MARGIN[0] - MARGIN[1]) * (value - self.x.0) / (self.x.1 - self.x.0)
    }

    fn y(&self, value: f64) -> f64 {
        HEIGHT - MARGIN[3] - (HEIGHT - MARGIN[2] - MARGIN[3]) * (value - self.y.0) / (self.y.1 - self.y.0)
    }

    /// Draws title, legend, grid and numbers.
    fn start(&self, labels: PlotLabels, legend: &[(&str, &str)]) -> String {
        let mut svg = format!(
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" xmlns=\"http://www.w3.org/2000/svg\" role=\"img\" \
             font-family=\"sans-serif\" font-size=\"12\" fill=\"#20252b\">\
             <rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"#fff\"/>\
             <text x=\"{}\" y=\"18\" font-weight=\"bold\">{}</text>",
            MARGIN[0],
            escape(labels.title)
        );
        let (left, right) = (MARGIN[0], WIDTH - MARGIN[1]);
        let (top, bottom) = (MARGIN[2], HEIGHT - MARGIN[3]);
        for value in ticks(self.y) {
            let y = self.y(value);
            let stroke = if value == 0.0 { "#8a929b" } else { "#e2e5e9" };
            let _ = write!(
                svg,
                "<path d=\"M{left:.1} {y:.1}H{right:.1}\" stroke=\"{stroke}\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                left - 6.0,
                y + 4.0,
                number(value)
            );
        }
        for value in ticks(self.x) {
            let x = self.x(value);
            let _ = write!(
                svg,
                "<path d=\"M{x:.1} {top:.1}V{bottom:.1}\" stroke=\"#eef0f2\"/>\
                 <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                bottom + 15.0,
                number(value)
            );
        }
        let middle = 0.5 * (top + bottom);
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\
             <text transform=\"translate(14 {middle:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            0.5 * (left + right),
            HEIGHT - 8.0,
            escape(labels.x),
            escape(labels.y)
        );
        let mut at = right;
        for (name, colour) in legend.iter().rev() {
            let _ = write!(
                svg,
                "<text x=\"{at:.1}\" y=\"18\" text-anchor=\"end\" fill=\"{}\" font-weight=\"bold\">{}</text>",
                escape(colour),
                escape(name)
            );
            at -= 8.0 * name.chars().count() as f64 + 14.0;
        }
        svg
    }
}

/// The range with a margin; never empty.
fn widened((low, high): (f64, f64)) -> (f64, f64) {
    if !(low.is_finite() && high.is_finite()) {
        return (0.0, 1.0);
    }
    let pad = 0.04 * (high - low);
    match high - low > 1e-12 {
        // A range that begins at zero gives an axis that begins at zero.
        true => (if low == 0.0 { low } else { low - pad }, if high == 0.0 { high } else { high + pad }),
        false => (low, high + 1e-3),
    }
}

/// Round numbers within a range.
fn ticks((low, high): (f64, f64)) -> Vec<f64> {
    let rough = (high - low) / TICKS;
    let power = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= rough).unwrap_or(rough);
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    (first..=last).map(|i| i as f64 * step).collect()
}

/// Formats a number with few digits.
fn number(value: f64) -> String {
    let text = format!("{value:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        assert_eq!(ticks((0.0, 100.0)), [0.0, 20.0, 40.0, 60.0, 80.0, 100.0]);
        let small = ticks((-0.013, 0.021));
        assert!(small.contains(&0.0) && small.iter().all(|t| (-0.013..=0.021).contains(t)));
        assert_eq!((number(0.02), number(-0.0), number(150.0)), ("0.02".into(), "0".into(), "150".into()));
    }

    #[test]
    fn plots_are_within_their_frame() {
        let labels = PlotLabels { title: "a < b", x: "time, s", y: "shift, m" };
        let line =
            PlotLine { name: "x", colour: "#d62728", points: vec![[0.0, -1.0], [1.0, f64::NAN], [2.0, 3.0]] };
        let svg = line_plot(labels, &[line]);
        assert!(svg.contains("a &lt; b") && svg.matches("<path").count() > 5 && svg.ends_with("</svg>"));
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        let svg = bar_plot(labels, 0.5, &[PlotBars { name: "before", colour: "red", counts: &[1, 0, 4] }]);
        assert_eq!(svg.matches("fill=\"red\"/>").count(), 2);
        for empty in [line_plot(labels, &[]), bar_plot(labels, 1.0, &[])] {
            assert!(!empty.contains("NaN") && !empty.contains("inf"), "{empty}");
        }
    }
}
