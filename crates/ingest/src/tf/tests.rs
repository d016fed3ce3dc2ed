use portolan_geometry::{Vector3, rotation_from_roll_pitch_yaw};
use proptest::prelude::*;

use super::*;

fn pose(x: f64, y: f64, yaw: f64) -> Rigid3 {
    Rigid3::from_parts(Vector3::new(x, y, 0.0).into(), rotation_from_roll_pitch_yaw(0.0, 0.0, yaw))
}

fn at(seconds: i64) -> Time {
    Time::from_ticks(seconds * 10_000_000)
}

fn robot() -> TfTree {
    let mut tree = TfTree::new();
    tree.insert_static("base_link", "laser", pose(0.5, 0.0, 0.0)).unwrap();
    tree.insert_static("base_link", "imu", pose(0.0, 0.2, 1.0)).unwrap();
    for t in 0..5 {
        tree.insert_moving("odom", "base_link", at(t), pose(t as f64, 0.0, 0.0)).unwrap();
    }
    tree
}

#[test]
fn transforms_chain_across_the_tree_and_time() {
    let tree = robot();
    let half = Time::from_ticks(15_000_000);
    let odom_from_laser = tree.lookup("odom", "laser", half).unwrap();
    assert!((odom_from_laser.translation.vector - Vector3::new(2.0, 0.0, 0.0)).norm() < 1e-9);
    let imu_from_laser = tree.lookup("imu", "laser", at(99)).unwrap();
    let expected = pose(0.0, 0.2, 1.0).inverse() * pose(0.5, 0.0, 0.0);
    assert!((imu_from_laser.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-12);
    assert_eq!(tree.lookup_static("imu", "laser"), Some(imu_from_laser));
    assert_eq!(tree.lookup_static("odom", "laser"), None);
    assert_eq!(tree.lookup("x", "x", half), Ok(Rigid3::identity()));
}

#[test]
fn faults_are_named() {
    let mut tree = robot();
    let late = tree.lookup("odom", "laser", at(7)).unwrap_err().to_string();
    assert!(late.contains("\"base_link\" in \"odom\" is known from"), "{late}");
    let unknown = tree.lookup("odom", "camera", at(1)).unwrap_err().to_string();
    assert!(unknown.contains("base_link, imu, laser, odom"), "{unknown}");
    tree.insert_static("arm", "camera", pose(0.0, 0.0, 0.0)).unwrap();
    let apart = tree.lookup("laser", "camera", at(1)).unwrap_err().to_string();
    assert!(apart.contains("below \"odom\"") && apart.contains("below \"arm\""), "{apart}");
    let closed = tree.insert_static("laser", "odom", pose(0.0, 0.0, 0.0)).unwrap_err().to_string();
    assert!(closed.contains("odom → base_link → laser → odom"), "{closed}");
    let twice = tree.insert_moving("camera", "imu", at(1), pose(0.0, 0.0, 0.0)).unwrap_err();
    assert!(matches!(twice, TfError::SecondParent { .. }));
    assert!(tree.insert_static("a", "a", pose(0.0, 0.0, 0.0)).is_err());
}

#[test]
fn old_poses_are_forgotten() {
    let mut tree = robot();
    tree.forget_before(at(3));
    assert!(tree.lookup("odom", "laser", at(1)).is_err());
    assert!(tree.lookup("odom", "laser", at(3)).is_ok());
}

#[test]
fn a_static_frame_has_one_pose_at_all_times() {
    let mut tree = TfTree::new();
    for t in [5, 6] {
        tree.insert_moving("base_link", "laser", at(t), pose(0.5, 0.0, 0.1)).unwrap();
    }
    assert!(tree.lookup("base_link", "laser", at(1)).is_ok());
    tree.insert_moving("base_link", "laser", at(7), pose(0.6, 0.0, 0.1)).unwrap();
    assert!(tree.lookup("base_link", "laser", at(1)).is_err());
}

#[test]
fn the_tree_is_written_as_text() {
    let text = robot().to_text();
    assert_eq!(
        text,
        "odom\n\
         └─ base_link (moves)\n   \
            ├─ imu (0 0.2 0 m, 0 0 57.2958°)\n   \
            └─ laser (0.5 0 0 m)\n"
    );
}

proptest! {
    #[test]
    fn random_trees_never_loop(edges in prop::collection::vec((0u8..12, 0u8..12, any::<bool>()), 0..60)) {
        let mut tree = TfTree::new();
        for (parent, child, moving) in edges {
            let (parent, child) = (format!("f{parent}"), format!("f{child}"));
            let _ = if moving {
                tree.insert_moving(&parent, &child, at(1), pose(1.0, 2.0, 0.3))
            } else {
                tree.insert_static(&parent, &child, pose(1.0, 2.0, 0.3))
            };
        }
        let frames: Vec<String> = tree.frames().map(str::to_owned).collect();
        for a in &frames {
            for b in &frames {
                if let Ok(a_from_b) = tree.lookup(a, b, at(1)) {
                    let b_from_a = tree.lookup(b, a, at(1)).unwrap();
                    prop_assert!(((a_from_b * b_from_a).to_homogeneous() - Rigid3::identity().to_homogeneous()).norm() < 1e-9);
                }
            }
        }
        tree.to_text();
    }
}
