//! Behaviour of the sparse solver: classic functions, robust losses, constants, degenerate problems,
//! cancelling, covariance, any number of threads.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::ops::ControlFlow;

use nalgebra as na;
use portolan_geometry::{Rigid2, Rigid3, Vector3, quaternion_from_angle_axis};
use portolan_solver::factors::{EuclideanPrior, Se2Between, Se2Prior, Se3Between, Se3Prior};
use portolan_solver::{
    Factor, Loss, Manifold, Problem, ProblemError, RotationFreedom, SolverOptions, Termination,
    TranslationFreedom, VariableId,
};

/// Two residuals of one or two scalar variables, given by a function and its derivatives.
struct Scalars<const N: usize> {
    variables: [VariableId; N],
    f: Function<N>,
}

type Function<const N: usize> = fn([f64; N]) -> ([f64; 2], [[f64; 2]; N]);

impl<const N: usize> Factor for Scalars<N> {
    fn variables(&self) -> &[VariableId] {
        &self.variables
    }

    fn residual_dimension(&self) -> usize {
        2
    }

    fn evaluate(
        &self,
        parameters: &[&[f64]],
        residual: &mut [f64],
        jacobians: Option<&mut [&mut [f64]]>,
    ) -> bool {
        let x = std::array::from_fn(|i| parameters[i][0]);
        let (r, j) = (self.f)(x);
        residual.copy_from_slice(&r);
        for (jacobian, j) in jacobians.into_iter().flatten().zip(j) {
            jacobian.copy_from_slice(&j);
        }
        true
    }
}

fn tight() -> SolverOptions {
    SolverOptions {
        max_num_iterations: 200,
        function_tolerance: 1e-16,
        parameter_tolerance: 1e-14,
        ..Default::default()
    }
}

#[test]
fn rosenbrock_converges_to_its_minimum() {
    for use_nonmonotonic_steps in [false, true] {
        let mut problem = Problem::new();
        let variables = [problem.add_scalar(-1.2), problem.add_scalar(1.0)];
        let f = |[x, y]: [f64; 2]| ([10.0 * (y - x * x), 1.0 - x], [[-20.0 * x, -1.0], [10.0, 0.0]]);
        problem.add_factor(Scalars { variables, f }, Loss::None).unwrap();
        let summary = problem.solve(&SolverOptions { use_nonmonotonic_steps, ..tight() }).unwrap();
        assert!(summary.termination.is_convergence() && summary.final_cost < 1e-16, "{summary:?}");
        assert!(variables.iter().all(|v| (problem.scalar(*v) - 1.0).abs() < 1e-8));
    }
}

#[test]
fn powells_singular_function_converges() {
    let mut problem = Problem::new();
    let [a, b, c, d] = [3.0, -1.0, 0.0, 1.0].map(|x| problem.add_scalar(x));
    let s5 = |[x, y]: [f64; 2]| ([5f64.sqrt() * (x - y), 0.0], [[5f64.sqrt(), 0.0], [-(5f64.sqrt()), 0.0]]);
    let sum = |[x, y]: [f64; 2]| ([x + 10.0 * y, 0.0], [[1.0, 0.0], [10.0, 0.0]]);
    let square = |[x, y]: [f64; 2]| {
        let (e, r) = (x - 2.0 * y, 2.0 * (x - 2.0 * y));
        ([e * e, 0.0], [[r, 0.0], [-2.0 * r, 0.0]])
    };
    let last = |[x, y]: [f64; 2]| {
        let s10 = 10f64.sqrt();
        ([s10 * (x - y).powi(2), 0.0], [[2.0 * s10 * (x - y), 0.0], [-2.0 * s10 * (x - y), 0.0]])
    };
    problem.add_factor(Scalars { variables: [a, b], f: sum }, Loss::None).unwrap();
    problem.add_factor(Scalars { variables: [c, d], f: s5 }, Loss::None).unwrap();
    problem.add_factor(Scalars { variables: [b, c], f: square }, Loss::None).unwrap();
    problem.add_factor(Scalars { variables: [a, d], f: last }, Loss::None).unwrap();
    let summary = problem.solve(&SolverOptions::default()).unwrap();
    assert!((summary.initial_cost - 107.5).abs() < 1e-9 && summary.final_cost < 1e-9, "{summary:?}");
}

fn prior(variable: VariableId, value: f64, weight: f64) -> EuclideanPrior {
    EuclideanPrior { variable, target: na::Vector4::new(value, 0.0, 0.0, 0.0), dimension: 1, weight }
}

