//! Analytic Jacobians of all factors against central differences, at random poses.

use nalgebra as na;
use portolan_geometry::{Quaternion, Rigid2, Rigid3, Vector3, quaternion_from_angle_axis};
use portolan_solver::factors::*;
use portolan_solver::{Factor, Manifold, Problem, VariableId, jacobian_error};
use proptest::prelude::*;

const CONVENTIONS: [Se3ErrorConvention; 3] =
    [Se3ErrorConvention::Logarithm, Se3ErrorConvention::DoubledQuaternion, Se3ErrorConvention::Quaternion];

/// Rounding of central differences; a wrong entry would be off by its whole size.
const TOLERANCE: f64 = 2e-7;

fn ids<const N: usize>() -> [VariableId; N] {
    let mut problem = Problem::new();
    std::array::from_fn(|_| problem.add_scalar(0.0))
}

fn se2() -> impl Strategy<Value = Rigid2> {
    (-5.0..5.0, -5.0..5.0, -7.0..7.0f64).prop_map(|(x, y, angle)| Rigid2::new(x, y, angle))
}

fn vector(size: f64) -> impl Strategy<Value = Vector3> {
    prop::array::uniform3(-size..size).prop_map(Vector3::from)
}

fn rotation(size: f64) -> impl Strategy<Value = Quaternion> {
    vector(size).prop_map(|v| quaternion_from_angle_axis(&v))
}

fn se3() -> impl Strategy<Value = Rigid3> {
    (vector(5.0), rotation(1.8)).prop_map(|(t, r)| Rigid3::from_parts(t.into(), r))
}

/// A pose near another: residuals of measurements that are not absurd.
fn near(pose: &Rigid3, by: &Rigid3) -> Rigid3 {
    let half = Rigid3::from_parts((by.translation.vector * 0.1).into(), by.rotation.powf(0.3));
    pose * half
}

fn pose_2d(pose: &Rigid2) -> (Manifold, Vec<f64>) {
    (Manifold::Se2, vec![pose.translation.x, pose.translation.y, pose.angle])
}

fn rotation_variable(q: &Quaternion) -> (Manifold, Vec<f64>) {
    (Manifold::Rotation(Default::default()), vec![q.w, q.i, q.j, q.k])
}

fn pose_3d(pose: &Rigid3) -> (Manifold, Vec<f64>) {
    let (t, q) = (pose.translation.vector, pose.rotation);
    (Manifold::SE3, vec![t.x, t.y, t.z, q.w, q.i, q.j, q.k])
}

