//! Estimates times of points from the residuals of registered sweeps.

use std::f32::consts::TAU;

use portolan_geometry::Vector2;
use portolan_geometry::nalgebra::{DMatrix, DVector, Matrix2, Matrix6, Matrix6x2, Vector6};

/// Number of azimuths at which turns may begin, five degrees apart.
const BINS: usize = 72;
/// Number of azimuth sectors whose sums are taken as independent of each other.
const SECTORS: usize = 24;
/// Information that holds poses in directions that no residual constrains.
const POSE_PRIOR: f64 = 1e-3;
/// Number of standard deviations by which a likely value may exceed the estimate.
pub(super) const LIKELY: f64 = 2.5;
/// Number of standard deviations by which the factor of another seam must exceed zero.
const CLEARLY: f64 = 4.0;

/// Phases of a point from which its time may follow: fractions of a turn or of a sweep, 0 to 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct Phases {
    /// Fraction of the turn by azimuth, from behind, counter-clockwise.
    pub azimuth: f32,
    /// Fraction of the sweep by the time that was recorded with the point.
    pub recorded: f32,
}

/// Phase from which times follow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Clock {
    Azimuth,
    Recorded,
}

/// Time of a turn as a function of the phase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TurnTimes {
    pub clock: Clock,
    /// Phase at which turns begin, 0 to 1.
    pub begin: f32,
    /// 1 where phases grow with time, −1 where they fall.
    pub sense: f32,
    /// Duration of a turn, in intervals between clouds: 1, or 1/2 where every other cloud is missing.
    pub part: f64,
}

impl TurnTimes {
    /// Times as they were recorded.
    pub const RECORDED: Self = Self { clock: Clock::Recorded, begin: 0.0, sense: 1.0, part: 1.0 };

    /// Times by azimuth: a turn that begins at the phase `begin`.
    pub fn by_azimuth(begin: f32, sense: f32) -> Self {
        Self { clock: Clock::Azimuth, begin, sense, part: 1.0 }
    }

    /// Time since the middle of the turn, in intervals between clouds.
    pub fn share(&self, phases: Phases) -> f64 {
        self.share_at(match self.clock {
            Clock::Azimuth => phases.azimuth,
            Clock::Recorded => phases.recorded,
        })
    }

    /// The same for the phase of the clock in use.
    fn share_at(&self, phase: f32) -> f64 {
        // The last point of a sweep is at its end, not at its beginning.
        if self.begin == 0.0 && self.sense > 0.0 {
            return self.part * (f64::from(phase) - 0.5);
        }
        self.part * (f64::from((self.sense * (phase - self.begin)).rem_euclid(1.0)) - 0.5)
    }
}

/// A matched point.
#[derive(Clone, Debug)]
pub(super) struct Row {
    /// Derivative of the residual by the pose.
    pub jacobian: Vector6<f64>,
    /// Distance of the point from the surface, metres.
    pub residual: f64,
    pub weight: f64,
    /// Phases of the point and of the point of the surface that it is matched to.
    pub phases: [Phases; 2],
    /// Change of the residual if the time of each of these two grows by one turn: by translation and by
    /// rotation.
    pub gains: [Vector2; 2],
    /// Change of the residual for each radian that all beams are raised.
    pub by_elevation: f64,
    /// Azimuth of the surface, radians.
    pub direction: f32,
}

/// Residuals of one sweep registered to another.
#[derive(Clone, Debug)]
pub(super) struct Pair {
    pub rows: Vec<Row>,
    /// Weighted number of the evaluated points that are on surfaces.
    pub explained: f64,
}

/// Estimated change of the factors of translation and of rotation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub factors: Vector2,
    pub sigmas: Vector2,
}

/// Change of the factors, with free poses.
pub(super) fn step(pairs: &[&Pair], times: TurnTimes) -> Option<Step> {
    step_toward(pairs, |phases| times.share(phases))
}

/// Change of the factors for any function of the phases, in turns.
fn step_toward(pairs: &[&Pair], share: impl Fn(Phases) -> f64) -> Option<Step> {
    solve(pairs, |row| row.slopes(&share))
}

/// Angle by which all beams should be raised, radians: the first of the two factors. A range error is not
/// estimated with it, as ground hardly separates the two.
pub(super) fn beam_step(pairs: &[&Pair]) -> Option<Step> {
    solve(pairs, |row| Vector2::new(row.by_elevation, 0.0))
}

