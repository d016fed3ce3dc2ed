//! Draws a cloud before and after a refinement: from above, in level and upright cuts, and where walls
//! changed most.

use portolan_evaluation::cloud::WallChange;
use portolan_export::{Mark, PointImage, PointView, encode_grey, marked_picture, scale_mark};
use portolan_refinement::continuous::DenseTrajectory;

use super::cloud_pair::{CloudPair, PairedPoint};

/// Maximum number of points that are drawn.
const POINTS: usize = 16_000_000;
/// Number of points from which the extent of the cloud is determined.
const EXTENT_POINTS: usize = 200_000;
/// Fraction of points at each end that is left outside.
const STRAYS: f64 = 0.003;
/// Longest edge of large pictures, pixels.
const LARGE: usize = 1100;
/// Edge of details, pixels.
const DETAIL: usize = 480;
/// Minimum size of a pixel, metres.
const FINEST: f64 = 0.005;
/// Edge of a detail, metres.
const DETAIL_SIZE: f64 = 3.0;
/// Half of the thickness of the cut of a detail, metres.
const HALF_CUT: f64 = 0.15;
/// Half of the thickness of the level and the upright cut, metres.
const HALF_LEVEL: f64 = 0.25;
/// Vertical component of a unit normal above which a wall counts as a floor, which is shown from the side.
const FLOOR: f64 = 0.7;
/// Seconds between the points of the drawn trajectory.
const LINE_STEP: f64 = 0.25;

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];

/// One view, before and after.
pub struct PicturePair {
    /// Its title.
    pub title: String,
    view: PointView,
    /// Whether only points near the height of the sensor at their time are drawn.
    level: bool,
    images: [PointImage; 2],
    marks: [Vec<Mark>; 2],
}

impl PicturePair {
    fn new(title: impl Into<String>, view: PointView) -> Self {
        let image = PointImage::new(&view);
        Self {
            title: title.into(),
            view,
            level: false,
            images: [image.clone(), image],
            marks: [Vec::new(), Vec::new()],
        }
    }

    /// Before and after as SVG, in the same greys.
    pub fn drawings(&self) -> std::io::Result<[String; 2]> {
        let strong = self.images.iter().map(PointImage::strong_count).max().unwrap_or(1);
        let draw = |i: usize| -> std::io::Result<String> {
            let (width, height) = (self.view.width, self.view.height);
            let png = encode_grey(width, height, &self.images[i].grey(strong))?;
            let mut marks = self.marks[i].clone();
            marks.extend(scale_mark(width, self.view.resolution));
            Ok(marked_picture(&png, width, height, &marks))
        };
        Ok([draw(0)?, draw(1)?])
    }
}

/// All pictures of a refinement.
pub struct Pictures {
    /// Pictures of the whole cloud.
    pub whole: Vec<PicturePair>,
    /// Pictures of the largest changes, in their order.
    pub details: Vec<PicturePair>,
}

/// Draws all pictures.
pub fn pictures(pair: &CloudPair, trajectory: &DenseTrajectory, changes: &[WallChange]) -> Pictures {
    let mut whole = whole_views(pair, trajectory, changes);
    let mut details: Vec<PicturePair> =
        changes.iter().enumerate().map(|(i, change)| detail(i + 1, change)).collect();
    let views: Vec<(PointView, bool)> = whole.iter().chain(&details).map(|p| (p.view, p.level)).collect();
    let images = pair.sum(
        POINTS,
        || views.iter().map(|(view, _)| [PointImage::new(view), PointImage::new(view)]).collect::<Vec<_>>(),
        |images, point| {
            for ((view, level), [before, after]) in views.iter().zip(images) {
                if !level || point.above_tracking.abs() <= HALF_LEVEL {
                    before.add(view, point.before);
                    after.add(view, point.after);
                }
            }
        },
        |mut a, b| {
            for ([before, after], [more_before, more_after]) in a.iter_mut().zip(&b) {
                before.merge(more_before);
                after.merge(more_after);
            }
            a
        },
    );
    for (picture, images) in whole.iter_mut().chain(&mut details).zip(images) {
        picture.images = images;
    }
    Pictures { whole, details }
}

