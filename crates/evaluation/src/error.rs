//! What can go wrong in an evaluation.

use thiserror::Error;

/// Why an evaluation is not possible.
#[derive(Debug, Error)]
pub enum EvaluationError {
    /// Reading or writing failed.
    #[error("reading or writing failed: {0}")]
    Io(#[from] std::io::Error),
    /// A line of a text file is not what the format asks for.
    #[error("line {line}: {reason}")]
    BadLine {
        /// Counted from one.
        line: usize,
        /// What is wrong and what is expected.
        reason: String,
    },
    /// Numbers that should be rotations are not.
    #[error(
        "the last four numbers of {count} lines are no quaternion qx qy qz qw of length 1: are these relations (time1 time2 x y z roll \
         pitch yaw), or another table?"
    )]
    NoQuaternions {
        /// Number of such lines, more than half.
        count: usize,
    },
    /// A binary relations file is damaged.
    #[error("damaged relations file at byte {position}: {reason}")]
    BadRelations {
        /// Byte offset in the file.
        position: usize,
        /// What is wrong.
        reason: &'static str,
    },
    /// Poses and times of a KITTI recording do not belong together.
    #[error("{poses} poses but {times} times: pass the times.txt of the same sequence")]
    UnequalLengths {
        /// Lines of the pose file.
        poses: usize,
        /// Lines of the times file.
        times: usize,
    },
    /// A trajectory without poses.
    #[error("the {0} trajectory has no poses")]
    EmptyTrajectory(&'static str),
    /// Too few relations: mean and standard deviation need two.
    #[error("{0} relations are too few: at least 2 are needed for mean and standard deviation")]
    TooFewRelations(usize),
    /// No relation is within the time span of the trajectory.
    #[error(
        "none of the {relations} relations ({relations_start} to {relations_end}) lies within the trajectory ({start} to {end}): are they of another recording, or counted from another time?"
    )]
    NoRelationInTime {
        /// Number of relations.
        relations: usize,
        /// First time of any relation, Unix seconds.
        relations_start: String,
        /// Last time of any relation, Unix seconds.
        relations_end: String,
        /// First pose, Unix seconds.
        start: String,
        /// Last pose, Unix seconds.
        end: String,
    },
    /// No pose of the estimate has a counterpart.
    #[error(
        "no pose of the estimate ({estimate_start} to {estimate_end}) lies within the truth ({truth_start} to {truth_end}): bring both to the same clock, or raise the tolerance"
    )]
    NothingAssociated {
        /// First pose of the estimate, Unix seconds.
        estimate_start: String,
        /// Last pose of the estimate, Unix seconds.
        estimate_end: String,
        /// First pose of the truth, Unix seconds.
        truth_start: String,
        /// Last pose of the truth, Unix seconds.
        truth_end: String,
    },
    /// The trajectory is too short for a step or segment.
    #[error("no two poses are {0} apart: choose a shorter step")]
    StepTooLong(String),
    /// A step that is not above zero.
    #[error("a step of {0} is not above zero")]
    BadStep(f64),
    /// Coordinates too large to compute with.
    #[error("the positions are too large to align (beyond 1e100 m): are they damaged?")]
    CannotAlign,
    /// A map from which relations cannot be made.
    #[error("cannot make relations from this map: {0}")]
    BadMap(String),
    /// A mesh file that cannot be used.
    #[error("this mesh cannot be used: {0}")]
    BadMesh(String),
}
