//! Semi-rigid refinement as published (Elseberg, Borrmann and Nüchter 2013; Nüchter, Bleier, Schauer and
//! Janotta 2017, section 5): sections of the trajectory are registered to each other as rigid bodies, all at
//! once. Then all elements of the trajectory are solved for in one sparse system, from pairs of points at the
//! level of single elements that were recorded long enough apart, and from the motion between consecutive
//! elements.
//!
//! Differences, each for a fault of the reference: poses are moved on SE(3) (no singular angle); the motion
//! of the input has a covariance in metres and radians per root second (independent of the number of elements
//! and of the unit of length), with which its residual is weighted, too; sections do not share points unless
//! requested, and points recorded shortly after each other are not paired, so that sections are not locked to
//! each other; pairs are weighted by their distance from the surface, and are used only if both face the same
//! direction (a quarter of all pairs within 50 cm join the two sides of a wall or different faces); each two
//! sections are linked once; the first pose is the gauge, not the first section; and motion within a section
//! is corrected, because pairs constrain the elements that measured them.

mod elements;
mod options;
mod sections;

use nalgebra::{Matrix3, Matrix6};
use portolan_geometry::{Rigid3, Time, Vector3};
use portolan_registration::{Link, LinkStatistics, RobustKernel};
use portolan_solver::NormalBlocks;
use rayon::prelude::*;

use crate::continuous::{
    DenseTrajectory, Knots, Method, MotionBlocks, OdometryNoise, RefineProgress, RefineStep, Refined,
    Session, TIGHT, conjugate_gradients, noise_found, odometry_terms,
};
use crate::{PointStore, RefineError};
use elements::{ElementEquations, ElementPair, End};
pub use options::SemiRigidOptions;
use sections::{PointPair, Sections};

/// Maximum number of points of a section for which a partner in another one is searched while sections are rigid.
const RIGID_QUERIES: usize = 120;
/// The same for elements.
const ELEMENT_QUERIES: usize = 1000;
/// Maximum number of iterations over all elements.
const ELEMENT_ITERATIONS: usize = 3;
/// Interval over which the noise of the input is estimated, seconds: over shorter ones its errors are smooth.
const ODOMETRY_SECONDS: f64 = 0.1;
/// Ratio of the residual of a pair to the scatter of all pairs above which it loses weight.
const KERNEL_SCATTER: f64 = 2.0;
/// Minimum standard deviation of a pair, metres.
const LEAST_DEVIATION: f64 = 0.005;
/// Residual above which pairs lose weight (Cauchy), as a fraction of the maximum pair distance.
const KERNEL: f64 = 0.1;
/// Minimum weight of the pairs of a link that is used.
const LEAST_ROWS: f64 = 20.0;
/// Usual number of steps of an outer iteration, for progress.
const USUAL_STEPS: usize = 12;
/// Motion below which sections have converged, metres: the rest is left to the elements, which converge
/// later.
const SECTIONS_REST: f64 = 0.01;
/// Motion below which elements have converged, metres.
const ELEMENTS_REST: f64 = 0.002;
const FAILED: RefineError = RefineError::Numerical("distribution over the elements");

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
    let outer_iterations = options.outer_iterations.max(1);
    for iteration in 0..outer_iterations {
        let usual = (USUAL_STEPS * outer_iterations) as f64;
        let mut report_step = |session: &Session, step: &RefineStep| {
            let steps = session.report.steps.len().min(USUAL_STEPS * (iteration + 1));
            observe(&RefineProgress {
                stage: match step.stage {
                    "elements" => format!("{} pairs of elements", step.terms),
                    _ => format!("{} links of sections", step.terms),
                },
                share: (steps as f64 / usual).min(0.99),
                rms: Some(step.rms),
                shift: Some(step.shift),
                entropy: session.report.sharpness_by_round.last().map(|s| s.mean_map_entropy),
            })
        };
        outer_iteration(&mut session, options, &mut report_step)?;
        if session.report.stopped {
            break;
        }
        session.measure_round();
    }
    Ok(session.finish(|_, _| {}))
}

/// One outer iteration: sections are made and linked, moved as rigid bodies until they fit, and then all
/// elements of the trajectory are solved for.
fn outer_iteration(
    session: &mut Session,
    options: &SemiRigidOptions,
    observe: &mut dyn FnMut(&Session, &RefineStep) -> bool,
) -> Result<(), RefineError> {
    let sections = Sections::of(session, options);
    for _ in 0..options.rigid_iterations {
        let step = move_sections(session, &sections, options)?;
        if !note(session, step, observe) {
            return Ok(());
        }
        if step.shift < SECTIONS_REST {
            break;
        }
    }
    let mut noise = NoiseModels { odometry: options.odometry, kernel: KERNEL * options.max_distance };
    let mut queries: Vec<Vec<u32>> =
        sections.links.iter().map(|link| sections.queries(*link, ELEMENT_QUERIES)).collect();
    for _ in 0..ELEMENT_ITERATIONS {
        let step = move_elements(session, &sections, &mut queries, options, &noise)?;
        noise = noise.learned(session, &step);
        if !note(session, step, observe) || step.shift < ELEMENTS_REST {
            break;
        }
    }
    Ok(())
}

