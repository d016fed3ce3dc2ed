//! The Lua dialect of configurations: a real Lua 5.2 with `include`, `choose` and `read`.

mod dictionary;
mod dump;
mod evaluate;
mod functions;
mod resolver;
mod snapshot;

pub use dictionary::Dictionary;
pub(crate) use dump::lua_literal;
pub use dump::{dump, print_configuration};
pub(crate) use evaluate::evaluate_number;
pub use evaluate::{Evaluation, Limits, evaluate_file, evaluate_text};
pub use resolver::{built_in_file, built_in_names};
