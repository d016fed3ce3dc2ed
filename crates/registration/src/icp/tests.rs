use super::pairs::moved;
use super::*;
use portolan_geometry::Vector3;
use portolan_geometry::angular_distance;

/// Three walls of a room's corner and a column, on no common grid.
pub(crate) fn corner() -> Vec<[f32; 3]> {
    let mut points = Vec::new();
    let mut state = 7u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1u32 << 24) as f32
    };
    for _ in 0..1500 {
        let (a, b) = (random() * 4.0, random() * 3.0);
        points.extend([[a, b, 0.0], [a, 0.0, b], [0.0, a, b]]);
        let angle = random() * std::f32::consts::TAU;
        points.push([2.0 + 0.3 * angle.cos(), 1.5 + 0.3 * angle.sin(), b]);
    }
    points
}

fn all_methods() -> Vec<IcpMethod> {
    use ClosedForm::*;
    let forms = [Quaternion, Svd, Orthonormal, DualQuaternion, Helix, SmallAngle];
    let mut methods: Vec<IcpMethod> = forms.map(IcpMethod::PointToPoint).to_vec();
    methods.extend([IcpMethod::PointToPlane, IcpMethod::Generalized]);
    methods
}

#[test]
fn every_method_finds_the_pose_of_a_moved_scan() {
    let expected = Rigid3::new(Vector3::new(0.05, -0.04, 0.03), Vector3::new(0.02, -0.01, 0.03));
    let back = expected.inverse();
    let model = ScanCloud::with_surfaces(corner(), 12, 0.5);
    let moved_points = corner()
        .into_iter()
        .step_by(3)
        .map(|p| moved(&back, p))
        .map(|p| [p.x as f32, p.y as f32, p.z as f32]);
    let data = ScanCloud::with_surfaces(moved_points.collect(), 10, 0.7);
    for method in all_methods() {
        let options = IcpOptions { method, max_distance: 0.5, max_iterations: 100, ..IcpOptions::default() };
        let found = icp(&model, &data, &Rigid3::identity(), &options).unwrap();
        let shift = (found.model_from_data.translation.vector - expected.translation.vector).norm();
        let turn = angular_distance(&found.model_from_data.rotation, &expected.rotation);
        assert!(
            shift < 2e-3 && turn < 1e-3,
            "{method:?}: {shift} m, {turn} rad in {} steps",
            found.iterations
        );
        assert!(found.converged && found.pairs > 1000 && found.covariance.is_some(), "{method:?}");
    }
}

#[test]
fn outliers_are_kept_out_by_trimming_and_kernels() {
    let expected = Rigid3::new(Vector3::new(0.03, 0.02, -0.02), Vector3::new(0.0, 0.01, 0.01));
    let back = expected.inverse();
    let model = ScanCloud::with_surfaces(corner(), 12, 0.5);
    let mut points: Vec<[f32; 3]> = corner()
        .iter()
        .step_by(4)
        .map(|p| moved(&back, *p))
        .map(|p| [p.x as f32, p.y as f32, p.z as f32])
        .collect();
    for i in 0..200 {
        points.push([1.0 + 0.001 * i as f32, 0.2, 1.0]);
    }
    let data = ScanCloud::new(points);
    let run = |options: IcpOptions| {
        let found = icp(&model, &data, &Rigid3::identity(), &options).unwrap();
        (found.model_from_data.translation.vector - expected.translation.vector).norm()
    };
    let base = IcpOptions { max_distance: 0.5, max_iterations: 100, ..IcpOptions::default() };
    let plain = run(base);
    assert!(run(IcpOptions { keep: 0.8, ..base }) < plain.min(5e-3));
    assert!(run(IcpOptions { kernel: RobustKernel::GemanMcClure(0.05), ..base }) < plain.min(5e-3));
    assert!(run(IcpOptions { reciprocal: true, ..base }) < 0.5 * plain);
}

#[test]
fn scans_that_cannot_be_matched_are_named() {
    let model = ScanCloud::new(corner());
    let run = |points: Vec<[f32; 3]>, guess: &Rigid3, options: IcpOptions| {
        icp(&model, &ScanCloud::new(points), guess, &options).unwrap_err()
    };
    let (here, usual) = (Rigid3::identity(), IcpOptions::default());
    let far = Rigid3::translation(100.0, 0.0, 0.0);
    let IcpError::TooFewPairs { found: 0, nearest: Some(nearest), .. } = run(corner(), &far, usual) else {
        panic!("scans that do not overlap")
    };
    assert!((95.9..=96.1).contains(&nearest), "{nearest}");
    assert_eq!(run(Vec::new(), &here, usual), IcpError::NoPoints("data"));
    assert_eq!(run(vec![[f32::NAN; 3]; 10], &here, usual), IcpError::NoPoints("data"));
    assert_eq!(run(vec![[1.0; 3]; 10], &here, usual), IcpError::OnePlace("data"));
    assert_eq!(run(vec![[1.0; 3]], &here, usual), IcpError::OnePlace("data"));
    let planes = IcpOptions { method: IcpMethod::PointToPlane, ..usual };
    assert_eq!(run(corner(), &here, planes), IcpError::NoSurfaces);
    let nothing = icp(&ScanCloud::new(Vec::new()), &model, &here, &usual);
    assert_eq!(nothing.unwrap_err(), IcpError::NoPoints("model"));
}

#[test]
fn points_that_are_not_finite_do_not_count() {
    let model = ScanCloud::new(corner());
    let mut points: Vec<[f32; 3]> = corner().into_iter().step_by(2).map(|p| p.map(|v| v + 0.01)).collect();
    let clean =
        icp(&model, &ScanCloud::new(points.clone()), &Rigid3::identity(), &IcpOptions::default()).unwrap();
    points.extend([[f32::NAN; 3], [f32::INFINITY, 0.0, 0.0]]);
    let dirty = icp(&model, &ScanCloud::new(points), &Rigid3::identity(), &IcpOptions::default()).unwrap();
    assert_eq!(clean.model_from_data, dirty.model_from_data);
}

/// Partners kept without a search are those that a search finds: the result is that of searching always.
#[test]
fn few_points_first_and_partners_kept_end_at_the_same_place() {
    let model = ScanCloud::new(corner());
    let data =
        ScanCloud::new(corner().into_iter().map(|p| [p[0] + 0.03, p[1] - 0.02, p[2] + 0.02]).collect());
    let options = IcpOptions { epsilon: 1e-12, max_iterations: 300, ..IcpOptions::default() };
    let all = icp(&model, &data, &Rigid3::identity(), &IcpOptions { first_points: 0, ..options }).unwrap();
    let few = icp(&model, &data, &Rigid3::identity(), &IcpOptions { first_points: 300, ..options }).unwrap();
    let difference = all.model_from_data.to_homogeneous() - few.model_from_data.to_homogeneous();
    assert!(difference.norm() < 1e-5, "{difference}");
    let pose = Rigid3::translation(-0.03, 0.02, -0.02);
    let mut pairing = Pairing::new(&model, &data, &options);
    for step in 0..20 {
        let near = Rigid3::translation(0.002 / f64::from(1 << step), 0.0, 0.0) * pose;
        let kept = pairing.find(&near, 1);
        let searched = Pairing::new(&model, &data, &options).find(&near, 1);
        assert_eq!(kept.len(), searched.len());
        assert!(kept.iter().zip(&searched).all(|(a, b)| (a.distance - b.distance).abs() < 1e-6));
    }
}
