//! Likelihood of horizontal shifts between two sets of upright structures, over all shifts at once, with a
//! prior (a histogram filter: Thrun, Burgard and Fox, "Probabilistic Robotics", section 4.1).
//!
//! A structure that is met again is evidence to the degree that meeting one there by chance is unlikely.
//! Along a wall, along a guard rail or in a hedge something is met at every shift; with a post it is not.
//! And since beams diverge, structures near a scanner are sampled more densely than the same structures
//! farther away: the fraction that is met again is largest where both sweeps would have been taken from
//! the same position, although the scanner moved. So each column is compared with its own neighbourhood,
//! not with the others.
//!
//! Points of one object are not independent, and objects may move: the likelihood of each object is mixed
//! with a uniform one, so that a car with a hundred points counts no more than a post.
//!
//! Voxels that cannot have been seen do not count: those farther away than any return in that direction,
//! above or below all beams, or between two of them. In a bare tunnel the limits of sight move with the
//! scanner, and would hold it at its old position.

use std::collections::BTreeMap;

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Point3f, Vector3};
use portolan_numeric::probabilities;

use crate::correlation::{Columns, CorrelationReference};
use crate::settings::CorrelationSettings;
use crate::settings::constants::shift_likelihood::{
    CHANCE_REACH, FARTHEST_IN_TWO, LEAST_CHANCE, MEASURED_VARIANCE_FRACTION, MET_AGAIN_PROBABILITY,
    MOVING_PROBABILITY, OBJECT_EDGE, REACH_SIGMAS, STEPS_PER_CELL,
};
use crate::sight::Sight;

/// Posterior of the shift of upright points, from the structures that are met again and the prior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Posterior {
    /// Mean, metres.
    pub shift: Vector3,
    /// The largest variance along any of the directions, as a fraction of the prior variance.
    pub remaining_variance: f64,
}

/// Grid of tested shifts, evenly spaced along each direction.
pub(crate) struct Shifts<'a> {
    directions: &'a [na::Vector2<f64>],
    /// Distance between shifts, metres.
    pub step: f64,
    /// Number of steps to each side.
    pub reach: i32,
    /// Number of steps beyond these, used only for the probability by chance.
    around: i32,
}

/// A column of voxels of an upright structure.
struct Upright {
    place: na::Vector2<f64>,
    mask: u64,
}

impl CorrelationSettings {
    /// Standard deviation of an unknown shift, metres.
    pub fn unknown(&self) -> f64 {
        self.farthest / REACH_SIGMAS
    }

    /// Systematic error of shifts, metres: structures are seen from another side, over many sweeps.
    pub fn resolution(&self) -> f64 {
        0.5 * f64::from(self.cell)
    }

    /// Whether a shift counts as measured, whose standard deviation was `before` and is `now`, metres:
    /// clearly smaller than before, and less than a cell.
    pub fn is_measured(&self, before: f64, now: f64) -> bool {
        now * now <= MEASURED_VARIANCE_FRACTION * before * before && now <= f64::from(self.cell)
    }

    /// The factor by which a shift is shrunk for its systematic error (James and Stein, "Estimation with quadratic loss", 1961).
    pub fn shrinkage(&self, shift: f64) -> f64 {
        let resolution = self.resolution();
        shift * shift / (shift * shift + resolution * resolution)
    }
}

