//! Iterative closest points.

mod pairs;
mod sums;

use nalgebra::Matrix6;
use portolan_geometry::Rigid3;

use super::{Model, ScanCloud};
use pairs::Pairing;
use portolan_spatial::{ClosedForm, best_transform};
use sums::{equations, point_moments};

/// Minimum number of pairs for a step.
const LEAST_PAIRS: usize = 4;
/// The same with planes, where each pair gives only one residual.
const LEAST_PLANES: u64 = 6;

/// The cost that is minimised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum IcpMethod {
    /// Distances of points, in closed form.
    PointToPoint(ClosedForm),
    /// Distances of points from the tangent planes of the model (Chen and Medioni 1992).
    PointToPlane,
    /// Distances weighted by the surfaces of both scans (Segal, Haehnel and Thrun 2009).
    Generalized,
}

/// Robust weighting of far pairs.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub enum RobustKernel {
    /// Equal weights.
    #[default]
    None,
    /// Linear beyond the scale (metres).
    Huber(f64),
    /// Logarithmic beyond the scale (metres).
    Cauchy(f64),
    /// Bounded beyond the scale (metres).
    GemanMcClure(f64),
}

impl RobustKernel {
    /// Weight of a residual of this distance, metres: from 0 to 1.
    pub fn weight(self, distance: f64) -> f64 {
        match self {
            Self::None => 1.0,
            Self::Huber(scale) => (scale / distance.max(f64::MIN_POSITIVE)).min(1.0),
            Self::Cauchy(scale) => 1.0 / (1.0 + (distance / scale).powi(2)),
            Self::GemanMcClure(scale) => 1.0 / (1.0 + (distance / scale).powi(2)).powi(2),
        }
    }
}

/// Options of ICP.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct IcpOptions {
    /// The cost that is minimised.
    pub method: IcpMethod,
    /// Maximum distance of pairs, metres.
    pub max_distance: f64,
    /// Maximum number of iterations; large scans have it twice, with few points first and then with all.
    pub max_iterations: usize,
    /// Change of the distance of pairs in each of two iterations below which it has converged, metres.
    pub epsilon: f64,
    /// Whether only pairs are used each of which is the nearest of the other.
    pub reciprocal: bool,
    /// Fraction of the nearest pairs that is used, above 0 to 1.
    pub keep: f64,
    /// Minimum absolute cosine between the normals of a pair, where both have one; −1 uses all.
    pub least_cosine: f64,
    /// Robust weighting of far pairs.
    pub kernel: RobustKernel,
    /// Stride of the points of the data scan for which a partner is searched; 1 for all.
    pub every: usize,
    /// Number of points with which larger data scans are first matched, before all are used; 0 uses all from
    /// the start. The result is the same within the tolerance of convergence.
    pub first_points: usize,
}

impl Default for IcpOptions {
    fn default() -> Self {
        Self {
            method: IcpMethod::PointToPoint(ClosedForm::Quaternion),
            max_distance: 0.25,
            max_iterations: 50,
            epsilon: 1e-7,
            reciprocal: false,
            keep: 1.0,
            least_cosine: -1.0,
            kernel: RobustKernel::None,
            every: 1,
            first_points: 20_000,
        }
    }
}

/// Reasons why scans could not be matched.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IcpError {
    /// A scan without points.
    #[error("the {0} scan has no points")]
    NoPoints(&'static str),
    /// All points of a scan coincide.
    #[error("all points of the {0} scan are at the same position")]
    OnePlace(&'static str),
    /// Too few points are near each other.
    #[error(
        "only {found} of {points} points have a partner within {max_distance} m{}; give a better guess or a larger distance",
        nearest.map_or(String::new(), |d| format!(" (the nearest two points are {d:.3} m apart)"))
    )]
    TooFewPairs {
        /// Number of pairs.
        found: usize,
        /// Number of points for which a partner was searched.
        points: usize,
        /// Maximum distance of the search, metres.
        max_distance: f64,
        /// Distance of the two scans, metres, estimated from a sample.
        nearest: Option<f64>,
    },
    /// A method with planes is requested, but the points have no surfaces.
    #[error("no point of the model is on a surface: use a method that matches points, or denser scans")]
    NoSurfaces,
    /// The pairs do not determine a transform.
    #[error("the point pairs do not determine a transform (are all of them on one line?)")]
    Undetermined,
}

/// A matched scan.
#[derive(Clone, Debug, PartialEq)]
pub struct IcpResult {
    /// The data scan in the frame of the model.
    pub model_from_data: Rigid3,
    /// Number of iterations.
    pub iterations: usize,
    /// Whether it converged.
    pub converged: bool,
    /// Number of pairs in the last iteration.
    pub pairs: u64,
    /// Root mean square distance of the pairs, metres.
    pub rms: f64,
    /// Covariance of the twist (rotation, translation) in the frame of the model; none where the pairs do not
    /// determine all of it.
    pub covariance: Option<Matrix6<f64>>,
}

