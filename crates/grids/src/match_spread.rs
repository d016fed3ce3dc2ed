//! Estimates the uncertainty of a match along its least constrained direction: along a corridor whose doors
//! look alike it is large.

use std::f64::consts::PI;

use nalgebra::Vector2;
use portolan_geometry::Rigid2;
use portolan_numeric::probabilities;
use portolan_sensor::PointCloud;

use super::{Grid2d, ProbabilityGrid};

/// Number of directions, evenly over half a turn, that are compared first, by the likelihood of shifts along
/// them.
const COARSE_DIRECTIONS: u32 = 18;
/// Longest shift in this comparison, metres.
const COARSE_SHIFT: f64 = 0.4;
/// Refinements of the best direction: steps as a fraction 1/x of the coarse step, and longest shifts
/// (metres). A wall 5 m away is still hit if the direction is right to a third of a degree.
const FINER: [(f64, f64); 2] = [(8.0, 1.5), (32.0, 5.0)];
/// The shifts, as fractions of the longest.
const PARTS: [f64; 8] = [-1.0, -0.75, -0.5, -0.25, 0.25, 0.5, 0.75, 1.0];
/// Number of cells to both sides of each place of which the best is taken: submaps are bent a little.
const ACROSS: i32 = 2;
/// Probability that a point is not explained by cells: people, glass, changes.
const UNEXPLAINED: f64 = 0.1;
/// Probability that an unknown cell stops a beam.
const UNKNOWN: f64 = 0.3;
/// Fraction of points in known cells from which a scan counts as inside the grid.
const KNOWN_SHARE: f64 = 0.5;
/// Number of points that count as one independent measurement, because neighbouring points share the errors
/// of the grid. With it the scatter of right matches agrees with their sigma, and of those with less than
/// 0.25 m one in a hundred is wrong (docs/experiments/2026-11-corridor-loops.md).
const POINTS_PER_INDEPENDENT_ONE: f64 = 10.0;
/// Maximum number of points used, evenly chosen from all.
const MOST_POINTS: usize = 90;
/// Minimum distance around the match that is examined, metres.
const LEAST_REACH: f64 = 1.0;

/// The least constrained direction of a match.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchSpread {
    /// Unit vector in the frame of the scan.
    pub direction: Vector2<f64>,
    /// Root mean square distance of the scan from the match along it, metres.
    pub sigma: f64,
}

/// Uncertainty of a match (frame of the grid) along its least constrained direction: from the likelihood of
/// all places along it (a histogram filter of one dimension: Thrun, Burgard and Fox, "Probabilistic
/// Robotics", §4.1) within `reach` metres of `guess` or near the match. None for distance fields and without
/// points.
pub fn match_spread(
    grid: &Grid2d,
    grid_from_scan: &Rigid2,
    points: &PointCloud,
    (guess, reach): (&Vector2<f64>, f64),
) -> Option<MatchSpread> {
    let Grid2d::Probability(grid) = grid else { return None };
    let ends = Ends::new(grid, grid_from_scan, points)?;
    let direction = ends.least_constrained_direction();
    let step = grid.limits().resolution();
    let from_guess = (guess - grid_from_scan.translation).dot(&direction);
    let first = ((from_guess - reach).min(-LEAST_REACH) / step).floor() as i64;
    let last = ((from_guess + reach).max(LEAST_REACH) / step).ceil() as i64;
    let across = Vector2::new(-direction.y, direction.x) * step;
    let shifts: Vec<f64> = (first..=last).map(|i| i as f64 * step).collect();
    let best_near = |shift: &f64| {
        let beside = (-ACROSS..=ACROSS).map(|i| direction * *shift + across * f64::from(i));
        let inside = beside.map(|shift| ends.at(&shift)).filter(|place| place.known >= KNOWN_SHARE);
        inside.map(|place| place.log_likelihood).fold(f64::NEG_INFINITY, f64::max)
    };
    let logs: Vec<f64> = shifts.iter().map(best_near).collect();
    let square: f64 = shifts.iter().zip(probabilities(&logs)).map(|(shift, p)| shift * shift * p).sum();
    let scan_from_grid = Rigid2::new(0.0, 0.0, -grid_from_scan.angle);
    square
        .is_finite()
        .then(|| MatchSpread { direction: scan_from_grid.transform_point(&direction), sigma: square.sqrt() })
}

/// Likelihood of a scan at a place.
struct Place {
    log_likelihood: f64,
    /// Fraction of the points that end in known cells.
    known: f64,
}

/// Ends of the beams of a scan.
struct Ends<'a> {
    grid: &'a ProbabilityGrid,
    ends: Vec<Vector2<f64>>,
    /// Number of independent measurements of the whole scan.
    independent: f64,
}

impl<'a> Ends<'a> {
    fn new(grid: &'a ProbabilityGrid, grid_from_scan: &Rigid2, points: &PointCloud) -> Option<Self> {
        let all = points.points.len();
        let end = |point: &portolan_geometry::Point3f| {
            grid_from_scan.transform_point(&Vector2::new(f64::from(point.x), f64::from(point.y)))
        };
        let ends: Vec<_> = points.points.iter().step_by(all.div_ceil(MOST_POINTS).max(1)).map(end).collect();
        (all > 0).then_some(Self { grid, ends, independent: all as f64 / POINTS_PER_INDEPENDENT_ONE })
    }

