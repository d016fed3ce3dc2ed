//! Estimates the offset of the clock of a lidar against that of an IMU, from rotations about all axes.
//!
//! Rotations over 0.3 s from sweeps are compared with those that the gyroscope measures some time later.
//! Least squares start at the lag with the smallest median difference. Their unknowns are the lag, the bias
//! of the gyroscope, and a matrix near the identity: sensors are mounted with an error of a degree or two,
//! and scales are not exact. The uncertainty of the lag comes from leaving out parts of the recording in
//! turn (block jackknife): the error over its standard deviation is approximately distributed as Student's t
//! with [`BLOCKS`] − 1 degrees of freedom.

use portolan_geometry::nalgebra::{Matrix3, SMatrix, SVector};
use portolan_geometry::{Duration, Quaternion, Time, Vector3, angle_axis_from_quaternion};

use super::gyroscope::Gyroscope;
use super::tracker::TrackedSweep;

/// Duration of the rotations that are compared, seconds: about half a step, so that swaying does not cancel
/// out.
const LENGTH: f64 = 0.3;
/// Excess over this duration above which a rotation is left out, seconds.
const MAX_EXCESS: f64 = 0.2;
/// Range of the lags that are tried, to each side, seconds.
const REACH: f64 = 0.5;
/// Step of the lags that are tried, seconds.
const STEP: f64 = 0.01;
/// Fraction of large rotations (19 of 20 are smaller) below which a rotation counts as rest: the platform
/// may be at rest most of the time. Steps rotate a tenth as much as corners, and matching errors at rest a
/// thousandth.
const SMALL_SHARE: f64 = 0.02;
/// Minimum number of rotations.
pub(super) const ENOUGH_TURNS: usize = 60;
/// Number of parts of the recording, each of which is left out once.
pub(super) const BLOCKS: usize = 20;
/// Number of iterations of least squares with new weights.
const ITERATIONS: u32 = 8;
/// Limit above which differences count less, in multiples of their usual size.
const LIMIT: f64 = 3.0;
/// Standard deviation of the prior of mounting and scale of an IMU, radians and fraction.
const MOUNTING_SIGMA: f64 = 0.03;
/// Standard deviation of the prior of the mounting where only the mounting is estimated, radians: so wide
/// that it is not drawn to the transforms.
const WIDE_MOUNTING_SIGMA: f64 = 0.5;
/// Error of matches in excess of their covariance, radians: surfaces are not exactly planar.
const MATCH_ERROR: f64 = 1e-4;
/// Differences as a fraction of the rotations themselves (of root mean squares), above which the sensors do
/// not rotate alike.
const MAX_SHARE: f64 = 0.5;

/// Lag, three for the bias of the gyroscope, nine for the matrix.
const UNKNOWNS: usize = 13;
type Normal = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
type Unknowns = SVector<f64, UNKNOWNS>;

/// Offset of the clocks and misalignment of the IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lag {
    /// Time by which the IMU is stamped too late against the lidar, seconds.
    pub seconds: f64,
    /// Standard deviation of the lag, seconds.
    pub sigma: f64,
    /// Rotation vector from the rotations of the gyroscope to those of sweeps, radians; it is small about
    /// axes about which the platform did not rotate.
    pub misalignment: Vector3,
    /// Standard deviation along the misalignment, radians.
    pub misalignment_sigma: f64,
}

/// A rotation measured by sweeps.
pub(super) struct SweepTurn {
    from: Time,
    to: Time,
    /// Rotation vector in the tracking frame.
    pub turn: Vector3,
    /// Whitening matrix: makes the errors equal about all axes and of unit size.
    whiten: Matrix3<f64>,
}

impl SweepTurn {
    fn new(a: &TrackedSweep, b: &TrackedSweep) -> Option<Self> {
        let covariance =
            a.covariance + b.covariance + Matrix3::from_diagonal_element(2.0 * MATCH_ERROR * MATCH_ERROR);
        let whiten = covariance.cholesky()?.l().try_inverse()?;
        Some(Self { from: a.time, to: b.time, turn: vector(&(a.rotation.inverse() * b.rotation)), whiten })
    }

    /// Size of the rotation relative to its error.
    fn size(&self) -> f64 {
        (self.whiten * self.turn).norm()
    }

    /// Rotation measured by the gyroscope if it is stamped too late by `lag`.
    pub fn shown(&self, gyroscope: &Gyroscope, lag: f64) -> Option<Vector3> {
        let lag = Duration::from_seconds(lag);
        Some(vector(&gyroscope.turn(self.from + lag, self.to + lag)?))
    }
}

fn vector(rotation: &Quaternion) -> Vector3 {
    angle_axis_from_quaternion(rotation)
}

