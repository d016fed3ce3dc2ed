//! Matches scans near a guess in 3D in a grid that is still being filled.

use nalgebra as na;
use portolan_geometry::{Point3f, Rigid3, Rigid3f, to_f32, to_f64};
use portolan_grids::value::{MAX_PROBABILITY, MIN_PROBABILITY};
use portolan_grids::{HybridGrid, VoxelLattice, is_finite};
use portolan_sensor::PointCloud;

use super::MatchResult;
use super::real_time_2d::RealTimeCorrelativeOptions;
use super::search_window::angular_steps_3d;
use crate::MatcherOptionError;
use surroundings::Surroundings;

mod surroundings;

/// At most this many steps to either side along each axis and about each axis. A wider window is cut.
const MAX_STEPS: i32 = 64;
/// Maximum number of look-ups of points, which take about two seconds. A window that would take more is cut,
/// the wider one of shifts and rotations first.
const MAX_LOOKUPS: f64 = 1e8;
/// Number of points after which it is checked whether a rotation can still be the best.
const POINTS_PER_CHECK: usize = 16;

/// Finds the best placement of a scan on a hybrid grid within a small window by scoring all of them; a
/// placement is given up as soon as it cannot exceed the best one (`slam3d.md` §3.1).
#[derive(Clone, Debug, PartialEq)]
pub struct RealTimeCorrelativeMatcher3d {
    options: RealTimeCorrelativeOptions,
}

impl RealTimeCorrelativeMatcher3d {
    /// # Errors
    /// If an option is negative.
    pub fn new(options: &RealTimeCorrelativeOptions) -> Result<Self, MatcherOptionError> {
        options.check()?;
        Ok(Self { options: options.clone() })
    }

    /// The placement of `points` (metres, in the tracking frame) with the largest score around `initial`;
    /// among equals the first one in order of z, y, x and rotation about z, y, x. Points that are not
    /// finite are left out; without points there is no result.
    ///
    /// A placement scores the mean probability of the cells the points meet times
    /// `exp(−(‖translation‖ w_t + angle w_r)²)` of the offset from `initial`.
    pub fn match_scan(
        &self,
        initial: &Rigid3,
        points: &PointCloud,
        grid: &HybridGrid,
    ) -> Option<MatchResult<Rigid3>> {
        let points: Vec<Point3f> = points.points.iter().copied().filter(is_finite).collect();
        if points.is_empty() || !initial.translation.vector.iter().all(|v| v.is_finite()) {
            return None;
        }
        let window = Window::new(&self.options, &points, grid.lattice());
        let search = Search::new(&self.options, &window, to_f32(initial), grid, &points);
        let (score, shift, rotation) = search.best(&points);
        let pose =
            search.initial * Rigid3f::from_parts(window.shift(shift).into(), window.rotation(rotation));
        Some(MatchResult { score, pose: to_f64(&pose) })
    }
}

/// Shifts and rotations around the initial pose, each numbered in the order in which they are preferred.
struct Window {
    resolution: f32,
    num_linear: i32,
    angular_step: f32,
    num_angular: i32,
}

impl Window {
    fn new(options: &RealTimeCorrelativeOptions, points: &[Point3f], lattice: VoxelLattice) -> Self {
        let farthest = points.iter().map(|p| p.coords.norm()).fold(0.0, f32::max);
        let (angular_step, num_angular) =
            angular_steps_3d(farthest, lattice.resolution, 1e-3, options.angular_search_window);
        let num_linear = (options.linear_search_window / f64::from(lattice.resolution)).round();
        let mut window = Self {
            resolution: lattice.resolution,
            num_linear: num_linear.min(f64::from(MAX_STEPS)) as i32,
            angular_step,
            num_angular: num_angular.min(MAX_STEPS),
        };
        let lookups = |w: &Self| w.num_shifts() as f64 * w.num_rotations() as f64 * points.len() as f64;
        while lookups(&window) > MAX_LOOKUPS && window.num_linear + window.num_angular > 0 {
            match window.num_linear >= window.num_angular {
                true => window.num_linear -= 1,
                false => window.num_angular -= 1,
            }
        }
        window
    }

    fn num_shifts(&self) -> usize {
        (2 * self.num_linear as usize + 1).pow(3)
    }

    fn num_rotations(&self) -> usize {
        (2 * self.num_angular as usize + 1).pow(3)
    }

    /// Steps along (or about) x, y, z of the placement with a number; x runs fastest.
    fn steps(number: usize, to_either_side: i32) -> [f32; 3] {
        let side = 2 * to_either_side as usize + 1;
        [number % side, number / side % side, number / side / side]
            .map(|i| (i as i32 - to_either_side) as f32)
    }

    fn shift(&self, number: usize) -> na::Vector3<f32> {
        na::Vector3::from(Self::steps(number, self.num_linear)) * self.resolution
    }

