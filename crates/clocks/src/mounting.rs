//! Determines whether the gyroscope rotates like sweeps of a lidar, or only after its axes are rotated or
//! its rates scaled.
//!
//! The rotation and the factor that fit the rotations of one sensor to those of the other in the sense of
//! least squares have a closed form (Kabsch 1976, "A solution for the best rotation to relate two sets of
//! vectors").

use portolan_geometry::Vector3;
use portolan_geometry::nalgebra::Matrix3;

use super::gyroscope::Gyroscope;
use super::lag::{ENOUGH_TURNS, SweepTurn};

/// Step of the lags that are tried, seconds.
const STEP: f64 = 0.05;
/// Number of lags that are tried to each side.
const STEPS: i32 = 10;
/// Fraction of the rotations of sweeps (of root mean squares) that is left unexplained, above which the two
/// do not rotate alike.
const LEFT: f64 = 0.5;
/// Fraction that is left with other axes, or another factor, below which these explain the difference.
const LEFT_OTHERWISE: f64 = 0.3;
/// Ratio of what a factor alone leaves unexplained to what a rotation of the axes leaves, up to which the
/// factor is preferred as simpler.
const AS_GOOD: f64 = 1.2;
/// Fraction of the rotations that is used: those that fit best.
const KEPT: f64 = 0.8;

/// Angle between the axes of the gyroscope and those assumed, radians, and ratio of its rates to the
/// rotation of sweeps, where it does not rotate like sweeps and these explain it. None where it does, or
/// where nothing explains it.
pub(super) fn find_mounting(turns: &[SweepTurn], gyroscope: &Gyroscope) -> Option<(f64, f64)> {
    let best = fits(turns, gyroscope)
        .reduce(|best, fit| if fit.turned.left < best.turned.left { fit } else { best })?;
    let simple = best.simple();
    let explains = best.as_assumed > LEFT && simple.left < LEFT_OTHERWISE;
    explains.then_some((simple.turned, simple.factor))
}

/// Whether the gyroscope certainly rotates like sweeps.
pub(super) fn turns_alike(turns: &[SweepTurn], gyroscope: &Gyroscope) -> bool {
    fits(turns, gyroscope).any(|fit| fit.as_assumed < LEFT_OTHERWISE)
}

fn fits(turns: &[SweepTurn], gyroscope: &Gyroscope) -> impl Iterator<Item = Fit> {
    let lags = (0..=STEPS).flat_map(|i| [STEP * f64::from(i), -STEP * f64::from(i)]);
    lags.filter_map(move |lag| Fit::of(turns, gyroscope, lag))
}

/// One fit of the rotations of the gyroscope to those of sweeps.
#[derive(Clone, Copy)]
struct Explanation {
    /// Angle between the axes of the IMU and those of the transforms, radians.
    turned: f64,
    /// Ratio of its rotation to that of sweeps.
    factor: f64,
    /// Fraction of the rotations of sweeps that is left unexplained.
    left: f64,
}

/// Fits at one lag.
struct Fit {
    /// Fraction that is left unexplained with the assumed axes and units.
    as_assumed: f64,
    scaled: Explanation,
    turned: Explanation,
}

/// Rotations measured by sweeps and by the gyroscope in the same time.
type Pair = (Vector3, Vector3);

impl Fit {
    /// Leaves out the pairs that fit worst: some sweeps are matched wrongly.
    fn of(turns: &[SweepTurn], gyroscope: &Gyroscope, lag: f64) -> Option<Self> {
        let shown = |turn: &SweepTurn| Some((turn.turn, turn.shown(gyroscope, lag)?));
        let mut pairs: Vec<Pair> = turns.iter().filter_map(shown).collect();
        if pairs.len() < ENOUGH_TURNS {
            return None;
        }
        let (_, matrix) = Self::least_squares(&pairs)?;
        let left = |pair: &Pair| (pair.0 - matrix * pair.1).norm();
        pairs.sort_by(|a, b| left(a).total_cmp(&left(b)));
        pairs.truncate((KEPT * pairs.len() as f64) as usize);
        Some(Self::least_squares(&pairs)?.0)
    }

    /// Returns also the matrix from rotations of the gyroscope to those of sweeps. The means, which contain
    /// the bias of the gyroscope, are subtracted.
    fn least_squares(pairs: &[Pair]) -> Option<(Self, Matrix3<f64>)> {
        let count = pairs.len() as f64;
        let sum = pairs.iter().fold((Vector3::zeros(), Vector3::zeros()), |s, p| (s.0 + p.0, s.1 + p.1));
        let (mut of_sweeps, mut of_gyroscope, mut product) = (0.0, 0.0, Matrix3::zeros());
        for (sweep, gyro) in pairs.iter().map(|p| (p.0 - sum.0 / count, p.1 - sum.1 / count)) {
            of_sweeps += sweep.norm_squared();
            of_gyroscope += gyro.norm_squared();
            product += sweep * gyro.transpose();
        }
        if of_sweeps <= 0.0 || of_gyroscope <= 0.0 {
            return None;
        }
        let share = |squares: f64| (squares.max(0.0) / of_sweeps).sqrt();
        // Least squares of s·b against a leave |a|² − common²/|b|², at s = common/|b|².
        let explanation = |turned: f64, common: f64| Explanation {
            turned,
            factor: of_gyroscope / common,
            left: share(of_sweeps - common * common / of_gyroscope),
        };
        let svd = product.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        let proper = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
        let rotation = u * proper * v_t;
        let angle = (0.5 * (rotation.trace() - 1.0)).clamp(-1.0, 1.0).acos();
        let fit = Self {
            as_assumed: share(of_sweeps + of_gyroscope - 2.0 * product.trace()),
            scaled: explanation(0.0, product.trace()),
            turned: explanation(angle, (proper * Matrix3::from_diagonal(&svd.singular_values)).trace()),
        };
        let simple = fit.simple();
        let axes = if simple.turned > 0.0 { rotation } else { Matrix3::identity() };
        Some((fit, axes / simple.factor))
    }

    /// The simplest explanation.
    fn simple(&self) -> Explanation {
        if self.scaled.left <= AS_GOOD * self.turned.left { self.scaled } else { self.turned }
    }
}
