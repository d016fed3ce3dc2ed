//! Classic test problems of Moré, Garbow and Hillstrom (1981), and edge cases of real use.

use nalgebra::{SMatrix, SVector, Vector1, Vector2, Vector4};

use super::*;

/// A problem given by residuals and Jacobian at Euclidean parameters.
struct Residuals<F>(F);

impl<F, const N: usize, const M: usize> DenseProblem<N> for Residuals<F>
where
    F: Fn(&SVector<f64, N>) -> Option<(SVector<f64, M>, SMatrix<f64, M, N>)>,
{
    type State = SVector<f64, N>;

    fn evaluate(&mut self, x: &Self::State, normal: Option<&mut NormalEquations<N>>) -> Option<f64> {
        let (residuals, jacobian) = (self.0)(x)?;
        if let Some(normal) = normal {
            for (i, r) in residuals.iter().enumerate() {
                normal.add(*r, &jacobian.row(i).transpose());
            }
        }
        Some(0.5 * residuals.norm_squared())
    }

    fn plus(&self, x: &Self::State, delta: &SVector<f64, N>) -> Self::State {
        x + delta
    }

    fn norm(&self, x: &Self::State) -> f64 {
        x.norm()
    }
}

fn rosenbrock(x: &Vector2<f64>) -> Option<(Vector2<f64>, SMatrix<f64, 2, 2>)> {
    let r = Vector2::new(10.0 * (x.y - x.x * x.x), 1.0 - x.x);
    Some((r, SMatrix::<f64, 2, 2>::new(-20.0 * x.x, 10.0, -1.0, 0.0)))
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
        let options = SolverOptions { use_nonmonotonic_steps, ..tight() };
        let (x, summary) = solve_dense(&mut Residuals(rosenbrock), Vector2::new(-1.2, 1.0), &options);
        assert!((x - Vector2::new(1.0, 1.0)).norm() < 1e-8, "{x} {summary:?}");
        assert!(summary.termination.is_convergence() && summary.final_cost < 1e-16);
        assert!((summary.initial_cost - 12.1).abs() < 1e-12);
    }
}

#[test]
fn powells_singular_function_converges_to_a_singular_jacobian() {
    let powell = |x: &Vector4<f64>| {
        let [a, b, c, d] = [x[0], x[1], x[2], x[3]];
        let (s5, s10) = (5f64.sqrt(), 10f64.sqrt());
        let r = Vector4::new(a + 10.0 * b, s5 * (c - d), (b - 2.0 * c).powi(2), s10 * (a - d).powi(2));
        let (e, f) = (2.0 * (b - 2.0 * c), 2.0 * s10 * (a - d));
        #[rustfmt::skip]
        let jacobian = SMatrix::<f64, 4, 4>::new(
            1.0, 10.0, 0.0, 0.0,
            0.0, 0.0, s5, -s5,
            0.0, e, -2.0 * e, 0.0,
            f, 0.0, 0.0, -f,
        );
        Some((r, jacobian))
    };
    let (x, summary) =
        solve_dense(&mut Residuals(powell), Vector4::new(3.0, -1.0, 0.0, 1.0), &SolverOptions::default());
    assert!(x.norm() < 1e-2 && summary.final_cost < 1e-9, "{x} {summary:?}");
}

#[test]
fn a_linear_problem_needs_a_few_steps_and_a_flat_one_none() {
    let line = |x: &Vector1<f64>| Some((Vector1::new(3.0 * x[0] - 6.0), Vector1::new(3.0)));
    let (x, summary) = solve_dense(&mut Residuals(line), Vector1::new(100.0), &SolverOptions::default());
    assert!((x[0] - 2.0).abs() < 1e-6 && summary.iterations <= 5, "{summary:?}");
    let flat = |_: &Vector1<f64>| Some((Vector1::new(1.0), Vector1::new(0.0)));
    let (x, summary) = solve_dense(&mut Residuals(flat), Vector1::new(7.0), &SolverOptions::default());
    assert_eq!((x[0], summary.iterations), (7.0, 0));
    assert_eq!(summary.termination, Termination::GradientTolerance);
}

