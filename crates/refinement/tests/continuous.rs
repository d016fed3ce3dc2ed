//! Continuous-time refinement in small worlds whose truth is known.
#![allow(clippy::unwrap_used, clippy::panic)] // tests

mod synthetic;

use portolan_geometry::nalgebra;
use portolan_geometry::{Duration, Rigid3, Time, Vector3};
use portolan_refinement::continuous::{
    BeforeAndAfter, ContinuousOptions, RefineProgress, Refined, refine_continuous,
};
use portolan_refinement::semi_rigid::{SemiRigidOptions, refine_semi_rigid};
use portolan_refinement::{PointStore, RefineError};
use portolan_testing::is_fast;
use synthetic::{circles, disturbed, errors, furnished, poses, room, scan, straight};

const SECONDS: f64 = 20.0;

fn refine(points: &PointStore, input: &[(Time, Rigid3)]) -> Refined {
    refine_continuous(points, input, &ContinuousOptions::default(), &mut |_| true).unwrap()
}

fn corrected(refined: &Refined, input: &[(Time, Rigid3)]) -> Vec<(Time, Rigid3)> {
    input.iter().map(|(time, pose)| (*time, refined.trajectory.corrected(*time, pose))).collect()
}

#[test]
fn drift_and_short_errors_are_found_in_a_room() {
    if is_fast() {
        return;
    }
    let truth = poses(circles, SECONDS);
    let points = scan(&furnished(), circles, SECONDS, 120);
    let input = disturbed(&truth, 0.5, 0.01);
    assert!(errors(&truth, &input).0 > 0.1);
    let refined = refine(&points, &input);
    let (shift, turn) = errors(&truth, &corrected(&refined, &input));
    assert!(shift < 0.004 && turn < 0.002, "{shift} m, {turn} rad");
    let report = &refined.report;
    assert!(report.undetermined.is_empty() && report.warnings.is_empty() && !report.kept_input);
    let (before, after) = (report.sharpness_before.unwrap(), report.sharpness_after.unwrap());
    assert!(after.mean_map_entropy < before.mean_map_entropy - 0.3);
    // The gauge: the first pose stays.
    let first = refined.trajectory.corrected(input[0].0, &input[0].1);
    assert!((first.to_homogeneous() - input[0].1.to_homogeneous()).norm() < 1e-6);
}

#[test]
fn a_perfect_trajectory_remains_perfect() {
    let truth = poses(circles, 10.0);
    let points = scan(&furnished(), circles, 10.0, 90);
    let refined = refine(&points, &truth);
    let (shift, turn) = errors(&truth, &corrected(&refined, &truth));
    assert!(shift < 0.002 && turn < 0.001, "{shift} m, {turn} rad");
}

#[test]
fn no_correction_is_made_along_a_corridor() {
    let walls = room([-100.0, -1.0, 0.0], [200.0, 1.2, 2.6]);
    let points = scan(&walls, straight, 10.0, 120);
    let truth = poses(straight, 10.0);
    // Wrong along the corridor by a scale, across it by waves.
    let input: Vec<(Time, Rigid3)> = truth
        .iter()
        .enumerate()
        .map(|(i, (time, pose))| {
            let s = i as f64 * 0.02;
            let error = Vector3::new(0.03 * s, 0.01 * (2.0 * s).sin(), 0.01 * (1.3 * s).sin());
            (*time, Rigid3::translation(error.x, error.y, error.z) * pose)
        })
        .collect();
    let refined = refine(&points, &input);
    let moved: Vec<Vector3> = corrected(&refined, &input)
        .iter()
        .zip(&input)
        .map(|(a, b)| a.1.translation.vector - b.1.translation.vector)
        .collect();
    let along = moved.iter().map(|m| m.x.abs()).fold(0.0, f64::max);
    assert!(along < 0.02, "moved {along} m along the corridor");
    let free = &refined.report.undetermined;
    assert!(
        free.iter().any(|u| !u.is_rotation && u.direction[0].abs() > 0.99 && u.to - u.from > 5.0),
        "{free:?}"
    );
    // No pass comes back: what is slower than two seconds stays as the input has it, and nothing gets worse.
    let (before, after) = (errors(&truth, &input), errors(&truth, &corrected(&refined, &input)));
    assert!(after.0 <= 1.01 * before.0 && after.1 <= 1.01 * before.1, "{before:?} {after:?}");
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    if is_fast() {
        return;
    }
    let truth = poses(circles, 8.0);
    let points = scan(&furnished(), circles, 8.0, 60);
    let input = disturbed(&truth, 0.2, 0.01);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let refined = pool.install(|| refine(&points, &input));
        corrected(&refined, &input)
    };
    let one = run(1);
    assert!(one == run(2) && one == run(4));
}

