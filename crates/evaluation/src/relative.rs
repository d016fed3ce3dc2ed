//! Relative pose error (RPE): the error of the estimated motion over a step of time or of distance; and the
//! drift over segments of given lengths, as in the KITTI benchmark (Geiger et al. 2012).

use std::fmt;

use portolan_geometry::{Duration, Rigid3, rotation_angle};
use serde::Serialize;

use crate::association::associate;
use crate::statistics::ErrorStatistics;
use crate::trajectory::covered_distances;
use crate::{Association, EvaluationError, PosePair, Trajectory};

/// Step over which motions are compared.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Step {
    /// Seconds.
    Time(f64),
    /// Metres along the true path.
    Distance(f64),
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Time(seconds) => write!(f, "{seconds} s"),
            Self::Distance(metres) => write!(f, "{metres} m"),
        }
    }
}

/// Relative errors of a trajectory over one step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RelativeErrors {
    /// The step.
    pub step: Step,
    /// Metres per step.
    pub translation: ErrorStatistics,
    /// Degrees per step.
    pub rotation_degrees: ErrorStatistics,
}

/// Error of a motion, in the frame of its start: metres and degrees.
fn motion_error(truth: (&Rigid3, &Rigid3), estimate: (&Rigid3, &Rigid3)) -> (f64, f64) {
    let true_motion = truth.0.inverse() * truth.1;
    let estimated_motion = estimate.0.inverse() * estimate.1;
    let error = true_motion.inverse() * estimated_motion;
    (error.translation.vector.norm(), rotation_angle(&error).to_degrees())
}

fn between(a: &PosePair, b: &PosePair) -> (f64, f64) {
    motion_error((&a.truth, &b.truth), (&a.estimate, &b.estimate))
}

/// Compares motions over a step, starting at every pose of the estimate that has a pose one step later. For a
/// step of time both trajectories are interpolated at the later time. For a distance the motion ends at the
/// first pose that is at least this many metres further along the true path. The maps need no alignment.
///
/// # Errors
/// If the step is not above zero, or as for [`associate`].
pub fn relative_errors(
    truth: &Trajectory,
    estimate: &Trajectory,
    association: Association,
    step: Step,
) -> Result<RelativeErrors, EvaluationError> {
    let (Step::Time(size) | Step::Distance(size)) = step;
    if size.is_nan() || size <= 0.0 {
        return Err(EvaluationError::BadStep(size));
    }
    let pairs = associate(truth, estimate, association)?;
    let errors: Vec<(f64, f64)> = match step {
        Step::Time(seconds) => {
            let later = |a: &PosePair| {
                let time = a.time + Duration::from_seconds(seconds);
                Some(PosePair { time, truth: truth.lookup(time)?, estimate: estimate.lookup(time)? })
            };
            pairs.iter().filter_map(|a| Some(between(a, &later(a)?))).collect()
        }
        Step::Distance(metres) => {
            let covered = covered_distances(pairs.iter().map(|p| &p.truth));
            let further = |(a, start): (&PosePair, &f64)| {
                let end = covered.partition_point(|c| *c < start + metres);
                Some(between(a, pairs.get(end)?))
            };
            pairs.iter().zip(&covered).filter_map(further).collect()
        }
    };
    let (translation, rotation): (Vec<f64>, Vec<f64>) = errors.into_iter().unzip();
    let too_long = || EvaluationError::StepTooLong(step.to_string());
    Ok(RelativeErrors {
        step,
        translation: ErrorStatistics::of(&translation).ok_or_else(too_long)?,
        rotation_degrees: ErrorStatistics::of(&rotation).ok_or_else(too_long)?,
    })
}

impl fmt::Display for RelativeErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Relative pose error over {} ({} motions)", self.step, self.translation.count)?;
        writeln!(f, "  translation  {} m", self.translation)?;
        write!(f, "  rotation     {} deg", self.rotation_degrees)
    }
}

/// Drift over all segments of one length, or of all lengths.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SegmentErrors {
    /// Length of the segments, metres; `None` for the mean over all lengths.
    pub length: Option<f64>,
    /// Number of segments.
    pub count: usize,
    /// Mean translational error, per cent of the length.
    pub translation_percent: f64,
    /// Mean rotational error, degrees per metre.
    pub rotation_degrees_per_metre: f64,
}