    fn least_constrained_direction(&self) -> Vector2<f64> {
        let coarse = PI / f64::from(COARSE_DIRECTIONS);
        let likelihood = |angle: f64, farthest: f64| -> f64 {
            let direction = Vector2::new(angle.cos(), angle.sin());
            PARTS.into_iter().map(|part| self.at(&(direction * (part * farthest))).log_likelihood).sum()
        };
        let best = |angles: &mut dyn Iterator<Item = f64>, farthest: f64| {
            let judged = angles.map(|angle| (angle, likelihood(angle, farthest)));
            judged.max_by(|(_, a), (_, b)| a.total_cmp(b)).map_or(0.0, |(angle, _)| angle)
        };
        let first = best(&mut (0..COARSE_DIRECTIONS).map(|i| f64::from(i) * coarse), COARSE_SHIFT);
        let angle = FINER.iter().fold(first, |angle, (parts, farthest)| {
            best(&mut (-4..=4).map(|i| angle + f64::from(i) * coarse / parts), *farthest)
        });
        Vector2::new(angle.cos(), angle.sin())
    }

    /// The scan moved by `shift`.
    fn at(&self, shift: &Vector2<f64>) -> Place {
        let (mut likelihood, mut known) = (1.0, 0u32);
        for end in &self.ends {
            let cell = self.grid.limits().cell_index((end + shift).cast::<f32>());
            let solid = self.grid.known_probability(cell);
            known += u32::from(solid.is_some());
            let solid = solid.map_or(UNKNOWN, f64::from);
            likelihood *= UNEXPLAINED + (1.0 - UNEXPLAINED) * solid;
        }
        let count = self.ends.len() as f64;
        Place { log_likelihood: likelihood.ln() * self.independent / count, known: f64::from(known) / count }
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::Point3f;

    use super::*;
    use crate::MapLimits;

    /// Walls of a corridor along x, with a door in a recess every four metres, and with `end` (x) a wall
    /// across, beyond which nothing is known.
    fn walls(half_length: f64, end: Option<f64>) -> Vec<Vector2<f64>> {
        let steps = (half_length / 0.05) as i32;
        let sides = (-steps..=steps).map(|i| 0.05 * f64::from(i)).flat_map(|x| {
            let depth = if x.rem_euclid(4.0) < 1.0 { 0.3 } else { 0.0 };
            [Vector2::new(x, 1.01 + depth), Vector2::new(x, -1.01 - depth)]
        });
        let across = (-50..=50).filter_map(|i| Some(Vector2::new(end?, 0.02 * f64::from(i))));
        sides.chain(across).filter(|wall| end.is_none_or(|end| wall.x <= end)).collect()
    }

    /// Spread of a scan that was taken at the origin of a corridor along a direction, within 10 m.
    fn spread(heading: f64, end: Option<f64>) -> MatchSpread {
        let map_from_corridor = Rigid2::new(0.0, 0.0, heading);
        let limits = MapLimits::new(0.05, Vector2::new(15.0, 15.0), 600, 600).unwrap();
        let mut grid = ProbabilityGrid::new(limits);
        for free in (-260..=260).flat_map(|i| (-25..=25).map(move |j| (i, j))) {
            let place = Vector2::new(0.05 * f64::from(free.0), 0.05 * f64::from(free.1));
            let cell = grid.limits().cell_index(map_from_corridor.transform_point(&place).cast::<f32>());
            grid.set_probability(cell, 0.15);
        }
        let mut solid = ProbabilityGrid::new(*grid.limits());
        // Walls are as thick as after inserting scans that differ by a cell.
        for wall in walls(13.0, end).into_iter().flat_map(around) {
            let cell = solid.limits().cell_index(map_from_corridor.transform_point(&wall).cast::<f32>());
            solid.set_probability(cell, 0.9);
        }
        let scan_from_map = Rigid2::new(0.0, 0.0, 0.7).inverse();
        let points = walls(5.0, end).into_iter().map(|wall| {
            let seen = scan_from_map.transform_point(&map_from_corridor.transform_point(&wall));
            Point3f::new(seen.x as f32, seen.y as f32, 0.0)
        });
        let points = PointCloud::new(points.collect());
        let merged = merge(&grid, &solid);
        match_spread(
            &Grid2d::Probability(merged),
            &Rigid2::new(0.0, 0.0, 0.7),
            &points,
            (&Vector2::zeros(), 10.0),
        )
        .unwrap()
    }

    fn around(place: Vector2<f64>) -> impl Iterator<Item = Vector2<f64>> {
        (-1..=1).flat_map(move |i| {
            (-1..=1).map(move |j| place + Vector2::new(f64::from(i), f64::from(j)) * 0.025)
        })
    }

    /// The occupied cells of one grid, on top of another.
    fn merge(below: &ProbabilityGrid, above: &ProbabilityGrid) -> ProbabilityGrid {
        let mut merged = ProbabilityGrid::new(*below.limits());
        for cell in (0..600).flat_map(|x| (0..600).map(move |y| crate::CellIndex::new(x, y))) {
            let of = if above.is_known(cell) { above } else { below };
            if of.is_known(cell) {
                merged.set_probability(cell, of.probability(cell));
            }
        }
        merged
    }

    #[test]
    fn similar_doors_leave_the_position_along_a_corridor_ambiguous() {
        for heading in [0.0, 0.4, -1.2] {
            let open = spread(heading, None);
            // Every fourth metre is as likely as the place itself.
            assert!(open.sigma > 3.0, "{open:?}");
            let along = Vector2::new((heading - 0.7_f64).cos(), (heading - 0.7).sin());
            assert!(open.direction.dot(&along).abs() > 0.9999, "{open:?}");
        }
    }

    #[test]
    fn the_end_of_a_corridor_constrains_the_position() {
        for heading in [0.0, 0.4, -1.2] {
            let closed = spread(heading, Some(4.0));
            assert!(closed.sigma < 0.1, "{closed:?}");
        }
    }
}
