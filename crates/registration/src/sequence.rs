//! Registers scans in sequence: each is matched with those before it, and loops are closed when they end.

use portolan_geometry::{Rigid3, angle_axis_from_quaternion};

use super::loop_closing::{close_loop, link_costs};
use super::{
    GlobalError, GlobalOptions, GlobalReport, IcpError, IcpOptions, IcpResult, Link, Metascan, RobustKernel,
    ScanCloud, icp, register_globally,
};

/// Number of scans on each side of the ends of a loop that are matched together.
const LOOP_SCANS: usize = 2;

/// The earlier scans that a scan is matched with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub enum ModelScans {
    /// The one before it.
    #[default]
    Previous,
    /// All before it (metascan).
    All,
    /// This number of scans before it.
    Last(usize),
}

/// Options of loop closing.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct LoopOptions {
    /// Distance of scans below which they close a loop, metres.
    pub distance: f64,
    /// Minimum difference of the indices of these scans.
    pub least_scans: usize,
    /// Maximum distance of paired points when the ends are matched, metres.
    pub max_distance: f64,
    /// Maximum number of iterations of that matching.
    pub max_iterations: usize,
}

impl Default for LoopOptions {
    fn default() -> Self {
        Self { distance: 5.0, least_scans: 20, max_distance: 7.0, max_iterations: 100 }
    }
}

/// Options of registration in sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct SequenceOptions {
    /// Matching of two scans.
    pub icp: IcpOptions,
    /// The scans that a scan is matched with.
    pub model: ModelScans,
    /// Whether initial guesses are accurate: then the correction of the scan before is not applied to a
    /// guess.
    pub trust_poses: bool,
    /// Loop closing; none for no closing.
    pub loops: Option<LoopOptions>,
}

/// A loop that was closed.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ClosedLoop {
    /// Its first scan.
    pub first: usize,
    /// Its last scan.
    pub last: usize,
    /// Translation of the last scan by the correction, metres.
    pub translation: f64,
    /// Angle of its rotation by the correction, radians.
    pub rotation: f64,
}

/// Results, scan by scan.
#[derive(Clone, Debug, PartialEq)]
pub struct SequenceReport {
    /// Results of the matching; none for the first scan.
    pub matched: Vec<Option<Result<IcpResult, IcpError>>>,
    /// Loops that were closed, in order.
    pub loops: Vec<ClosedLoop>,
}

/// Registers scans in their order. `world_from_scan` holds initial guesses and then the results; the first
/// scan is not moved. A scan that cannot be matched moves with the one before it, and its error is in the
/// report. `observe` is called with the index of each finished scan. The result is the same for any number of
/// threads.
pub fn register_sequence(
    scans: &[ScanCloud],
    world_from_scan: &mut [Rigid3],
    options: &SequenceOptions,
    observe: &mut dyn FnMut(usize),
) -> SequenceReport {
    let count = scans.len().min(world_from_scan.len());
    let guesses = world_from_scan.to_vec();
    let mut report = SequenceReport { matched: vec![None; count.min(1)], loops: Vec::new() };
    let mut open: Option<Link> = None;
    for index in 1..count {
        if !options.trust_poses {
            let correction = world_from_scan[index - 1] * guesses[index - 1].inverse();
            world_from_scan[index] = correction * guesses[index];
        }
        let result = match_scan(scans, world_from_scan, index, options);
        if let Ok(found) = &result {
            world_from_scan[index] = found.model_from_data;
        }
        report.matched.push(Some(result));
        observe(index);
        if let Some(loops) = options.loops {
            let candidate = loop_candidate(world_from_scan, index, &loops);
            let ended = open.filter(|_| candidate.is_none());
            open = match (open, candidate) {
                // The pair of scans nearest to each other, as long as the path stays near.
                (Some(a), Some(b)) => {
                    Some(if apart(world_from_scan, a) <= apart(world_from_scan, b) { a } else { b })
                }
                (None, candidate) => candidate,
                (Some(_), None) => None,
            };
            let ended = ended.or(open.filter(|_| index + 1 == count));
            if let Some(link) = ended {
                let reached = &mut world_from_scan[..=index];
                report.loops.extend(try_to_close(&scans[..=index], reached, link, options, &loops));
            }
        }
    }
    report
}

fn apart(poses: &[Rigid3], link: Link) -> f64 {
    (poses[link.from].translation.vector - poses[link.to].translation.vector).norm()
}

/// The earlier scan nearest to a scan, if they close a loop.
fn loop_candidate(poses: &[Rigid3], index: usize, loops: &LoopOptions) -> Option<Link> {
    let old = index.checked_sub(loops.least_scans.max(1))?;
    (0..old)
        .map(|from| Link { from, to: index })
        .min_by(|a, b| apart(poses, *a).total_cmp(&apart(poses, *b)))
        .filter(|link| apart(poses, *link) < loops.distance)
}