#[test]
fn unobservable_parameters_do_not_change() {
    let valley =
        |x: &Vector2<f64>| Some((Vector1::new(x.x + x.y - 2.0), SMatrix::<f64, 1, 2>::new(1.0, 1.0)));
    let (x, _) = solve_dense(&mut Residuals(valley), Vector2::new(5.0, 3.0), &tight());
    assert!((x.x + x.y - 2.0).abs() < 1e-9 && (x.x - x.y - 2.0).abs() < 1e-6, "{x}");
}

#[test]
fn a_failed_evaluation_keeps_the_initial_value() {
    let nowhere = |_: &Vector1<f64>| None::<(Vector1<f64>, Vector1<f64>)>;
    let (x, summary) = solve_dense(&mut Residuals(nowhere), Vector1::new(1.5), &SolverOptions::default());
    assert_eq!((x[0], summary.termination), (1.5, Termination::EvaluationFailed));
    let nan = |_: &Vector1<f64>| Some((Vector1::new(1.0), Vector1::new(f64::NAN)));
    let (x, summary) = solve_dense(&mut Residuals(nan), Vector1::new(1.5), &SolverOptions::default());
    assert_eq!((x[0], summary.termination), (1.5, Termination::EvaluationFailed));
    // Only the start can be evaluated: every step is rejected until the trust region has vanished.
    let island = |x: &Vector1<f64>| (x[0] == 1.5).then(|| (Vector1::new(1.0), Vector1::new(1.0)));
    let options = SolverOptions { max_num_iterations: 1000, ..Default::default() };
    let (x, summary) = solve_dense(&mut Residuals(island), Vector1::new(1.5), &options);
    assert_eq!(x[0], 1.5);
    assert!(summary.successful_steps == 0 && summary.final_cost == 0.5, "{summary:?}");
}

#[test]
fn nonmonotonic_steps_never_return_worse_than_monotonic_start() {
    // A winding valley: the cost rises temporarily.
    let wiggly = |x: &Vector2<f64>| {
        let r = Vector2::new(x.x - 3.0 + (3.0 * x.x).sin(), 5.0 * (x.y - x.x.sin()));
        let j = SMatrix::<f64, 2, 2>::new(1.0 + 3.0 * (3.0 * x.x).cos(), 0.0, -5.0 * x.x.cos(), 5.0);
        Some((r, j))
    };
    for start in [-4.0, -1.0, 0.5, 7.0, 11.0] {
        let options = SolverOptions { use_nonmonotonic_steps: true, ..tight() };
        let (x, summary) = solve_dense(&mut Residuals(wiggly), Vector2::new(start, 0.0), &options);
        let cost = 0.5 * wiggly(&x).unwrap().0.norm_squared();
        assert!(summary.final_cost <= summary.initial_cost && (cost - summary.final_cost).abs() < 1e-12);
    }
}

#[test]
fn persistently_indefinite_normal_equations_end_the_solution() {
    struct Indefinite;
    impl DenseProblem<1> for Indefinite {
        type State = f64;
        fn evaluate(&mut self, x: &f64, normal: Option<&mut NormalEquations<1>>) -> Option<f64> {
            if let Some(normal) = normal {
                normal.hessian[(0, 0)] = -1.0;
                normal.gradient[0] = *x;
            }
            Some(1.0)
        }
        fn plus(&self, x: &f64, delta: &Vector1<f64>) -> f64 {
            x + delta[0]
        }
    }
    let (x, summary) = solve_dense(&mut Indefinite, 3.0, &SolverOptions::default());
    assert_eq!((x, summary.termination, summary.iterations), (3.0, Termination::InvalidSteps, 5));
}