#[test]
fn robust_losses_ignore_outliers() {
    let losses = [
        (Loss::Huber(0.1), 0.1),
        (Loss::Cauchy(0.1), 1e-2),
        (Loss::Tukey(1.0), 1e-6),
        (Loss::GemanMcClure(0.3), 1e-2),
        (Loss::Truncated(1.0), 1e-9),
    ];
    for (loss, tolerance) in losses {
        let mut problem = Problem::new();
        let x = problem.add_scalar(0.4);
        for value in [-0.01, 0.0, 0.01, 0.02, -0.02, 50.0, 70.0] {
            problem.add_factor(prior(x, value, 1.0), loss).unwrap();
        }
        problem.solve(&tight()).unwrap();
        assert!(problem.scalar(x).abs() < tolerance, "{loss:?}: {}", problem.scalar(x));
    }
    // Tolerant: within its width nothing pulls.
    let mut problem = Problem::new();
    let x = problem.add_scalar(0.0);
    problem.add_factor(prior(x, 0.0, 1e-3), Loss::None).unwrap();
    problem.add_factor(prior(x, 3.0, 1.0), Loss::Tolerant(100.0, 1.0)).unwrap();
    problem.solve(&tight()).unwrap();
    assert!(problem.scalar(x).abs() < 1e-6);
}

/// A spiral of poses in 3D with chords; wrong initial values.
fn spiral(n: usize) -> (Problem, Vec<VariableId>) {
    let mut problem = Problem::new();
    let truth = |i: usize| {
        let a = 0.1 * i as f64;
        let turn = quaternion_from_angle_axis(&Vector3::new(0.1 * a.sin(), 0.0, a));
        Rigid3::from_parts(Vector3::new(a.cos() * (5.0 + a), a.sin() * (5.0 + a), 0.01 * a).into(), turn)
    };
    let wrong = |i: usize| {
        let k = i as f64;
        let turn =
            quaternion_from_angle_axis(&Vector3::new(0.02 * k.sin(), 0.03 * (2.0 * k).cos(), 0.05 * k.cos()));
        truth(i) * Rigid3::from_parts(Vector3::new(0.3 * k.sin(), 0.2 * k.cos(), 0.1).into(), turn)
    };
    let ids: Vec<VariableId> = (0..n).map(|i| problem.add_se3(&wrong(i))).collect();
    problem.set_values(ids[0], problem.values(ids[1]).to_vec().as_slice()).unwrap();
    problem.set_constant(ids[0]);
    for i in 0..n {
        for step in [1, 2, 7, 63] {
            if i + step < n {
                let noise = Rigid3::translation(0.01 * (i as f64).sin(), 0.01 * (step as f64).cos(), 0.0);
                let factor = Se3Between {
                    variables: [ids[i], ids[i + step]],
                    measurement: truth(i).inverse() * truth(i + step) * noise,
                    translation_weight: 10.0,
                    rotation_weight: 20.0,
                };
                problem.add_factor(factor, if step == 63 { Loss::Huber(1.0) } else { Loss::None }).unwrap();
            }
        }
    }
    (problem, ids)
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let solve = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (mut problem, ids) = spiral(700);
        let summary = pool.install(|| problem.solve(&SolverOptions::default()).unwrap());
        assert!(summary.final_cost < 1e-3 * summary.initial_cost, "{summary:?}");
        let bits: Vec<u64> = ids.iter().flat_map(|id| problem.values(*id)).map(|v| v.to_bits()).collect();
        (bits, summary.final_cost.to_bits(), summary.iterations)
    };
    let one = solve(1);
    assert!(one == solve(2) && one == solve(4) && one == solve(1));
}