fn check(factor: &dyn Factor, variables: &[(Manifold, Vec<f64>)]) -> Result<(), TestCaseError> {
    let error = jacobian_error(factor, variables);
    prop_assert!(error < TOLERANCE, "error {error:e}");
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn pairs_2d(a in se2(), b in se2(), noise in se2(), root in prop::array::uniform9(-2.0..2.0f64)) {
        // Keeps the angle error off ±π, where it jumps.
        let measurement = a.inverse() * b * Rigid2::new(noise.translation.x, noise.translation.y, noise.angle * 0.4);
        let variables = [pose_2d(&a), pose_2d(&b)];
        check(&Se2Between { variables: ids(), measurement, translation_weight: 2.0, rotation_weight: 0.7 }, &variables)?;
        let square_root_information = na::Matrix3::from_row_slice(&root);
        check(&Se2BetweenInformation { variables: ids(), measurement, square_root_information }, &variables)?;
        let [variable] = ids();
        let pose = b * Rigid2::new(noise.translation.x, noise.translation.y, noise.angle * 0.4);
        check(&Se2Prior { variable, pose, translation_weight: 2.0, rotation_weight: 0.7 }, &variables[1..])?;
    }

    #[test]
    fn pairs_3d(a in se3(), b in se3(), noise in se3(), root in prop::array::uniform32(-2.0..2.0f64)) {
        let measurement = near(&(a.inverse() * b), &noise);
        let variables = [pose_3d(&a), pose_3d(&b)];
        check(&Se3Between { variables: ids(), measurement, translation_weight: 2.0, rotation_weight: 0.7 }, &variables)?;
        let square_root_information = na::Matrix6::from_fn(|i, j| root[(6 * i + j) % 32]);
        for convention in CONVENTIONS {
            let factor = Se3BetweenInformation { variables: ids(), measurement, square_root_information, convention };
            check(&factor, &variables)?;
        }
        let [variable] = ids();
        let pose = near(&b, &noise);
        let rotation = pose.rotation;
        check(&RotationPrior { variable, rotation, weight: 0.7 }, &[rotation_variable(&b.rotation)])?;
        check(&Se3Prior { variable, pose, translation_weight: 2.0, rotation_weight: 0.7 }, &variables[1..])?;
    }

    #[test]
    fn landmarks(
        a in se3(), noise in se3(), landmark in se3(), seen in se3(), factor in 0.0..1.0f64, far in any::<bool>(),
    ) {
        let b = if far { a * noise } else { near(&a, &Rigid3::from_parts(noise.translation, noise.rotation.powf(1e-3))) };
        let tracking = Landmark3d {
            variables: ids(), interpolation_factor: factor, tracking_from_landmark: Rigid3::identity(),
            translation_weight: 2.0, rotation_weight: 0.7,
        }.interpolated_tracking_pose(&a, &b);
        let tracking_from_landmark = near(&(tracking.inverse() * landmark), &seen);
        let factor_3d = Landmark3d {
            variables: ids(), interpolation_factor: factor, tracking_from_landmark,
            translation_weight: 2.0, rotation_weight: 0.7,
        };
        // Where the arc is half a turn, the shorter side jumps.
        prop_assume!(a.rotation.coords.dot(&b.rotation.coords).abs() > 1e-3);
        check(&factor_3d, &[pose_3d(&a), pose_3d(&b), pose_3d(&landmark)])?;
    }

    #[test]
    fn landmarks_2d(
        a in se2(), turn in -2.0..2.0f64, gravity in prop::array::uniform2(0.0..0.3f64),
        landmark in se3(), seen in se3(), factor in 0.0..1.0f64,
    ) {
        let b = a * Rigid2::new(0.4, -0.1, turn);
        let gravity_alignments = gravity.map(|g| quaternion_from_angle_axis(&Vector3::new(g, -0.5 * g, 0.0)));
        let mut factor_2d = Landmark2d {
            variables: ids(), interpolation_factor: factor, gravity_alignments,
            tracking_from_landmark: Rigid3::identity(), translation_weight: 2.0, rotation_weight: 0.7,
        };
        let tracking = factor_2d.interpolated_tracking_pose(&a, &b);
        factor_2d.tracking_from_landmark = near(&(tracking.inverse() * landmark), &seen);
        check(&factor_2d, &[pose_2d(&a), pose_2d(&b), pose_3d(&landmark)])?;
    }

    #[test]
    fn imu(
        a in se3(), b in se3(), c in se3(), delta in rotation(0.5), calibration in rotation(1.5),
        dv in vector(3.0), g in 0.0..12.0f64,
    ) {
        let rotation = ImuRotation { variables: ids(), first_from_second: delta, weight: 3.0 };
        let calibrated = rotation_variable(&calibration);
        check(&rotation, &[pose_3d(&a), pose_3d(&b), calibrated.clone()])?;
        let acceleration = ImuAcceleration {
            variables: ids(), delta_velocity_in_second: dv, first_duration: 0.7, second_duration: 1.1, weight: 0.6,
        };
        let gravity = (Manifold::NonNegative, vec![g]);
        check(&acceleration, &[pose_3d(&a), pose_3d(&b), pose_3d(&c), gravity, calibrated])?;
    }

    #[test]
    fn numbers(x in prop::array::uniform3(-9.0..9.0f64)) {
        let [variable] = ids();
        let prior = EuclideanPrior { variable, target: na::Vector4::new(1.0, 2.0, 3.0, 4.0), dimension: 3, weight: 1.5 };
        check(&prior, &[(Manifold::Euclidean(3), x.to_vec())])?;
    }
}

#[test]
fn residuals_vanish_where_the_measurement_is_met() {
    let a = Rigid3::from_parts(
        Vector3::new(1.0, -2.0, 0.5).into(),
        quaternion_from_angle_axis(&Vector3::new(0.3, 1.0, -0.4)),
    );
    let b = a * Rigid3::from_parts(
        Vector3::new(0.2, 0.1, 0.0).into(),
        quaternion_from_angle_axis(&Vector3::new(0.0, 0.0, 3.1)),
    );
    let measurement = a.inverse() * b;
    let (a, b) = (pose_3d(&a).1, pose_3d(&b).1);
    let mut residual = [1.0; 6];
    let weighted =
        Se3Between { variables: ids(), measurement, translation_weight: 2.0, rotation_weight: 0.7 };
    assert!(weighted.evaluate(&[&a, &b], &mut residual, None));
    assert!(residual.iter().all(|r| r.abs() < 1e-12));
    let square_root_information = na::Matrix6::identity();
    let convention = Se3ErrorConvention::default();
    let full = Se3BetweenInformation { variables: ids(), measurement, square_root_information, convention };
    assert!(full.evaluate(&[&a, &b], &mut residual, None));
    assert!(residual.iter().all(|r| r.abs() < 1e-12));
    assert!(!full.evaluate(&[&a, &b[..3]], &mut residual, None));
}
