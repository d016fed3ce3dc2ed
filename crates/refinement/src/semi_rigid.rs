//! Semi-rigid refinement as published (Elseberg, Borrmann and Nüchter 2013; Nüchter, Bleier, Schauer and Janotta
//! 2017, section 5): sections of the trajectory are registered to each other, all at once, in one sparse system with
//! the motion between consecutive elements, and at last all elements of the trajectory are solved for.
//!
//! Differences, each for a fault of the reference: poses are moved on SE(3) (no singular angle); the input's
//! motion has a covariance in metres and radians per root second (independent of the number of elements and of
//! the unit of length); sections do not share points unless asked to, so that they are not locked to each
//! other; pairs count by their distance from the surface, and only if both face the same way (a quarter of all pairs
//! within 50 cm join the two sides of a wall or different faces); each two sections are linked once; the first pose is the gauge, not the first section.

use nalgebra::{Matrix3, Matrix6};
use portolan_geometry::{Rigid3, Time, Vector3, nalgebra as na};
use portolan_solver::NormalBlocks;
use rayon::prelude::*;

use crate::continuous::{
    Knots, Method, OdometryNoise, RefineProgress, RefineStep, Refined, Session, odometry_terms,
};
use crate::neighbours::{VoxelRepresentative, reduce};
use crate::registration::{
    GlobalOptions, Link, LinkStatistics, LinkSums, RobustKernel, ScanCloud, links_by_overlap,
};
use crate::{PointStore, RefineError};

/// Points of a section that look for a partner in another one.
const MAX_QUERIES: usize = 400;
/// Neighbours of a point that tell its normal.
const NORMAL_NEIGHBOURS: usize = 12;
/// Beyond this share of the pair distance pairs lose weight (Cauchy).
const KERNEL: f64 = 0.1;
/// Links with less weight of pairs are not used.
const LEAST_ROWS: f64 = 20.0;
/// Sections rest when none moves farther, metres.
const REST: f64 = 0.002;
const FAILED: RefineError = RefineError::Numerical("distribution over the elements");

/// Parameters as in the paper.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct SemiRigidOptions {
    /// Seconds of one element of the trajectory (a profile, a packet, or whole sweeps for the coarse mode).
    pub element: f64,
    /// A section is made every so many elements.
    pub interval: usize,
    /// It holds the points of so many elements on each side of its middle.
    pub half_width: usize,
    /// Edge of the voxels of which one point each is kept, metres.
    pub voxel: f64,
    /// Most iterations of the registration of the sections.
    pub rigid_iterations: usize,
    /// Sections with more pairs than this are linked.
    pub min_pairs: usize,
    /// Farthest points of a pair, metres.
    pub max_distance: f64,
    /// How often sections are made, registered and distributed.
    pub outer_iterations: usize,
    /// How wrong the motion of the input may be.
    pub odometry: OdometryNoise,
}

impl Default for SemiRigidOptions {
    fn default() -> Self {
        Self {
            element: 1.0 / 120.0,
            interval: 300,
            half_width: 150,
            voxel: 0.10,
            rigid_iterations: 20,
            min_pairs: 400,
            max_distance: 0.5,
            outer_iterations: 1,
            odometry: OdometryNoise { translation: 0.05, rotation: 0.5_f64.to_radians() },
        }
    }
}

impl SemiRigidOptions {
    fn check(&self) -> Result<(), RefineError> {
        let sensible =
            [self.element, self.voxel, self.max_distance, self.odometry.translation, self.odometry.rotation]
                .iter()
                .all(|v| *v > 0.0 && *v < 1e6);
        if !sensible || self.interval == 0 {
            return Err(RefineError::Option(
                "element, interval, voxel, pair distance and odometry noise must be above 0".to_owned(),
            ));
        }
        if 2 * self.half_width < self.interval {
            return Err(RefineError::Option(format!(
                "with a half width of {} elements sections every {} elements leave gaps; it must be at least half of that",
                self.half_width, self.interval
            )));
        }
        Ok(())
    }
}

