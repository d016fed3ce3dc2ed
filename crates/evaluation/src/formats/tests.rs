use super::*;
use crate::{TimedPose, Trajectory};
use portolan_geometry::Vector3;
use proptest::prelude::*;

fn example() -> Trajectory {
    let pose = |i: i64| TimedPose {
        time: Time::from_ros(1_600_000_000 + i, 123_456_700),
        map_from_tracking: Rigid3::new(
            Vector3::new(1.5 * i as f64, -2.25, 0.125),
            Vector3::new(0.1, -0.2, 0.3) * i as f64,
        ),
    };
    Trajectory::new((0..12).map(pose)).0
}

fn assert_near(a: &Trajectory, b: &Trajectory, with_times: bool) {
    assert_eq!(a.len(), b.len());
    for (a, b) in a.poses().iter().zip(b.poses()) {
        assert!(!with_times || a.time == b.time);
        let difference = a.map_from_tracking.inverse() * b.map_from_tracking;
        assert!(difference.translation.vector.norm() < 2e-6 && difference.rotation.angle() < 1e-7);
    }
}

fn tum(text: &str) -> Result<(Trajectory, TrajectoryRepairs), EvaluationError> {
    read_tum(text.as_bytes())
}

#[test]
fn every_format_round_trips() {
    let example = example();
    let mut text = Vec::new();
    write_tum(&example, &mut text).unwrap();
    let (read, repairs) = read_tum(&text[..]).unwrap();
    assert_near(&read, &example, true);
    assert_eq!(repairs, TrajectoryRepairs::default());

    text.clear();
    write_csv(&example, &mut text).unwrap();
    assert_near(&read_csv(&text[..]).unwrap().0, &example, true);

    text.clear();
    write_kitti(&example, &mut text).unwrap();
    let poses = read_kitti_poses(&text[..]).unwrap();
    let times: Vec<Time> = example.poses().iter().map(|p| p.time).collect();
    assert_near(&kitti_trajectory(&poses, &times).unwrap().0, &example, true);
    assert!(kitti_trajectory(&poses, &times[1..]).unwrap_err().to_string().contains("11 times"));
}

#[test]
fn tum_files_of_all_kinds() {
    let text = "\u{feff}# made elsewhere\r\n\n3 1 2 3 0 0 0 1\r\n  1.5\t1 2 3 0 0 0 2  \n%c\n3 9 9 9 0 0 0 1\n\
                2 nan 2 3 0 0 0 1\n4 1 2 3 0 0 0 0";
    let (trajectory, repairs) = tum(text).unwrap();
    let seconds: Vec<f64> = trajectory.poses().iter().map(|p| p.time.unix_seconds()).collect();
    assert_eq!(seconds, [1.5, 3.0]);
    let expected =
        TrajectoryRepairs { unsorted: 1, duplicate_stamps: 1, invalid_poses: 2, renormalized_quaternions: 1 };
    assert_eq!(repairs, expected);
}

#[test]
fn damage_is_named_by_line() {
    let message = |text: &str| tum(text).unwrap_err().to_string();
    assert!(message("1 2 3 4 0 0 0 1\n1 2 3").starts_with("line 2: too few numbers"));
    assert!(message("1 2 3 4 0 0 0 1 9").starts_with("line 1: too many"));
    assert!(message("1 2 x 4 0 0 0 1").contains("\"x\" is not a number"));
    assert!(message("1403636579763555584 2 3 4 0 0 0 1").contains("nanoseconds"));
    assert!(read_tum(&[0xff, 0xfe, 0x00][..]).unwrap_err().to_string().contains("not text"));
    assert!(message(&"1 ".repeat(100_000)).contains("64 KiB"));
    assert!(read_kitti_poses("1 0 0 0 0 1 0 0 0 0 2 0".as_bytes()).is_err());
    assert!(read_kitti_poses("-1 0 0 0 0 1 0 0 0 0 1 0".as_bytes()).is_err());
    assert!(read_kitti_poses("nan 0 0 0 0 1 0 0 0 0 1 0".as_bytes()).is_err());
    assert!(read_csv("1,2,3\n".as_bytes()).is_err() && read_csv("".as_bytes()).is_err());
    assert!(read_csv("time,x,y\n1,2\n".as_bytes()).unwrap_err().to_string().contains("column 3"));
}

#[test]
fn tables_are_understood_by_their_names() {
    let text = "# ipc_timestamp,logger_timestamp,x,y,theta(corrected),raw_x\n91.2,21.0,0.9,-0.2,-0.5,7\n";
    let (trajectory, _) = read_csv(text.as_bytes()).unwrap();
    let pose = trajectory.poses()[0];
    assert_eq!(pose.time.unix_decimal(), "91.2000000");
    assert!((pose.map_from_tracking.translation.vector - Vector3::new(0.9, -0.2, 0.0)).norm() < 1e-12);
    assert!((portolan_geometry::yaw(&pose.map_from_tracking.rotation) + 0.5).abs() < 1e-12);
}

proptest! {
    #[test]
    fn any_text_is_read_or_refused(text in "[-0-9. ,\n#e+a]{0,300}", bytes in prop::collection::vec(any::<u8>(), 0..100)) {
        for data in [text.as_bytes(), &bytes] {
            let _ = (read_tum(data), read_csv(data), read_kitti_poses(data), read_kitti_times(data));
            let _ = read_csv([b"time,x,y,yaw\n", data].concat().as_slice());
        }
    }

    #[test]
    fn numbers_of_any_size_are_survived(values in prop::collection::vec(any::<f64>(), 36)) {
        let line = |n: usize| values[..n].iter().map(|v| format!("{v:e}")).collect::<Vec<_>>().join(" ");
        let _ = (tum(&line(8)), read_kitti_poses(line(12).as_bytes()));
    }
}
