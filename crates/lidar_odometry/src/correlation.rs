//! Correlates two sweeps without a prior of the motion: every shift and heading is tried, and scored by
//! the fraction of upright structures that is met again (correlative scan matching: Olson, "Real-Time
//! Correlative Scan Matching", ICRA 2009, here on columns of voxels).
//!
//! Nearest neighbours do not measure the motion: the rings in which beams hit the ground, and the lines
//! that they make along a wall, move with the scanner, and hold it at its old position. Structures of some
//! height do not.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Point3f, Rigid3, Vector3, quaternion_from_angle_axis, to_f32};
use portolan_numeric::median;

use crate::settings::CorrelationSettings;

impl CorrelationSettings {
    /// Height of voxels, metres. A point is upright if its column has points two to four voxels higher or
    /// lower: less than the height of a car, more than slopes rise in a column.
    fn layer(&self) -> f32 {
        0.5 * self.cell
    }

    /// The layer at a height, metres, with its fraction.
    pub(crate) fn layer_at(&self, height: f64) -> f64 {
        (height as f32 / self.layer() + 0.5 * LAYERS).into()
    }

    /// The height of the middle of a layer, metres.
    pub(crate) fn height_of(&self, layer: u32) -> f64 {
        f64::from((layer as f32 + 0.5 - 0.5 * LAYERS) * self.layer())
    }
}

/// Number of layers of a column of voxels, one bit each.
const LAYERS: f32 = 64.0;

/// A pose of one sweep in another, and the fraction of upright structures that is met again there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Peak {
    pub pose: Rigid3,
    /// Fraction of the voxels of the second sweep.
    pub share: f64,
}

/// Search window: all shifts up to `linear` metres along x and y, all headings up to `angular` radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Window {
    pub linear: f64,
    pub angular: f64,
}

impl Window {
    /// Window that covers the motion of a platform over this time, seconds.
    pub fn after(seconds: f64, rotation_is_measured: bool, settings: &CorrelationSettings) -> Self {
        let linear = (settings.fastest * seconds).min(settings.farthest);
        Self { linear, angular: if rotation_is_measured { 0.0 } else { settings.widest } }
    }
}

/// The columns of a sweep, in which upright structures of other sweeps are searched.
pub(crate) struct CorrelationReference<'a> {
    settings: &'a CorrelationSettings,
    columns: Columns,
}

impl<'a> CorrelationReference<'a> {
    /// Reference of points (metres) in a frame at the scanner that is about level.
    pub fn new(points: &[Point3f], settings: &'a CorrelationSettings) -> Self {
        // The range covers all shifts of a sweep.
        let range = settings.range + settings.farthest as f32 + settings.cell;
        let mut columns = Columns::of(points, settings.cell, range, [0.0; 2], settings);
        // A platform rises and sinks a little between sweeps.
        columns.masks.iter_mut().for_each(|mask| *mask |= *mask << 1 | *mask >> 1);
        Self { settings, columns }
    }

    pub fn settings(&self) -> &CorrelationSettings {
        self.settings
    }

    pub fn columns(&self) -> &Columns {
        &self.columns
    }

    /// Poses of another sweep, whose points are in such a frame, too, around an initial pose: the best one
    /// first, then other local maxima that are nearly as good, and the initial pose itself where no other
    /// is clearly better. None where there are hardly any upright structures.
    pub fn peaks(&self, points: &[Point3f], initial: &Rigid3, window: Window) -> Vec<Peak> {
        let settings = self.settings;
        let upright = upright(points, settings);
        let mut scores = Scores::new(window.linear, settings.cell);
        // A rotation by this step moves half of the points by less than a cell.
        let mut distances: Vec<f64> = upright.iter().map(|p| f64::from(p.x.hypot(p.y))).collect();
        let step =
            f64::from(settings.cell) / median(&mut distances).unwrap_or(0.0).max(f64::from(settings.cell));
        let turns = (window.angular / step).ceil() as i32;
        for heading in (-turns..=turns).map(|i| step * f64::from(i)) {
            let turned = to_f32(&Rigid3::from_parts(initial.translation, turned(initial, heading)));
            let moved: Vec<Point3f> = upright.iter().map(|p| turned * p).collect();
            for half in [[0, 0], [0, 1], [1, 0], [1, 1]] {
                let by = half.map(|h| 0.5 * h as f32);
                let columns = Columns::of(&moved, settings.cell, settings.range, by, settings);
                scores.add(&self.columns, &columns, half, heading, settings);
            }
        }
        scores.peaks(settings, initial)
    }
}