#[test]
fn a_jump_of_the_input_is_taken_out() {
    if is_fast() {
        return;
    }
    let truth = poses(circles, SECONDS);
    let points = scan(&furnished(), circles, SECONDS, 120);
    let jump = Rigid3::new(Vector3::new(0.8, -0.4, 0.1), Vector3::new(0.0, 0.0, 0.1));
    let input: Vec<(Time, Rigid3)> = disturbed(&truth, 0.2, 0.005)
        .into_iter()
        .map(|(time, pose)| (time, if time > truth[450].0 { jump * pose } else { pose }))
        .collect();
    let refined = refine(&points, &input);
    assert_eq!(refined.report.jumps.len(), 1);
    assert!((refined.report.jumps[0].seconds - 9.0).abs() < 0.05);
    let (shift, turn) = errors(&truth, &corrected(&refined, &input));
    assert!(shift < 0.005 && turn < 0.003, "{shift} m, {turn} rad");
    // What was before is what was given, with its jump.
    let clouds = BeforeAndAfter::new(&points, &refined);
    let point = points.points().iter().find(|p| p.seconds() > 22.0).unwrap();
    let seconds = point.seconds() + points.start().seconds_since(input[0].0);
    let pose = refined.trajectory.input_pose(seconds);
    let given = input.iter().find(|(time, _)| time.seconds_since(input[0].0) >= seconds).unwrap();
    assert!((pose.translation.vector - given.1.translation.vector).norm() < 0.05);
    let before = pose * nalgebra::Point3::from(point.in_tracking.map(f64::from));
    assert!((Vector3::from(clouds.place(point).before) - before.coords).norm() < 1e-3);
    let (_, last) = points.span().unwrap();
    assert!(clouds.iter().count() + refined.report.points_outside_trajectory == points.points().len());
    assert!(last > input[0].0);
}

#[test]
fn the_published_method_finds_drift_too() {
    if is_fast() {
        return;
    }
    let truth = poses(circles, SECONDS);
    let points = scan(&furnished(), circles, SECONDS, 120);
    let input = disturbed(&truth, 0.4, 0.005);
    let options = SemiRigidOptions { interval: 120, half_width: 60, ..SemiRigidOptions::default() };
    let refine = |options| refine_semi_rigid(&points, &input, &options, &mut |_| true).unwrap();
    let error = |refined: &Refined| errors(&truth, &corrected(refined, &input)).0;
    let before = errors(&truth, &input).0;
    let fine = error(&refine(options));
    assert!(fine < 0.02 * before, "{before} -> {fine}");
    let coarse = refine(options.coarse(points.sweep_seconds()));
    let after = error(&coarse);
    assert!(after < 0.02 * before, "{before} -> {after}");
    let last = coarse.report.steps.last().unwrap();
    assert!(last.stage == "elements" && (last.knot_spacing - 0.2).abs() < 0.01, "{last:?}");
}

#[test]
fn stopping_keeps_the_result_so_far() {
    let truth = poses(circles, 8.0);
    let points = scan(&furnished(), circles, 8.0, 60);
    let input = disturbed(&truth, 0.3, 0.01);
    for asked in 1..=8 {
        let mut left = asked;
        let mut observe = |_: &RefineProgress| {
            left -= 1;
            left > 0
        };
        let refined =
            refine_continuous(&points, &input, &ContinuousOptions::default(), &mut observe).unwrap();
        // The observer is also called before long steps, and not again once it has requested a stop.
        assert!(refined.report.stopped && left == 0 && refined.report.steps.len() < asked, "{asked}");
        let error = errors(&truth, &corrected(&refined, &input)).0;
        assert!(error <= errors(&truth, &input).0, "{asked}: {error}");
        let moved = errors(&input, &corrected(&refined, &input)).0;
        assert!(!refined.report.steps.is_empty() || moved < 1e-9, "{asked}: {moved}");
    }
}

#[test]
fn gaps_other_clocks_and_missing_points_are_reported() {
    let truth = poses(circles, 8.0);
    let points = scan(&furnished(), circles, 8.0, 60);
    let options = ContinuousOptions::default();
    let mut with_gap = truth.clone();
    with_gap.retain(|(time, _)| {
        let s = time.seconds_since(truth[0].0);
        !(3.0..5.0).contains(&s)
    });
    let report = refine(&points, &with_gap).report;
    assert!(report.gaps.len() == 1 && report.points_outside_trajectory > 0 && !report.warnings.is_empty());
    let other_clock: Vec<(Time, Rigid3)> =
        truth.iter().map(|(time, pose)| (*time + Duration::from_seconds(5000.0), *pose)).collect();
    match refine_continuous(&points, &other_clock, &options, &mut |_| true) {
        Err(RefineError::NoOverlap { hint, .. }) => assert!(hint.contains("-5000.0"), "{hint}"),
        other => panic!("{other:?}"),
    }
    let none = refine_continuous(&PointStore::new(0.3), &truth, &options, &mut |_| true);
    assert_eq!(none.unwrap_err(), RefineError::NoPoints);
    let bad = ContinuousOptions { window: 0.0, ..options };
    assert!(matches!(refine_continuous(&points, &truth, &bad, &mut |_| true), Err(RefineError::Option(_))));
}
