//! Where measurements come from.
//!
//! One interface ([`Recording`]) over every format; one file or folder of modules per format.

mod message;
mod source;

pub use message::*;
pub use source::*;