impl CorrelationReference<'_> {
    /// Posterior of the shift of upright points along horizontal directions (orthonormal, one or two), if
    /// only its standard deviation `sigma`, metres, is known before. `seen_from`: the position from which
    /// the reference was taken. None where there are no upright structures.
    pub fn posterior(
        &self,
        seen_from: &Vector3,
        upright: &[Point3f],
        directions: &[na::Vector2<f64>],
        sigma: f64,
        points_per_independent_one: f64,
    ) -> Option<Posterior> {
        let settings = self.settings();
        let shifts = Shifts::new(directions, sigma, settings)?;
        let mut logs = self.log_likelihoods(seen_from, upright, &shifts, points_per_independent_one)?;
        let tried: Vec<na::Vector2<f64>> = shifts.tried().collect();
        for (log, shift) in logs.iter_mut().zip(&tried) {
            *log -= 0.5 * (shift / sigma).norm_squared();
        }
        let probabilities = probabilities(&logs);
        let weighted = || tried.iter().zip(&probabilities);
        let mean = weighted().map(|(shift, probability)| shift * *probability).sum::<na::Vector2<f64>>();
        let variance = |direction: &na::Vector2<f64>| {
            weighted().map(|(shift, p)| p * direction.dot(&(shift - mean)).powi(2)).sum::<f64>()
        };
        let remaining = directions.iter().map(variance).fold(0.0, f64::max) / (sigma * sigma);
        Some(Posterior { shift: Vector3::new(mean.x, mean.y, 0.0), remaining_variance: remaining })
    }

    /// Log-likelihood of each of the shifts, from the upright structures that are met again. None where
    /// there are no upright structures.
    pub fn log_likelihoods(
        &self,
        seen_from: &Vector3,
        upright: &[Point3f],
        shifts: &Shifts<'_>,
        points_per_independent_one: f64,
    ) -> Option<Vec<f64>> {
        let sight = Sight::of(self.columns(), seen_from, self.settings());
        let count = shifts.tried().count();
        let mut objects: BTreeMap<[i32; 2], Vec<f64>> = BTreeMap::new();
        for column in self.upright_columns(upright) {
            let object = [column.place.x, column.place.y].map(|v| (v / OBJECT_EDGE).floor() as i32);
            let logs = objects.entry(object).or_insert_with(|| vec![0.0; count]);
            shifts.add_to(logs, &column, self.columns(), &sight, self.settings());
        }
        let mut all = vec![0.0; count];
        for logs in objects.values() {
            let best = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            for (all, log) in all.iter_mut().zip(logs) {
                let as_it_is = ((log - best) / points_per_independent_one).exp();
                *all += (MOVING_PROBABILITY + (1.0 - MOVING_PROBABILITY) * as_it_is).ln();
            }
        }
        (!objects.is_empty()).then_some(all)
    }

    /// The columns of upright points, evenly sampled if there are many.
    fn upright_columns(&self, upright: &[Point3f]) -> Vec<Upright> {
        let settings = self.settings();
        let columns = Columns::of(upright, settings.cell, settings.range, [0.0; 2], settings);
        let mut sums = vec![(na::Vector2::zeros(), 0.0); columns.len()];
        for point in upright {
            let Some((column, _)) = columns.voxel(point, settings.cell, [0.0; 2], settings) else { continue };
            if let Some((sum, count)) = sums.get_mut(column) {
                *sum += point.coords.xy().cast::<f64>();
                *count += 1.0;
            }
        }
        let filled = sums.iter().enumerate().filter(|(_, (_, count))| *count > 0.0);
        let all: Vec<Upright> =
            filled.map(|(i, (sum, count))| Upright { place: sum / *count, mask: columns.mask(i) }).collect();
        let stride = all.len().div_ceil(settings.max_columns).max(1);
        all.into_iter().step_by(stride).collect()
    }
}

impl<'a> Shifts<'a> {
    /// Shifts along one or two directions (orthonormal), with this prior standard deviation, metres.
    pub fn new(
        directions: &'a [na::Vector2<f64>],
        sigma: f64,
        settings: &CorrelationSettings,
    ) -> Option<Self> {
        let step = STEPS_PER_CELL.get(directions.len().checked_sub(1)?)? * f64::from(settings.cell);
        let farthest = settings.farthest;
        let farthest = if directions.len() == 1 { farthest } else { farthest.min(FARTHEST_IN_TWO) };
        let reach = ((REACH_SIGMAS * sigma).min(farthest) / step).ceil() as i32;
        Some(Self { directions, step, reach, around: (CHANCE_REACH / step).ceil() as i32 })
    }