fn turned(initial: &Rigid3, heading: f64) -> portolan_geometry::Quaternion {
    quaternion_from_angle_axis(&(Vector3::z() * heading)) * initial.rotation
}

/// The upright points, with others a little above or below them: walls, trunks, cars, but neither the
/// ground nor a ceiling. Far points are left out.
pub(crate) fn upright(points: &[Point3f], settings: &CorrelationSettings) -> Vec<Point3f> {
    let below_others = |all: u64| all >> 2 | all >> 3 | all >> 4;
    in_columns(points, |all| all & (two_to_four_above(all) | below_others(all)), settings)
}

/// The upper ones of these: with others a little below them.
pub(crate) fn above_others(points: &[Point3f], settings: &CorrelationSettings) -> Vec<Point3f> {
    in_columns(points, |all| all & two_to_four_above(all), settings)
}

fn two_to_four_above(mask: u64) -> u64 {
    mask << 2 | mask << 3 | mask << 4
}

/// The points in the layers of wide columns that `pick` selects.
fn in_columns(points: &[Point3f], pick: impl Fn(u64) -> u64, settings: &CorrelationSettings) -> Vec<Point3f> {
    let edge = 2.0 * settings.cell;
    let mut columns = Columns::of(points, edge, settings.range, [0.0; 2], settings);
    columns.masks.iter_mut().for_each(|mask| *mask = pick(*mask));
    let is_picked = |p: &&Point3f| columns.contains(p, edge, settings);
    points.iter().filter(is_picked).copied().collect()
}

/// Columns of voxels around a scanner.
pub(crate) struct Columns {
    /// Row by row.
    masks: Vec<u64>,
    /// Columns along each side.
    side: i32,
    /// Edge of a column, metres.
    edge: f32,
}

impl Columns {
    /// Columns of points up to a range to each side, moved by fractions of a column.
    pub fn of(
        points: &[Point3f],
        edge: f32,
        range: f32,
        moved: [f32; 2],
        settings: &CorrelationSettings,
    ) -> Self {
        let side = 2 * (range / edge).ceil() as i32;
        let mut columns = Self { masks: vec![0; (side * side) as usize], side, edge };
        for point in points {
            let Some((column, layer)) = columns.voxel(point, edge, moved, settings) else { continue };
            if let Some(mask) = columns.masks.get_mut(column) {
                *mask |= 1 << layer;
            }
        }
        columns
    }

    fn contains(&self, point: &Point3f, edge: f32, settings: &CorrelationSettings) -> bool {
        let voxel = self.voxel(point, edge, [0.0; 2], settings);
        voxel.is_some_and(|(column, layer)| self.masks.get(column).is_some_and(|mask| mask >> layer & 1 == 1))
    }

    pub fn len(&self) -> usize {
        self.masks.len()
    }

    pub fn mask(&self, column: usize) -> u64 {
        self.masks.get(column).copied().unwrap_or(0)
    }

    /// Columns that are not empty: their centres, metres, and layers.
    pub fn filled(&self) -> impl Iterator<Item = (na::Vector2<f64>, u64)> {
        let (edge, half) = (f64::from(self.edge), 0.5 * f64::from(self.side));
        let centre = move |i: i32| (f64::from(i) + 0.5 - half) * edge;
        let filled = self.masks.iter().enumerate().filter(|(_, mask)| **mask != 0);
        filled.map(move |(i, mask)| {
            (na::Vector2::new(centre(i as i32 % self.side), centre(i as i32 / self.side)), *mask)
        })
    }

