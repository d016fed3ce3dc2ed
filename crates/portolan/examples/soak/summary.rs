//! Rows as plots, and whether the end is as the first hour was.

use std::fmt::Write;

use portolan::export::{PlotLabels, PlotLine, line_plot};

use crate::rows::{ROWS_AN_HOUR, Row, at};

/// It is flat if the end is at most so many times the first hour.
const FLAT: f64 = 1.05;

/// A value of a row, with two words on it: its name and colour, or its name and unit.
type Line<'a> = (&'a str, &'a str, fn(&Row) -> f64);

const PLOTS: [(&str, &str, &[Line]); 3] = [
    ("Memory", "MB", &[("in use", "#1f77b4", |row| row.memory)]),
    (
        "Processor time from one measurement to the next",
        "ms",
        &[("median", "#2ca02c", |row| row.cpu_latency[0]), ("99 %", "#9467bd", |row| row.cpu_latency[1])],
    ),
    (
        "Pose graph",
        "",
        &[
            ("nodes", "#1f77b4", |row| row.graph[0] as f64),
            ("submaps, times 10", "#ff7f0e", |row| 10.0 * row.graph[1] as f64),
            ("constraints", "#8c564b", |row| row.graph[2] as f64),
        ],
    ),
];

/// Memory, processor time, latency and the pose graph over the hours of the recording, as SVG.
pub fn plots(rows: &[Row]) -> String {
    let draw = |title, y, lines: &[(&str, &str, Vec<[f64; 2]>)]| {
        let lines: Vec<PlotLine> = lines
            .iter()
            .map(|(name, colour, points)| PlotLine { name, colour, points: points.clone() })
            .collect();
        line_plot(PlotLabels { title, x: "recording, h", y }, &lines)
    };
    let points = |value: fn(&Row) -> f64| rows.iter().map(|row| [row.hours, value(row)]).collect();
    // Localisation has no graph.
    let shows = |(_, _, lines): &&(&str, &str, &[Line])| {
        lines.iter().any(|(.., value)| rows.iter().any(|row| value(row) > 0.0))
    };
    let mut all: Vec<String> = PLOTS
        .iter()
        .filter(shows)
        .map(|(title, y, lines)| {
            let lines = lines.iter().map(|(name, colour, value)| (*name, *colour, points(*value)));
            draw(title, y, &lines.collect::<Vec<_>>())
        })
        .collect();
    let pairs = rows.windows(2).filter_map(|pair| {
        let [a, b] = pair else { return None };
        Some([b.hours, (b.cpu_seconds - a.cpu_seconds) / (60.0 * (b.hours - a.hours))])
    });
    let cpu = [("processor", "#d62728", pairs.collect())];
    all.insert(1, draw("Processor time", "s a minute of recording", &cpu));
    let height = 20 + 270 * all.len();
    let mut svg = format!("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"780\" height=\"{height}\">");
    for (i, plot) in all.iter().enumerate() {
        let placed = plot.replacen(
            "<svg ",
            &format!("<svg x=\"10\" y=\"{}\" width=\"760\" height=\"260\" ", 10 + 270 * i),
            1,
        );
        svg += &placed;
    }
    svg + "</svg>"
}

/// Medians of half an hour, at the end of the first hour and at the end; of runs of less than two hours those of thirds.
pub fn verdict(rows: &[Row]) -> String {
    let hour = ROWS_AN_HOUR as usize;
    let window = (hour / 2).min(rows.len() / 3).max(1);
    let first_end = hour.min(rows.len() / 2).max(window);
    let median = |rows: &[Row], value: fn(&Row) -> f64| {
        let mut values: Vec<f64> = rows.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        at(&values, 0.5)
    };
    let mut text = String::new();
    let values: [Line; 3] = [
        ("memory", "MB", |row| row.memory),
        ("processor time of a measurement, 99 %", "ms", |row| row.cpu_latency[1]),
        ("latency by the clock, 99 %", "ms", |row| row.latency[1]),
    ];
    for (name, unit, value) in values {
        let first = rows.get(first_end - window..first_end).map_or(0.0, |rows| median(rows, value));
        let end = median(&rows[rows.len().saturating_sub(window)..], value);
        let ratio = end / first;
        let is_flat = if ratio <= FLAT { "flat" } else { "NOT flat" };
        let _ = writeln!(
            text,
            "{name}: {first:.2} {unit} after the first hour, {end:.2} at the end: {ratio:.3}, {is_flat}"
        );
    }
    let last = rows.last().copied().unwrap_or_default();
    let speed = last.hours * 60.0 / last.cpu_seconds;
    text + &format!(
        "{:.2} h in {:.0} s of processor time: {speed:.3} h a minute",
        last.hours, last.cpu_seconds
    )
}
