//! Scan after scan: each is matched with those before it, and loops are closed when they end.

use portolan_geometry::{Rigid3, angle_axis_from_quaternion};

use super::loop_closing::{close_loop, link_costs};
use super::{
    GlobalError, GlobalOptions, GlobalReport, IcpError, IcpOptions, IcpResult, Link, Metascan, RobustKernel,
    ScanCloud, icp, register_globally,
};

/// Scans on each side of the ends of a loop that are matched together.
const LOOP_SCANS: usize = 2;

/// Which earlier scans a scan is matched with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub enum ModelScans {
    /// The one before it.
    #[default]
    Previous,
    /// All before it (metascan).
    All,
    /// So many before it.
    Last(usize),
}

/// When a loop is closed.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct LoopOptions {
    /// Scans nearer to each other than this close a loop, metres.
    pub distance: f64,
    /// Scans that lie at least between.
    pub least_scans: usize,
    /// Farthest points of a pair when the ends are matched, metres.
    pub max_distance: f64,
    /// Most iterations of that.
    pub max_iterations: usize,
}

impl Default for LoopOptions {
    fn default() -> Self {
        Self { distance: 5.0, least_scans: 20, max_distance: 7.0, max_iterations: 100 }
    }
}

/// How scans are registered one after the other.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct SequenceOptions {
    /// Matching of two scans.
    pub icp: IcpOptions,
    /// With which scans.
    pub model: ModelScans,
    /// First guesses are good: a scan does not begin where the correction of the one before would put it.
    pub trust_poses: bool,
    /// Closing of loops; none for no closing.
    pub loops: Option<LoopOptions>,
}

/// A loop that was closed.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ClosedLoop {
    /// Its first scan.
    pub first: usize,
    /// Its last scan.
    pub last: usize,
    /// How far the last scan was off, metres.
    pub translation: f64,
    /// By what angle, radians.
    pub rotation: f64,
}

/// What came out, scan by scan.
#[derive(Clone, Debug, PartialEq)]
pub struct SequenceReport {
    /// Results of the matching; none for the first scan.
    pub matched: Vec<Option<Result<IcpResult, IcpError>>>,
    /// Loops that were closed, in order.
    pub loops: Vec<ClosedLoop>,
}

/// Registers scans in their order. `world_from_scan` holds first guesses and then the results; the first scan stays.
/// A scan that cannot be matched moves with the one before it, which the report tells. `observe` is called with the
/// number of each finished scan. The same for any number of threads.
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
                // The pair of scans nearest to each other, while the way stays near.
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

/// The earlier scan nearest to a scan, if a loop closes there.
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
        // In the frame of the scan before, so that nothing has to be moved for each query.
        let previous = poses[index - 1];
        let guess = previous.inverse() * poses[index];
        let found = icp(&scans[index - 1], &scans[index], &guess, &options.icp)?;
        return Ok(in_world(found, &previous));
    }
    let model = Metascan::new((from..index).map(|i| (&scans[i], poses[i])));
    icp(&model, &scans[index], &poses[index], &options.icp)
}

/// A result in the frame of another scan as one in the world.
fn in_world(found: IcpResult, world_from_model: &Rigid3) -> IcpResult {
    let covariance = found.covariance.map(|c| {
        // Twists (turn, shift) are carried along by the adjoint.
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

/// Matches the scans about both ends of a loop and shares out what is found; none if they do not match.
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
        // Far pairs are needed to come near, but must not hold the result.
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

/// Scans that no link joins to the first one, ascending; they stay where they are in the global matching.
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

/// Registers all scans at once, first coarsely with pairs up to `max_distance`, then again with the last, smaller
/// distance, if one is given. As [`register_globally`], whose errors it has.
///
/// # Errors
/// Fails if a link names a scan that is not there, or the equations cannot be solved.
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