/// Moves the data scan onto the model, starting from a guess. The result is the same for any number of
/// threads.
///
/// # Errors
/// Fails if one of the scans has no extent, too few points are near each other, or pairs do not determine a
/// transform.
pub fn icp<M: Model>(
    model: &M,
    data: &ScanCloud,
    guess: &Rigid3,
    options: &IcpOptions,
) -> Result<IcpResult, IcpError> {
    check(model, data, options)?;
    let mut pairing = Pairing::new(model, data, options);
    let mut run = Run { pose: *guess, iterations: 0, converged: false };
    // Few points suffice to come near; finally all of them are used.
    for stride in pairing.strides() {
        run.iterate(&mut pairing, stride, options)?;
    }
    finish(&mut pairing, run, options)
}

fn check<M: Model>(model: &M, data: &ScanCloud, options: &IcpOptions) -> Result<(), IcpError> {
    if model.count() == 0 {
        return Err(IcpError::NoPoints("model"));
    }
    let [low, high] = data.bounds();
    if low[0] > high[0] {
        return Err(IcpError::NoPoints("data"));
    }
    if low == high {
        return Err(IcpError::OnePlace("data"));
    }
    match options.method {
        IcpMethod::PointToPlane if !model.has_surfaces() => Err(IcpError::NoSurfaces),
        _ => Ok(()),
    }
}

/// State of the iteration.
struct Run {
    pose: Rigid3,
    iterations: usize,
    converged: bool,
}

impl Run {
    /// Steps with every `stride`-th point until convergence.
    fn iterate<M: Model>(
        &mut self,
        pairing: &mut Pairing<M>,
        stride: usize,
        options: &IcpOptions,
    ) -> Result<(), IcpError> {
        let mut errors: Vec<f64> = Vec::new();
        self.converged = false;
        let end = self.iterations + options.max_iterations.max(1);
        while self.iterations < end && !self.converged {
            let (step, rms) = self.step(pairing, stride, options)?;
            self.pose = step * self.pose;
            self.pose.rotation.renormalize();
            self.iterations += 1;
            let rest = |back: usize| {
                errors.len().checked_sub(back).is_some_and(|i| (errors[i] - rms).abs() < options.epsilon)
            };
            self.converged = rest(1) && rest(2);
            errors.push(rms);
        }
        Ok(())
    }

    /// The motion of one step, and the distance of pairs before it.
    fn step<M: Model>(
        &self,
        pairing: &mut Pairing<M>,
        stride: usize,
        options: &IcpOptions,
    ) -> Result<(Rigid3, f64), IcpError> {
        let matches = pairing.find(&self.pose, stride);
        if matches.len() < LEAST_PAIRS {
            return Err(pairing.too_few(&self.pose, matches.len(), stride));
        }
        match options.method {
            IcpMethod::PointToPoint(form) => {
                let moments = point_moments(pairing, &self.pose, &matches, options);
                Ok((best_transform(&moments, form).ok_or(IcpError::Undetermined)?, moments.rms()))
            }
            _ => {
                let equations = equations(pairing, &self.pose, &matches, options);
                if equations.count < LEAST_PLANES {
                    return Err(pairing.too_few(&self.pose, equations.count as usize, stride));
                }
                let step = equations.step().ok_or(IcpError::Undetermined)?;
                Ok((step, (equations.cost / equations.weight).sqrt()))
            }
        }
    }
}

fn finish<M: Model>(pairing: &mut Pairing<M>, run: Run, options: &IcpOptions) -> Result<IcpResult, IcpError> {
    let matches = pairing.find(&run.pose, options.every.max(1));
    if matches.len() < LEAST_PAIRS {
        return Err(pairing.too_few(&run.pose, matches.len(), options.every.max(1)));
    }
    let moments = point_moments(pairing, &run.pose, &matches, options);
    let equations = equations(pairing, &run.pose, &matches, options);
    // Points give three residuals each, planes one.
    let residuals =
        equations.count as f64 * if options.method == IcpMethod::PointToPlane { 1.0 } else { 3.0 };
    let variance = equations.cost / (residuals - 6.0).max(1.0);
    let covariance = equations.matrix.cholesky().map(|factor| factor.inverse() * variance);
    Ok(IcpResult {
        model_from_data: run.pose,
        iterations: run.iterations,
        converged: run.converged,
        pairs: moments.count,
        rms: moments.rms(),
        covariance,
    })
}

#[cfg(test)]
mod tests;
