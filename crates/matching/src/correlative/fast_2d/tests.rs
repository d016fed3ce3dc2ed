use super::*;
use crate::correlative::joint_search::Placement;
use crate::testing::{Lcg, golden_scan, grid_g, random_room};
use portolan_geometry::Vector2;
use portolan_grids::{CellIndex, ProbabilityGrid};

/// Branch and bound as defined, over shifts only, with stable sorting.
struct Definition<'a> {
    matcher: &'a FastCorrelativeMatcher2d,
    scans: RotatedScans,
    bounds: Vec<[[i32; 2]; 2]>,
}

impl Definition<'_> {
    fn score(&mut self, p: &Placement, level: u32) -> f32 {
        let byte = |c: &[i32; 2]| self.matcher.pyramid.window_max(c[0] + p.x, c[1] + p.y, level);
        let sum = self.scans.cells(p.scan).iter().map(|c| u32::from(byte(c))).sum();
        self.matcher.score.of(sum, self.scans.num_points())
    }

    fn sorted(&mut self, candidates: Vec<Placement>, level: u32) -> Vec<(f32, Placement)> {
        let mut scored: Vec<_> = candidates.iter().map(|p| (self.score(p, level), *p)).collect();
        scored.sort_by(|a, b| b.0.total_cmp(&a.0));
        scored
    }

    fn branch(
        &mut self,
        candidates: Vec<(f32, Placement)>,
        level: u32,
        min_score: f32,
    ) -> (f32, Option<Placement>) {
        if level == 0 {
            return (candidates[0].0, Some(candidates[0].1));
        }
        let mut best = (min_score, None);
        for (score, p) in candidates {
            if score <= min_score {
                break;
            }
            let half = 1 << (level - 1);
            let [[_, max_x], [_, max_y]] = self.bounds[p.scan as usize];
            let mut children = Vec::new();
            for x in [p.x, p.x + half].into_iter().filter(|x| *x <= max_x) {
                for y in [p.y, p.y + half].into_iter().filter(|y| *y <= max_y) {
                    children.push(Placement { x, y, ..p });
                }
            }
            let children = self.sorted(children, level - 1);
            let found = self.branch(children, level - 1, best.0);
            if found.0 > best.0 {
                best = found;
            }
        }
        best
    }
}

fn by_definition(
    matcher: &FastCorrelativeMatcher2d,
    initial: &Rigid2,
    points: &PointCloud,
    min_score: f32,
    [linear, angular]: [f64; 2],
) -> Option<MatchResult<Rigid2>> {
    let window = SearchWindow::new(&points.points, matcher.limits.resolution(), linear, angular);
    let mut scans = RotatedScans::new(&points.points, initial, window, matcher.limits, [0, 0]);
    let n = window.num_linear;
    let size = [matcher.limits.num_x_cells() as i32, matcher.limits.num_y_cells() as i32];
    let bounds: Vec<[[i32; 2]; 2]> = (0..window.num_scans())
        .map(|k| {
            let cells = scans.cells(k);
            [0, 1].map(|axis| {
                let low = cells.iter().map(|c| -c[axis]).min().unwrap().min(0).max(-n);
                let high = cells.iter().map(|c| size[axis] - 1 - c[axis]).max().unwrap().max(0).min(n);
                [low, high]
            })
        })
        .collect();
    let level = matcher.options.branch_and_bound_depth - 1;
    let mut roots = Vec::new();
    for (scan, [[min_x, max_x], [min_y, max_y]]) in (0..).zip(bounds.clone()) {
        for x in (min_x..=max_x).step_by(1 << level) {
            for y in (min_y..=max_y).step_by(1 << level) {
                roots.push(Placement { scan, x, y });
            }
        }
    }
    let mut definition = Definition { matcher, scans, bounds };
    let roots = definition.sorted(roots, level);
    let (score, placement) = definition.branch(roots, level, min_score);
    (score > min_score).then(|| MatchResult { score, pose: window.pose(initial, &placement.unwrap()) })
}

