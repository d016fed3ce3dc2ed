use portolan_geometry::{Point3f, quaternion_from_angle_axis, rotation_from_roll_pitch_yaw};

use super::*;
use crate::testing::{drawn_cloud_b, golden_initial_3d, golden_scan_3d};

fn options(rotation_weight: f64) -> GradientMatcherOptions3d {
    GradientMatcherOptions3d { rotation_weight, ..Default::default() }
}

#[test]
fn the_golden_scan_is_matched() {
    let (high, low, scan) = (drawn_cloud_b(0.1, 5), drawn_cloud_b(0.45, 5), golden_scan_3d());
    let clouds = [&high, &low].map(|grid| CloudInGrid { cloud: &scan, grid, intensities: None });
    let initial = golden_initial_3d();
    let matcher = GradientMatcher3d::new(&options(4e2), 2).unwrap();
    let found = matcher.match_scan(initial.translation.vector, &initial, &clouds);
    assert!((found.summary.initial_cost / 5.231_671_13 - 1.0).abs() < 1e-6, "{:?}", found.summary);
    assert!((found.summary.final_cost / 4.268_846_9 - 1.0).abs() < 1e-3, "{:?}", found.summary);
    let golden = Vector3::new(0.437241781, -0.266287907, 0.126490772);
    assert!((found.pose.translation.vector - golden).norm() < 2e-3, "{}", found.pose);
    let golden = na::Quaternion::new(0.998963175, 0.00251011536, -0.0017184452, 0.0454237994);
    assert!(found.pose.rotation.angle_to(&Quaternion::new_normalize(golden)) < 2e-3, "{}", found.pose);
}

