//! Every option, typed, documented and checked in one place; Cartographer's Lua files load unchanged.

pub mod bounds;
mod define;
pub mod node;
pub mod options;
pub mod value;

pub use bounds::Bounds;
pub use options::*;
pub use value::{Table, Value};
