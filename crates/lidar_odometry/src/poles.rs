//! Vertical structures: trunks, poles, corners.
//!
//! Among trees hardly anything but the ground is planar, and planes of the rings in which beams hit it
//! move with the scanner. Where no sensor measures the motion, points of vertical structures are therefore
//! registered to the nearest ones of the previous sweeps, too (point to point, as Vizzo et al., "KISS-ICP:
//! In Defense of Point-to-Point ICP", 2023). This is done horizontally only, since neighbouring beams hit
//! a trunk at different heights. Where they are in a row, as on a wall, they do not constrain the
//! direction along it, in which nearest points are always equally near (Segal, Haehnel and Thrun,
//! "Generalized-ICP", 2009, express that by covariances).

use nalgebra as na;
use portolan_geometry::{Point3f, Quaternion};
use portolan_sensor::{TimedPoint, voxel_filter_indices};

use crate::deskew::PiecewiseLinearTrajectory;
use crate::settings::PoleSettings;
use crate::settings::constants::poles::{ELONGATED_RATIO, STEEPEST_GROUND_TANGENT};
use cells::Cells;

mod cells;
mod map;
mod recent;
mod residuals;
#[cfg(test)]
mod tests;

pub use map::PoleMap;
pub(crate) use recent::{PolesToRegister, RecentPoles, SeenPoles};
pub(crate) use residuals::PoleResiduals;

impl PoleSettings {
    /// Standard deviation of a pair, metres.
    fn noise(&self) -> f32 {
        0.5 * self.final_scale as f32
    }

    /// Maximum distance of paired points, metres.
    fn reach(&self) -> f32 {
        2.0 * self.final_scale as f32
    }
}

/// A point of a vertical structure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolePoint {
    /// The raw point.
    pub point: TimedPoint,
    /// The direction of the wall that it is part of, a unit vector in the frame of the scanner; none if
    /// its surroundings are as wide as they are long.
    pub wall_direction: Option<na::Vector3<f32>>,
}

impl PolePoint {
    /// Points of vertical structures, in order of time, of a sweep that is de-skewed by `to_end`.
    pub fn of_sweep(
        sweep: impl Iterator<Item = TimedPoint>,
        to_end: &PiecewiseLinearTrajectory,
        level_from_end: &Quaternion,
        settings: &PoleSettings,
    ) -> Vec<Self> {
        let turn = level_from_end.cast::<f32>();
        let leveled = |p: TimedPoint| (p, turn * to_end.moved(&p.position, p.time));
        let all: Vec<(TimedPoint, Point3f)> = sweep.map(leveled).collect();
        let standing = above_others(&all, settings);
        let walls = WallDirections::of(&standing, settings);
        let back = turn.inverse();
        let kept =
            voxel_filter_indices(&standing, |(_, place)| *place, settings.final_scale as f32).into_iter();
        let point = |(point, place): &(TimedPoint, Point3f)| {
            let wall_direction =
                walls.around(place, settings).map(|d| back * na::Vector3::new(d.x, d.y, 0.0));
            Self { point: *point, wall_direction }
        };
        let mut points: Vec<&(TimedPoint, Point3f)> = kept.filter_map(|i| standing.get(i as usize)).collect();
        points.sort_by(|(a, _), (b, _)| a.time.total_cmp(&b.time));
        let number = points.len().min(settings.max_points);
        (0..number).map(|i| point(points[i * points.len() / number])).collect()
    }
}

/// Points that are above others of their column.
fn above_others(all: &[(TimedPoint, Point3f)], settings: &PoleSettings) -> Vec<(TimedPoint, Point3f)> {
    let mut columns = Cells::new(settings.column, [f32::INFINITY, f32::NEG_INFINITY]);
    let mut count = |place: &Point3f| {
        let column = columns.number_of(columns.column(place));
        let [lowest, highest] = columns.value_mut(column);
        (*lowest, *highest) = (lowest.min(place.z), highest.max(place.z));
        column
    };
    let column_of: Vec<usize> = all.iter().map(|(_, place)| count(place)).collect();
    let stands = |place: &Point3f, column: usize| {
        let [lowest, highest] = columns.value(column);
        highest - lowest > settings.column && place.z > lowest + STEEPEST_GROUND_TANGENT * settings.column
    };
    let standing = all.iter().zip(column_of).filter(|((_, place), column)| stands(place, *column));
    standing.map(|(point, _)| *point).collect()
}

/// Moments of the points in a cell: count, sum, and sum of outer products.
type Moments = (f32, na::Vector2<f32>, na::Matrix2<f32>);

/// Horizontal spread of points, from which wall directions are computed.
struct WallDirections(Cells<Moments>);

impl WallDirections {
    fn of(points: &[(TimedPoint, Point3f)], settings: &PoleSettings) -> Self {
        let mut cells = Cells::new(settings.neighbourhood, Moments::default());
        for (_, place) in points {
            let (count, sum, products) = cells.at_mut(cells.column(place));
            *count += 1.0;
            *sum += place.coords.xy();
            *products += place.coords.xy() * place.coords.xy().transpose();
        }
        Self(cells)
    }

    /// The direction of the wall around a position, if there is one.
    fn around(&self, place: &Point3f, settings: &PoleSettings) -> Option<na::Vector2<f32>> {
        let [x, y, _] = self.0.around(place);
        let around =
            (-1..=1).flat_map(|i| (-1..=1).map(move |j| [x.saturating_add(i), y.saturating_add(j), 0]));
        let cells = around.filter_map(|cell| self.0.at(cells::key_of(cell)));
        let (count, sum, products) =
            cells.fold(Moments::default(), |all, cell| (all.0 + cell.0, all.1 + cell.1, all.2 + cell.2));
        let mean = sum / count;
        let eigen = na::SymmetricEigen::new(products / count - mean * mean.transpose());
        let (long, narrow) = (eigen.eigenvalues.imax(), eigen.eigenvalues.imin());
        let [long_variance, narrow_variance] = [long, narrow].map(|i| eigen.eigenvalues[i]);
        // Minimum: half the spread of a wall through the whole neighbourhood.
        let length = 0.5 * (3.0 * settings.neighbourhood) / 12_f32.sqrt();
        let is_wall = long_variance > length * length
            && narrow_variance * ELONGATED_RATIO * ELONGATED_RATIO < long_variance;
        is_wall.then(|| eigen.eigenvectors.column(long).into_owned())
    }
}
