use super::*;
use crate::links_by_overlap;
use portolan_geometry::{angular_distance, nalgebra as na};

/// A ring of scans of a room with four walls, a floor and three columns, each scan in its own frame.
fn scans(true_poses: &[Rigid3]) -> Vec<ScanCloud> {
    let mut state = 11u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1u32 << 24)
    };
    true_poses
        .iter()
        .map(|pose| {
            let back = pose.inverse();
            let mut points = Vec::new();
            for _ in 0..500 {
                let (u, v, h) = (random() * 6.0, random() * 5.0, random() * 2.5);
                let turn = random() * std::f64::consts::TAU;
                for p in [
                    [u, v, 0.0],
                    [u, 0.0, h],
                    [u, 5.0, h],
                    [0.0, v, h],
                    [6.0, v, h],
                    [2.0 + 0.3 * turn.cos(), 1.5 + 0.3 * turn.sin(), h],
                    [4.2 + 0.2 * turn.cos(), 3.1 + 0.2 * turn.sin(), h],
                ] {
                    let x = back * na::Point3::from(p);
                    points.push([x.x as f32, x.y as f32, x.z as f32]);
                }
            }
            ScanCloud::new(points)
        })
        .collect()
}

fn true_poses() -> Vec<Rigid3> {
    (0..5)
        .map(|i| f64::from(i) * 1.2)
        .map(|a| {
            Rigid3::new(
                Vector3::new(3.0 + a.cos(), 2.5 + a.sin(), 1.0 + 0.1 * a),
                Vector3::new(0.1 * a.sin(), 0.05, 0.5 * a),
            )
        })
        .collect()
}

fn disturbed(poses: &[Rigid3]) -> Vec<Rigid3> {
    poses
        .iter()
        .enumerate()
        .map(|(i, pose)| {
            let k = if i == 0 { 0.0 } else { 1.0 };
            let s = f64::from(i as u32);
            let error = Rigid3::new(
                Vector3::new((s * 2.1).sin(), (s * 1.7).cos(), (s * 3.3).sin()) * (0.06 * k),
                Vector3::new((s * 1.1).sin(), (s * 2.9).cos(), (s * 0.7).sin()) * (0.015 * k),
            );
            pose * error
        })
        .collect()
}

#[test]
fn all_variants_agree_and_find_the_poses() {
    let truth = true_poses();
    let scans = scans(&truth);
    for method in [
        GlobalMethod::Se3,
        GlobalMethod::Euler,
        GlobalMethod::Quaternion,
        GlobalMethod::Helix,
        GlobalMethod::SmallAngle,
    ] {
        let mut poses = disturbed(&truth);
        let links = links_by_overlap(&scans, &poses, 400, 0.5);
        assert_eq!(links.len(), 10);
        let options = GlobalOptions { method, max_iterations: 60, ..GlobalOptions::default() };
        let report = register_globally(&scans, &mut poses, &links, &options).unwrap();
        assert_eq!(report.links, 10, "{method:?}");
        for (pose, truth) in poses.iter().zip(&truth) {
            let shift = (pose.translation.vector - truth.translation.vector).norm();
            let turn = angular_distance(&pose.rotation, &truth.rotation);
            assert!(
                shift < 0.02 && turn < 0.01,
                "{method:?}: {shift} m {turn} rad after {}",
                report.iterations
            );
        }
        let weighted = matches!(method, GlobalMethod::Se3 | GlobalMethod::Euler);
        assert_eq!(report.covariances.len(), if weighted { 5 } else { 0 });
    }
}

#[test]
fn links_to_nowhere_are_refused_and_lone_scans_stay() {
    let truth = true_poses();
    let scans = scans(&truth);
    let mut poses = truth.clone();
    let options = GlobalOptions { max_iterations: 2, ..GlobalOptions::default() };
    assert!(register_globally(&scans, &mut poses, &[Link { from: 0, to: 9 }], &options).is_err());
    register_globally(&scans, &mut poses, &[Link { from: 0, to: 1 }], &options).unwrap();
    assert!((poses[3].to_homogeneous() - truth[3].to_homogeneous()).norm() < 1e-9);
}

#[test]
fn euler_steps_agree_with_twists_to_first_order() {
    let pose = Rigid3::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.3, 0.4, -1.1));
    let error = Vector6::new(1e-5, -2e-5, 3e-5, 2e-5, -1e-5, 1e-5);
    let difference =
        move_by_euler(&pose, &error).to_homogeneous() - move_by_twist(&pose, &-error).to_homogeneous();
    assert!(difference.norm() < 1e-8, "{difference}");
}

/// The error that one step of a method leaves when scan 1 is off by `scale` times a motion and pairs are exact.
fn left_after_one_step(method: GlobalMethod, scale: f64) -> f64 {
    let truth = Rigid3::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.3, 0.4, -1.1));
    let motion = Rigid3::new(Vector3::new(0.3, -0.2, 0.4) * scale, Vector3::new(-0.3, 0.5, 0.2) * scale);
    let mut poses = [Rigid3::translation(0.2, 0.1, 0.0), motion * truth];
    let links = [Link { from: 0, to: 1 }];
    let mut sums = LinkSums::empty();
    for i in 0..60 {
        let i = f64::from(i);
        let place = Vector3::new((i * 0.7).sin() * 5.0, (i * 1.1).cos() * 4.0, (i * 0.3).sin() * 2.0);
        // A little scatter, without which links are not used; it has no mean and no moment worth mentioning.
        let noise = Vector3::new((i * 12.9).sin(), (i * 78.2).sin(), (i * 37.7).sin()) * 1e-5;
        let moved = (motion * na::Point3::from(place)).coords;
        sums.add(&(place + noise), &moved, method == GlobalMethod::Quaternion);
    }
    let mut report = register_globally(&[], &mut [], &[], &GlobalOptions::default()).unwrap();
    match method {
        GlobalMethod::Quaternion => {
            assert_eq!(update::quaternion_step(&mut poses, &links, &[sums]).unwrap(), 1)
        }
        GlobalMethod::Helix => assert_eq!(update::helix_step(&mut poses, &links, &[sums]).unwrap(), 1),
        GlobalMethod::SmallAngle => {
            assert_eq!(update::small_angle_step(&mut poses, &links, &[sums]).unwrap(), 1)
        }
        _ => weighted_step(&mut poses, &links, &[sums], method, &mut report).unwrap(),
    }
    (poses[1].to_homogeneous() - truth.to_homogeneous()).norm()
}

/// With the right derivatives one step leaves an error of second order: a tenth of the motion, a hundredth of it.
#[test]
fn every_variant_has_the_right_derivatives() {
    use GlobalMethod::{Euler, Helix, Quaternion, Se3, SmallAngle};
    for method in [Se3, Euler, Quaternion, Helix, SmallAngle] {
        let (large, small) = (left_after_one_step(method, 0.1), left_after_one_step(method, 0.01));
        assert!(large < 0.02 && small < 0.02 * large + 2e-5, "{method:?}: {large} {small}");
    }
}