/// A problem with every kind of residual, at a pose where none is at its minimum.
fn with_problem<R>(check: impl FnOnce(PoseProblem<'_>, Rigid3) -> R) -> R {
    let (high, low, mut scan) = (drawn_cloud_b(0.1, 2), drawn_cloud_b(0.45, 2), golden_scan_3d());
    let mut bright = IntensityGrid::new(0.45).unwrap();
    for (i, point) in scan.points.iter().enumerate() {
        scan.intensities.push((i % 50) as f32);
        bright.add_intensity(bright.cell_index(point).unwrap(), (i % 40) as f32);
    }
    let clouds = [
        CloudInGrid { cloud: &scan, grid: &high, intensities: Some(&bright) },
        CloudInGrid { cloud: &scan, grid: &low, intensities: None },
    ];
    let intensity = IntensityCostOptions { weight: 0.5, huber_scale: 0.3, intensity_threshold: 40.0 };
    let options = GradientMatcherOptions3d { intensity_costs: vec![intensity], ..options(4.0) };
    let target = rotation_from_roll_pitch_yaw(0.3, -0.2, 0.5);
    let problem = PoseProblem::new(&options, Vector3::new(1.0, 2.0, 3.0), target, &clouds);
    let pose = Rigid3::from_parts([0.43, -0.28, 0.12].into(), rotation_from_roll_pitch_yaw(0.1, 0.05, 0.2));
    check(problem, pose)
}

fn assert_gradient<const N: usize>(problem: &mut PoseProblem<'_>, pose: &Rigid3)
where
    for<'a> PoseProblem<'a>: DenseProblem<N, State = Rigid3>,
{
    let mut normal = NormalEquations::<N>::new();
    let cost = DenseProblem::<N>::evaluate(problem, pose, Some(&mut normal)).unwrap();
    assert!(cost > 0.0 && DenseProblem::<N>::norm(problem, pose) > 1.0);
    for i in 0..N {
        let h = 1e-6;
        let mut cost_at = |step: f64| {
            let mut delta = na::SVector::<f64, N>::zeros();
            delta[i] = step;
            let moved = DenseProblem::<N>::plus(problem, pose, &delta);
            DenseProblem::<N>::evaluate(problem, &moved, None).unwrap()
        };
        let numeric = (cost_at(h) - cost_at(-h)) / (2.0 * h);
        let scale = 1.0 + normal.gradient.amax();
        assert!((normal.gradient[i] - numeric).abs() < 1e-6 * scale, "{i}: {numeric} {}", normal.gradient);
    }
}

#[test]
fn gradients_are_derivatives_of_the_cost() {
    with_problem(|mut problem, pose| {
        assert_gradient::<6>(&mut problem, &pose);
        assert_gradient::<4>(&mut problem, &pose);
    });
}

#[test]
fn rotation_residuals_grow_with_half_the_angle() {
    let clouds = [];
    for (target, turn) in [
        (Quaternion::identity(), Vector3::new(0.3, 0.0, 0.0)),
        (rotation_from_roll_pitch_yaw(0.5, 1.0, -2.0), Vector3::new(0.1, -0.2, 0.7)),
    ] {
        let problem = PoseProblem::new(&options(7.0), Vector3::zeros(), target, &clouds);
        let turn = quaternion_from_angle_axis(&turn);
        for rotation in [target * turn, turn * target] {
            let pose = Rigid3::from_parts(Default::default(), rotation);
            let cost = problem.cost(&pose, &mut NormalEquations::<6>::new());
            let expected = 0.5 * (7.0 * (turn.angle() / 2.0).sin()).powi(2);
            assert!((cost - expected).abs() < 1e-8);
        }
    }
}

/// Seven points on a grid of one-metre cells, three metres off.
fn seven_points() -> (PointCloud, HybridGrid, IntensityGrid) {
    let places = [
        (-3.0, 2.0, 0.0),
        (-4.0, 2.0, 0.0),
        (-5.0, 2.0, 0.0),
        (-6.0, 2.0, 0.0),
        (-6.0, 3.0, 1.0),
        (-6.0, 4.0, 2.0),
        (-7.0, 3.0, 1.0),
    ];
    let (mut grid, mut bright) = (HybridGrid::new(1.0).unwrap(), IntensityGrid::new(1.0).unwrap());
    let mut cloud = PointCloud::default();
    for (x, y, z) in places {
        let cell = grid.cell_index(&Point3f::new(x, y, z)).unwrap();
        grid.set_probability(cell, 1.0);
        bright.add_intensity(cell, 50.0);
        cloud.points.push(Point3f::new(x + 1.0, y, z));
        cloud.intensities.push(50.0);
    }
    (cloud, grid, bright)
}

#[test]
fn small_errors_are_corrected() {
    let (cloud, grid, bright) = seven_points();
    let expected = Rigid3::translation(-1.0, 0.0, 0.0);
    let options = GradientMatcherOptions3d {
        occupied_space_weights: vec![1.0],
        intensity_costs: vec![IntensityCostOptions {
            weight: 0.5,
            huber_scale: 55.0,
            intensity_threshold: 100.0,
        }],
        translation_weight: 0.01,
        rotation_weight: 0.1,
        only_optimize_yaw: false,
        solver: SolverOptions { max_num_iterations: 10, ..Default::default() },
    };
    let matcher = GradientMatcher3d::new(&options, 1).unwrap();
    let mut starts: Vec<Rigid3> = [(-1.0, 0.0, 0.0), (-0.8, 0.0, 0.0), (-1.0, 0.0, -0.2), (-0.9, -0.2, 0.2)]
        .map(|(x, y, z)| Rigid3::translation(x, y, z))
        .to_vec();
    starts.push(Rigid3::from_parts(
        [-1.0, 0.0, 0.0].into(),
        quaternion_from_angle_axis(&Vector3::new(0.05, 0.0, 0.0)),
    ));
    for start in starts {
        let clouds = [CloudInGrid { cloud: &cloud, grid: &grid, intensities: Some(&bright) }];
        let found = matcher.match_scan(start.translation.vector, &start, &clouds);
        assert!(found.summary.final_cost < 1e-2, "{start}: {:?}", found.summary);
        let error = found.pose.inverse() * expected;
        assert!(error.translation.vector.norm() < 3e-2 && error.rotation.angle() < 3e-2, "{start}");
        assert!(found.information.symmetric_eigenvalues().min() > -1e-9);
    }
}

#[test]
fn yaw_alone_leaves_roll_and_pitch() {
    let (grid, scan) = (drawn_cloud_b(0.1, 5), golden_scan_3d());
    let tilt = rotation_from_roll_pitch_yaw(0.02, -0.03, 0.06);
    let initial = Rigid3::from_parts([0.43, -0.27, 0.1].into(), tilt);
    let options = GradientMatcherOptions3d {
        occupied_space_weights: vec![1.0],
        only_optimize_yaw: true,
        ..options(0.1)
    };
    let matcher = GradientMatcher3d::new(&options, 1).unwrap();
    let clouds = [CloudInGrid { cloud: &scan, grid: &grid, intensities: None }];
    let found = matcher.match_scan(initial.translation.vector, &initial, &clouds);
    let turn = found.pose.rotation * tilt.inverse();
    assert!(turn.imag().xy().norm() < 1e-12 && turn.imag().z.abs() > 1e-3, "{turn}");
    assert!(found.summary.final_cost < found.summary.initial_cost);
}

#[test]
fn impossible_options_and_points_do_no_harm() {
    assert!(GradientMatcher3d::new(&options(0.0), 2).is_err());
    assert!(matches!(GradientMatcher3d::new(&options(1.0), 1), Err(MatcherOptionError::Count { .. })));
    let (mut cloud, grid, _) = seven_points();
    let matcher = GradientMatcher3d::new(
        &GradientMatcherOptions3d { occupied_space_weights: vec![1.0], ..options(1.0) },
        1,
    )
    .unwrap();
    cloud.points.push(Point3f::new(1e30, f32::INFINITY, f32::NAN));
    cloud.points.push(Point3f::new(0.0, -1e30, 0.0));
    let start = Rigid3::translation(-0.9, 0.0, 0.0);
    let clouds = [CloudInGrid { cloud: &cloud, grid: &grid, intensities: None }];
    let found = matcher.match_scan(start.translation.vector, &start, &clouds);
    assert!(found.summary.termination.is_usable());
    assert!((found.pose.translation.vector - Vector3::new(-1.0, 0.0, 0.0)).norm() < 0.1, "{}", found.pose);
    let empty = PointCloud::default();
    let clouds = [CloudInGrid { cloud: &empty, grid: &grid, intensities: None }];
    assert_eq!(matcher.match_scan(start.translation.vector, &start, &clouds).pose, start);
}
