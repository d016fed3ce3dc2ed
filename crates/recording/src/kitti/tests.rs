//! Reads synthetic KITTI folders.

use std::path::Path;

use portolan_geometry::Time;

use crate::{Message, RecordedMessage, open};
use portolan_issue::{Issue, IssueKind};

fn write(path: &Path, bytes: impl AsRef<[u8]>) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, bytes).unwrap();
}

fn sweep(points: &[[f32; 4]]) -> Vec<u8> {
    points.iter().flatten().flat_map(|v| v.to_le_bytes()).collect()
}

fn read(folder: &Path) -> (Vec<RecordedMessage>, Vec<Issue>) {
    let recording = open(folder).unwrap();
    let mut reader = recording.read(&|_| true).unwrap();
    let messages = std::iter::from_fn(|| reader.next_message().unwrap()).collect();
    (messages, reader.issues())
}

#[test]
fn raw_drives_have_times_fixes_and_an_imu() {
    let root = tempfile::tempdir().unwrap();
    let drive = root.path().join("2011_09_26_drive_0001_sync");
    let points =
        [[10.0, 0.0, 0.0, 0.5], [0.0, 10.0, 0.0, 0.5], [-10.0, 0.1, 0.0, 0.5], [0.0, -10.0, 1.0, 0.25]];
    for i in 0..3 {
        write(&drive.join(format!("velodyne_points/data/{i:010}.bin")), sweep(&points));
        let values = format!(
            "49.01 8.43 116.4 0.03 -0.01 -1.2 {}",
            "0 0 0 0 0 0.1 0.2 9.8 0 0 9.8 0.01 0.02 0.03 0 0 0 0.5 0.1 4 7 5 5 5"
        );
        write(&drive.join(format!("oxts/data/{i:010}.txt")), values);
    }
    let dates = |offset: f64| -> String {
        (0..3).map(|i| format!("2011-09-26 13:02:{:012.9}\n", 25.0 + 0.1 * f64::from(i) + offset)).collect()
    };
    write(&drive.join("velodyne_points/timestamps.txt"), dates(0.05));
    write(&drive.join("velodyne_points/timestamps_start.txt"), dates(0.0));
    write(&drive.join("velodyne_points/timestamps_end.txt"), dates(0.1));
    write(&drive.join("oxts/timestamps.txt"), dates(0.05));
    write(
        &root.path().join("calib_imu_to_velo.txt"),
        "calib_time: x\nR: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.3 -0.8\n",
    );
    let (messages, issues) = read(&drive);
    assert!(issues.is_empty(), "{issues:?}");
    assert_eq!(messages.len(), 1 + 3 * 3);
    assert!(messages.windows(2).all(|pair| pair[0].log_time <= pair[1].log_time));
    let Message::Tf(tf) = &messages[0].message else { panic!() };
    assert_eq!(tf.transforms[0].transform.position, [0.8, -0.3, 0.8]);
    let cloud =
        messages.iter().find_map(|m| if let Message::PointCloud2(c) = &m.message { Some(c) } else { None });
    let cloud = cloud.unwrap();
    // The stamp is when the lidar pointed ahead, so it is also right for readers that ignore the times of
    // points.
    assert_eq!(cloud.header.stamp, Time::from_unix_decimal("1317042145.05").unwrap());
    let times: Vec<f32> =
        cloud.data.chunks_exact(22).map(|p| f32::from_le_bytes(p[18..].try_into().unwrap())).collect();
    // Rear, left, ahead, right: clockwise from the rear.
    for (time, expected) in times.iter().zip([-0.0498, -0.025, 0.0, 0.025]) {
        assert!((time - expected).abs() < 2e-4, "{times:?}");
    }
    let imu =
        messages.iter().find_map(|m| if let Message::Imu(i) = &m.message { Some(i) } else { None }).unwrap();
    assert_eq!((imu.linear_acceleration[2], imu.angular_velocity[2]), (9.8, 0.03));
}

#[test]
fn sequences_have_no_times_of_points_and_faults_are_counted() {
    let root = tempfile::tempdir().unwrap();
    let points = [[1.0, 2.0, 3.0, 0.5]; 20];
    for i in 0..5 {
        let mut bytes = sweep(&points);
        bytes.truncate(if i == 2 { 50 } else { bytes.len() });
        write(&root.path().join(format!("velodyne/{i:06}.bin")), if i == 3 { Vec::new() } else { bytes });
    }
    write(&root.path().join("times.txt"), "0.000000e+00\n1.036224e-01\nnonsense\n3.0e-01\n");
    let (messages, issues) = read(root.path());
    assert_eq!(messages.len(), 2);
    let Message::PointCloud2(cloud) = &messages[1].message else { panic!() };
    assert!(cloud.fields.iter().all(|f| f.name != "time") && cloud.width == 20);
    assert_eq!(cloud.header.stamp, Time::from_ros(1_000_000_000, 103_622_400));
    let losses: Vec<IssueKind> = issues.iter().filter(|r| r.lost_data()).map(|r| r.kind).collect();
    assert!(losses.contains(&IssueKind::WithoutTime) && losses.contains(&IssueKind::SweepWithoutPoints));
    std::fs::remove_file(root.path().join("times.txt")).unwrap();
    assert!(open(root.path()).err().unwrap().to_string().contains("times.txt"));
}
