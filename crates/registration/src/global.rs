//! Registers all scans at once: Lu and Milios in six degrees of freedom, in the published parametrisations
//! and on SE(3).

mod sums;
mod update;

use nalgebra::{DMatrix, Matrix6, Vector6};
use portolan_geometry::{Rigid3, Vector3};
use portolan_solver::NormalBlocks;
use rayon::prelude::*;

use super::{Link, RobustKernel, ScanCloud};
pub(crate) use sums::LinkSums;
use update::{move_by_euler, move_by_twist};

/// Stiffness that fixes the first scan.
const FIXED: f64 = 1e15;
/// Stiffness that holds scans without links, without a noticeable effect on the others.
const TRACE: f64 = 1e-6;
/// Maximum number of scans for which covariances are computed.
const MAX_COVARIANCES: usize = 300;

/// Parametrisation of the poses (specification sections 2.2 to 2.6).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub enum GlobalMethod {
    /// Twists on SE(3): no singularity. Recommended.
    #[default]
    Se3,
    /// Euler angles, as published; where they are singular the step is taken on SE(3).
    Euler,
    /// Quaternions that are not normalised, as published.
    Quaternion,
    /// Helical motions; links are not weighted.
    Helix,
    /// Small rotations first, then translations; links are not weighted.
    SmallAngle,
}

/// Options of global registration.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct GlobalOptions {
    /// Parametrisation.
    pub method: GlobalMethod,
    /// Maximum distance of pairs, metres.
    pub max_distance: f64,
    /// Maximum number of iterations.
    pub max_iterations: usize,
    /// Mean movement of the scans below which it has converged, metres.
    pub epsilon: f64,
    /// For scans with surfaces: uses only the distance of a point from the plane of its partner, and requires
    /// that the normals of both agree (with their signs: see [`ScanCloud::with_normals_towards`]). For the
    /// weighted methods.
    pub planes: bool,
    /// Robust weighting of far pairs when `planes` is set.
    pub kernel: RobustKernel,
    /// Maximum number of points of a link for which a partner is searched, chosen evenly.
    pub max_queries: usize,
}

impl Default for GlobalOptions {
    fn default() -> Self {
        Self {
            method: GlobalMethod::Se3,
            max_distance: 0.5,
            max_iterations: 50,
            epsilon: 1e-5,
            planes: false,
            kernel: RobustKernel::None,
            max_queries: usize::MAX,
        }
    }
}

/// Result of the registration.
#[derive(Clone, Debug, PartialEq)]
pub struct GlobalReport {
    /// Number of iterations.
    pub iterations: usize,
    /// Whether it converged.
    pub converged: bool,
    /// Number of links with enough pairs, in the last iteration.
    pub links: usize,
    /// Number of pairs, in the last iteration.
    pub pairs: u64,
    /// Root mean square distance of the pairs before the last step, metres.
    pub rms: f64,
    /// Mean movement of the scans in the last iteration, metres.
    pub shift: f64,
    /// Covariance of each scan's twist (translation, rotation; world), with the first scan fixed. For the
    /// weighted methods and up to a few hundred scans, otherwise empty.
    pub covariances: Vec<Matrix6<f64>>,
    /// The last information of each link: scans, MᵀM/s².
    pub information: Vec<(Link, Matrix6<f64>)>,
}

/// Reasons why scans could not be registered globally.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GlobalError {
    /// A link names a scan that does not exist, or one scan twice.
    #[error("link {} - {} does not join two scans", .0.from, .0.to)]
    BadLink(Link),
    /// The equations have no solution.
    #[error(
        "the equations could not be solved (global registration); this should not happen with finite input"
    )]
    Singular,
}

