use super::*;
use crate::testing::{golden_initial, golden_scan, grid_g, room_limits, room1, room2};
use portolan_geometry::{Point3f, Vector2f};
use portolan_grids::{
    MapLimits, ProbabilityGrid, Tsdf2d, TsdfInserter, TsdfInserterOptions, value::MAX_CORRESPONDENCE_COST,
};
use portolan_solver::Termination;

fn golden_matcher(occupied_space_weight: f64) -> GradientMatcher2d {
    let options = GradientMatcherOptions2d { occupied_space_weight, ..Default::default() };
    GradientMatcher2d::new(&options).unwrap()
}

fn close(pose: &Rigid2, [x, y, angle]: [f64; 3], tolerance: f64) -> bool {
    (pose.translation - Vector2::new(x, y)).norm() < tolerance && (pose.angle - angle).abs() < tolerance
}

#[test]
fn golden_matches_on_a_probability_grid() {
    let (grid, scan, initial) = (Grid2d::from(grid_g()), golden_scan(), golden_initial());
    let matcher = golden_matcher(1.0);
    let found = matcher.match_scan(initial.translation, &initial, &scan, &grid);
    assert!((found.summary.initial_cost - 0.257132080).abs() < 1e-9, "{found:?}");
    assert!((found.summary.final_cost - 0.256281458).abs() < 1e-7, "{found:?}");
    assert!(close(&found.pose, [1.5300591, 0.656073862, 0.169749216], 1e-5), "{found:?}");
    let start = Rigid2::new(1.48, 0.710000001, 0.198861766);
    let found = matcher.match_scan(initial.translation, &start, &scan, &grid);
    assert!((found.summary.final_cost - 0.257633326).abs() < 1e-6, "{found:?}");
    assert!(close(&found.pose, [1.51657358, 0.674078025, 0.199293635], 1e-4), "{found:?}");
    let eigenvalues = found.information.symmetric_eigenvalues();
    assert!(eigenvalues.min() > 0.0 && found.information == found.information.transpose());
}

#[test]
fn golden_match_on_a_distance_field() {
    let inserter = TsdfInserter::new(&TsdfInserterOptions::default()).unwrap();
    let mut tsdf = Tsdf2d::new(room_limits(), 0.3, 10.0).unwrap();
    for data in [room1(), room1(), room1(), room2()] {
        inserter.insert(&data, &mut tsdf).unwrap();
    }
    let initial = golden_initial();
    let found = golden_matcher(10.0).match_scan(initial.translation, &initial, &golden_scan(), &tsdf.into());
    assert!((found.summary.final_cost - 1.60413752).abs() < 1e-4, "{found:?}");
    assert!(close(&found.pose, [1.50847684, 0.693931192, 0.169641378], 1e-3), "{found:?}");
}

#[test]
fn a_single_cell_attracts_a_single_point() {
    let limits = MapLimits::new(1.0, Vector2::new(10.0, 10.0), 20, 20).unwrap();
    let mut grid = ProbabilityGrid::new(limits);
    grid.set_probability(limits.cell_index(Vector2f::new(-3.5, 2.5)), 0.9);
    let grid = Grid2d::from(grid);
    let options = GradientMatcherOptions2d {
        occupied_space_weight: 1.0,
        translation_weight: 0.1,
        rotation_weight: 1.5,
        solver: SolverOptions { use_nonmonotonic_steps: true, ..Default::default() },
    };
    let matcher = GradientMatcher2d::new(&options).unwrap();
    let cloud = PointCloud::new(vec![Point3f::new(-3.0, 2.0, 0.0)]);
    for (x, y) in [(-0.5, 0.5), (-0.3, 0.5), (-0.45, 0.3), (-0.3, 0.3)] {
        let initial = Rigid2::new(x, y, 0.0);
        let found = matcher.match_scan(initial.translation, &initial, &cloud, &grid);
        assert!(found.summary.final_cost < 1e-2, "{found:?}");
        assert!(close(&found.pose, [-0.5, 0.5, 0.0], 2e-2), "{found:?}");
    }
}

#[test]
fn unknown_space_costs_the_largest_cost() {
    let limits = MapLimits::new(1.0, Vector2::new(1.0, 1.0), 2, 2).unwrap();
    let grid = ProbabilityGrid::new(limits);
    let points = [Point3f::origin()];
    let cost = OccupiedSpace2d::new(&grid, &points, 1.0).evaluate(&Rigid2::identity(), None);
    assert!(((2.0 * cost).sqrt() - f64::from(MAX_CORRESPONDENCE_COST)).abs() < 1e-15);
}

#[test]
fn derivatives_are_those_of_the_cost() {
    let (grid, scan) = (grid_g(), golden_scan());
    let residuals = OccupiedSpace2d::new(&grid, &scan.points, 3.0);
    for pose in [golden_initial(), Rigid2::new(5.5, -2.0, 2.0)] {
        let problem = || PoseProblem {
            scan: ScanResiduals::Probability(OccupiedSpace2d::new(&grid, &scan.points, 3.0)),
            target_translation: Vector2::new(0.1, -0.2),
            target_angle: 0.3,
            translation_weight: 0.7,
            rotation_weight: 1.3,
        };
        let mut normal = NormalEquations::new();
        problem().evaluate(&pose, Some(&mut normal)).unwrap();
        for i in 0..3 {
            let h = 1e-6;
            let step = |s: f64| na::Vector3::from_fn(|k, _| if k == i { s } else { 0.0 });
            let cost = |s: f64| problem().evaluate(&problem().plus(&pose, &step(s)), None).unwrap();
            let numeric = (cost(h) - cost(-h)) / (2.0 * h);
            assert!((numeric - normal.gradient[i]).abs() < 1e-5, "{i} {numeric} {normal:?}");
        }
        assert!(residuals.evaluate(&pose, None) > 0.0);
    }
}

#[test]
fn empty_scans_and_unknown_grids_give_the_initial_pose() {
    let initial = golden_initial();
    let found = golden_matcher(1.0).match_scan(
        initial.translation,
        &initial,
        &PointCloud::default(),
        &Grid2d::from(grid_g()),
    );
    assert!(found.pose == initial && found.information == na::Matrix3::zeros());
    let tsdf = Tsdf2d::new(room_limits(), 0.3, 10.0).unwrap();
    let found = golden_matcher(1.0).match_scan(initial.translation, &initial, &golden_scan(), &tsdf.into());
    assert_eq!((found.pose, found.summary.termination), (initial, Termination::EvaluationFailed));
    let options = GradientMatcherOptions2d { rotation_weight: 0.0, ..Default::default() };
    assert!(GradientMatcher2d::new(&options).is_err());
}
