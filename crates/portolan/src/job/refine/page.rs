//! Writes the report of a refinement as one page.

use portolan_config::fingerprint_of;
use portolan_evaluation::cloud::{CloudQuality, WallThickness};
use portolan_export::{HtmlPage, PlotBars, PlotLabels, PlotLine, bar_plot, line_plot};
use portolan_geometry::{Vector3, angle_axis_from_quaternion};
use portolan_numeric::counted;
use portolan_refinement::continuous::DenseTrajectory;

use super::judgement::Judgement;
use super::pictures::Pictures;
use super::results::RefineResults;
use crate::job::JobError;

/// Maximum number of points of a plotted line.
const PLOT_POINTS: usize = 800;
const COLOURS: [&str; 4] = ["#d62728", "#2ca02c", "#1f77b4", "#20252b"];
const BEFORE: &str = "#e08214";
const AFTER: &str = "#1f77b4";

/// The whole page.
pub fn report_page(
    results: &RefineResults,
    judgement: &Judgement,
    pictures: &Pictures,
    command: &str,
) -> Result<String, JobError> {
    let mut page = HtmlPage::new("Portolan: a refined map");
    page.command(command);
    input(&mut page, results);
    notes(&mut page, results);
    sharpness(&mut page, judgement);
    if !pictures.details.is_empty() {
        page.heading("Where walls changed most");
        page.paragraph(
            "Cuts 30 cm thick, 3 m wide; before on the left, after on the right. Numbers are marked in the views \
             below. Thickness is the standard deviation of the same points across their wall.",
        );
        for picture in &pictures.details {
            page.figures(&side_by_side(picture)?);
        }
    }
    page.heading("The whole cloud");
    for picture in &pictures.whole {
        page.figures(&side_by_side(picture)?);
    }
    page.heading("How the trajectory was changed");
    page.figures(&[
        (shift_plot(&results.refined.trajectory), "Change of position, in the axes of the map.".to_owned()),
        (
            turn_plot(&results.refined.trajectory),
            "Change of orientation, about the axes of the map.".to_owned(),
        ),
    ]);
    steps(&mut page, results);
    Ok(page.finish())
}

fn side_by_side(picture: &super::pictures::PicturePair) -> Result<[(String, String); 2], JobError> {
    let [before, after] = picture.drawings().map_err(JobError::Drawing)?;
    Ok([(before, format!("{} (before)", picture.title)), (after, format!("{} (after)", picture.title))])
}

fn input(page: &mut HtmlPage, results: &RefineResults) {
    let plan = &results.read.plan;
    let topics: Vec<&str> = plan.range.iter().map(|r| &*r.source.topic).collect();
    let report = &results.refined.report;
    // Numbers can always be written as JSON.
    let method = serde_json::to_string(&report.method).unwrap_or_default();
    let mut rows = vec![
        ["Version".to_owned(), format!("Portolan {}", env!("CARGO_PKG_VERSION"))],
        [
            "Sensors".to_owned(),
            format!("{}; poses are those of frame {}", topics.join(", "), plan.tracking_frame),
        ],
        [
            "Points".to_owned(),
            format!(
                "{} along {:.1} s of trajectory with {}",
                report.points,
                results.refined.trajectory.duration(),
                counted(results.input.len() as u64, "pose", "poses")
            ),
        ],
        ["Options".to_owned(), method.clone()],
        ["Fingerprint of the options".to_owned(), fingerprint_of([method])],
    ];
    for file in results.files {
        let size = std::fs::metadata(file).map_or(0, |m| m.len());
        rows.insert(1, ["Input".to_owned(), format!("{} ({:.1} MB)", file.display(), size as f64 / 1e6)]);
    }
    page.table(&[], &rows);
}

/// Warnings, undetermined motion, and issues.
fn notes(page: &mut HtmlPage, results: &RefineResults) {
    let report = &results.refined.report;
    report.warnings.iter().for_each(|warning| page.warning(warning));
    if report.stopped {
        page.warning("It was stopped before the end; these are the results so far.");
    }
    for u in &report.undetermined {
        let what = if u.is_rotation { "rotation about" } else { "translation along" };
        let [x, y, z] = u.direction;
        page.warning(&format!(
            "Not determined by the measurements from {:.0} s to {:.0} s: {what} ({x:.2}, {y:.2}, {z:.2}); kept as in the input.",
            u.from, u.to
        ));
    }
    for issue in &results.read.issues {
        let label = if issue.lost_data() { "Lost" } else { "Repaired" };
        let times = counted(issue.count, "time", "times");
        page.paragraph(&format!("{label} while reading: {issue} ({times})."));
    }
}

