//! What can be wrong with a world that is asked for.

/// Why a world could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// There is no such kind of building.
    #[error("there is no scene \"{name}\"; choose one of: {known}")]
    UnknownScene {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// A floor plan of one's own cannot be used.
    #[error("the floor plan cannot be used: {detail}")]
    BadPlan {
        /// What to change.
        detail: String,
    },
}