    /// All shifts up to this number of steps to each side: row by row if there are two directions.
    fn within(&self, reach: i32) -> impl Iterator<Item = na::Vector2<f64>> {
        let second = if self.directions.len() == 2 { reach } else { 0 };
        let at = move |direction: usize, i: i32| {
            self.directions.get(direction).map_or_else(na::Vector2::zeros, |d| d * (f64::from(i) * self.step))
        };
        (-second..=second).flat_map(move |j| (-reach..=reach).map(move |i| at(0, i) + at(1, j)))
    }

    fn tried(&self) -> impl Iterator<Item = na::Vector2<f64>> {
        self.within(self.reach)
    }

    /// Adds the log-likelihood ratio, at each shift, of meeting a column again and of meeting it by
    /// chance.
    fn add_to(
        &self,
        logs: &mut [f64],
        column: &Upright,
        reference: &Columns,
        sight: &Sight,
        settings: &CorrelationSettings,
    ) {
        let all = self.reach + self.around;
        let side = (2 * all + 1) as usize;
        let bits = f64::from(column.mask.count_ones());
        // The fraction of its visible layers that is met at each shift.
        let met: Vec<Option<f64>> = self
            .within(all)
            .map(|shift| {
                let place = column.place + shift;
                let in_sight = column.mask & sight.layers(&place, settings);
                let met = reference.solid_at(&place) & in_sight;
                (in_sight != 0).then(|| f64::from(met.count_ones()) / f64::from(in_sight.count_ones()))
            })
            .collect();
        let known =
            self.sums_around(met.iter().map(|met| f64::from(u8::from(met.is_some()))).collect(), side);
        let sums = self.sums_around(met.iter().map(|met| met.unwrap_or(0.0)).collect(), side);
        let rows = if self.directions.len() == 2 { 2 * self.reach + 1 } else { 1 };
        let first_row = if self.directions.len() == 2 { self.around } else { 0 };
        let inner = (0..rows).flat_map(|j| (0..=2 * self.reach).map(move |i| (j, i)));
        for (log, (j, i)) in logs.iter_mut().zip(inner) {
            let at = (first_row + j) as usize * side + (self.around + i) as usize;
            let (Some(Some(met)), Some(sum), Some(known)) = (met.get(at), sums.get(at), known.get(at)) else {
                continue;
            };
            let chance = (sum / known).clamp(LEAST_CHANCE, 1.0 - LEAST_CHANCE);
            let met_again = MET_AGAIN_PROBABILITY.max(chance);
            *log += bits
                * (met * (met_again / chance).ln() + (1.0 - met) * ((1.0 - met_again) / (1.0 - chance)).ln());
        }
    }

    /// Sums over the neighbourhood of each shift.
    fn sums_around(&self, values: Vec<f64>, side: usize) -> Vec<f64> {
        let along = moving_sum(&values, side, 1, self.around as usize);
        if self.directions.len() == 2 { moving_sum(&along, side, side, self.around as usize) } else { along }
    }
}