/// Current noise models of input and pairs.
#[derive(Clone, Copy)]
struct NoiseModels {
    odometry: OdometryNoise,
    /// Scale of the robust kernel, metres.
    kernel: f64,
}

impl NoiseModels {
    /// Updates the noise models. An input that is better than assumed gets more weight, so that elements with
    /// few surfaces follow it. Pairs that scatter less than assumed make it clearer which of them are wrong.
    fn learned(self, session: &mut Session, step: &RefineStep) -> Self {
        let knots = Knots::new(session.trajectory.duration(), ODOMETRY_SECONDS);
        let found = noise_found(&session.trajectory, &knots);
        session.report.odometry_found = found;
        let odometry = OdometryNoise {
            translation: found.translation.min(self.odometry.translation),
            rotation: found.rotation.min(self.odometry.rotation),
        };
        Self { odometry, kernel: self.kernel.min(KERNEL_SCATTER * step.rms) }
    }
}

/// Records and reports a step; returns whether to go on.
fn note(
    session: &mut Session,
    step: RefineStep,
    observe: &mut dyn FnMut(&Session, &RefineStep) -> bool,
) -> bool {
    session.report.steps.push(step);
    let continues = observe(session, &step);
    session.report.stopped |= !continues;
    continues
}

/// One iteration with rigid sections: pairs are searched at their current poses, and everything is solved for
/// at once. Each link contributes the difference D of its sections with information C⁻¹ (equations 7 to 9),
/// consecutive sections the motion of the input. Between sections the elements behave like a chain of equal
/// springs.
fn move_sections(
    session: &mut Session,
    sections: &Sections,
    options: &SemiRigidOptions,
) -> Result<RefineStep, RefineError> {
    let poses = sections.poses(session);
    let kernel = RobustKernel::Cauchy(KERNEL * options.max_distance);
    let sum = |link: &Link| {
        let mut statistics = LinkStatistics::default();
        let queries = sections.queries(*link, RIGID_QUERIES);
        for pair in sections.pairs(*link, &poses, &queries, options) {
            let pair = sections.place(*link, &poses, pair);
            let weight = kernel.weight(pair.normal.dot(&(pair.a - pair.b)).abs());
            statistics.add_plane(&pair.a, &pair.b, &pair.normal, weight);
        }
        statistics
    };
    let sums: Vec<LinkStatistics> = sections.links.par_iter().map(sum).collect();
    let knots = Knots::new(session.trajectory.duration(), options.element * options.interval as f64);
    let mut equations = NormalBlocks::new(knots.count());
    let squares: f64 = sums.iter().map(|s| s.squares).sum();
    let common = squares / sums.iter().map(|s| s.rows).sum::<f64>().max(1e-12);
    for (link, statistics) in sections.links.iter().zip(&sums) {
        add_link(&mut equations, &knots, sections, &poses, *link, statistics, common)?;
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
    Ok(RefineStep {
        stage: "sections",
        knot_spacing: knots.spacing(),
        reach: options.max_distance,
        terms: sections.links.len(),
        rms: common.sqrt(),
        shift: largest_shift(&increment),
    })
}

/// One iteration over all elements: pairs are searched as before, but each point is placed by its own
/// element, and constrains that element. Of the queries of each link only those are kept that have found a
/// partner.
fn move_elements(
    session: &mut Session,
    sections: &Sections,
    queries: &mut [Vec<u32>],
    options: &SemiRigidOptions,
    noise: &NoiseModels,
) -> Result<RefineStep, RefineError> {
    let elements = Knots::new(session.trajectory.duration(), options.element);
    let mut pairs = element_pairs(session, sections, queries, &elements, options, noise);
    let weights: f64 = pairs.iter().map(|p| f64::from(p.weight)).sum();
    let squares: f64 = pairs.iter().map(|p| f64::from(p.weight) * f64::from(p.residual).powi(2)).sum();
    let variance = (squares / weights.max(1e-12)).max(LEAST_DEVIATION * LEAST_DEVIATION);
    pairs.iter_mut().for_each(|p| p.weight /= variance as f32);
    let terms = pairs.len();
    let increment = solve_elements(&session.trajectory, &elements, pairs, noise)?;
    session.trajectory.apply(&elements, &increment);
    Ok(RefineStep {
        stage: "elements",
        knot_spacing: elements.spacing(),
        reach: options.max_distance,
        terms,
        rms: variance.sqrt(),
        shift: largest_shift(&increment),
    })
}

/// Pairs of points of all links, each point placed by its own element, linearised there.
fn element_pairs(
    session: &Session,
    sections: &Sections,
    queries: &mut [Vec<u32>],
    elements: &Knots,
    options: &SemiRigidOptions,
    noise: &NoiseModels,
) -> Vec<ElementPair> {
    let poses = sections.poses(session);
    let matrices = session.trajectory.matrices();
    let kernel = RobustKernel::Cauchy(noise.kernel);
    let of_link = |(link, queries): (&Link, &mut Vec<u32>)| -> Vec<ElementPair> {
        let ends = [link.from, link.to].map(|i| &sections.sections[i].measured);
        let linearised = |pair: PointPair| {
            let normal = sections.normal(*link, &poses, pair);
            let placed = [0, 1].map(|end| {
                let (seconds, in_tracking) = ends[end][pair[end] as usize];
                let matrix = matrices.at(seconds);
                let place = Vector3::from(matrices.to_world(seconds, in_tracking));
                (seconds, place, Vector3::new(matrix[3], matrix[7], matrix[11]))
            });
            let residual = normal.dot(&(placed[0].1 - placed[1].1));
            ElementPair {
                normal: normal.map(|v| v as f32).into(),
                ends: placed
                    .map(|(seconds, place, from)| End::new(elements, seconds, &place, &from, &normal)),
                residual: residual as f32,
                weight: kernel.weight(residual.abs()) as f32,
            }
        };
        let found = sections.pairs(*link, &poses, queries, options);
        queries.clear();
        queries.extend(found.iter().map(|pair| pair[1]));
        found.into_iter().map(linearised).collect()
    };
    let parts: Vec<Vec<ElementPair>> = sections.links.par_iter().zip(queries).map(of_link).collect();
    parts.concat()
}

/// The increment of all elements that solves the equations of pairs and of the motion of the input.
fn solve_elements(
    trajectory: &DenseTrajectory,
    elements: &Knots,
    pairs: Vec<ElementPair>,
    noise: &NoiseModels,
) -> Result<Vec<f64>, RefineError> {
    let equations = ElementEquations::new(pairs, elements);
    let motion = odometry_terms(trajectory, elements, noise.odometry);
    let motion = MotionBlocks::new(&motion, &[], elements.count());
    let preconditioner = motion.preconditioner(|diagonal, below| equations.add_blocks(diagonal, below));
    let preconditioner = preconditioner.ok_or(FAILED)?;
    let product = |x: &[f64], y: &mut [f64]| {
        y.fill(0.0);
        equations.multiply(x, y);
        motion.multiply(x, y);
    };
    let mut right = motion.gradient.clone();
    equations.gradient(&mut right);
    right.iter_mut().for_each(|r| *r = -*r);
    Ok(conjugate_gradients(&right, product, |x| preconditioner.solve(x), TIGHT))
}

/// Largest translation, metres.
fn largest_shift(increment: &[f64]) -> f64 {
    increment.chunks_exact(6).map(|k| Vector3::new(k[0], k[1], k[2]).norm()).fold(0.0, f64::max)
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
    // A few pairs may by chance fit much better than pairs usually do.
    let variance = variance.max(common_variance);
    let information =
        (statistics.matrix + Matrix6::identity() * (1e-9 * statistics.matrix.trace())) / variance;
    let Some(root) = information.cholesky().map(|c| c.l().transpose()) else { return Ok(()) };
    let residual = root * difference;
    let ends = [(link.from, 1.0), (link.to, -1.0)].map(|(section, sign)| {
        let (knot, f) = knots.place(sections.sections[section].middle);
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

/// The twist in the world of an increment (translation, rotation about a position): `(τ + p × φ, φ)`.
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
        let tiny = SemiRigidOptions { element: 1e-6, ..SemiRigidOptions::default() };
        assert!(tiny.check().is_err());
    }

    #[test]
    fn the_coarse_mode_has_elements_of_two_sweeps_and_sections_as_long_as_before() {
        let coarse = SemiRigidOptions::default().coarse(0.1);
        assert!((coarse.element - 0.2).abs() < 1e-12 && coarse.check().is_ok());
        let seconds = coarse.interval as f64 * coarse.element;
        assert!((seconds - 2.5).abs() < 0.25 && coarse.half_width == 7 && coarse.time_window == 8);
    }
}
