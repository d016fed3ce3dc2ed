//! Alignment of an estimate with the truth, without change of scale.

use portolan_geometry::{Quaternion, Rigid3, Vector3, nalgebra as na};
use serde::Serialize;

use crate::{EvaluationError, PosePair};

/// How the map of the estimate is aligned with the map of the ground truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum Alignment {
    /// No alignment: both use the same map frame already.
    None,
    /// The first common poses are made equal.
    FirstPose,
    /// Least-squares alignment of the positions in 2D; heights are not compared.
    #[default]
    Se2,
    /// Least-squares alignment of the positions (Umeyama 1991, with scale 1).
    Se3,
}

/// The transform `truth_from_estimate` between the maps of the pairs.
///
/// # Errors
/// If there is no pair, or no rotation brings the positions of the pairs together.
pub fn align(pairs: &[PosePair], alignment: Alignment) -> Result<Rigid3, EvaluationError> {
    let Some(first) = pairs.first() else { return Err(EvaluationError::EmptyTrajectory("associated")) };
    match alignment {
        Alignment::None => Ok(Rigid3::identity()),
        Alignment::FirstPose => Ok(first.truth * first.estimate.inverse()),
        Alignment::Se2 => best_rotation(pairs, Vector3::new(1.0, 1.0, 0.0), |h| {
            Some(Quaternion::from_axis_angle(&Vector3::z_axis(), (h.m12 - h.m21).atan2(h.m11 + h.m22)))
        }),
        Alignment::Se3 => best_rotation(pairs, Vector3::new(1.0, 1.0, 1.0), rotation_from_correlation),
    }
}

/// Least squares over the positions: the rotation from the correlation of the positions after both means are
/// subtracted, then the translation that aligns the means.
fn best_rotation(
    pairs: &[PosePair],
    axes: Vector3,
    rotation_from: impl Fn(&na::Matrix3<f64>) -> Option<Quaternion>,
) -> Result<Rigid3, EvaluationError> {
    let positions = |p: &PosePair| {
        (p.estimate.translation.vector.component_mul(&axes), p.truth.translation.vector.component_mul(&axes))
    };
    let count = pairs.len() as f64;
    let (mut mean_estimate, mut mean_truth) = (Vector3::zeros(), Vector3::zeros());
    for pair in pairs {
        let (estimate, truth) = positions(pair);
        mean_estimate += estimate / count;
        mean_truth += truth / count;
    }
    let mut correlation = na::Matrix3::zeros();
    for pair in pairs {
        let (estimate, truth) = positions(pair);
        correlation += (estimate - mean_estimate) * (truth - mean_truth).transpose();
    }
    if !correlation.iter().all(|v| v.is_finite()) {
        return Err(EvaluationError::CannotAlign);
    }
    let rotation = rotation_from(&correlation).ok_or(EvaluationError::CannotAlign)?;
    let translation = mean_truth - rotation * mean_estimate;
    Ok(Rigid3::from_parts(na::Translation3::from(translation), rotation))
}

fn rotation_from_correlation(correlation: &na::Matrix3<f64>) -> Option<Quaternion> {
    let svd = correlation.try_svd(true, true, f64::EPSILON, 1000)?;
    let (u, v) = (svd.u?, svd.v_t?.transpose());
    // Without this a planar trajectory could be mirrored instead of rotated.
    let sign = (v * u.transpose()).determinant().signum();
    let rotation = v * na::Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * u.transpose();
    Some(Quaternion::from_rotation_matrix(&na::Rotation3::from_matrix_unchecked(rotation)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Time, angular_distance};
    use proptest::prelude::*;

    fn pairs(positions: &[[f64; 3]], truth_from_estimate: &Rigid3) -> Vec<PosePair> {
        let pair = |(i, p): (usize, &[f64; 3])| {
            let estimate = Rigid3::new(Vector3::from(*p), Vector3::from(*p) * 0.1);
            PosePair { time: Time::from_ticks(i as i64), truth: truth_from_estimate * estimate, estimate }
        };
        positions.iter().enumerate().map(pair).collect()
    }

    proptest! {
        #[test]
        fn the_transform_is_found_again(
            positions in prop::collection::vec(prop::array::uniform3(-10.0..10.0f64), 4..20),
            t in prop::array::uniform3(-50.0..50.0f64), w in prop::array::uniform3(-1.7..1.7f64),
        ) {
            let expected = Rigid3::new(Vector3::from(t), Vector3::from(w));
            let found = align(&pairs(&positions, &expected), Alignment::Se3).unwrap();
            prop_assert!((found.translation.vector - expected.translation.vector).norm() < 1e-3);
            prop_assert!(angular_distance(&found.rotation, &expected.rotation) < 1e-4);
            let first = align(&pairs(&positions, &expected), Alignment::FirstPose).unwrap();
            prop_assert!(angular_distance(&first.rotation, &expected.rotation) < 1e-6);
        }
    }

    #[test]
    fn in_2d_heights_are_not_compared() {
        let expected = Rigid3::new(Vector3::new(1.0, 2.0, 0.0), Vector3::z() * 3.0);
        let positions = [[0.0, 0.0, 5.0], [1.0, 0.0, -5.0], [1.0, 2.0, 8.0]];
        let found = align(&pairs(&positions, &expected), Alignment::Se2).unwrap();
        assert!((found.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-12);
    }

    #[test]
    fn a_plane_is_turned_not_mirrored() {
        let expected = Rigid3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(2.0, 0.5, -0.3));
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 2.0, 0.0], [4.0, 1.0, 0.0]];
        let found = align(&pairs(&positions, &expected), Alignment::Se3).unwrap();
        assert!((found.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-9);
    }

    #[test]
    fn degenerate_and_damaged_positions() {
        for alignment in [Alignment::None, Alignment::FirstPose, Alignment::Se2, Alignment::Se3] {
            assert!(align(&[], alignment).is_err());
            let same = pairs(&[[1.0, 2.0, 3.0]; 3], &Rigid3::translation(1.0, 0.0, 0.0));
            assert!(align(&same, alignment).is_ok());
        }
        let huge = pairs(&[[1e200, 0.0, 0.0], [-1e200, 1e200, 0.0]], &Rigid3::identity());
        assert!(matches!(align(&huge, Alignment::Se3), Err(EvaluationError::CannotAlign)));
    }
}
