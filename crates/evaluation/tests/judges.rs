//! Figures of independent programs (numpy and scipy) for a made walk and its estimate, in
//! `tests/fixtures`.
#![allow(clippy::unwrap_used)]

use portolan_evaluation::{
    Alignment, Association, EvaluationError, Step, Trajectory, absolute_errors, drift, read_relations,
    read_tum, relation_errors, relative_errors,
};
use portolan_geometry::Duration;

fn trajectory(text: &str) -> Trajectory {
    read_tum(text.as_bytes()).unwrap().0
}

fn truth() -> Trajectory {
    trajectory(include_str!("fixtures/truth.tum"))
}

fn estimate() -> Trajectory {
    trajectory(include_str!("fixtures/estimate.tum"))
}

fn assert_close(actual: f64, expected: f64, tolerance: f64) {
    assert!((actual - expected).abs() <= tolerance, "{actual} instead of {expected}");
}

#[test]
fn relation_errors_agree() {
    let relations = read_relations(include_bytes!("fixtures/relations.txt")).unwrap();
    let report = relation_errors(&estimate(), &relations).unwrap();
    assert_eq!((report.count, report.outside_trajectory), (40, 0));
    assert_close(report.translation.mean, 0.1643, 5e-5);
    assert_close(report.translation.median, 0.1343, 5e-5);
    assert_close(report.rotation_degrees.mean, 1.227, 5e-4);
    assert_close(report.share_within(0.2), 0.675, 1e-9);
}

#[test]
fn absolute_errors_agree() {
    let interpolate = Association::default();
    let nearest = |ticks| Association::Nearest { tolerance: Duration::from_ticks(ticks) };
    // Association, alignment, count, rmse, mean, median, max (m), rotation rmse and max (degrees).
    let expected = [
        (nearest(200_000), Alignment::Se2, 9, [0.0440, 0.0397, 0.0429, 0.0648, 1.904, 3.036]),
        (nearest(200_000), Alignment::Se3, 9, [0.0488, 0.0441, 0.0436, 0.0751, 1.993, 3.212]),
        (nearest(500_000), Alignment::Se2, 18, [0.0566, 0.0505, 0.0445, 0.1051, 1.911, 3.526]),
        (interpolate, Alignment::Se2, 80, [0.0410, 0.0370, 0.0370, 0.0913, 1.862, 3.760]),
        (interpolate, Alignment::Se3, 80, [0.0482, 0.0453, 0.0434, 0.0917, 1.975, 3.756]),
    ];
    for (association, alignment, count, figures) in expected {
        let e = absolute_errors(&truth(), &estimate(), association, alignment).unwrap();
        assert_eq!((e.count, e.estimate_poses, e.truth_poses), (count, 95, 60));
        let t = e.translation;
        for (actual, expected) in [t.rmse, t.mean, t.median, t.max].iter().zip(&figures) {
            assert_close(*actual, *expected, 5.1e-5);
        }
        assert_close(e.rotation_degrees.rmse, figures[4], 5.1e-4);
        assert_close(e.rotation_degrees.max, figures[5], 5.1e-4);
        assert!(e.to_string().contains(&format!("of {count} poses")));
    }
}

#[test]
fn relative_errors_agree() {
    let second = relative_errors(&truth(), &estimate(), Association::default(), Step::Time(1.0)).unwrap();
    assert_eq!(second.translation.count, 77);
    assert_close(second.translation.rmse, 0.05575587703392185, 1e-6);
    assert_close(second.translation.median, 0.043835220480590624, 1e-6);
    assert_close(second.rotation_degrees.rmse, 1.1639914707225305, 1e-5);
    assert_close(second.rotation_degrees.max, 2.3096305059740287, 1e-5);
    let metres = relative_errors(&truth(), &estimate(), Association::default(), Step::Distance(5.0)).unwrap();
    assert_eq!(metres.translation.count, 64);
    assert_close(metres.translation.rmse, 0.14320993843842705, 1e-6);
    assert_close(metres.rotation_degrees.rmse, 1.5922826723561645, 1e-5);
    assert!(metres.to_string().starts_with("Relative pose error over 5 m (64 motions)"));
}

#[test]
fn drift_agrees() {
    let d = drift(&truth(), &estimate(), Association::default(), &[5.0, 10.0, 20.0, 100.0], 10).unwrap();
    let expected = [
        (5.0, 7, 2.372854899698781, 0.3243266034780299),
        (10.0, 6, 1.549921987889814, 0.19568494864974062),
        (20.0, 4, 0.6289320770350693, 0.11709807132864514),
    ];
    assert_eq!(d.by_length.len(), expected.len());
    for (segments, (length, count, percent, degrees)) in d.by_length.iter().zip(expected) {
        assert_eq!((segments.length, segments.count), (Some(length), count));
        assert_close(segments.translation_percent, percent, 1e-5);
        assert_close(segments.rotation_degrees_per_metre, degrees, 1e-6);
    }
    let mean = d.mean.unwrap();
    assert_eq!(mean.count, 17);
    assert_close(mean.translation_percent, 1.6720732078453309, 1e-5);
    assert_close(mean.rotation_degrees_per_metre, 0.23016401185642552, 1e-6);
    assert_close(d.path_length, 32.94021049645482, 1e-5);
    assert_close(d.end_translation, 0.26989994, 1e-6);
    assert_close(d.end_rotation_degrees, 4.29781324, 1e-6);
    assert_close(d.end_drift_per_metre().unwrap(), 0.26989994 / 32.94021049645482, 1e-6);
    assert_eq!(d.to_string().lines().count(), 6);
}

#[test]
fn a_perfect_estimate_has_no_errors() {
    let errors = absolute_errors(&truth(), &truth(), Association::default(), Alignment::Se3).unwrap();
    assert!(errors.translation.max < 1e-6 && errors.rotation_degrees.max < 1e-4);
    let first = absolute_errors(&truth(), &truth(), Association::default(), Alignment::FirstPose).unwrap();
    assert!(first.translation.max < 1e-9 && first.count == 60);
}

#[test]
fn trajectories_that_cannot_be_compared_are_named() {
    let empty = Trajectory::default();
    let later = estimate().shifted(Duration::from_seconds(1e6));
    let ate = |t: &Trajectory, e: &Trajectory| absolute_errors(t, e, Association::default(), Alignment::Se2);
    assert!(matches!(ate(&empty, &estimate()), Err(EvaluationError::EmptyTrajectory("true"))));
    assert!(matches!(ate(&truth(), &empty), Err(EvaluationError::EmptyTrajectory("estimated"))));
    assert!(ate(&truth(), &later).unwrap_err().to_string().contains("same clock"));
    let gap = Association::Interpolate { max_gap: Some(Duration::from_seconds(0.1)) };
    let error = absolute_errors(&truth(), &estimate(), gap, Alignment::Se2);
    assert!(error.is_ok_and(|e| e.count < 10), "only poses at the very times of the truth are left");
    let rpe = |step| relative_errors(&truth(), &estimate(), Association::default(), step);
    assert!(rpe(Step::Time(1e6)).unwrap_err().to_string().contains("1000000 s"));
    assert!(rpe(Step::Distance(-1.0)).is_err() && rpe(Step::Time(f64::NAN)).is_err());
    assert!(drift(&truth(), &estimate(), Association::default(), &[f64::NAN], 1).is_err());
    let short = drift(&truth(), &estimate(), Association::default(), &[1000.0], 0).unwrap();
    assert!(short.mean.is_none() && short.by_length.is_empty());
}