fn golden_matcher() -> FastCorrelativeMatcher2d {
    let options = FastCorrelativeOptions2d {
        linear_search_window: 2.0,
        angular_search_window: 0.5,
        branch_and_bound_depth: 6,
    };
    FastCorrelativeMatcher2d::new(&grid_g().into(), &options).unwrap()
}

fn check(found: &MatchResult<Rigid2>, score: f32, [x, y, angle]: [f64; 3]) {
    assert!((found.score - score).abs() < 1e-7, "{found:?}");
    assert!((found.pose.translation - Vector2::new(x, y)).norm() < 1e-7, "{found:?}");
    assert!((found.pose.angle - angle).abs() < 1e-7, "{found:?}");
}

#[test]
fn golden_matches() {
    let (matcher, scan) = (golden_matcher(), golden_scan());
    let found = matcher.match_local(&Rigid2::new(0.9, 1.2, 0.05), &scan, 0.2).unwrap();
    check(&found, 0.3763085, [1.50000001, 0.699999993, 0.201524282]);
    let found = matcher.match_full(&scan, 0.2).unwrap();
    check(&found, 0.38227975, [1.40000003, 1.55000002, -1.36371853]);
    assert!(matcher.match_full(&scan, 0.39).is_none() && matcher.match_full(&scan, 0.99).is_none());
}

#[test]
fn the_result_is_that_of_the_definition() {
    let mut lcg = Lcg::new(4);
    for i in 0..10 {
        let (grid, mut scan) = random_room(&mut lcg, i % 5 == 4);
        if i % 2 == 0 {
            // Few points tie often, and the plain search is quick.
            scan.points.truncate(4 + i);
        }
        let options = FastCorrelativeOptions2d {
            linear_search_window: [0.3, 1.0, 2.5][i % 3],
            angular_search_window: [0.1, 0.4][i % 2],
            branch_and_bound_depth: [1, 3, 4, 6][i % 4],
        };
        let matcher = FastCorrelativeMatcher2d::new(&grid, &options).unwrap();
        let mut near = |a: f32| f64::from(lcg.symmetric(a));
        let initial = Rigid2::new(near(1.0), near(1.0), near(0.3));
        let window = [options.linear_search_window, options.angular_search_window];
        for min_score in [0.0, 0.3, 0.45] {
            let found = matcher.match_local(&initial, &scan, min_score);
            let expected = by_definition(&matcher, &initial, &scan, min_score, window);
            assert_eq!(found, expected, "{i} {min_score} {options:?}");
        }
    }
}

#[test]
fn a_whole_submap_is_searched_as_defined() {
    let mut lcg = Lcg::new(8);
    for depth in [4, 6] {
        let (grid, mut scan) = random_room(&mut lcg, false);
        scan.points = scan.points.into_iter().step_by(8).collect();
        let options = FastCorrelativeOptions2d { branch_and_bound_depth: depth, ..Default::default() };
        let matcher = FastCorrelativeMatcher2d::new(&grid.cropped(), &options).unwrap();
        let limits = matcher.limits;
        let half = 0.5
            * limits.resolution()
            * Vector2::new(limits.num_y_cells().into(), limits.num_x_cells().into());
        let centre = Rigid2 { translation: limits.max() - half, angle: 0.0 };
        let found = matcher.match_full(&scan, 0.4);
        let window = [1e6 * limits.resolution(), std::f64::consts::PI];
        assert!(found.is_some());
        assert_eq!(found, by_definition(&matcher, &centre, &scan, 0.4, window), "{depth}");
    }
}

