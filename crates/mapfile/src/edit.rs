//! Edits maps as documents: removes parts, merges, moves, corrects and optimises maps.
//!
//! A [`MapDraft`] holds the pose graph and the options in memory and the paths of the files with the rest
//! (submaps, nodes, measurements). The rest is copied when the draft is written, message by message: memory
//! does not grow with the grids, and messages without changes keep their bytes.

mod area;
mod clear;
mod constraints;
mod draft;
mod error;
mod graph;
mod loop_search;
mod merge;
mod optimize;
mod poses;
mod rest;
mod select;
mod unread;
mod walls;

pub use constraints::{LoopResidual, LoopWeights};
pub use draft::{EditReport, MapDraft};
pub use error::EditError;
pub use loop_search::FoundLoop;
pub use merge::JoinedMap;
pub use optimize::MapOptimization;
pub use poses::PoseReplacement;
pub use walls::{Walls, find_walls};
