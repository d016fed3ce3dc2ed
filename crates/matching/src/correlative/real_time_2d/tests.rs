use super::*;
use crate::testing::{Lcg, golden_initial, golden_scan, grid_g, random_room, room_limits, room1, room2};
use portolan_geometry::{Vector2, Vector2f};
use portolan_grids::{
    NormalEstimationOptions, ProbabilityGrid, ProbabilityInserter, ProbabilityInserterOptions, Tsdf2d,
    TsdfInserter, TsdfInserterOptions,
};
use portolan_sensor::RangeData;

fn golden_options() -> RealTimeCorrelativeOptions {
    RealTimeCorrelativeOptions { angular_search_window: 0.1, ..Default::default() }
}

fn golden_tsdf() -> Grid2d {
    let inserter = TsdfInserter::new(&TsdfInserterOptions::default()).unwrap();
    let mut tsdf = Tsdf2d::new(room_limits(), 0.3, 10.0).unwrap();
    for data in [room1(), room1(), room1(), room2()] {
        inserter.insert(&data, &mut tsdf).unwrap();
    }
    tsdf.into()
}

/// Scores every placement in order, as defined.
fn exhaustive(
    options: &RealTimeCorrelativeOptions,
    initial: &Rigid2,
    points: &PointCloud,
    grid: &Grid2d,
) -> MatchResult<Rigid2> {
    let window = SearchWindow::new(
        &points.points,
        grid.limits().resolution(),
        options.linear_search_window,
        options.angular_search_window,
    );
    let penalty = Penalty::new(options, 1.0, window);
    let mut scans = RotatedScans::new(&points.points, initial, window, *grid.limits(), [0, 0]);
    let n = window.num_linear;
    let mut best: Option<(f32, Placement)> = None;
    for scan in 0..window.num_scans() {
        let cells = scans.cells_in_given_order(scan).to_vec();
        for x in -n..=n {
            for y in -n..=n {
                let placement = Placement { scan, x, y };
                let at = cells.iter().map(|c| CellIndex::new(c[0] + x, c[1] + y));
                let mean = mean_score(grid, at, cells.len());
                let score = (f64::from(mean) * penalty.factor(&placement)) as f32;
                if best.is_none_or(|b| score > b.0) {
                    best = Some((score, placement));
                }
            }
        }
    }
    let (score, placement) = best.unwrap();
    MatchResult { score, pose: window.pose(initial, &placement) }
}

fn mean_score(grid: &Grid2d, cells: impl Iterator<Item = CellIndex>, count: usize) -> f32 {
    match grid {
        Grid2d::Probability(g) => {
            let mut sum = 0.0;
            cells.for_each(|c| sum += g.probability(c));
            sum / count as f32
        }
        Grid2d::Tsdf(g) => {
            let (mut sum, mut weights) = (0.0, 0.0);
            for c in cells {
                let t = g.truncation_distance();
                sum += (t - g.signed_distance(c).abs()) / t * g.weight(c);
                weights += g.weight(c);
            }
            if weights == 0.0 { 0.0 } else { sum / weights }
        }
    }
}

fn check(found: MatchResult<Rigid2>, score: f32, [x, y, angle]: [f64; 3]) {
    assert!((found.score - score).abs() < 1e-7, "{found:?}");
    assert!((found.pose.translation - Vector2::new(x, y)).norm() < 1e-8, "{found:?}");
    assert!((found.pose.angle - angle).abs() < 1e-8, "{found:?}");
}

#[test]
fn golden_matches() {
    let matcher = RealTimeCorrelativeMatcher2d::new(&golden_options()).unwrap();
    let (initial, scan) = (golden_initial(), golden_scan());
    let found = matcher.match_scan(&initial, &scan, &grid_g().into()).unwrap();
    check(found, 0.39715654, [1.48, 0.710000001, 0.198861766]);
    let found = matcher.match_scan(&initial, &scan, &golden_tsdf()).unwrap();
    check(found, 0.91941196, [1.48, 0.710000001, 0.206077207]);
}

#[test]
fn the_result_is_that_of_trying_everything() {
    let mut lcg = Lcg::new(99);
    for i in 0..12 {
        let (grid, mut scan) = random_room(&mut lcg, i % 2 == 1);
        if i % 3 == 0 {
            // Few points tie often.
            scan.points.truncate(5);
        }
        let options = RealTimeCorrelativeOptions {
            linear_search_window: [0.0, 0.1, 0.3, 0.6][i % 4],
            angular_search_window: [0.5, 0.0, 0.05, 0.2][i / 3],
            translation_delta_cost_weight: [0.1, 10.0, 0.0][i % 3],
            rotation_delta_cost_weight: [0.0, 0.1, 3.0][i % 3],
        };
        let matcher = RealTimeCorrelativeMatcher2d::new(&options).unwrap();
        let mut near = |a: f32| f64::from(lcg.symmetric(a));
        let initial = Rigid2::new(near(0.3), near(0.3), near(0.1));
        let found = matcher.match_scan(&initial, &scan, &grid).unwrap();
        assert_eq!(found, exhaustive(&options, &initial, &scan, &grid), "{i} {options:?}");
    }
}