#[test]
fn constant_variables_and_restrictions_are_kept() {
    let mut problem = Problem::new();
    let start = Rigid3::from_parts(
        Vector3::new(1.0, 2.0, 3.0).into(),
        quaternion_from_angle_axis(&Vector3::new(0.1, 0.2, 0.3)),
    );
    let target = Rigid3::from_parts(
        Vector3::new(-1.0, 0.0, 9.0).into(),
        quaternion_from_angle_axis(&Vector3::new(-0.4, 0.3, 1.0)),
    );
    let free = problem.add_se3(&start);
    let held = problem.add_se3(&start);
    let flat = problem.add_se3_with(&start, TranslationFreedom::ConstantZ, RotationFreedom::YawOnly);
    let levelling = problem.add_se3_with(&start, TranslationFreedom::Constant, RotationFreedom::ConstantYaw);
    problem.set_constant(held);
    for variable in [free, held, flat, levelling] {
        let factor = Se3Prior { variable, pose: target, translation_weight: 1.0, rotation_weight: 1.0 };
        problem.add_factor(factor, Loss::None).unwrap();
    }
    assert_eq!(problem.degrees_of_freedom(), 6 + 3 + 2);
    let before = problem.cost().unwrap();
    let summary = problem.solve(&tight()).unwrap();
    assert!((summary.initial_cost - before).abs() < 1e-12 && problem.cost().unwrap() < before);
    assert!((problem.se3(free).to_homogeneous() - target.to_homogeneous()).norm() < 1e-7);
    assert_eq!(problem.se3(held), start);
    let flat = problem.se3(flat);
    assert!((flat.translation.vector - Vector3::new(-1.0, 0.0, 3.0)).norm() < 1e-7);
    let turned = flat.rotation * start.rotation.inverse();
    assert!(turned.i.abs() < 1e-12 && turned.j.abs() < 1e-12 && turned.k.abs() > 0.1);
    let levelled = problem.se3(levelling);
    assert_eq!(levelled.translation, start.translation);
    assert!(levelled.rotation.angle_to(&target.rotation) < start.rotation.angle_to(&target.rotation));
    // Held again at the optimum, nothing is left to do.
    for id in [free, levelling] {
        problem.set_constant(id);
    }
    problem.set_free(held);
    assert_eq!(problem.degrees_of_freedom(), 3 + 6);
}

#[test]
fn a_factor_without_residuals_does_nothing() {
    struct NoResiduals([VariableId; 2]);
    impl Factor for NoResiduals {
        fn variables(&self) -> &[VariableId] {
            &self.0
        }
        fn residual_dimension(&self) -> usize {
            0
        }
        fn evaluate(&self, _: &[&[f64]], _: &mut [f64], _: Option<&mut [&mut [f64]]>) -> bool {
            true
        }
    }
    let mut problem = Problem::new();
    let ids = [problem.add_scalar(1.0), problem.add_scalar(2.0)];
    problem.add_factor(prior(ids[0], 5.0, 1.0), Loss::None).unwrap();
    problem.add_factor(prior(ids[1], 6.0, 1.0), Loss::None).unwrap();
    problem.add_factor(NoResiduals(ids), Loss::Huber(1.0)).unwrap();
    let summary = problem.solve(&tight()).unwrap();
    assert!(summary.final_cost < 1e-12 && (problem.scalar(ids[1]) - 6.0).abs() < 1e-6);
}

#[test]
fn gravity_remains_positive() {
    let mut problem = Problem::new();
    let g = problem.add_nonnegative(9.8);
    problem.add_factor(prior(g, -3.0, 1.0), Loss::None).unwrap();
    problem.solve(&SolverOptions::default()).unwrap();
    assert_eq!(problem.scalar(g), 0.0);
}

fn chain(problem: &mut Problem, n: usize) -> Vec<VariableId> {
    let ids: Vec<VariableId> = (0..n).map(|i| problem.add_se2(&Rigid2::new(i as f64, 0.1, 0.2))).collect();
    for pair in ids.windows(2) {
        let factor = Se2Between {
            variables: [pair[0], pair[1]],
            measurement: Rigid2::new(1.0, 0.0, 0.0),
            translation_weight: 1.0,
            rotation_weight: 1.0,
        };
        problem.add_factor(factor, Loss::None).unwrap();
    }
    ids
}

#[test]
fn underdetermined_problems_are_solved() {
    // No anchor at all: the whole may float.
    let mut problem = Problem::new();
    let ids = chain(&mut problem, 5);
    let isolated = problem.add_se2(&Rigid2::new(7.0, 7.0, 7.0));
    let summary = problem.solve(&tight()).unwrap();
    assert!(summary.final_cost < 1e-12, "{summary:?}");
    assert_eq!(problem.se2(isolated), Rigid2::new(7.0, 7.0, 7.0));
    assert_eq!(problem.covariance(&ids[..1]), Err(ProblemError::Singular));
    // Nothing to do.
    let mut empty = Problem::new();
    assert_eq!(empty.solve(&tight()).unwrap().iterations, 0);
    ids.iter().chain([&isolated]).for_each(|id| problem.set_constant(*id));
    let summary = problem.solve(&tight()).unwrap();
    assert!(summary.iterations == 0 && summary.final_cost < 1e-12);
    assert!(problem.covariance(&ids).unwrap().matrix().is_empty());
}