#[test]
fn a_moved_scan_is_found_back() {
    let shape = [(-2.5, 0.5), (-2.0, 0.5), (0.0, -0.5), (0.5, -1.6), (2.5, 0.5), (2.5, 1.7)];
    let cloud = PointCloud::new(shape.map(|(x, y)| Point3f::new(x, y, 0.0)).to_vec());
    let mut lcg = Lcg::new(42);
    for full in [false, true] {
        for _ in 0..20 {
            let mut random = |a: f32| f64::from(lcg.symmetric(a));
            let truth = Rigid2::new(random(2.0), random(2.0), random(0.5));
            let transform = crate::Transform2d::from_pose(&truth);
            let returns = PointCloud::new(cloud.points.iter().map(|p| transform.apply(p)).collect());
            let [x, y] = [truth.translation.x as f32, truth.translation.y as f32];
            let data =
                portolan_sensor::RangeData { origin: Point3f::new(x, y, 0.0), returns, ..Default::default() };
            let limits = MapLimits::new(0.05, Vector2::new(5.0, 5.0), 200, 200).unwrap();
            let mut grid = ProbabilityGrid::new(limits);
            let inserter = portolan_grids::ProbabilityInserterOptions {
                hit_probability: 0.7,
                miss_probability: 0.4,
                ..Default::default()
            };
            portolan_grids::ProbabilityInserter::new(&inserter).unwrap().insert(&data, &mut grid).unwrap();
            let options = FastCorrelativeOptions2d {
                linear_search_window: 3.0,
                angular_search_window: 1.0,
                branch_and_bound_depth: 3,
            };
            let matcher = FastCorrelativeMatcher2d::new(&grid.into(), &options).unwrap();
            let found = if full {
                let away = crate::Transform2d::from_pose(&Rigid2::new(random(10.0), random(10.0), 0.0));
                let moved = PointCloud::new(cloud.points.iter().map(|p| away.apply(p)).collect());
                let found = matcher.match_full(&moved, 0.1).unwrap();
                assert!(found.score > 0.1);
                let back = away.inverse().apply(&Point3f::origin());
                let centre =
                    found.pose.transform_point(&Vector2::new(-f64::from(back.x), -f64::from(back.y)));
                Rigid2 { translation: centre, ..found.pose }
            } else {
                matcher.match_local(&Rigid2::identity(), &cloud, 0.1).unwrap().pose
            };
            assert!((found.translation - truth.translation).norm() < 0.05, "{full} {found:?} {truth:?}");
            assert!((found.normalized_angle() - truth.angle).abs() < 0.03, "{full} {found:?} {truth:?}");
        }
    }
}

#[test]
fn searches_of_odd_input_terminate() {
    let (matcher, mut scan) = (golden_matcher(), golden_scan());
    assert!(matcher.match_full(&PointCloud::default(), 0.1).is_none());
    assert!(matcher.match_local(&Rigid2::new(f64::NAN, 0.0, 0.0), &scan, 0.1).is_none());
    assert!(matcher.match_local(&Rigid2::new(1e12, 0.0, 0.0), &scan, 0.2).is_none());
    assert!(matcher.match_full(&scan, f32::NAN).is_none());
    scan.points.push(Point3f::new(f32::NAN, 0.0, 0.0));
    assert!(matcher.match_local(&Rigid2::new(0.9, 1.2, 0.05), &scan, 0.2).is_some());
    let options = FastCorrelativeOptions2d { branch_and_bound_depth: 0, ..Default::default() };
    assert!(FastCorrelativeMatcher2d::new(&grid_g().into(), &options).is_err());
    // A plateau: every placement on it is as good as any other.
    let limits = MapLimits::new(0.05, Vector2::new(7.5, 7.5), 300, 300).unwrap();
    let mut flat = ProbabilityGrid::new(limits);
    for x in 0..300 {
        (0..300).for_each(|y| assert!(flat.set_probability(CellIndex::new(x, y), 0.8)));
    }
    let matcher = FastCorrelativeMatcher2d::new(&flat.into(), &FastCorrelativeOptions2d::default()).unwrap();
    assert!(matcher.match_full(&golden_scan(), 0.2).unwrap().score > 0.79);
}