/// Views from above, at the height of the sensor, and an upright cut through the largest change.
fn whole_views(pair: &CloudPair, trajectory: &DenseTrajectory, changes: &[WallChange]) -> Vec<PicturePair> {
    let sample = pair.sample(EXTENT_POINTS);
    let Some([low, high]) = extent(&sample) else { return Vec::new() };
    let centre: [f64; 3] = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
    let from_above = PointView::new(centre, [X, Y], [high[0] - low[0], high[1] - low[1]], LARGE, FINEST);
    let mut top = PicturePair::new("From above, all points", from_above);
    let mut level = PicturePair::new(
        format!("Level cut, {HALF_LEVEL} m below to {HALF_LEVEL} m above the sensor"),
        from_above,
    );
    level.level = true;
    let lines = trajectory_marks(trajectory, &from_above);
    for picture in [&mut top, &mut level] {
        for (marks, line) in picture.marks.iter_mut().zip(&lines) {
            marks.push(line.clone());
            marks.extend(changes.iter().enumerate().map(|(i, c)| frame(&from_above, i + 1, c)));
        }
    }
    // Upright cut along the trajectory, in the middle or through the largest change.
    let along = main_direction(trajectory);
    let middle = changes.first().map_or(centre, |c| c.place);
    let reach = |k: usize| (high[k] - low[k]).abs();
    let length = (along[0] * reach(0)).abs() + (along[1] * reach(1)).abs();
    let sideways = [-along[1], along[0], 0.0];
    let off = (0..2).map(|k| (middle[k] - centre[k]) * sideways[k]).sum::<f64>();
    let through = [centre[0] + off * sideways[0], centre[1] + off * sideways[1], centre[2]];
    let upright =
        PointView::new(through, [along, Z], [length, reach(2)], LARGE, FINEST).with_half_depth(HALF_LEVEL);
    let name = if changes.is_empty() { "Upright cut" } else { "Upright cut through 1" };
    let upright = PicturePair::new(format!("{name}, {} m thick", 2.0 * HALF_LEVEL), upright);
    vec![top, level, upright]
}

/// Extent of nearly all points of both clouds.
fn extent(sample: &[PairedPoint]) -> Option<[[f64; 3]; 2]> {
    let (mut lowest, mut highest) = ([0.0; 3], [0.0; 3]);
    for (k, (low, high)) in lowest.iter_mut().zip(&mut highest).enumerate() {
        let mut values: Vec<f64> =
            sample.iter().flat_map(|p| [p.before[k], p.after[k]]).filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        let last = values.len().checked_sub(1)?;
        let at = |share: f64| values[(share * last as f64) as usize];
        (*low, *high) = (at(STRAYS), at(1.0 - STRAYS));
        let margin = 0.02 * (*high - *low) + 0.5;
        (*low, *high) = (*low - margin, *high + margin);
    }
    Some([lowest, highest])
}

/// The trajectory before and after as lines.
fn trajectory_marks(trajectory: &DenseTrajectory, view: &PointView) -> [Mark; 2] {
    let count = (trajectory.duration() / LINE_STEP).ceil().clamp(1.0, 4000.0) as usize;
    let line = |input: bool| {
        let place = |i: usize| {
            let seconds = trajectory.duration() * i as f64 / count as f64;
            let pose = if input { trajectory.input_pose(seconds) } else { trajectory.pose(seconds) };
            view.place(pose.translation.vector.into())
        };
        Mark::Line((0..=count).map(place).collect())
    };
    [line(true), line(false)]
}

/// The horizontal direction in which the trajectory extends most.
fn main_direction(trajectory: &DenseTrajectory) -> [f64; 3] {
    let count = 500;
    let places: Vec<[f64; 2]> = (0..=count)
        .map(|i| trajectory.pose(trajectory.duration() * f64::from(i) / f64::from(count)).translation)
        .map(|t| [t.x, t.y])
        .collect();
    let mean = |k: usize| places.iter().map(|p| p[k]).sum::<f64>() / places.len() as f64;
    let (mx, my) = (mean(0), mean(1));
    let (xx, xy, yy) = places.iter().fold((0.0, 0.0, 0.0), |(xx, xy, yy), [x, y]| {
        (xx + (x - mx).powi(2), xy + (x - mx) * (y - my), yy + (y - my).powi(2))
    });
    let angle = 0.5 * f64::atan2(2.0 * xy, xx - yy);
    [angle.cos(), angle.sin(), 0.0]
}

/// Frame of a change in a larger picture.
fn frame(view: &PointView, number: usize, change: &WallChange) -> Mark {
    let size = DETAIL_SIZE / view.resolution;
    let [x, y] = view.place(change.place);
    Mark::Frame([x - 0.5 * size, y - 0.5 * size, size, size], number.to_string())
}

/// A cut across a wall, seen from above, or across a floor, seen from the side.
fn detail(number: usize, change: &WallChange) -> PicturePair {
    let is_floor = change.normal[2].abs() > FLOOR;
    let axes = if is_floor { [X, Z] } else { [X, Y] };
    let view = PointView::new(change.place, axes, [DETAIL_SIZE; 2], DETAIL, FINEST).with_half_depth(HALF_CUT);
    let [x, y, z] = change.place;
    let how = if is_floor { "upright cut" } else { "level cut" };
    PicturePair::new(
        format!(
            "{number}: {how} at ({x:.1}, {y:.1}, {z:.1}) m, wall {:.1} -> {:.1} cm thick",
            100.0 * change.before,
            100.0 * change.after
        ),
        view,
    )
}