    /// Layers of the column around a position that was not moved, including those between two beams; empty
    /// outside.
    pub fn solid_at(&self, place: &na::Vector2<f64>) -> u64 {
        let half = 0.5 * f64::from(self.side);
        let [x, y] = [place.x, place.y].map(|v| v / f64::from(self.edge) + half);
        let is_inside = |v: f64| v >= 0.0 && v < f64::from(self.side);
        let mask = if is_inside(x) && is_inside(y) {
            self.mask(y as usize * self.side as usize + x as usize)
        } else {
            0
        };
        // Layers within a metre of others both above and below.
        let near = |shift: fn(u64, u32) -> u64| (1..=4).fold(mask, |near, by| near | shift(mask, by));
        near(|mask, by| mask << by) & near(|mask, by| mask >> by)
    }

    /// The index of the column of a point, and its bit in the column.
    pub fn voxel(
        &self,
        point: &Point3f,
        edge: f32,
        moved: [f32; 2],
        settings: &CorrelationSettings,
    ) -> Option<(usize, u32)> {
        let half = 0.5 * self.side as f32;
        let [x, y] = [point.x / edge + moved[0] + half, point.y / edge + moved[1] + half];
        let layer = point.z / settings.layer() + 0.5 * LAYERS;
        let is_inside = |v: f32, end: f32| v >= 0.0 && v < end;
        let (end, inside) = (self.side as f32, is_inside(layer, LAYERS));
        (inside && is_inside(x, end) && is_inside(y, end))
            .then(|| (y as usize * self.side as usize + x as usize, layer as u32))
    }

    /// The columns that are not empty, by their index in a larger grid with the same centre.
    fn filled_in(&self, larger: &Columns) -> Vec<(usize, u64)> {
        let margin = (larger.side - self.side) / 2;
        let filled = self.masks.iter().enumerate().filter(|(_, mask)| **mask != 0);
        let place = |i: usize| [i as i32 % self.side + margin, i as i32 / self.side + margin];
        filled.map(|(i, mask)| (larger.index(place(i)), *mask)).collect()
    }

    fn index(&self, [x, y]: [i32; 2]) -> usize {
        (y * self.side + x) as usize
    }
}

/// The best share and its heading for every shift.
struct Scores {
    best: Vec<(f64, f64)>,
    /// Number of shifts to each side of zero.
    reach: i32,
    /// Distance between shifts, metres.
    step: f64,
}

impl Scores {
    fn new(linear: f64, cell: f32) -> Self {
        let step = 0.5 * f64::from(cell);
        let reach = (linear / step).ceil() as i32;
        let side = (2 * reach + 1) as usize;
        Self { best: vec![(0.0, 0.0); side * side], reach, step }
    }

    /// Scores a sweep that was moved by half a column, or none, at all shifts by whole ones.
    fn add(
        &mut self,
        reference: &Columns,
        sweep: &Columns,
        half: [i32; 2],
        heading: f64,
        settings: &CorrelationSettings,
    ) {
        let filled = sweep.filled_in(reference);
        let stride = filled.len().div_ceil(settings.max_columns).max(1);
        let filled: Vec<(usize, u64)> = filled.into_iter().step_by(stride).collect();
        let all: u32 = filled.iter().map(|(_, mask)| mask.count_ones()).sum();
        if all < settings.min_voxels {
            return;
        }
        let whole = |half: i32| (-self.reach - half).div_euclid(2)..=(self.reach - half).div_euclid(2);
        for row in whole(half[1]) {
            for column in whole(half[0]) {
                let Some(index) = self.index(2 * column + half[0], 2 * row + half[1]) else { continue };
                let shift = (row * reference.side + column) as isize;
                let met = |(place, mask): &(usize, u64)| {
                    let other = reference.masks.get(place.wrapping_add_signed(shift));
                    other.map_or(0, |other| (other & mask).count_ones())
                };
                let share = f64::from(filled.iter().map(met).sum::<u32>()) / f64::from(all);
                if let Some(best) = self.best.get_mut(index).filter(|best| share > best.0) {
                    *best = (share, heading);
                }
            }
        }
    }

