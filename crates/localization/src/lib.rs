#![doc = include_str!("../README.md")]

mod belief;
mod evidence;
mod finder;
mod hypothesis;
mod likelihood;
mod localizer;
mod plane_map;
mod scan;
mod scan_match;
mod search;
mod state;

pub use belief::Matrix3;
pub use localizer::{Localizer, LocalizerError, LocalizerSettings, StartPose};
pub use plane_map::{KnownMapError, PlanarMap};
pub use state::{Estimate, Place, Reason, State};