/// Finds the offset; none without enough data, or if the two do not rotate alike.
pub(super) fn find_lag(sweeps: &[TrackedSweep], gyroscope: &Gyroscope) -> Option<Lag> {
    let turns = turns(sweeps);
    if turns.len() < ENOUGH_TURNS {
        return None;
    }
    let steps = (REACH / STEP) as i32;
    let lags = (0..=steps).flat_map(|i| [STEP * f64::from(i), -STEP * f64::from(i)]);
    let medians = lags.filter_map(|lag| Some((median_difference(&turns, gyroscope, lag)?, lag)));
    // Among equal values, the first is nearest to zero.
    let (_, mut lag) = medians.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let mut unknowns = Unknowns::zeros();
    let mut equations = Vec::new();
    for _ in 0..ITERATIONS {
        unknowns[0] = 0.0;
        equations = linearised(&turns, gyroscope, lag);
        let limit = LIMIT * usual(&equations, &unknowns)?;
        let blocks = normal_equations(&equations, &unknowns, limit);
        unknowns = solve(&blocks, None, MOUNTING_SIGMA)?;
        let change = unknowns[0].clamp(-2.0 * STEP, 2.0 * STEP);
        lag += change;
        if change.abs() < 1e-5 {
            break;
        }
    }
    let limit = LIMIT * usual(&equations, &unknowns)?;
    if lag.abs() > REACH || share_left(&equations, &unknowns, limit) > MAX_SHARE {
        return None;
    }
    let blocks = normal_equations(&equations, &unknowns, limit);
    let sigma = jackknife(without_each(&blocks, MOUNTING_SIGMA)?.iter().map(|part| part[0]));
    let (misalignment, misalignment_sigma) = find_misalignment(&equations, unknowns)?;
    Some(Lag { seconds: lag, sigma, misalignment, misalignment_sigma })
}

/// The misalignment of the gyroscope, and the standard deviation along it, radians.
fn find_misalignment(equations: &[Equations], mut unknowns: Unknowns) -> Option<(Vector3, f64)> {
    let mut blocks = Vec::new();
    for _ in 0..ITERATIONS {
        let limit = LIMIT * usual(equations, &unknowns)?;
        blocks = normal_equations(equations, &unknowns, limit);
        unknowns = solve(&blocks, None, WIDE_MOUNTING_SIGMA)?;
    }
    let mounting = mounting_of(&unknowns);
    let along = |part: &Unknowns| mounting_of(part).dot(&mounting) / mounting.norm().max(1e-9);
    Some((mounting, jackknife(without_each(&blocks, WIDE_MOUNTING_SIGMA)?.iter().map(along))))
}

/// Solutions with each block left out in turn.
fn without_each(blocks: &[(Normal, Unknowns)], mounting_sigma: f64) -> Option<Vec<Unknowns>> {
    (0..blocks.len()).map(|left_out| solve(blocks, Some(left_out), mounting_sigma)).collect()
}

/// Standard deviation of a value from its values without each block (block jackknife).
fn jackknife(without: impl ExactSizeIterator<Item = f64> + Clone) -> f64 {
    let count = without.len() as f64;
    let mean = without.clone().sum::<f64>() / count;
    let squares: f64 = without.map(|part| (part - mean).powi(2)).sum();
    (squares * (count - 1.0) / count).sqrt()
}

/// The rotation in the matrix, as a rotation vector: its antisymmetric part is sin θ along the axis.
fn mounting_of(unknowns: &Unknowns) -> Vector3 {
    let matrix = |row: usize, column: usize| unknowns[4 + 3 * row + column];
    let [x, y, z] = [(2, 1), (0, 2), (1, 0)].map(|(i, j)| 0.5 * (matrix(i, j) - matrix(j, i)));
    let sine = Vector3::new(x, y, z);
    sine.try_normalize(1e-12).map_or_else(Vector3::zeros, |axis| axis * sine.norm().min(1.0).asin())
}

/// Fraction of the rotations that is left unexplained (of root mean squares, weighted).
fn share_left(equations: &[Equations], unknowns: &Unknowns, limit: f64) -> f64 {
    // With the matrix zero, the rotations of the gyroscope vanish.
    let mut without_rotation = Unknowns::zeros();
    for axis in 0..3 {
        without_rotation[4 + 4 * axis] = -1.0;
    }
    let squares = |of: &Unknowns| -> f64 {
        equations.iter().map(|e| weight(e, unknowns, limit) * e.left(of).norm_squared()).sum()
    };
    (squares(unknowns) / squares(&without_rotation)).sqrt()
}

/// Rotations from each sweep to the first one that is long enough after it. Those at rest are left out: they
/// do not constrain the lag, and matches at rest are so accurate that all others would look like outliers.
pub(super) fn turns(sweeps: &[TrackedSweep]) -> Vec<SweepTurn> {
    let from = |i: usize| {
        let a = &sweeps[i];
        let seconds = |b: &TrackedSweep| b.time.seconds_since(a.time);
        let b = sweeps[i..].iter().find(|b| seconds(b) >= LENGTH)?;
        let is_one = a.segment == b.segment && seconds(b) < LENGTH + MAX_EXCESS;
        is_one.then(|| SweepTurn::new(a, b))?
    };
    let mut turns: Vec<SweepTurn> = (0..sweeps.len()).filter_map(from).collect();
    let mut sizes: Vec<f64> = turns.iter().map(SweepTurn::size).collect();
    sizes.sort_unstable_by(f64::total_cmp);
    let large = sizes.get(sizes.len() * 19 / 20).copied().unwrap_or(0.0);
    turns.retain(|turn| turn.size() > SMALL_SHARE * large);
    turns
}

