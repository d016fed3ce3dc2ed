//! Absolute trajectory error (ATE): the error of each pose after the estimate is aligned with the ground
//! truth (Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", 2012).

use std::fmt;

use portolan_geometry::{Rigid3, rotation_angle, yaw};
use serde::Serialize;

use crate::alignment::align;
use crate::association::associate;
use crate::statistics::ErrorStatistics;
use crate::{Alignment, Association, EvaluationError, PosePair, Trajectory};

/// Absolute errors of a trajectory.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AbsoluteErrors {
    /// Poses of the estimate that were compared.
    pub count: usize,
    /// All poses of the estimate.
    pub estimate_poses: usize,
    /// All poses of the truth.
    pub truth_poses: usize,
    /// How the maps were aligned.
    pub alignment: Alignment,
    /// The map of the estimate in that of the truth: x y z (m), qx qy qz qw.
    pub truth_from_estimate: [f64; 7],
    /// Metres; in 2D for [`Alignment::Se2`].
    pub translation: ErrorStatistics,
    /// Degrees; of heading alone for [`Alignment::Se2`].
    pub rotation_degrees: ErrorStatistics,
    /// Length of the true path between the first and the last compared pose, metres.
    pub path_length: f64,
}

/// Compares an estimate with the truth.
///
/// # Errors
/// As for [`associate`].
pub fn absolute_errors(
    truth: &Trajectory,
    estimate: &Trajectory,
    association: Association,
    alignment: Alignment,
) -> Result<AbsoluteErrors, EvaluationError> {
    let pairs = associate(truth, estimate, association)?;
    let truth_from_estimate = align(&pairs, alignment)?;
    let (translation, rotation): (Vec<f64>, Vec<f64>) =
        pairs.iter().map(|p| error_of(p, &truth_from_estimate, alignment)).unzip();
    let empty = || EvaluationError::EmptyTrajectory("associated");
    let covered = crate::trajectory::covered_distances(pairs.iter().map(|p| &p.truth));
    let t = truth_from_estimate.translation;
    let [qx, qy, qz, qw] = crate::quaternion_xyzw(&truth_from_estimate);
    Ok(AbsoluteErrors {
        count: pairs.len(),
        estimate_poses: estimate.len(),
        truth_poses: truth.len(),
        alignment,
        truth_from_estimate: [t.x, t.y, t.z, qx, qy, qz, qw],
        translation: ErrorStatistics::of(&translation).ok_or_else(empty)?,
        rotation_degrees: ErrorStatistics::of(&rotation).ok_or_else(empty)?,
        path_length: covered.last().copied().unwrap_or(0.0),
    })
}

/// Metres and degrees.
fn error_of(pair: &PosePair, truth_from_estimate: &Rigid3, alignment: Alignment) -> (f64, f64) {
    let aligned = truth_from_estimate * pair.estimate;
    let mut offset = aligned.translation.vector - pair.truth.translation.vector;
    let rotation = pair.truth.inverse() * aligned;
    if alignment == Alignment::Se2 {
        offset.z = 0.0;
        return (offset.norm(), yaw(&rotation.rotation).abs().to_degrees());
    }
    (offset.norm(), rotation_angle(&rotation).to_degrees())
}

impl fmt::Display for AbsoluteErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let aligned = match self.alignment {
            Alignment::None => "not aligned",
            Alignment::FirstPose => "first pose made to agree",
            Alignment::Se2 => "aligned in 2D",
            Alignment::Se3 => "aligned in 3D",
        };
        writeln!(
            f,
            "Absolute trajectory error of {} poses over {:.1} m ({aligned})",
            self.count, self.path_length
        )?;
        writeln!(f, "  translation  {} m", self.translation)?;
        write!(f, "  rotation     {} deg", self.rotation_degrees)
    }
}