/// Refines a trajectory as published. Arguments and errors as for
/// [`refine_continuous`](crate::continuous::refine_continuous).
///
/// # Errors
/// Fails if there are no points, too few poses, or points and poses are of different times.
pub fn refine_semi_rigid(
    points: &PointStore,
    input: &[(Time, Rigid3)],
    options: &SemiRigidOptions,
    observe: &mut dyn FnMut(&RefineProgress) -> bool,
) -> Result<Refined, RefineError> {
    options.check()?;
    let mut session = Session::new(points, input, Method::SemiRigid(*options), options.odometry)?;
    session.look_for_suspicions();
    for iteration in 0..options.outer_iterations.max(1) {
        let step = outer_iteration(&mut session, options)?;
        session.measure_round(iteration);
        let progress = RefineProgress {
            stage: format!("{} sections", step.terms),
            share: (iteration + 1) as f64 / options.outer_iterations.max(1) as f64,
            rms: step.rms,
            shift: step.shift,
            entropy: session.report.sharpness_by_round.last().map(|s| s.mean_map_entropy),
        };
        if !observe(&progress) {
            session.report.stopped = iteration + 1 < options.outer_iterations;
            break;
        }
    }
    Ok(session.finish(|_, _| {}))
}

/// Sections are made and linked; then they are moved until they fit, at last with all elements.
fn outer_iteration(session: &mut Session, options: &SemiRigidOptions) -> Result<RefineStep, RefineError> {
    let middles = middles(session.trajectory.duration(), options);
    let scans: Vec<ScanCloud> = middles.par_iter().map(|middle| section(session, *middle, options)).collect();
    let poses: Vec<Rigid3> = middles.iter().map(|m| session.trajectory.pose(*m)).collect();
    let links = links_by_overlap(&scans, &poses, options.min_pairs, options.max_distance);
    let sections = Sections { middles, scans, links };
    // Between sections the elements do what a chain of equal springs does; one knot a section is as good until the
    // end.
    let spacing = options.element * options.interval as f64;
    for _ in 1..options.rigid_iterations {
        let step = move_sections(session, &sections, spacing, options)?;
        session.report.steps.push(step);
        if step.shift < REST {
            break;
        }
    }
    let step = move_sections(session, &sections, options.element, options)?;
    session.report.steps.push(step);
    Ok(step)
}

/// Sections of one outer iteration.
struct Sections {
    middles: Vec<f64>,
    /// Points in the frame of the trajectory at the middle of the section.
    scans: Vec<ScanCloud>,
    links: Vec<Link>,
}

/// One iteration: pairs are searched at the current poses of the sections, and everything is solved for at once: each
/// link wants the difference D of its sections with information C⁻¹ (equations 7 to 9), consecutive knots want the
/// motion of the input.
fn move_sections(
    session: &mut Session,
    sections: &Sections,
    spacing: f64,
    options: &SemiRigidOptions,
) -> Result<RefineStep, RefineError> {
    let poses: Vec<Rigid3> = sections.middles.iter().map(|m| session.trajectory.pose(*m)).collect();
    let matching = GlobalOptions {
        max_distance: options.max_distance,
        max_queries: MAX_QUERIES,
        planes: true,
        kernel: RobustKernel::Cauchy(KERNEL * options.max_distance),
        ..GlobalOptions::default()
    };
    let sums: Vec<LinkSums> = sections
        .links
        .par_iter()
        .map(|link| LinkSums::of(&sections.scans, &poses, *link, &matching))
        .collect();
    let knots = Knots::new(session.trajectory.duration(), spacing);
    let mut equations = NormalBlocks::new(knots.count());
    let (mut squares, mut weights) = (0.0, 0.0);
    for sum in &sums {
        squares += sum.statistics.squares;
        weights += sum.statistics.rows;
    }
    let common = squares / f64::max(weights, 1e-12);
    for (link, sum) in sections.links.iter().zip(&sums) {
        add_link(&mut equations, &knots, sections, &poses, *link, &sum.statistics, common)?;
    }
    for term in &odometry_terms(&session.trajectory, &knots, options.odometry) {
        let i = term.knot();
        for (jacobian, residual, weight) in term.rows() {
            let part = |first: usize| std::array::from_fn(|k| jacobian[first + k]);
            equations.add_row(&[(i, part(0)), (i + 1, part(6))], residual, weight).map_err(|_| FAILED)?;
        }
    }
    equations.hold(0, 1e9);
    let increment = equations.solve().map_err(|_| FAILED)?.ok_or(FAILED)?;
    session.trajectory.apply(&knots, &increment);
    let shift = increment.chunks_exact(6).map(|k| Vector3::new(k[0], k[1], k[2]).norm()).fold(0.0, f64::max);
    Ok(RefineStep {
        stage: "sections",
        knot_spacing: knots.spacing(),
        reach: options.max_distance,
        terms: sections.scans.len(),
        rms: common.sqrt(),
        shift,
    })
}