/// Sums over `half` neighbours to both sides, of values that are `stride` apart in lines of `side`.
fn moving_sum(values: &[f64], side: usize, stride: usize, half: usize) -> Vec<f64> {
    let mut sums = vec![0.0; values.len()];
    let lines = values.len() / side;
    for line in 0..lines {
        let at = |i: usize| if stride == 1 { line * side + i } else { i * stride + line };
        let value = |i: usize| values.get(at(i)).copied().unwrap_or(0.0);
        let mut sum: f64 = (0..half.min(side)).map(value).sum();
        for i in 0..side {
            if i + half < side {
                sum += value(i + half);
            }
            if i > half {
                sum -= value(i - half - 1);
            }
            if let Some(of_neighbours) = sums.get_mut(at(i)) {
                *of_neighbours = sum.max(0.0);
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIGMA: f64 = 1.0;
    /// Half of a cell.
    const RESOLUTION: f64 = 0.25;

    fn column(x: f32, y: f32) -> impl Iterator<Item = Point3f> {
        (0..8).map(move |k| Point3f::new(x, y, 0.25 * k as f32 - 1.0))
    }

    /// Guard rails along x as a scanner at a position sees them, sparser with distance, and posts beside
    /// them.
    fn road(scanner: f32, posts: &[f32]) -> Vec<Point3f> {
        let rails = (-200..=200).filter_map(|i| {
            let tangent = 0.05 * i as f32;
            (tangent.abs() < 9.0).then_some(scanner + 4.0 * tangent)
        });
        let rails = rails.flat_map(|x| [-4.0, 4.0].map(|y| column(x, y)));
        let posts = posts.iter().map(|x| column(*x, 6.1));
        rails.chain(posts).flatten().collect()
    }

    /// Posterior of the shift if both sets are assumed to be seen from x = 0, but the second one was seen
    /// from x = `moved`.
    fn estimated(moved: f32, posts: &[f32]) -> Posterior {
        let settings = CorrelationSettings::default();
        let reference = CorrelationReference::new(&road(0.0, posts), &settings);
        let after: Vec<Point3f> =
            road(moved, posts).iter().map(|p| Point3f::new(p.x - moved, p.y, p.z)).collect();
        let along = [na::Vector2::x()];
        reference.posterior(&Vector3::zeros(), &after, &along, SIGMA, 10.0).unwrap()
    }

    #[test]
    fn posts_constrain_the_shift_along_a_road() {
        let found = estimated(1.4, &[-22.2, -14.9, -9.4, -3.7, 3.1, 7.2, 11.7, 18.4, 26.2]);
        assert!((found.shift.x - 1.4).abs() < RESOLUTION && found.remaining_variance < 0.5, "{found:?}");
    }

    #[test]
    fn guard_rails_do_not_constrain_the_shift_along_a_road() {
        let found = estimated(1.4, &[]);
        assert!(found.shift.x.abs() < 0.1 && found.remaining_variance > 0.9, "{found:?}");
    }

    #[test]
    fn trees_constrain_both_directions_and_empty_sets_none() {
        let settings = CorrelationSettings::default();
        let trees =
            [(3.1, 7.2), (-8.3, 2.4), (12.2, -6.4), (-4.1, -9.2), (7.7, -2.3), (-13.4, 11.1), (1.3, -15.2)];
        let seen_from = |x: f32, y: f32| -> Vec<Point3f> {
            trees.iter().flat_map(|(tree_x, tree_y)| column(tree_x - x, tree_y - y)).collect()
        };
        let ground = (-40..40)
            .flat_map(|i| (-40..40).map(move |j| Point3f::new(0.5 * i as f32, 0.5 * j as f32, -1.5)));
        let before: Vec<Point3f> = seen_from(0.0, 0.0).into_iter().chain(ground).collect();
        let reference = CorrelationReference::new(&before, &settings);
        let both = [na::Vector2::new(0.8, 0.6), na::Vector2::new(-0.6, 0.8)];
        let posterior = |after: &[Point3f], directions: &[na::Vector2<f64>]| {
            reference.posterior(&Vector3::zeros(), after, directions, SIGMA, 10.0)
        };
        let found = posterior(&seen_from(0.7, -0.5), &both).unwrap();
        assert!((found.shift - Vector3::new(0.7, -0.5, 0.0)).norm() < RESOLUTION, "{found:?}");
        assert!(found.remaining_variance < 0.1, "{found:?}");
        assert_eq!(posterior(&[], &both), None);
        assert_eq!(posterior(&seen_from(0.0, 0.0), &[]), None);
    }
}
