//! Recordings of real robots.

use portolan_issue::IssueKind;
use portolan_recording::*;
use portolan_testing::real_data;

use crate::sample::{assert_same, read_all};

fn count_of(messages: &[RecordedMessage], topic: &str) -> usize {
    messages.iter().filter(|message| &*message.topic == topic).count()
}

#[test]
fn the_same_recording_in_ros1_and_ros2_is_the_same() {
    let (Some(bag), Some(folder)) = (real_data("lidar2d/aces/aces.bag"), real_data("lidar2d/aces/aces_ros2"))
    else {
        return;
    };
    let (ros1, issues) = read_all(&*open(bag).unwrap());
    assert_eq!(issues, []);
    let (ros2, issues) = read_all(&*open(folder).unwrap());
    assert_eq!(issues, []);
    assert_eq!(count_of(&ros1, "/scan"), 7374);
    assert_eq!(count_of(&ros1, "/odom"), 7374);
    // The order of messages of the same time is that of the files, which differs.
    for topic in ["/scan", "/odom", "/tf_static"] {
        let of_topic = |messages: &[RecordedMessage]| {
            messages.iter().filter(|message| &*message.topic == topic).cloned().collect::<Vec<_>>()
        };
        assert_same(&of_topic(&ros1), &of_topic(&ros2));
    }
    let Message::LaserScan(scan) = &ros1.iter().find(|m| &*m.topic == "/scan").unwrap().message else {
        panic!()
    };
    assert_eq!(scan.ranges.len(), 180);
    assert!(scan.ranges.iter().any(|range| (0.5..20.0).contains(range)));
}

#[test]
fn bz2_chunks_are_read() {
    let Some(path) = real_data("lidar2d/fr079/fr079.bag") else { return };
    let recording = open(path).unwrap();
    assert_eq!(recording.format(), "ROS 1 bag 2.0 (bz2)");
    let (messages, issues) = read_all(&*recording);
    assert_eq!(issues, []);
    assert_eq!(count_of(&messages, "/scan"), 4934);
    assert!(messages.is_sorted_by_key(|message| message.log_time));
}

#[test]
fn a_bag_with_a_damaged_index_is_recovered() {
    let Some(path) = real_data("ros_bags/scan_tools_demo.bag") else { return };
    let (messages, issues) = read_all(&*open(path).unwrap());
    assert!(
        issues.iter().any(|issue| issue.text().contains("index")) && !issues[0].lost_data(),
        "{issues:?}"
    );
    // 278 in the chunk before the damage and 82 behind it; they follow each other at 10 Hz.
    assert_eq!(messages.len(), 278 + 82);
    let stamps: Vec<_> = messages.iter().map(|m| m.message.header().unwrap().stamp).collect();
    assert!(stamps.windows(2).all(|pair| (pair[1].seconds_since(pair[0]) - 0.1).abs() < 0.02));
}

#[test]
fn transforms_odometry_and_foreign_types_are_read() {
    if let Some(path) = real_data("ros_bags/evo_tf_example.bag") {
        let (messages, issues) = read_all(&*open(path).unwrap());
        assert_eq!((count_of(&messages, "/tf"), count_of(&messages, "/tf_static")), (517, 1));
        assert_eq!(issues, []);
        for message in &messages {
            let Message::Tf(tf) = &message.message else { panic!() };
            assert_eq!(tf.is_static, &*message.topic == "/tf_static");
            for transform in &tf.transforms {
                let q = transform.transform.orientation_xyzw;
                assert!((q.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 1e-3);
            }
        }
    }
    if let Some(path) = real_data("ros_bags/nav2_turtlebot.mcap") {
        let (messages, issues) = read_all(&*open(path).unwrap());
        assert_eq!(issues, []);
        assert_eq!((count_of(&messages, "/odom"), count_of(&messages, "/tf")), (2639, 5422));
        let Message::Odometry(odometry) = &messages.iter().find(|m| &*m.topic == "/odom").unwrap().message
        else {
            panic!()
        };
        assert!(!odometry.child_frame_id.is_empty() && odometry.pose_covariance.len() == 36);
    }
    if let Some(path) = real_data("ros_bags/ouster_512x10_raw.bag") {
        let (messages, issues) = read_all(&*open(path).unwrap());
        // The clock of that sensor counts from when it was switched on.
        assert!(
            issues.iter().all(|r| !r.lost_data() && r.kind == IssueKind::SensorClockNotSet),
            "{issues:?}"
        );
        let clouds: Vec<_> = messages
            .iter()
            .filter_map(|m| if let Message::PointCloud2(c) = &m.message { Some(c) } else { None })
            .collect();
        // 32 packets of 16 columns are one sweep of 512, in two pieces.
        assert!((1..=2).contains(&clouds.len()) && clouds.iter().map(|c| c.width).sum::<u32>() > 20_000);
        assert_eq!(count_of(&messages, "/os_node0/lidar_packets"), clouds.len());
        assert!(count_of(&messages, "/os_node0/imu_packets") > 0);
        let up: Vec<f64> = messages
            .iter()
            .filter_map(|m| if let Message::Imu(i) = &m.message { Some(i.linear_acceleration) } else { None })
            .map(|a| a.iter().map(|v| v * v).sum::<f64>().sqrt())
            .collect();
        assert!(up.iter().all(|a| (8.0..12.0).contains(a)), "{up:?}");
    }
}

#[test]
fn point_clouds_and_imu_are_read_in_order() {
    for path in ["lidar3d/corridor_imu.bag", "lidar3d/kitti_0001.bag"] {
        let Some(path) = real_data(path) else { continue };
        let recording = open(path).unwrap();
        let mut reader = recording.read(&|_| true).unwrap();
        let mut last = portolan_geometry::Time::MIN;
        let mut clouds = 0;
        while clouds < 5 {
            let message = reader.next_message().unwrap().unwrap();
            assert!(message.log_time >= last);
            last = message.log_time;
            match message.message {
                Message::PointCloud2(cloud) => {
                    let points = cloud.width as usize * cloud.height as usize;
                    assert_eq!(cloud.data.len(), points * cloud.point_step as usize);
                    assert!(points > 1000);
                    clouds += 1;
                }
                Message::Imu(imu) => assert!(imu.linear_acceleration[2] > 5.0),
                _ => {}
            }
        }
        assert_eq!(reader.issues(), []);
    }
}
