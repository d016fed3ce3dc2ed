#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), warn(clippy::indexing_slicing))]

mod file;
mod forward;
mod kind;
mod lines;
mod xml;

pub use file::{named, read_all, regular_file};
pub use forward::Forward;
pub use kind::{kind_of, quoted, unwanted_kind_of};
pub use lines::{Line, read_line, skip_line};
pub use xml::{XmlLimits, XmlProblem, check_xml};
