//! The functions `include`, `choose` and `read`, and the state of a run: files read and lines printed.

use std::cell::RefCell;
use std::rc::Rc;

use mlua::chunk::ChunkMode;
use mlua::{Error, Lua, MultiValue, Value as LuaValue};

use super::resolver::{FoundFile, Resolver};
use crate::error::{ConfigError, Place};

/// Lua code that removes what a configuration must not use.
const PRELUDE: &str = include_str!("prelude.lua");
/// Maximum number of lines of output that are kept.
const MAX_PRINTED_LINES: usize = 1000;
/// Maximum length of a line of output that is kept, bytes.
const MAX_PRINTED_LENGTH: usize = 1000;

/// One run of the interpreter.
#[derive(Clone)]
pub(super) struct Session(Rc<RefCell<State>>);

struct State {
    main: FoundFile,
    resolver: Resolver,
    /// Full paths in the order of inclusion, without the main file.
    included: Vec<String>,
    sources: Vec<FoundFile>,
    printed: Vec<String>,
    /// Error for a file that was not found. It is kept here because a Lua error could not carry its fields.
    not_found: Option<ConfigError>,
}

impl Session {
    pub fn new(main: FoundFile, resolver: Resolver) -> Self {
        let sources = vec![main.clone()];
        Self(Rc::new(RefCell::new(State {
            main,
            resolver,
            included: Vec::new(),
            sources,
            printed: Vec::new(),
            not_found: None,
        })))
    }

    /// The main file.
    pub fn main(&self) -> FoundFile {
        self.0.borrow().main.clone()
    }

    /// Takes the files read and the lines printed.
    pub fn take(&self) -> (Vec<FoundFile>, Vec<String>) {
        let mut state = self.0.borrow_mut();
        (std::mem::take(&mut state.sources), std::mem::take(&mut state.printed))
    }

    fn find(&self, lua: &Lua, name: &str) -> mlua::Result<FoundFile> {
        let mut state = self.0.borrow_mut();
        if let Some(found) = state.resolver.find(name) {
            return Ok(found);
        }
        let error = ConfigError::FileNotFound {
            name: name.to_owned(),
            searched: state.resolver.searched(),
            place: caller(lua).map(|(chunk, line)| state.place(&chunk, line)),
        };
        let message = format!("File '{name}' was not found.");
        state.not_found = Some(error);
        Err(Error::RuntimeError(message))
    }

    /// Converts an error of the interpreter to a configuration error with its position.
    pub fn explain(&self, error: &Error) -> ConfigError {
        let mut state = self.0.borrow_mut();
        let (message, memory) = innermost(error);
        if let Some(not_found) = state.not_found.take()
            && message.contains(" was not found.")
        {
            return not_found;
        }
        let first_line = message.split("\nstack traceback:").next().unwrap_or(&message);
        let (place, text) = match split_place(first_line) {
            Some((chunk, line, text)) => (Some(state.place(chunk, line)), text),
            None => (Some(Place { file: state.main.path.clone(), line: None }), first_line),
        };
        if memory || text.contains("not enough memory") {
            return ConfigError::Limit { place, limit: "it needs too much memory".to_owned() };
        }
        if let Some(limit) = text.strip_prefix(TOO_LONG) {
            return ConfigError::Limit { place, limit: format!("{TOO_LONG}{limit}") };
        }
        ConfigError::Lua { place, message: text.to_owned(), hint: hint(text) }
    }
}

impl State {
    /// The file of a chunk; Lua may have shortened the name at its beginning.
    fn place(&self, chunk: &str, line: usize) -> Place {
        let end = chunk.strip_prefix("...");
        let is_meant = |path: &&String| path.as_str() == chunk || end.is_some_and(|end| path.ends_with(end));
        let file = self.sources.iter().map(|source| &source.path).find(is_meant);
        Place { file: file.map_or(chunk, String::as_str).to_owned(), line: Some(line) }
    }
}

/// Maximum number of included files; a robot's configuration includes three.
const MAX_INCLUDED: usize = 100;
/// Maximum size of all files kept for messages, bytes; the memory limit of the interpreter does not count
/// them.
const MAX_SOURCES: usize = 32 << 20;
const TOO_LONG: &str = "it ran longer than ";

/// Creates the error that ends a run at its deadline.
pub(super) fn too_long(seconds: f64, source: &mlua::debug::DebugSource<'_>, line: Option<usize>) -> Error {
    let chunk = source.short_src.as_deref().unwrap_or("?");
    Error::RuntimeError(format!("{chunk}:{}: {TOO_LONG}{seconds} s", line.unwrap_or(0)))
}

/// Name of a file in messages of Lua.
pub(super) fn chunk_name(path: &str) -> String {
    format!("@{path}")
}