#[test]
fn unknown_grids_keep_the_initial_pose_if_wanted() {
    let matcher = RealTimeCorrelativeMatcher2d::new(&golden_options()).unwrap();
    for grid in [
        Grid2d::from(ProbabilityGrid::new(room_limits())),
        Grid2d::from(Tsdf2d::new(room_limits(), 0.3, 10.0).unwrap()),
    ] {
        let (initial, mut scan) = (golden_initial(), golden_scan());
        scan.points.truncate(40);
        let found = matcher.match_scan(&initial, &scan, &grid).unwrap();
        assert_eq!(found, exhaustive(&golden_options(), &initial, &scan, &grid));
        // Far away from the grid nothing is known either.
        let far = Rigid2::new(1e7, -1e9, 0.0);
        assert!(matcher.match_scan(&far, &scan, &grid).is_some());
        assert!(matcher.match_scan(&initial, &PointCloud::default(), &grid).is_none());
        assert!(matcher.match_scan(&Rigid2::new(f64::NAN, 0.0, 0.0), &scan, &grid).is_none());
    }
    let bad = RealTimeCorrelativeOptions { rotation_delta_cost_weight: -1.0, ..Default::default() };
    assert!(RealTimeCorrelativeMatcher2d::new(&bad).is_err());
}

fn corner() -> PointCloud {
    let points = [
        (0.025, 0.175),
        (-0.025, 0.175),
        (-0.075, 0.175),
        (-0.125, 0.175),
        (-0.125, 0.125),
        (-0.125, 0.075),
        (-0.125, 0.025),
    ];
    PointCloud::new(points.map(|p| Point3f::new(p.0, p.1, 0.0)).to_vec())
}

#[test]
fn a_perfect_placement_scores_the_hit_probability() {
    let limits = MapLimits::new(0.05, Vector2::new(0.05, 0.25), 6, 6).unwrap();
    let mut grid = ProbabilityGrid::new(limits);
    let options =
        ProbabilityInserterOptions { hit_probability: 0.7, miss_probability: 0.4, ..Default::default() };
    let data = RangeData { returns: corner(), ..Default::default() };
    ProbabilityInserter::new(&options).unwrap().insert(&data, &mut grid).unwrap();
    let score = |y: f32| {
        let cells = corner().points.into_iter().map(move |p| limits.cell_index(Vector2f::new(p.x + y, p.y)));
        mean_score(&grid.clone().into(), cells, 7)
    };
    assert!((score(0.0) - 0.7).abs() < 1e-2);
    assert!(score(0.05) > 0.7 * 3.0 / 7.0 && score(0.05) < 0.7);
    let still = RealTimeCorrelativeOptions { linear_search_window: 0.0, ..golden_options() };
    let matcher = RealTimeCorrelativeMatcher2d::new(&still).unwrap();
    let found = matcher.match_scan(&Rigid2::identity(), &corner(), &grid.clone().into()).unwrap();
    assert_eq!(found.score, score(0.0));
}

#[test]
fn a_perfect_placement_on_a_distance_field_scores_one() {
    let limits = MapLimits::new(0.05, Vector2::new(0.3, 0.5), 20, 20).unwrap();
    let mut tsdf = Tsdf2d::new(limits, 0.3, 1.0).unwrap();
    let options = TsdfInserterOptions {
        maximum_weight: 1.0,
        project_sdf_distance_to_scan_normal: false,
        normal_estimation: NormalEstimationOptions::default(),
        update_weight_angle_scan_normal_to_ray_kernel_bandwidth: 0.0,
        update_weight_distance_cell_to_hit_kernel_bandwidth: 0.0,
        ..Default::default()
    };
    let data = RangeData { origin: Point3f::new(0.5, -0.5, 0.0), returns: corner(), ..Default::default() };
    TsdfInserter::new(&options).unwrap().insert(&data, &mut tsdf).unwrap();
    let grid = Grid2d::from(tsdf);
    let limits = *grid.limits();
    let cells = |x: i32| {
        corner().points.into_iter().map(move |p| {
            let cell = limits.cell_index(p.coords.xy());
            CellIndex::new(cell.x + x, cell.y)
        })
    };
    let (perfect, shifted) = (mean_score(&grid, cells(0), 7), mean_score(&grid, cells(1), 7));
    assert!(perfect > 0.95 && perfect < 1.1, "{perfect}");
    assert!(shifted > 1.0 - 4.0 / 42.0 - 0.1 && shifted < 1.0, "{shifted}");
}

#[test]
fn a_search_around_several_poses_equals_single_searches() {
    let poses: Vec<Rigid2> =
        (-2..=2).map(|i| golden_initial() * Rigid2::new(0.3 * f64::from(i), 0.1, 0.0)).collect();
    let mut strange = golden_scan();
    strange.points.push(Point3f::new(f32::NAN, 0.0, 0.0));
    for (linear, grid) in [(0.15, grid_g().into()), (0.4, grid_g().into()), (0.15, golden_tsdf())] {
        let options = RealTimeCorrelativeOptions { linear_search_window: linear, ..golden_options() };
        let matcher = RealTimeCorrelativeMatcher2d::new(&options).unwrap();
        for points in [golden_scan(), strange.clone(), PointCloud::default()] {
            let each: Vec<_> = poses.iter().map(|pose| matcher.match_scan(pose, &points, &grid)).collect();
            assert_eq!(matcher.match_scan_around(&poses, &points, &grid), each);
        }
        assert!(matcher.match_scan_around(&[], &golden_scan(), &grid).is_empty());
    }
}