/// `δ_a − δ_b = −D` with information C⁻¹, δ being the twists of both sections in the world.
fn add_link(
    equations: &mut NormalBlocks,
    knots: &Knots,
    sections: &Sections,
    poses: &[Rigid3],
    link: Link,
    statistics: &LinkStatistics,
    common_variance: f64,
) -> Result<(), RefineError> {
    let Some((difference, variance)) = statistics.difference() else { return Ok(()) };
    if statistics.rows < LEAST_ROWS {
        return Ok(());
    }
    // A few pairs may fit by chance much better than pairs do.
    let variance = variance.max(common_variance);
    let information =
        (statistics.matrix + Matrix6::identity() * (1e-9 * statistics.matrix.trace())) / variance;
    let Some(root) = information.cholesky().map(|c| c.l().transpose()) else { return Ok(()) };
    let residual = root * difference;
    let ends = [(link.from, 1.0), (link.to, -1.0)].map(|(section, sign)| {
        let (knot, f) = knots.place(sections.middles[section]);
        (knot, f, root * twist_of_increment(&poses[section].translation.vector) * sign)
    });
    for row in 0..6 {
        let part = |m: &Matrix6<f64>, f: f64| -> [f64; 6] { std::array::from_fn(|k| f * m[(row, k)]) };
        let mut terms = [(0, [0.0; 6]); 4];
        for (end, (knot, f, m)) in ends.iter().enumerate() {
            terms[2 * end] = (*knot, part(m, 1.0 - f));
            terms[2 * end + 1] = (knot + 1, part(m, *f));
        }
        equations.add_row(&terms, residual[row], 1.0).map_err(|_| FAILED)?;
    }
    Ok(())
}

/// Times of the middles of the sections.
fn middles(duration: f64, options: &SemiRigidOptions) -> Vec<f64> {
    let interval = options.interval as f64 * options.element;
    let count = (duration / interval).floor() as usize + 1;
    (0..count).map(|i| i as f64 * interval).collect()
}

/// The points around a time, joined with the current trajectory in the frame at that time, one in each voxel.
fn section(session: &Session, middle: f64, options: &SemiRigidOptions) -> ScanCloud {
    let half = options.half_width as f64 * options.element;
    let section_from_world = session.trajectory.pose(middle).inverse();
    let mut joined = Vec::new();
    session.for_each_point([middle - half, middle + half], |_, in_world| {
        let p = section_from_world * na::Point3::from(in_world);
        joined.push([p.x as f32, p.y as f32, p.z as f32]);
    });
    let reduced = reduce(&joined, options.voxel as f32, VoxelRepresentative::Random(1));
    let reach = (5.0 * options.voxel) as f32;
    ScanCloud::with_surfaces(reduced, NORMAL_NEIGHBOURS, reach).with_normals_towards([0.0; 3])
}

/// The twist in the world of an increment (shift, turn about a place): `(τ + p × φ, φ)`.
fn twist_of_increment(place: &Vector3) -> Matrix6<f64> {
    let mut m = Matrix6::identity();
    let cross: Matrix3<f64> = place.cross_matrix();
    m.fixed_view_mut::<3, 3>(0, 3).copy_from(&cross);
    m
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    #[test]
    fn increments_are_twists_in_the_world() {
        let place = Vector3::new(3.0, -2.0, 1.0);
        let (shift, turn) = (Vector3::new(0.1, 0.2, 0.3), Vector3::new(0.01, -0.02, 0.03));
        let twist =
            twist_of_increment(&place) * Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
        let x = Vector3::new(5.0, 6.0, 7.0);
        let by_increment = shift + turn.cross(&(x - place));
        let by_twist = twist.fixed_rows::<3>(0) + turn.cross(&x);
        assert!((by_increment - by_twist).norm() < 1e-12);
    }

    #[test]
    fn sections_that_leave_gaps_are_refused() {
        let options = SemiRigidOptions { half_width: 100, ..SemiRigidOptions::default() };
        assert!(options.check().is_err() && SemiRigidOptions::default().check().is_ok());
    }
}
