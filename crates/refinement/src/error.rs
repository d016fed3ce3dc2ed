//! Errors of refinement.

/// Reasons why a refinement is not possible, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RefineError {
    /// The trajectory has too few poses.
    #[error("the trajectory has {0} poses, but at least two at different times are needed")]
    ShortTrajectory(usize),
    /// A pose is not finite, or not later than the one before.
    #[error("pose number {0} (from 0) of the trajectory is not finite or not later than the one before")]
    BadPose(usize),
    /// There are no points.
    #[error("there are no points to refine with")]
    NoPoints,
    /// Points and trajectory do not overlap in time.
    #[error(
        "points ({points}) and trajectory ({trajectory}) do not overlap in time{hint}; is it the trajectory of this recording?"
    )]
    NoOverlap {
        /// Span of the points, Unix seconds.
        points: String,
        /// Span of the trajectory, Unix seconds.
        trajectory: String,
        /// An offset that would fit, if there is one.
        hint: String,
    },
    /// No plane was found.
    #[error("no surfaces were found in the points; are extrinsics and times right? {0} points were searched")]
    NoSurfaces(usize),
    /// The value of an option is invalid.
    #[error("{0}")]
    Option(String),
    /// Equations could not be solved.
    #[error("the equations could not be solved ({0}); this should not happen with finite input")]
    Numerical(&'static str),
    /// It was stopped before there was any result.
    #[error("it was stopped before there was any result")]
    Stopped,
}
