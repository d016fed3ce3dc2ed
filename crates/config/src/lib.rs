#![doc = include_str!("../README.md")]

pub mod bounds;
mod catalogue;
mod check;
mod define;
mod engine;
mod error;
mod fingerprint;
mod json;
mod legacy;
mod load;
mod locate;
pub mod lua;
mod nearest;
pub mod node;
pub mod options;
mod policies;
mod read;
mod reference;
mod setting;
mod to_lua;
pub mod value;
mod without_effect;

pub use bounds::Bounds;
pub use catalogue::{Entry, OptionDoc, catalogue, explain, explain_all};
pub use engine::Engine;
pub use error::{ConfigError, ConfigWarning, Place};
pub use fingerprint::fingerprint_of;
pub use load::{LoadedConfig, Loader};
pub use nearest::edit_distance;
pub use options::*;
pub use read::Strictness;
pub use reference::reference;
pub use value::{Table, Value};
pub use without_effect::little_effect;
