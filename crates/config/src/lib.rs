//! Every option, typed, documented and checked in one place; Cartographer's Lua files load unchanged.
//!
//! - [`Options`] is the whole configuration of a run as plain structs, with the defaults of the
//!   reference. Field names are the keys of the files.
//! - [`Loader`] brings it together: defaults, then a Lua file, then single settings `path=value`.
//!   Unknown keys, wrong types and values out of bounds are errors that name the option, the nearest
//!   known one, the bound, the file and the line; all of them at once.
//! - [`reference()`], [`explain`] and [`catalogue()`] tell what each option means.
//! - [`lua`] runs any configuration file (pipelines too) in a real Lua 5.2, within limits.
//!
//! ```
//! use portolan_config::{Loader, Options};
//! # fn main() -> Result<(), portolan_config::ConfigError> {
//! let loader = Loader { settings: vec!["constraint_builder.min_score=0.6".into()], ..Loader::default() };
//! let config = loader.load("backpack_2d.lua".as_ref())?;
//! assert_eq!(config.options.map_builder.pose_graph.constraint_builder.min_score, 0.6);
//! assert!(Options::for_2d().validate().is_ok());
//! # Ok(())
//! # }
//! ```
//!
//! # Adding an option
//!
//! One entry in a file of `src/options/` is all: documentation, name, type, default, unit, bounds.
//!
//! ```text
//! options! {
//!     PortolanOptions {
//!         /// What it does. Raise it when ….
//!         my_option: f64 = 0.5, "m", Bounds::at_least(0.0);
//!     }
//! }
//! ```
//!
//! It is then a field with rustdoc, read from Lua and JSON, set by path, checked, listed, part of the
//! fingerprint and on the reference page. Options that only Portolan has belong into
//! `src/options/portolan.rs`; the table `portolan` may be left out of files. An option of Cartographer
//! also goes into the files of `src/configuration_files/`; a test compares these with the defaults.
//! Types are `bool`, `i32`, `usize`, `f32`, `f64`, `String`, enums made by `choices!`, other tables, and
//! `Option<table>` for tables that may be absent. Checks that concern several options are in `check.rs`.

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
pub use options::*;
pub use read::Strictness;
pub use reference::reference;
pub use value::{Table, Value};
pub use without_effect::little_effect;
