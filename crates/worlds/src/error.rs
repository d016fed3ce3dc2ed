//! Errors of drawing a world.

/// Why a world could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// The name of the scene is unknown.
    #[error("there is no scene \"{name}\"; choose one of: {known}")]
    UnknownScene {
        /// The requested name.
        name: String,
        /// The known names.
        known: String,
    },
    /// A floor plan given by the user is not valid.
    #[error("the floor plan cannot be used: {detail}")]
    BadPlan {
        /// What to change.
        detail: String,
    },
}