    fn rotation(&self, number: usize) -> na::UnitQuaternion<f32> {
        let v = na::Vector3::from(Self::steps(number, self.num_angular)) * self.angular_step;
        let squared = v.norm_squared();
        let (w, scale) = if squared > 1e-8 {
            let norm = squared.sqrt();
            ((norm / 2.0).cos(), (norm / 2.0).sin() / norm)
        } else {
            (1.0, 0.5)
        };
        na::UnitQuaternion::new_unchecked(na::Quaternion::from_parts(w, v * scale))
    }

    /// The largest angle of any rotation of the window.
    fn max_angle(&self) -> f32 {
        3f32.sqrt() * self.num_angular as f32 * self.angular_step
    }

    /// The longest shift of the window.
    fn max_shift(&self) -> f32 {
        3f32.sqrt() * self.num_linear as f32 * self.resolution
    }
}

struct Search<'a> {
    window: &'a Window,
    initial: Rigid3f,
    surroundings: Surroundings<'a>,
    lattice: VoxelLattice,
    /// Translations of all shifts in the frame of the grid, by axis.
    translations: [Vec<f32>; 3],
    /// Addition of the offset of each shift to the exponent of the score.
    shift_penalties: Vec<f64>,
    rotation_weight: f64,
}

impl<'a> Search<'a> {
    fn new(
        options: &RealTimeCorrelativeOptions,
        window: &'a Window,
        initial: Rigid3f,
        grid: &'a HybridGrid,
        points: &[Point3f],
    ) -> Self {
        let shifts: Vec<na::Vector3<f32>> = (0..window.num_shifts()).map(|i| window.shift(i)).collect();
        let moved: Vec<na::Vector3<f32>> =
            shifts.iter().map(|s| initial.rotation * s + initial.translation.vector).collect();
        Self {
            window,
            initial,
            surroundings: Surroundings::new(grid, points, &initial, window.max_angle(), window.max_shift()),
            lattice: grid.lattice(),
            translations: [0, 1, 2].map(|axis| moved.iter().map(|t| t[axis]).collect()),
            shift_penalties: shifts
                .iter()
                .map(|s| f64::from(s.norm()) * options.translation_delta_cost_weight)
                .collect(),
            rotation_weight: options.rotation_delta_cost_weight,
        }
    }

    /// Score, number of the shift and number of the rotation of the best placement.
    fn best(&self, points: &[Point3f]) -> (f32, usize, usize) {
        let no_rotation = self.window.num_rotations() / 2;
        let mut sums = vec![0.0; self.window.num_shifts()];
        let mut best = (f32::NEG_INFINITY, usize::MAX, usize::MAX);
        // The middle is probably good, which saves counting all points at many others.
        for rotation in std::iter::once(no_rotation).chain(0..self.window.num_rotations()) {
            let turn = self.window.rotation(rotation);
            let angle = 2.0 * f64::from(turn.imag().norm()).atan2(f64::from(turn.w.abs()));
            let penalty = angle * self.rotation_weight;
            let score = |sum: f32, shift: usize| {
                let mean = sum / points.len() as f32;
                let exponent = self.shift_penalties[shift] + penalty;
                (f64::from(mean) * (-exponent * exponent).exp()) as f32
            };
            let is_hopeless = |sums: &[f32], num_left: usize| {
                let most = num_left as f32 * MAX_PROBABILITY * 1.001;
                sums.iter().enumerate().all(|(shift, sum)| score(sum + most, shift) < best.0)
            };
            if !self.add_up(points, self.initial.rotation * turn, &mut sums, is_hopeless) {
                continue;
            }
            for (shift, sum) in sums.iter().enumerate() {
                let score = score(*sum, shift);
                if score > best.0 || (score == best.0 && (shift, rotation) < (best.1, best.2)) {
                    best = (score, shift, rotation);
                }
            }
        }
        best
    }

    /// Sums of the probabilities that the points meet for every shift. False if given up because even the
    /// largest possible sums would be hopeless.
    fn add_up(
        &self,
        points: &[Point3f],
        grid_from_points: na::UnitQuaternion<f32>,
        sums: &mut [f32],
        is_hopeless: impl Fn(&[f32], usize) -> bool,
    ) -> bool {
        sums.fill(0.0);
        let [x, y, z] = &self.translations;
        for (i, point) in points.iter().enumerate() {
            if i % POINTS_PER_CHECK == 0 && is_hopeless(sums, points.len() - i) {
                return false;
            }
            let turned = grid_from_points * point;
            let around = self.surroundings.of_point(i);
            for (((sum, x), y), z) in sums.iter_mut().zip(x).zip(y).zip(z) {
                let cell = self.lattice.unchecked_cell([turned.x + x, turned.y + y, turned.z + z]);
                *sum += around.probability(cell);
            }
        }
        true
    }
}

/// The probability of cells that are not known.
const UNKNOWN: f32 = MIN_PROBABILITY;

#[cfg(test)]
mod tests;