    fn index(&self, x: i32, y: i32) -> Option<usize> {
        let reach = -self.reach..=self.reach;
        let side = 2 * self.reach + 1;
        (reach.contains(&x) && reach.contains(&y))
            .then(|| ((y + self.reach) * side + x + self.reach) as usize)
    }

    fn share(&self, x: i32, y: i32) -> f64 {
        self.index(x, y).and_then(|i| self.best.get(i)).map_or(0.0, |best| best.0)
    }

    fn is_maximum(&self, x: i32, y: i32) -> bool {
        let share = self.share(x, y);
        let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))).filter(|at| *at != (0, 0));
        // Of a plateau only the first one counts.
        around.into_iter().all(|(dx, dy)| {
            let other = self.share(x + dx, y + dy);
            if (dy, dx) < (0, 0) { share > other } else { share >= other }
        })
    }

    fn peaks(&self, settings: &CorrelationSettings, initial: &Rigid3) -> Vec<Peak> {
        let highest = self.best.iter().map(|best| best.0).fold(0.0, f64::max);
        if highest == 0.0 {
            return Vec::new();
        }
        let all = (-self.reach..=self.reach).flat_map(|y| (-self.reach..=self.reach).map(move |x| (x, y)));
        let is_peak = |(x, y): &(i32, i32)| {
            let share = self.share(*x, *y) / highest;
            share >= settings.nearly_as_good && ((*x, *y) == (0, 0) || self.is_maximum(*x, *y))
        };
        let peak = |(x, y): (i32, i32)| {
            let (share, heading) = self.best.get(self.index(x, y)?).copied()?;
            let shift = Vector3::new(f64::from(x), f64::from(y), 0.0) * self.step;
            let place = initial.translation.vector + shift;
            Some(Peak { pose: Rigid3::from_parts(place.into(), turned(initial, heading)), share })
        };
        let mut peaks: Vec<Peak> = all.filter(is_peak).filter_map(peak).collect();
        peaks.sort_by(|a, b| b.share.total_cmp(&a.share));
        peaks.truncate(settings.max_peaks);
        peaks
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::street;

    #[test]
    fn posts_and_walls_determine_the_motion_of_a_car() {
        let settings = CorrelationSettings::default();
        let first = street(&Rigid3::identity());
        let reference = CorrelationReference::new(&first, &settings);
        let window = Window::after(0.1, false, &settings);
        for (x, y, heading) in [(1.6, 0.1, 0.03), (-2.2, 0.4, -0.1), (0.0, 0.0, 0.0)] {
            let expected = Rigid3::new(Vector3::new(x, y, 0.0), Vector3::z() * heading);
            let peaks = reference.peaks(&street(&expected), &Rigid3::identity(), window);
            let error = peaks[0].pose.inverse() * expected;
            assert!(error.translation.vector.norm() < 0.3, "{x}: {error}");
            assert!(error.rotation.angle() < 0.03 && peaks[0].share > 0.5, "{x}: {error}");
        }
        assert!(reference.peaks(&first[..20], &Rigid3::identity(), window).is_empty());
        assert!(reference.peaks(&[], &Rigid3::identity(), window).is_empty());
        let nothing = CorrelationReference::new(&[], &settings);
        assert!(nothing.peaks(&first, &Rigid3::identity(), window).is_empty());
    }

    #[test]
    fn ground_ceilings_and_non_finite_points_are_not_upright() {
        let settings = CorrelationSettings::default();
        let room =
            |z: f32| (0..400).map(move |i| Point3f::new(0.1 * (i % 20) as f32, 0.1 * (i / 20) as f32, z));
        let mut points: Vec<Point3f> = room(-1.0).chain(room(1.6)).collect();
        points.extend([f32::NAN, f32::INFINITY, 1e30].map(|v| Point3f::new(v, 0.0, 0.0)));
        assert!(upright(&points, &settings).is_empty());
        points.extend((0..20).map(|k| Point3f::new(1.0, 1.0, 0.1 * k as f32 - 0.5)));
        assert!(upright(&points, &settings).len() >= 20);
    }
}