/// Solves for two unknowns on which the residuals depend by these slopes, with free poses.
fn solve(pairs: &[&Pair], slopes_of: impl Fn(&Row) -> Vector2) -> Option<Step> {
    let mut sectors = [(Vector2::zeros(), Matrix2::zeros()); SECTORS];
    for pair in pairs {
        let slopes: Vec<Vector2> = pair.rows.iter().map(&slopes_of).collect();
        let mut information = Matrix6::identity() * POSE_PRIOR;
        let (mut of_slopes, mut of_residuals) = (Matrix6x2::zeros(), Vector6::zeros());
        for (row, slopes) in pair.rows.iter().zip(&slopes) {
            let weighted = row.jacobian * row.weight;
            information += weighted * row.jacobian.transpose();
            of_slopes += weighted * slopes.transpose();
            of_residuals += weighted * row.residual;
        }
        let factor = information.cholesky()?;
        let (of_slopes, of_residuals) = (factor.solve(&of_slopes), factor.solve(&of_residuals));
        for (row, slopes) in pair.rows.iter().zip(&slopes) {
            let slopes = slopes - of_slopes.tr_mul(&row.jacobian);
            let residual = row.residual - row.jacobian.dot(&of_residuals);
            if let Some((gradient, information)) = sectors.get_mut(row.sector()) {
                *gradient -= slopes * (row.weight * residual);
                *information += slopes * slopes.transpose() * row.weight;
            }
        }
    }
    let covariance = held(sectors.iter().map(|(_, information)| information).sum()).try_inverse()?;
    let factors: Vector2 = covariance * sectors.iter().map(|(gradient, _)| gradient).sum::<Vector2>();
    // Scatter of the single sectors about the common solution.
    let scatter: Matrix2<f64> = (sectors.iter())
        .map(|(gradient, information)| gradient - information * factors)
        .map(|rest| rest * rest.transpose())
        .sum();
    let sigmas = (covariance * scatter * covariance).diagonal().map(f64::sqrt);
    Some(Step { factors, sigmas })
}

/// Holds a factor without information, where there is no rotation or no translation.
fn held(information: Matrix2<f64>) -> Matrix2<f64> {
    information + Matrix2::identity() * (1e-6 * information.trace() + f64::MIN_POSITIVE)
}

impl Row {
    fn slopes(&self, share: impl Fn(Phases) -> f64) -> Vector2 {
        self.gains[0] * share(self.phases[0]) + self.gains[1] * share(self.phases[1])
    }

    fn sector(&self) -> usize {
        ((self.direction / TAU + 0.5) * SECTORS as f32) as usize % SECTORS
    }
}

/// Begin and direction of the turns: those for which times of points reduce the residuals most significantly.
pub(super) fn most_likely_turn(pairs: &[&Pair]) -> Option<TurnTimes> {
    let equations = BinEquations::of(pairs)?;
    let sure = |times: &TurnTimes| equations.step(|phase| times.share_at(phase)).significance();
    turns().max_by(|a, b| sure(a).total_cmp(&sure(b)))
}

/// A turn that fits clearly better than the one that the sweeps were de-skewed with.
pub(super) fn better_turn(pairs: &[&Pair], taken_out: TurnTimes) -> Option<TurnTimes> {
    let equations = BinEquations::of(pairs)?;
    let change = |times: &TurnTimes, phase: f32| times.share_at(phase) - taken_out.share_at(phase);
    let sure = |times: &TurnTimes| equations.step(|phase| change(times, phase)).significance();
    let best = turns().filter(|t| *t != taken_out).max_by(|a, b| sure(a).total_cmp(&sure(b)))?;
    let step = step_toward(pairs, |phases| change(&best, phases.azimuth))?;
    // One step finds about a third of the factor.
    let is_better = |factor: f64, sigma: f64| factor > (CLEARLY * sigma).max(0.2);
    let Step { factors, sigmas } = step;
    (is_better(factors.x, sigmas.x) || is_better(factors.y, sigmas.y)).then_some(best)
}

