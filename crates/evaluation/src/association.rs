//! Association of the poses of an estimate with poses of the ground truth, by time.

use portolan_geometry::{Duration, Rigid3, Time};

use crate::{EvaluationError, Trajectory};

/// How poses are associated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Association {
    /// The truth is interpolated at the times of the estimate. Poses of the estimate within gaps of the truth
    /// longer than `max_gap` have no counterpart. [`Association::default`] has no limit.
    Interpolate {
        /// Longest gap of the truth over which poses are interpolated.
        max_gap: Option<Duration>,
    },
    /// The pose of the truth that is nearest in time.
    Nearest {
        /// Largest difference in time.
        tolerance: Duration,
    },
}

impl Default for Association {
    fn default() -> Self {
        Self::Interpolate { max_gap: None }
    }
}

/// The poses of both trajectories at one time. The two map frames may differ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePair {
    /// Time of the pose of the estimate.
    pub time: Time,
    /// The tracking frame in the map of the truth.
    pub truth: Rigid3,
    /// The tracking frame in the map of the estimate.
    pub estimate: Rigid3,
}

/// Pairs in order of time: one for every pose of the estimate that the truth covers, at least one.
///
/// # Errors
/// If a trajectory has no poses, or no pose of the estimate has a counterpart.
pub fn associate(
    truth: &Trajectory,
    estimate: &Trajectory,
    association: Association,
) -> Result<Vec<PosePair>, EvaluationError> {
    let truth_span = truth.span().ok_or(EvaluationError::EmptyTrajectory("true"))?;
    let estimate_span = estimate.span().ok_or(EvaluationError::EmptyTrajectory("estimated"))?;
    let pair = |pose: &crate::TimedPose| {
        let truth = match association {
            Association::Interpolate { max_gap } => interpolated(truth, pose.time, max_gap)?,
            Association::Nearest { tolerance } => truth.nearest(pose.time, tolerance)?.map_from_tracking,
        };
        Some(PosePair { time: pose.time, truth, estimate: pose.map_from_tracking })
    };
    let pairs: Vec<PosePair> = estimate.poses().iter().filter_map(pair).collect();
    if pairs.is_empty() {
        return Err(EvaluationError::NothingAssociated {
            estimate_start: estimate_span.0.unix_decimal(),
            estimate_end: estimate_span.1.unix_decimal(),
            truth_start: truth_span.0.unix_decimal(),
            truth_end: truth_span.1.unix_decimal(),
        });
    }
    Ok(pairs)
}

fn interpolated(truth: &Trajectory, time: Time, max_gap: Option<Duration>) -> Option<Rigid3> {
    let (before, after) = truth.neighbours(time)?;
    if max_gap.is_some_and(|max_gap| after.time - before.time > max_gap) {
        return None;
    }
    truth.lookup(time)
}