fn sharpness(page: &mut HtmlPage, judgement: &Judgement) {
    page.heading("Sharpness");
    let (before, after) = (&judgement.before, &judgement.after);
    let mut rows = Vec::new();
    let mut row = |what: &str, value: &dyn Fn(&CloudQuality) -> Option<f64>, digits: usize| {
        let cell = |quality| value(quality).map_or("–".to_owned(), |v| format!("{v:.digits$}"));
        rows.push([what.to_owned(), cell(before), cell(after)]);
    };
    row("Mean map entropy", &|q| Some(q.sharpness?.mean_map_entropy), 3);
    row("Mean plane thickness, cm", &|q| Some(100.0 * q.sharpness?.mean_plane_variance.sqrt()), 2);
    row(
        "Thickness of surfaces at right angles (MOM), cm",
        &|q| Some(100.0 * q.orthogonality?.mean_plane_variance.sqrt()),
        2,
    );
    row("Median thickness of walls, cm", &|q| Some(100.0 * q.walls.as_ref()?.median), 2);
    row("90 % of walls are thinner than, cm", &|q| Some(100.0 * q.walls.as_ref()?.percentile_90), 2);
    row("Median distance between passes, cm", &|q| Some(100.0 * q.passes?.median_across), 2);
    row("95 % of distances between passes, cm", &|q| Some(100.0 * q.passes?.percentile_95_across), 2);
    page.table(&["", "before", "after"], &rows);
    if let Some(sharpness) = &after.sharpness {
        page.paragraph(&format!(
            "Measured within {} m of {} places, {:.0} points each, in {} of the points; lower is sharper. Figures \
             can only be compared between clouds of one density measured with the same radius.",
            sharpness.options.radius, sharpness.neighbourhoods, sharpness.mean_neighbours, sharpness.points
        ));
    }
    for change in &judgement.changes {
        page.paragraph(&format!("{change}."));
    }
    if let (Some(before), Some(after)) = (&before.walls, &after.walls) {
        page.figures(&[(wall_plot(before, after), "How thick walls are.".to_owned())]);
    }
}

fn wall_plot(before: &WallThickness, after: &WallThickness) -> String {
    let bars = |name, colour, walls| PlotBars { name, colour, counts: walls };
    bar_plot(
        PlotLabels {
            title: "Thickness of walls",
            x: "standard deviation across the wall, cm (the last bar counts all that are thicker)",
            y: "pieces of wall",
        },
        0.5,
        &[
            bars("before", BEFORE, &before.histogram_half_centimetres),
            bars("after", AFTER, &after.histogram_half_centimetres),
        ],
    )
}

/// A vector over time: its components and its norm.
fn vector_lines<'a>(
    trajectory: &DenseTrajectory,
    names: [&'a str; 4],
    value: impl Fn(f64) -> Vector3,
) -> Vec<PlotLine<'a>> {
    let count = (trajectory.duration() / 0.05).ceil().clamp(1.0, PLOT_POINTS as f64) as usize;
    let values: Vec<(f64, Vector3)> = (0..=count)
        .map(|i| trajectory.duration() * i as f64 / count as f64)
        .map(|seconds| (seconds, value(seconds)))
        .collect();
    let line = |k: usize| {
        let part = |v: &Vector3| if k < 3 { v[k] } else { v.norm() };
        let points = values.iter().map(|(s, v)| [*s, part(v)]).collect();
        PlotLine { name: names[k], colour: COLOURS[k], points }
    };
    (0..4).map(line).collect()
}

fn shift_plot(trajectory: &DenseTrajectory) -> String {
    let labels = PlotLabels { title: "Change of position", x: "time, s", y: "translation, m" };
    line_plot(
        labels,
        &vector_lines(trajectory, ["x", "y", "z", "length"], |s| trajectory.correction(s).shift),
    )
}

fn turn_plot(trajectory: &DenseTrajectory) -> String {
    let labels = PlotLabels { title: "Change of orientation", x: "time, s", y: "rotation, deg" };
    let turn = |s| angle_axis_from_quaternion(&trajectory.correction(s).turn).map(f64::to_degrees);
    line_plot(labels, &vector_lines(trajectory, ["x", "y", "z", "angle"], turn))
}

/// Steps of the optimisation.
fn steps(page: &mut HtmlPage, results: &RefineResults) {
    let steps = &results.refined.report.steps;
    if steps.is_empty() {
        return;
    }
    page.heading("Steps");
    let rows: Vec<[String; 6]> = steps
        .iter()
        .map(|s| {
            [
                s.stage.to_owned(),
                format!("{:.2}", s.knot_spacing),
                format!("{:.3}", s.reach),
                s.terms.to_string(),
                format!("{:.2}", 1e3 * s.rms),
                format!("{:.2}", 1e3 * s.shift),
            ]
        })
        .collect();
    page.table(
        &["stage", "knots, s", "reach, m", "terms", "scatter before, mm", "largest translation, mm"],
        &rows,
    );
}