/// Moves all scans but the first so that the pairs of all links come together; pairs are searched anew in
/// each iteration. The result is the same for any number of threads.
///
/// # Errors
/// Fails if a link names a scan that does not exist, or the equations cannot be solved.
pub fn register_globally(
    scans: &[ScanCloud],
    world_from_scan: &mut [Rigid3],
    links: &[Link],
    options: &GlobalOptions,
) -> Result<GlobalReport, GlobalError> {
    let count = scans.len().min(world_from_scan.len());
    if let Some(link) = links.iter().find(|l| l.from >= count || l.to >= count || l.from == l.to) {
        return Err(GlobalError::BadLink(*link));
    }
    let mut report = GlobalReport {
        iterations: 0,
        converged: false,
        links: 0,
        pairs: 0,
        rms: 0.0,
        shift: 0.0,
        covariances: Vec::new(),
        information: Vec::new(),
    };
    for _ in 0..options.max_iterations {
        let sums: Vec<LinkSums> =
            links.par_iter().map(|link| LinkSums::of(scans, world_from_scan, *link, options)).collect();
        report.pairs = sums.iter().map(|s| s.statistics.count).sum();
        let squares: f64 = sums.iter().map(|s| s.statistics.squares).sum();
        report.rms = (squares / report.pairs.max(1) as f64).sqrt();
        let before: Vec<Vector3> = world_from_scan.iter().map(|p| p.translation.vector).collect();
        match options.method {
            GlobalMethod::Se3 | GlobalMethod::Euler => {
                weighted_step(world_from_scan, links, &sums, options.method, &mut report)?;
            }
            GlobalMethod::Quaternion => {
                report.links = update::quaternion_step(world_from_scan, links, &sums)?;
            }
            GlobalMethod::Helix => report.links = update::helix_step(world_from_scan, links, &sums)?,
            GlobalMethod::SmallAngle => {
                report.links = update::small_angle_step(world_from_scan, links, &sums)?;
            }
        }
        report.iterations += 1;
        let moved = world_from_scan.iter().zip(&before).map(|(p, b)| (p.translation.vector - b).norm());
        report.shift = moved.sum::<f64>() / count.max(1) as f64;
        if report.shift < options.epsilon {
            report.converged = true;
            break;
        }
    }
    Ok(report)
}

/// One step of equations (12) to (17): G X = B, G and B from C⁻¹ and C⁻¹D of the links.
fn weighted_step(
    poses: &mut [Rigid3],
    links: &[Link],
    sums: &[LinkSums],
    method: GlobalMethod,
    report: &mut GlobalReport,
) -> Result<(), GlobalError> {
    let mut equations = NormalBlocks::new(poses.len());
    report.information.clear();
    for (link, sum) in links.iter().zip(sums) {
        let Some((_, variance)) = sum.statistics.difference() else { continue };
        let information = sum.statistics.matrix / variance;
        let right = sum.statistics.vector / variance;
        report.information.push((*link, information));
        let rows = |m: Matrix6<f64>| -> [f64; 36] { std::array::from_fn(|i| m[(i / 6, i % 6)]) };
        let part = |v: Vector6<f64>| -> [f64; 6] { std::array::from_fn(|i| v[i]) };
        equations.add_block(link.from, link.from, &rows(information));
        equations.add_block(link.to, link.to, &rows(information));
        equations.add_block(link.from.max(link.to), link.from.min(link.to), &rows(-information));
        equations.add_right(link.from, &part(right));
        equations.add_right(link.to, &part(-right));
    }
    report.links = report.information.len();
    hold(&mut equations, poses.len());
    let solution = equations.solve().ok().flatten().ok_or(GlobalError::Singular)?;
    for (pose, x) in poses.iter_mut().zip(solution.chunks_exact(6)).skip(1) {
        let error = Vector6::from_column_slice(x);
        *pose = match method {
            GlobalMethod::Euler => move_by_euler(pose, &error),
            _ => move_by_twist(pose, &-error),
        };
    }
    report.covariances = covariances(poses.len(), &report.information);
    Ok(())
}

fn hold(equations: &mut NormalBlocks, count: usize) {
    equations.hold(0, FIXED);
    (1..count).for_each(|i| equations.hold(i, TRACE));
}

/// Diagonal blocks of G⁻¹ without the first scan (equation 16); that of the first scan is zero.
fn covariances(count: usize, information: &[(Link, Matrix6<f64>)]) -> Vec<Matrix6<f64>> {
    if !(2..=MAX_COVARIANCES).contains(&count) {
        return Vec::new();
    }
    let mut g = DMatrix::<f64>::identity(6 * (count - 1), 6 * (count - 1)) * TRACE;
    for (link, block) in information {
        for (r, c, sign) in [
            (link.from, link.from, 1.0),
            (link.to, link.to, 1.0),
            (link.from, link.to, -1.0),
            (link.to, link.from, -1.0),
        ] {
            if r > 0 && c > 0 {
                let mut view = g.fixed_view_mut::<6, 6>(6 * (r - 1), 6 * (c - 1));
                view += block * sign;
            }
        }
    }
    let Some(inverse) = g.cholesky().map(|factor| factor.inverse()) else { return Vec::new() };
    let block = |i: usize| inverse.fixed_view::<6, 6>(6 * i, 6 * i).into_owned();
    std::iter::once(Matrix6::zeros()).chain((0..count - 1).map(block)).collect()
}

#[cfg(test)]
mod tests;