/// Median whitened difference at a lag, after subtracting the mean difference (the bias of the gyroscope).
fn median_difference(turns: &[SweepTurn], gyroscope: &Gyroscope, lag: f64) -> Option<f64> {
    let known: Vec<(Vector3, &SweepTurn)> =
        turns.iter().filter_map(|t| Some((t.turn - t.shown(gyroscope, lag)?, t))).collect();
    if known.len() < ENOUGH_TURNS {
        return None;
    }
    let mean = known.iter().map(|(d, _)| d).sum::<Vector3>() / known.len() as f64;
    Some(median(known.iter().map(|(d, t)| (t.whiten * (d - mean)).norm()).collect()))
}

/// Equations of one rotation: three rows.
struct Equations {
    /// Difference with all unknowns zero, whitened.
    difference: Vector3,
    /// Derivatives of the explained difference by the unknowns, whitened.
    rows: SMatrix<f64, 3, UNKNOWNS>,
}

impl Equations {
    fn left(&self, unknowns: &Unknowns) -> Vector3 {
        self.difference - self.rows * unknowns
    }
}

fn linearised(turns: &[SweepTurn], gyroscope: &Gyroscope, lag: f64) -> Vec<Equations> {
    let of_turn = |turn: &SweepTurn| {
        let shown = turn.shown(gyroscope, lag)?;
        let around = [-0.5 * STEP, 0.5 * STEP].map(|change| turn.shown(gyroscope, lag + change));
        let [before, after] = around;
        let mut rows = SMatrix::<f64, 3, UNKNOWNS>::zeros();
        rows.set_column(0, &((after? - before?) / STEP));
        for axis in 0..3 {
            rows[(axis, 1 + axis)] = turn.to.seconds_since(turn.from);
            for other in 0..3 {
                rows[(axis, 4 + 3 * axis + other)] = shown[other];
            }
        }
        Some(Equations { difference: turn.whiten * (turn.turn - shown), rows: turn.whiten * rows })
    };
    turns.iter().filter_map(of_turn).collect()
}

/// Usual size of the residuals (median, as a standard deviation of one axis).
fn usual(equations: &[Equations], unknowns: &Unknowns) -> Option<f64> {
    // The median of the length of a normal vector in 3D is 1.538 standard deviations.
    let size = median(equations.iter().map(|e| e.left(unknowns).norm()).collect()) / 1.538;
    (equations.len() >= ENOUGH_TURNS && size.is_finite()).then_some(size.max(1e-9))
}

/// Weight after Geman and McClure.
fn weight(equation: &Equations, unknowns: &Unknowns, limit: f64) -> f64 {
    let squared = limit * limit;
    (squared / (squared + equation.left(unknowns).norm_squared())).powi(2)
}

/// The normal equations of each block.
fn normal_equations(equations: &[Equations], unknowns: &Unknowns, limit: f64) -> Vec<(Normal, Unknowns)> {
    let mut blocks = vec![(Normal::zeros(), Unknowns::zeros()); BLOCKS];
    let variance = (limit / LIMIT).powi(2);
    for (i, equation) in equations.iter().enumerate() {
        let weight = weight(equation, unknowns, limit) / variance;
        let (normal, right) = &mut blocks[i * BLOCKS / equations.len()];
        *normal += equation.rows.transpose() * equation.rows * weight;
        *right += equation.rows.transpose() * equation.difference * weight;
    }
    blocks
}

/// Least squares with a prior of the matrix; its antisymmetric part, which is a rotation, has the given
/// standard deviation.
fn solve(blocks: &[(Normal, Unknowns)], left_out: Option<usize>, mounting_sigma: f64) -> Option<Unknowns> {
    let mut normal = Normal::identity() * 1e-9;
    let mut right = Unknowns::zeros();
    let [of_scale, of_rotation] = [MOUNTING_SIGMA, mounting_sigma].map(|sigma| 1.0 / (sigma * sigma));
    for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column))) {
        let [one, other] = [(row, column), (column, row)].map(|(i, j)| 4 + 3 * i + j);
        match row == column {
            true => normal[(one, one)] += of_scale,
            false => {
                normal[(one, one)] += 0.5 * (of_scale + of_rotation);
                normal[(one, other)] += 0.5 * (of_scale - of_rotation);
            }
        }
    }
    for (_, (block, block_right)) in blocks.iter().enumerate().filter(|(i, _)| Some(*i) != left_out) {
        normal += block;
        right += block_right;
    }
    Some(normal.cholesky()?.solve(&right)).filter(|x| x.iter().all(|v| v.is_finite()))
}

fn median(mut values: Vec<f64>) -> f64 {
    portolan_numeric::median(&mut values).unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
