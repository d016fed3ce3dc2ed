//! Figures on real and simulated recordings, against those of independent programs.
#![allow(clippy::unwrap_used)]

use std::fs::File;
use std::io::BufReader;

use portolan_evaluation::{
    Alignment, Association, Step, TimedPose, Trajectory, absolute_errors, in_time_base, read_csv,
    read_relations, read_tum, relation_errors, relative_errors, write_binary_relations,
};
use portolan_geometry::{Duration, Time};
use portolan_testing::real_data;

fn tum(path: &str) -> Option<Trajectory> {
    let (trajectory, repairs) = read_tum(BufReader::new(File::open(real_data(path)?).unwrap())).unwrap();
    assert_eq!(repairs, Default::default());
    Some(trajectory)
}

fn assert_close(actual: f64, expected: f64, tolerance: f64) {
    assert!((actual - expected).abs() <= tolerance, "{actual} instead of {expected}");
}

#[test]
fn corridor() {
    let Some(truth) = tum("lidar3d/corridor_imu.truth.tum") else { return };
    let expected = [
        ("maps/reference/corridor_imu.tum", [0.1019, 0.0813, 0.2042, 0.634]),
        ("maps/reference/corridor_imu.local.tum", [0.2738, 0.1777, 0.7570, 1.003]),
    ];
    for (path, [rmse, median, max, degrees]) in expected {
        let Some(estimate) = tum(path) else { return };
        let e = absolute_errors(&truth, &estimate, Association::default(), Alignment::Se3).unwrap();
        assert_eq!(e.count, 749);
        assert_close(e.translation.rmse, rmse, 5.1e-5);
        assert_close(e.translation.median, median, 5.1e-5);
        assert_close(e.translation.max, max, 5.1e-5);
        assert_close(e.rotation_degrees.rmse, degrees, 5.1e-4);
    }
    let nearest = Association::Nearest { tolerance: Duration::from_ticks(200_000) };
    let Some(estimate) = tum("maps/reference/corridor_imu.tum") else { return };
    let e = absolute_errors(&truth, &estimate, nearest, Alignment::Se2).unwrap();
    assert_close(e.translation.rmse, 0.0962, 5.1e-5);
    assert_close(e.rotation_degrees.rmse, 0.399, 5.1e-4);
}

#[test]
fn walk() {
    let (Some(truth), Some(input)) = (tum("lidar3d/walk.truth.tum"), tum("lidar3d/walk.input.tum")) else {
        return;
    };
    let e = absolute_errors(&truth, &input, Association::default(), Alignment::Se3).unwrap();
    assert_eq!(e.count, 20_329);
    assert_close(e.translation.rmse, 0.1768, 5.1e-5);
    assert_close(e.rotation_degrees.rmse, 1.122, 5.1e-4);
    let r = relative_errors(&truth, &input, Association::default(), Step::Time(1.0)).unwrap();
    assert_close(r.translation.rmse, 0.0275, 0.001);
}

#[test]
fn relations_of_the_reference() {
    // Written by Cartographer; its figure for the nodes alone is 0.00195 m, 0.04833 degrees.
    let Some(path) = real_data("maps/reference/corridor_imu.generated_5m.pb") else { return };
    let bytes = std::fs::read(path).unwrap();
    let relations = read_relations(&bytes).unwrap();
    assert_eq!(relations.len(), 24);
    let mut written = Vec::new();
    write_binary_relations(&relations, &mut written).unwrap();
    assert_eq!(written, bytes);
    let Some(estimate) = tum("maps/reference/corridor_imu.tum") else { return };
    let report = relation_errors(&estimate, &relations).unwrap();
    assert_eq!(
        report.to_string(),
        "Abs translational error 0.00195 +/- 0.00124 m\nSqr translational error 0.00001 +/- 0.00001 m^2\n\
         Abs rotational error 0.04833 +/- 0.03672 deg\nSqr rotational error 0.00363 +/- 0.00579 deg^2"
    );
}

#[test]
fn carmen_relations() {
    let Some(path) = real_data("lidar2d/aces/aces.relations") else { return };
    let relations = read_relations(&std::fs::read(path).unwrap()).unwrap();
    assert_eq!(relations.len(), 1279);
    let Some(path) = real_data("lidar2d/aces/reference_poses.csv") else { return };
    let (poses, _) = read_csv(BufReader::new(File::open(path).unwrap())).unwrap();
    let same_clock = relation_errors(&poses, &in_time_base(&poses, &relations).unwrap().0).unwrap();
    // A trajectory with the stamps of the ROS recording.
    let converted =
        |p: &TimedPose| TimedPose { time: Time::from_ticks(p.time.ticks() + 10_000_000_000_000_000), ..*p };
    let ros = Trajectory::new(poses.poses().iter().map(converted)).0;
    let (shifted, notice) = in_time_base(&ros, &relations).unwrap();
    assert_eq!(notice.unwrap().count, 1279);
    assert_eq!(
        relation_errors(&ros, &shifted).unwrap().absolute_translation,
        same_clock.absolute_translation
    );
}