/// Installs the functions of the dialect and removes the forbidden ones.
pub(super) fn install(lua: &Lua, session: &Session) -> mlua::Result<()> {
    let globals = lua.globals();
    let output = session.clone();
    let print = lua.create_function(move |_, line: mlua::LuaString| {
        let mut state = output.0.borrow_mut();
        if state.printed.len() < MAX_PRINTED_LINES {
            let bytes = line.as_bytes();
            let kept = bytes.get(..MAX_PRINTED_LENGTH).unwrap_or(&bytes);
            state.printed.push(String::from_utf8_lossy(kept).into_owned());
        }
        Ok(())
    })?;
    lua.load(PRELUDE).set_name("=prelude").call::<()>(print)?;

    let files = session.clone();
    let include = lua.create_function(move |lua, arguments: MultiValue| include(lua, &files, &arguments))?;
    globals.raw_set("include", include)?;
    let files = session.clone();
    let read = lua.create_function(move |lua, arguments: MultiValue| {
        let name = one_string(lua, "read", &arguments)?;
        let found = files.find(lua, &name)?;
        lua.create_string(&found.content)
    })?;
    globals.raw_set("read", read)?;
    globals.raw_set("choose", lua.create_function(|lua, arguments: MultiValue| choose(lua, &arguments))?)
}

fn include(lua: &Lua, session: &Session, arguments: &MultiValue) -> mlua::Result<MultiValue> {
    let name = one_string(lua, "include", arguments)?;
    let found = session.find(lua, &name)?;
    {
        let mut state = session.0.borrow_mut();
        if state.included.contains(&found.path) {
            let order = state.included.join(", ");
            return Err(located(
                lua,
                &format!(
                    "Tried to include {} twice. Already included files in order of inclusion: {order}",
                    found.path
                ),
            ));
        }
        if state.included.len() >= MAX_INCLUDED {
            return Err(located(lua, &format!("more than {MAX_INCLUDED} files are included")));
        }
        let kept: usize = state.sources.iter().map(|source| source.content.len()).sum();
        if kept + found.content.len() > MAX_SOURCES {
            let most = MAX_SOURCES >> 20;
            return Err(located(lua, &format!("the files that are included are larger than {most} MiB")));
        }
        state.included.push(found.path.clone());
        state.sources.push(found.clone());
    }
    lua.load(found.content).set_name(chunk_name(&found.path)).set_mode(ChunkMode::Text).eval()
}

fn choose(lua: &Lua, arguments: &MultiValue) -> mlua::Result<LuaValue> {
    let [condition, yes, no] = arguments.as_slices().0 else {
        return Err(located(lua, &format!("choose needs 3 arguments, got {}", arguments.len())));
    };
    match condition {
        LuaValue::Boolean(true) => Ok(yes.clone()),
        LuaValue::Boolean(false) => Ok(no.clone()),
        _ => Err(located(lua, "condition is not a boolean value.")),
    }
}

fn one_string(lua: &Lua, function: &str, arguments: &MultiValue) -> mlua::Result<String> {
    let argument = if arguments.len() == 1 { arguments.front() } else { None };
    let text = argument.and_then(|value| lua.coerce_string(value.clone()).ok().flatten());
    match text {
        Some(text) => Ok(text.to_string_lossy()),
        None => Err(located(lua, &format!("{function} needs exactly one string"))),
    }
}

/// Chunk and line from which Lua called one of these functions.
fn caller(lua: &Lua) -> Option<(String, usize)> {
    lua.inspect_stack(1, |debug| {
        let source = debug.source().short_src?.into_owned();
        Some((source, debug.current_line()?))
    })
    .flatten()
}

fn located(lua: &Lua, message: &str) -> Error {
    Error::RuntimeError(match caller(lua) {
        Some((chunk, line)) => format!("{chunk}:{line}: {message}"),
        None => message.to_owned(),
    })
}

/// The message of the original error, and whether memory ran out.
fn innermost(error: &Error) -> (String, bool) {
    match error {
        Error::CallbackError { cause, .. } | Error::WithContext { cause, .. } => innermost(cause),
        Error::SyntaxError { message, .. } | Error::RuntimeError(message) => (message.clone(), false),
        Error::MemoryError(message) => (message.clone(), true),
        other => (other.to_string(), false),
    }
}

/// Splits `file:line: text`.
fn split_place(message: &str) -> Option<(&str, usize, &str)> {
    let mut from = 0;
    while let Some(colon) = message.get(from..)?.find(':').map(|offset| from + offset) {
        let rest = message.get(colon + 1..)?;
        if let Some((line, text)) = rest.split_once(": ")
            && let Ok(line) = line.parse()
        {
            return Some((message.get(..colon)?, line, text));
        }
        from = colon + 1;
    }
    None
}

/// Advice for errors that files of other versions cause.
fn hint(message: &str) -> Option<String> {
    if message.contains("'SPARSE_POSE_GRAPH'") {
        return Some("SPARSE_POSE_GRAPH of old versions is POSE_GRAPH now".to_owned());
    }
    for global in ["MAP_BUILDER", "POSE_GRAPH", "TRAJECTORY_BUILDER"] {
        if message.contains(&format!("'{global}")) && message.contains("a nil value") {
            return Some(
                "is an include \"map_builder.lua\" or \"trajectory_builder.lua\" missing?".to_owned(),
            );
        }
    }
    None
}
