//! Iterative closest points.

use nalgebra::{Matrix3, Matrix6};
use portolan_geometry::{Rigid3, Vector3, nalgebra as na};
use rayon::prelude::*;

use super::linearized::TwistEquations;
use super::{ClosedForm, PairMoments, ScanCloud, best_transform};

/// Points worked on by one thread at a time; part of the definition of the sums.
const CHUNK: usize = 1024;
/// Variance along the normal against that along the surface, in generalised ICP (Segal et al. 2009).
const ACROSS: f64 = 1e-3;

/// What is minimised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum IcpMethod {
    /// Distances of points, by a closed form.
    PointToPoint(ClosedForm),
    /// Distances of points from the tangent planes of the model (Chen and Medioni 1992).
    PointToPlane,
    /// Distances weighted by the surfaces of both scans (Segal, Haehnel and Thrun 2009).
    Generalized,
}

/// How much less far pairs count.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub enum RobustKernel {
    /// All alike.
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
    pub(crate) fn weight(self, distance: f64) -> f64 {
        match self {
            Self::None => 1.0,
            Self::Huber(scale) => (scale / distance.max(f64::MIN_POSITIVE)).min(1.0),
            Self::Cauchy(scale) => 1.0 / (1.0 + (distance / scale).powi(2)),
            Self::GemanMcClure(scale) => 1.0 / (1.0 + (distance / scale).powi(2)).powi(2),
        }
    }
}

/// How scans are matched.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct IcpOptions {
    /// What is minimised.
    pub method: IcpMethod,
    /// Pairs farther apart do not count, metres.
    pub max_distance: f64,
    /// Most iterations.
    pub max_iterations: usize,
    /// It ends when the distance of pairs has changed by less in each of two iterations, metres.
    pub epsilon: f64,
    /// Only pairs each of which is the nearest of the other.
    pub reciprocal: bool,
    /// Share of the nearest pairs that is used, above 0 to 1.
    pub keep: f64,
    /// Least cosine between the normals of a pair, where both have one; −1 uses all.
    pub least_cosine: f64,
    /// How much less far pairs count.
    pub kernel: RobustKernel,
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
        }
    }
}

/// A matched scan.
#[derive(Clone, Debug, PartialEq)]
pub struct IcpResult {
    /// The data scan in the frame of the model.
    pub model_from_data: Rigid3,
    /// Iterations made.
    pub iterations: usize,
    /// Whether it ended by itself.
    pub converged: bool,
    /// Pairs in the last iteration.
    pub pairs: u64,
    /// Root mean square distance of the pairs, metres.
    pub rms: f64,
    /// Covariance of the twist (turn, shift) in the frame of the model; none where the pairs do not determine
    /// all of it.
    pub covariance: Option<Matrix6<f64>>,
}

#[derive(Clone, Copy)]
struct Match {
    model: u32,
    data: u32,
    distance: f32,
}

/// Moves the data scan onto the model scan, beginning at a guess. None if there are never enough pairs. The result
/// is the same for any number of threads.
pub fn icp(model: &ScanCloud, data: &ScanCloud, guess: &Rigid3, options: &IcpOptions) -> Option<IcpResult> {
    let mut pose = *guess;
    let mut errors: Vec<f64> = Vec::new();
    for iteration in 1..=options.max_iterations.max(1) {
        let matches = find_matches(model, data, &pose, options);
        let (step, rms) = match options.method {
            IcpMethod::PointToPoint(form) => {
                let moments = point_moments(model, data, &pose, &matches, options);
                (best_transform(&moments, form)?, moments.rms())
            }
            _ => {
                let equations = equations(model, data, &pose, &matches, options);
                if equations.count < 6 {
                    return None;
                }
                (equations.step()?, (equations.cost / equations.weight).sqrt())
            }
        };
        pose = step * pose;
        pose.rotation.renormalize();
        let rest = |back: usize| {
            errors.len().checked_sub(back).is_some_and(|i| (errors[i] - rms).abs() < options.epsilon)
        };
        let converged = rest(1) && rest(2);
        errors.push(rms);
        if converged || iteration == options.max_iterations.max(1) {
            return Some(finish(model, data, pose, options, iteration, converged));
        }
    }
    None
}

fn finish(
    model: &ScanCloud,
    data: &ScanCloud,
    pose: Rigid3,
    options: &IcpOptions,
    iterations: usize,
    converged: bool,
) -> IcpResult {
    let matches = find_matches(model, data, &pose, options);
    let moments = point_moments(model, data, &pose, &matches, options);
    let equations = equations(model, data, &pose, &matches, options);
    // Points give three residuals each, planes one.
    let residuals =
        equations.count as f64 * if options.method == IcpMethod::PointToPlane { 1.0 } else { 3.0 };
    let variance = equations.cost / (residuals - 6.0).max(1.0);
    let covariance = equations.matrix.cholesky().map(|factor| factor.inverse() * variance);
    IcpResult {
        model_from_data: pose,
        iterations,
        converged,
        pairs: moments.count,
        rms: moments.rms(),
        covariance,
    }
}