#[test]
fn covariance_is_the_inverse_of_the_information() {
    let mut problem = Problem::new();
    let ids = chain(&mut problem, 3);
    let factor = Se2Prior {
        variable: ids[0],
        pose: Rigid2::identity(),
        translation_weight: 2.0,
        rotation_weight: 10.0,
    };
    problem.add_factor(factor, Loss::None).unwrap();
    problem.solve(&tight()).unwrap();
    let covariance = problem.covariance(&[ids[2], ids[0]]).unwrap();
    let first = covariance.block(1, 1).unwrap();
    assert!(
        (first - na::DMatrix::from_diagonal(&na::DVector::from_vec(vec![0.25, 0.25, 0.01]))).norm() < 1e-9
    );
    let last = covariance.block(0, 0).unwrap();
    // Along the chain variances add up: x is exact, y gets the angles with their levers 2 and 1.
    assert!((last[(0, 0)] - 2.25).abs() < 1e-9 && (last[(2, 2)] - 2.01).abs() < 1e-9);
    assert!((last[(1, 1)] - (0.25 + 2.0 + 4.0 * 0.01 + 1.0)).abs() < 1e-9);
    assert!((covariance.block(0, 1).unwrap().transpose() - covariance.block(1, 0).unwrap()).norm() < 1e-12);
    assert!(covariance.block(2, 0).is_none());
}

#[test]
fn an_observer_can_stop_and_the_best_is_kept() {
    let (mut problem, _) = spiral(80);
    let mut seen = Vec::new();
    let summary = problem
        .solve_observed(&tight(), &mut |progress| {
            seen.push(progress.cost);
            if progress.iteration >= 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })
        .unwrap();
    assert_eq!((summary.termination, summary.iterations), (Termination::Cancelled, 2));
    assert!(seen.len() == 3 && (problem.cost().unwrap() / summary.final_cost - 1.0).abs() < 1e-9);
}

#[test]
fn wrong_use_is_an_error() {
    let mut problem = Problem::new();
    let x = problem.add_scalar(1.0);
    let other = {
        let mut other = Problem::new();
        let ids: [VariableId; 5] = std::array::from_fn(|_| other.add_scalar(0.0));
        ids[4]
    };
    let unknown = problem.add_factor(prior(other, 0.0, 1.0), Loss::None);
    assert!(matches!(unknown, Err(ProblemError::UnknownVariable { variable: 4, count: 1 })));
    let f = |_: [f64; 2]| ([0.0; 2], [[0.0; 2]; 2]);
    let repeated = problem.add_factor(Scalars { variables: [x, x], f }, Loss::None);
    assert!(matches!(repeated, Err(ProblemError::RepeatedVariable(0))));
    let none = |_: [f64; 0]| ([0.0; 2], []);
    let empty = problem.add_factor(Scalars { variables: [], f: none }, Loss::None);
    assert!(matches!(empty, Err(ProblemError::VariableCount(0))));
    assert_eq!(problem.add_factor(prior(x, 0.0, 1.0), Loss::Huber(-1.0)), Err(ProblemError::InvalidLoss));
    let short = problem.add_variable(Manifold::SE3, &[0.0; 6]);
    assert_eq!(short, Err(ProblemError::AmbientDimension { expected: 7, given: 6 }));
    assert!(problem.set_values(x, &[1.0, 2.0]).is_err() && problem.set_values(other, &[1.0]).is_err());
    // A factor for three numbers on a variable of one cannot be evaluated, nor can NaN.
    let id = problem
        .add_factor(
            EuclideanPrior { variable: x, target: na::Vector4::zeros(), dimension: 3, weight: 1.0 },
            Loss::None,
        )
        .unwrap();
    assert_eq!(problem.solve(&tight()), Err(ProblemError::NotEvaluable));
    assert_eq!(problem.first_bad_factor(), Some(id));
    let mut problem = Problem::new();
    let x = problem.add_scalar(f64::NAN);
    problem.add_factor(prior(x, 0.0, 1.0), Loss::None).unwrap();
    assert_eq!(problem.solve(&tight()), Err(ProblemError::NotEvaluable));
}