/// Drift of a trajectory.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Drift {
    /// One entry for each length with at least one segment.
    pub by_length: Vec<SegmentErrors>,
    /// Over all segments; none if the trajectory is shorter than the shortest length.
    pub mean: Option<SegmentErrors>,
    /// Length of the true path, metres.
    pub path_length: f64,
    /// Error of the last pose after the first poses are aligned, metres.
    pub end_translation: f64,
    /// Error of the last pose after the first poses are aligned, degrees.
    pub end_rotation_degrees: f64,
}

/// Lengths of the KITTI benchmark, metres.
pub const KITTI_LENGTHS: [f64; 8] = [100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0];
/// The KITTI benchmark starts a segment at every tenth pose.
pub const KITTI_STRIDE: usize = 10;

/// Measures drift over segments of the given lengths (metres along the true path), started at every
/// `stride`-th pose. A segment ends at the first pose beyond its length. [`KITTI_LENGTHS`] and
/// [`KITTI_STRIDE`] give the figures of that benchmark.
///
/// # Errors
/// If a length is not above zero, or as for [`associate`].
pub fn drift(
    truth: &Trajectory,
    estimate: &Trajectory,
    association: Association,
    lengths: &[f64],
    stride: usize,
) -> Result<Drift, EvaluationError> {
    if let Some(bad) = lengths.iter().find(|l| l.is_nan() || **l <= 0.0) {
        return Err(EvaluationError::BadStep(*bad));
    }
    let pairs = associate(truth, estimate, association)?;
    let covered = covered_distances(pairs.iter().map(|p| &p.truth));
    let mut all = Vec::new();
    let mut by_length = Vec::new();
    for length in lengths {
        let starts = pairs.iter().zip(&covered).step_by(stride.max(1));
        let errors: Vec<(f64, f64)> = starts
            .filter_map(|(start, from)| {
                let end = covered.partition_point(|c| *c <= from + length);
                let (translation, rotation) = between(start, pairs.get(end)?);
                Some((translation / length, rotation / length))
            })
            .collect();
        by_length.extend(mean_of(&errors, Some(*length)));
        all.extend(errors);
    }
    let (Some(first), Some(last)) = (pairs.first(), pairs.last()) else {
        return Err(EvaluationError::EmptyTrajectory("associated"));
    };
    let (end_translation, end_rotation_degrees) = between(first, last);
    Ok(Drift {
        by_length,
        mean: mean_of(&all, None),
        path_length: covered.last().copied().unwrap_or(0.0),
        end_translation,
        end_rotation_degrees,
    })
}

fn mean_of(errors: &[(f64, f64)], length: Option<f64>) -> Option<SegmentErrors> {
    if errors.is_empty() {
        return None;
    }
    let count = errors.len() as f64;
    Some(SegmentErrors {
        length,
        count: errors.len(),
        translation_percent: 100.0 * errors.iter().map(|e| e.0).sum::<f64>() / count,
        rotation_degrees_per_metre: errors.iter().map(|e| e.1).sum::<f64>() / count,
    })
}

impl Drift {
    /// Error of the last pose per metre of path, after the first poses are aligned.
    pub fn end_drift_per_metre(&self) -> Option<f64> {
        (self.path_length > 0.0).then(|| self.end_translation / self.path_length)
    }
}

impl fmt::Display for Drift {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Drift over {:.1} m", self.path_length)?;
        for errors in self.by_length.iter().chain(&self.mean) {
            match errors.length {
                Some(length) => write!(f, "  {length:>6} m")?,
                None => write!(f, "  {:>8}", "mean")?,
            }
            writeln!(
                f,
                "  {:.3} %  {:.5} deg/m  ({} segments)",
                errors.translation_percent, errors.rotation_degrees_per_metre, errors.count
            )?;
        }
        write!(f, "  at the end  {:.3} m  {:.3} deg", self.end_translation, self.end_rotation_degrees)?;
        match self.end_drift_per_metre() {
            Some(drift) => write!(f, "  ({:.3} % of the path)", 100.0 * drift),
            None => Ok(()),
        }
    }
}
