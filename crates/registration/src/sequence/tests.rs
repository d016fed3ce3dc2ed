use super::*;
use crate::IcpMethod;
use portolan_geometry::{Vector3, angular_distance, nalgebra as na};

/// Scans on a loop through a hall with pillars, each with the surfaces within 6 m.
fn hall(count: usize) -> (Vec<ScanCloud>, Vec<Rigid3>) {
    let mut state = 17_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1_u32 << 24)
    };
    let pillars: Vec<[f64; 3]> =
        (0..30).map(|_| [20.0 * random(), 20.0 * random(), 0.2 + 0.3 * random()]).collect();
    let truth: Vec<Rigid3> = (0..count)
        .map(|i| i as f64 * std::f64::consts::TAU / (count - 3) as f64)
        .map(|a| {
            let place = Vector3::new(10.0 + 7.0 * a.cos(), 10.0 + 7.0 * a.sin(), 1.0);
            Rigid3::new(place, Vector3::z() * a)
        })
        .collect();
    let scans = truth
        .iter()
        .map(|pose| {
            let (mut points, mut kind) = (Vec::new(), 0);
            while points.len() < 6000 {
                kind += 1;
                let (u, v, h) = (20.0 * random(), 20.0 * random(), 3.0 * random());
                let pillar = pillars[(random() * 30.0) as usize % 30];
                let turn = random() * std::f64::consts::TAU;
                let p = match kind % 5 {
                    0 => [u, v, 0.0],
                    1 => [[u, 0.0, h], [u, 20.0, h]][usize::from(random() > 0.5)],
                    2 => [[0.0, v, h], [20.0, v, h]][usize::from(random() > 0.5)],
                    _ => [pillar[0] + pillar[2] * turn.cos(), pillar[1] + pillar[2] * turn.sin(), h],
                };
                let x = pose.inverse() * na::Point3::from(p);
                if x.coords.norm() < 9.0 {
                    points.push([x.x as f32, x.y as f32, x.z as f32]);
                }
            }
            ScanCloud::with_surfaces(points, 12, 1.0)
        })
        .collect();
    (scans, truth)
}

fn worst(poses: &[Rigid3], truth: &[Rigid3]) -> (f64, f64) {
    poses.iter().zip(truth).fold((0.0, 0.0), |(shift, turn), (p, t)| {
        let s = (p.translation.vector - t.translation.vector).norm();
        (f64::max(shift, s), f64::max(turn, angular_distance(&p.rotation, &t.rotation)))
    })
}

/// Poses whose every step is a little wrong.
fn drifted(truth: &[Rigid3]) -> Vec<Rigid3> {
    let drift = Rigid3::new(Vector3::new(0.02, 0.01, 0.0), Vector3::z() * 0.004);
    let mut poses = vec![truth[0]];
    for pair in truth.windows(2) {
        let last = poses[poses.len() - 1];
        poses.push(last * (pair[0].inverse() * pair[1]) * drift);
    }
    poses
}

#[test]
fn scans_are_registered_one_after_the_other() {
    let (scans, truth) = hall(12);
    for model in [ModelScans::Previous, ModelScans::All, ModelScans::Last(3)] {
        let mut poses = drifted(&truth);
        let icp = IcpOptions { method: IcpMethod::PointToPlane, max_distance: 0.5, ..IcpOptions::default() };
        let options = SequenceOptions { icp, model, ..SequenceOptions::default() };
        let mut seen = Vec::new();
        let before = worst(&poses, &truth).0;
        let report = register_sequence(&scans, &mut poses, &options, &mut |i| seen.push(i));
        assert_eq!(seen, (1..12).collect::<Vec<_>>());
        assert!(report.matched[1..].iter().all(|m| matches!(m, Some(Ok(_)))), "{:?}", report.matched);
        let (shift, turn) = worst(&poses, &truth);
        assert!(shift < 0.5 * before && turn < 0.03, "{model:?}: {shift} m of {before} m, {turn} rad");
    }
}

#[test]
fn loops_are_closed_where_the_path_returns() {
    let (scans, truth) = hall(27);
    let mut poses = drifted(&truth);
    // Matching is switched off in effect: only the loop closure corrects the poses.
    let icp = IcpOptions { max_distance: 1e-4, ..IcpOptions::default() };
    let loops = LoopOptions { distance: 3.0, least_scans: 15, max_distance: 2.0, max_iterations: 100 };
    let options = SequenceOptions { icp, loops: Some(loops), ..SequenceOptions::default() };
    let before = worst(&poses, &truth).0;
    let report = register_sequence(&scans, &mut poses, &options, &mut |_| ());
    assert_eq!(report.loops.len(), 1, "{:?}", report.loops);
    assert!(report.loops[0].translation > 0.3);
    let (shift, _) = worst(&poses, &truth);
    assert!(shift < 0.6 * before, "{shift} m of {before} m");
}

#[test]
fn a_scan_of_another_place_is_named_and_moves_with_the_others() {
    let (mut scans, truth) = hall(4);
    scans[2] = ScanCloud::new((0..100).map(|i| [500.0 + i as f32, 900.0, 30.0]).collect());
    let mut poses = truth.clone();
    let report = register_sequence(&scans, &mut poses, &SequenceOptions::default(), &mut |_| ());
    let Some(Err(error)) = &report.matched[2] else { panic!("{:?}", report.matched[2]) };
    assert!(error.to_string().contains("0 of 100 points") && error.to_string().contains("apart"), "{error}");
    assert!(matches!(report.matched[1], Some(Ok(_))));
    assert_eq!(unlinked_scans(4, &[Link { from: 0, to: 1 }, Link { from: 3, to: 1 }]), [2]);
}

#[test]
fn threads_change_nothing() {
    let (scans, truth) = hall(8);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut poses = drifted(&truth);
        let options = SequenceOptions {
            icp: IcpOptions { first_points: 500, max_distance: 0.5, ..IcpOptions::default() },
            model: ModelScans::All,
            ..SequenceOptions::default()
        };
        pool.install(|| register_sequence(&scans, &mut poses, &options, &mut |_| ()));
        poses
    };
    let one = run(1);
    assert!(one == run(2) && one == run(4));
}