fn vector(p: [f32; 3]) -> Vector3 {
    Vector3::from(p.map(f64::from))
}

fn moved(pose: &Rigid3, p: [f32; 3]) -> Vector3 {
    (pose * na::Point3::from(vector(p))).coords
}

fn find_matches(model: &ScanCloud, data: &ScanCloud, pose: &Rigid3, options: &IcpOptions) -> Vec<Match> {
    let back = pose.inverse();
    let parts: Vec<Vec<Match>> = data
        .points()
        .par_chunks(CHUNK)
        .enumerate()
        .map(|(chunk, points)| {
            let mut matches = Vec::with_capacity(points.len());
            for (i, point) in points.iter().enumerate() {
                let index = chunk * CHUNK + i;
                let x = moved(pose, *point);
                let query = [x.x as f32, x.y as f32, x.z as f32];
                let Some(hit) = model.nearest(query, options.max_distance as f32) else { continue };
                if !is_accepted(model, data, pose, &back, (hit.index as usize, index), options) {
                    continue;
                }
                let distance = hit.squared_distance.sqrt();
                matches.push(Match { model: hit.index, data: index as u32, distance });
            }
            matches
        })
        .collect();
    let mut matches = parts.concat();
    if options.keep > 0.0 && options.keep < 1.0 {
        let count = (matches.len() as f64 * options.keep).ceil() as usize;
        matches.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.data.cmp(&b.data)));
        matches.truncate(count);
    }
    matches
}

fn is_accepted(
    model: &ScanCloud,
    data: &ScanCloud,
    pose: &Rigid3,
    back: &Rigid3,
    (m, d): (usize, usize),
    options: &IcpOptions,
) -> bool {
    if options.least_cosine > -1.0
        && let (Some(a), Some(b)) = (model.surface(m), data.surface(d))
        && vector(a.normal).dot(&(pose.rotation * vector(b.normal))).abs() < options.least_cosine
    {
        return false;
    }
    if !options.reciprocal {
        return true;
    }
    let x = moved(back, model.points()[m]);
    let query = [x.x as f32, x.y as f32, x.z as f32];
    data.nearest(query, options.max_distance as f32).is_some_and(|hit| hit.index as usize == d)
}

fn point_moments(
    model: &ScanCloud,
    data: &ScanCloud,
    pose: &Rigid3,
    matches: &[Match],
    options: &IcpOptions,
) -> PairMoments {
    let parts: Vec<PairMoments> = matches
        .par_chunks(CHUNK)
        .map(|chunk| {
            let mut moments = PairMoments::default();
            for pair in chunk {
                let m = vector(model.points()[pair.model as usize]);
                let d = moved(pose, data.points()[pair.data as usize]);
                moments.add(&m, &d, options.kernel.weight(f64::from(pair.distance)));
            }
            moments
        })
        .collect();
    let mut sum = PairMoments::default();
    parts.iter().for_each(|part| sum.merge(part));
    sum
}

fn equations(
    model: &ScanCloud,
    data: &ScanCloud,
    pose: &Rigid3,
    matches: &[Match],
    options: &IcpOptions,
) -> TwistEquations {
    let parts: Vec<TwistEquations> = matches
        .par_chunks(CHUNK)
        .map(|chunk| {
            let mut equations = TwistEquations::default();
            for pair in chunk {
                let (mi, di) = (pair.model as usize, pair.data as usize);
                let m = vector(model.points()[mi]);
                let x = moved(pose, data.points()[di]);
                let surface = |cloud: &ScanCloud, i| cloud.surface(i).map(|s| vector(s.normal));
                match options.method {
                    IcpMethod::PointToPoint(_) => {
                        let weight = options.kernel.weight(f64::from(pair.distance));
                        equations.add_weighted(&m, &x, &Matrix3::identity(), weight);
                    }
                    IcpMethod::PointToPlane => {
                        let Some(normal) = surface(model, mi) else { continue };
                        let weight = options.kernel.weight(normal.dot(&(m - x)).abs());
                        equations.add_plane(&m, &normal, &x, weight);
                    }
                    IcpMethod::Generalized => {
                        let spread = shape(surface(model, mi))
                            + shape(surface(data, di).map(|normal| pose.rotation * normal));
                        let Some(information) = spread.try_inverse() else { continue };
                        let weight = options.kernel.weight(f64::from(pair.distance));
                        equations.add_weighted(&m, &x, &information, weight);
                    }
                }
            }
            equations
        })
        .collect();
    let mut sum = TwistEquations::default();
    parts.iter().for_each(|part| sum.merge(part));
    sum
}

/// Covariance of a point on a surface with this normal, in units of that along the surface; a ball without one.
fn shape(normal: Option<Vector3>) -> Matrix3<f64> {
    match normal {
        Some(n) => Matrix3::identity() - n * n.transpose() * (1.0 - ACROSS),
        None => Matrix3::identity(),
    }
}

#[cfg(test)]
mod tests;