fn match_scan(
    scans: &[ScanCloud],
    poses: &[Rigid3],
    index: usize,
    options: &SequenceOptions,
) -> Result<IcpResult, IcpError> {
    let from = match options.model {
        ModelScans::All => 0,
        ModelScans::Previous => index - 1,
        ModelScans::Last(count) => index.saturating_sub(count.max(1)),
    };
    if from + 1 == index {
        // In the frame of the scan before, so that no query has to be transformed.
        let previous = poses[index - 1];
        let guess = previous.inverse() * poses[index];
        let found = icp(&scans[index - 1], &scans[index], &guess, &options.icp)?;
        return Ok(in_world(found, &previous));
    }
    let model = Metascan::new((from..index).map(|i| (&scans[i], poses[i])));
    icp(&model, &scans[index], &poses[index], &options.icp)
}

/// Transforms a result from the frame of another scan to the world.
fn in_world(found: IcpResult, world_from_model: &Rigid3) -> IcpResult {
    let covariance = found.covariance.map(|c| {
        // Covariances of twists (rotation, translation) are transformed by the adjoint.
        let rotation = world_from_model.rotation.to_rotation_matrix();
        let mut adjoint = nalgebra::Matrix6::zeros();
        adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation.matrix());
        adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation.matrix());
        let lever = world_from_model.translation.vector.cross_matrix() * rotation.matrix();
        adjoint.fixed_view_mut::<3, 3>(3, 0).copy_from(&lever);
        adjoint * c * adjoint.transpose()
    });
    IcpResult { model_from_data: world_from_model * found.model_from_data, covariance, ..found }
}

/// Matches the scans around both ends of a loop and distributes the correction; none if they do not match.
fn try_to_close(
    scans: &[ScanCloud],
    poses: &mut [Rigid3],
    link: Link,
    options: &SequenceOptions,
    loops: &LoopOptions,
) -> Option<ClosedLoop> {
    let count = poses.len();
    let near = |end: usize| end.saturating_sub(LOOP_SCANS)..(end + LOOP_SCANS + 1).min(count);
    let model = Metascan::new(near(link.from).map(|i| (&scans[i], poses[i])));
    // The last scans as one, in the frame of the last.
    let world_from_last = poses[link.to];
    let mut points = Vec::new();
    for i in link.to.saturating_sub(LOOP_SCANS)..=link.to {
        let last_from_scan = world_from_last.inverse() * poses[i];
        points.extend(scans[i].points().iter().map(|p| {
            let x = last_from_scan * portolan_geometry::nalgebra::Point3::from(p.map(f64::from));
            [x.x as f32, x.y as f32, x.z as f32]
        }));
    }
    let data = ScanCloud::new(points);
    let icp_options = IcpOptions {
        method: super::IcpMethod::PointToPoint(portolan_spatial::ClosedForm::Quaternion),
        max_distance: loops.max_distance,
        max_iterations: loops.max_iterations,
        // Far pairs are needed to converge from a distance, but must not bias the result.
        kernel: RobustKernel::Cauchy(options.icp.max_distance),
        ..options.icp
    };
    let found = icp(&model, &data, &world_from_last, &icp_options).ok()?;
    let correction = found.model_from_data * world_from_last.inverse();
    let chain: Vec<Link> = (1..count).map(|to| Link { from: to - 1, to }).collect();
    let costs = link_costs(scans, poses, &chain, options.icp.max_distance);
    close_loop(poses, &costs, link.from, link.to, &correction);
    let moved = found.model_from_data.translation.vector - world_from_last.translation.vector;
    let rotation = angle_axis_from_quaternion(&correction.rotation).norm();
    Some(ClosedLoop { first: link.from, last: link.to, translation: moved.norm(), rotation })
}

/// Scans that no chain of links connects with the first one, ascending; they are not moved in global
/// registration.
pub fn unlinked_scans(count: usize, links: &[Link]) -> Vec<usize> {
    let mut reached = vec![false; count];
    let mut open = vec![0];
    while let Some(scan) = open.pop() {
        if reached.get(scan) != Some(&false) {
            continue;
        }
        reached[scan] = true;
        open.extend(links.iter().filter(|l| l.from == scan).map(|l| l.to));
        open.extend(links.iter().filter(|l| l.to == scan).map(|l| l.from));
    }
    (0..count).filter(|i| !reached[*i]).collect()
}

/// Registers all scans at once, first coarsely with pairs up to `max_distance`, then again with the smaller
/// `last_distance`, if given. As [`register_globally`], with the same errors.
///
/// # Errors
/// Fails if a link names a scan that does not exist, or the equations cannot be solved.
pub fn register_globally_twice(
    scans: &[ScanCloud],
    world_from_scan: &mut [Rigid3],
    links: &[Link],
    options: &GlobalOptions,
    last_distance: Option<f64>,
) -> Result<GlobalReport, GlobalError> {
    let report = register_globally(scans, world_from_scan, links, options)?;
    match last_distance {
        Some(max_distance) => {
            register_globally(scans, world_from_scan, links, &GlobalOptions { max_distance, ..*options })
        }
        None => Ok(report),
    }
}

#[cfg(test)]
mod tests;