/// Largest likely steps over all turns. The scale of formal standard deviations is taken from the turn `one`,
/// for which they are known.
pub(super) fn largest_steps(pairs: &[&Pair], of_one: Step, one: TurnTimes) -> Option<Vector2> {
    let equations = BinEquations::of(pairs)?;
    let formal = equations.step(|phase| one.share_at(phase)).sigmas();
    let scale = of_one.sigmas.component_div(&formal);
    let likely = |times: TurnTimes| {
        let step = equations.step(|phase| times.share_at(phase));
        step.factors() + scale.component_mul(&step.sigmas()) * LIKELY
    };
    turns().map(likely).reduce(|a, b| a.sup(&b))
}

fn turns() -> impl Iterator<Item = TurnTimes> {
    let begin = |i: usize| i as f32 / BINS as f32;
    (0..BINS).flat_map(move |i| [1.0, -1.0].map(|sense| TurnTimes::by_azimuth(begin(i), sense)))
}

/// Normal equations of the times of all phases, poses eliminated: first translation, then rotation.
struct BinEquations {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
}

/// Normal equations of the factors of translation and of rotation.
struct FactorEquations {
    information: Matrix2<f64>,
    gradient: Vector2,
}

impl BinEquations {
    fn of(pairs: &[&Pair]) -> Option<Self> {
        let size = 2 * BINS;
        let (mut information, mut gradient) = (DMatrix::zeros(size, size), DVector::zeros(size));
        for pair in pairs {
            let mut of_pose = Matrix6::identity() * POSE_PRIOR;
            let mut residuals = Vector6::zeros();
            let mut cross = DMatrix::<f64>::zeros(6, size);
            for row in &pair.rows {
                let weighted = row.jacobian * row.weight;
                of_pose += weighted * row.jacobian.transpose();
                residuals += weighted * row.residual;
                let gains = row.bin_gains();
                for (bin, gain) in gains {
                    let mut column = cross.column_mut(bin);
                    column += weighted * gain;
                    if let Some(gradient) = gradient.get_mut(bin) {
                        *gradient -= row.weight * gain * row.residual;
                    }
                    for (other, other_gain) in gains {
                        if let Some(information) = information.get_mut((bin, other)) {
                            *information += row.weight * gain * other_gain;
                        }
                    }
                }
            }
            let factor = of_pose.cholesky()?;
            gradient += cross.tr_mul(&factor.solve(&residuals));
            information -= cross.tr_mul(&factor.solve(&cross));
        }
        Some(Self { information, gradient })
    }

    /// Normal equations of the factors for times by azimuth.
    fn step(&self, share: impl Fn(f32) -> f64) -> FactorEquations {
        let times = DVector::from_fn(BINS, |i, _| share((i as f32 + 0.5) / BINS as f32));
        let block = |i: usize, j: usize| {
            let part = self.information.view((i * BINS, j * BINS), (BINS, BINS));
            times.dot(&(part * &times))
        };
        let information = Matrix2::new(block(0, 0), block(0, 1), block(1, 0), block(1, 1));
        let gradient = |i: usize| self.gradient.rows(i * BINS, BINS).dot(&times);
        FactorEquations { information: held(information), gradient: Vector2::new(gradient(0), gradient(1)) }
    }
}

impl Row {
    /// Change of the residual with the times of azimuth bins, by translation and by rotation.
    fn bin_gains(&self) -> [(usize, f64); 4] {
        let bins = self.phases.map(|phases| (phases.azimuth * BINS as f32) as usize % BINS);
        let [source, target] = self.gains;
        [(bins[0], source.x), (bins[1], target.x), (BINS + bins[0], source.y), (BINS + bins[1], target.y)]
    }
}

impl FactorEquations {
    fn factors(&self) -> Vector2 {
        self.information.try_inverse().map_or_else(Vector2::zeros, |inverse| inverse * self.gradient)
    }

    /// Standard deviations, up to a common scale.
    fn sigmas(&self) -> Vector2 {
        let inverse = self.information.try_inverse().unwrap_or_else(|| Matrix2::identity() * f64::MAX);
        inverse.diagonal().map(f64::sqrt)
    }

    /// By how many standard deviations the factors exceed zero, up to a common scale. Negative factors do not
    /// count.
    fn significance(&self) -> f64 {
        let factors = self.factors();
        let alone =
            |gradient: f64, information: f64| gradient.max(0.0) / information.max(f64::MIN_POSITIVE).sqrt();
        if factors.min() >= 0.0 {
            factors.dot(&self.gradient).max(0.0).sqrt()
        } else {
            alone(self.gradient.x, self.information.m11).max(alone(self.gradient.y, self.information.m22))
        }
    }
}
