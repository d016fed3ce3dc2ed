//! Runs a configuration file within limits of time and memory.

use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use mlua::chunk::ChunkMode;
use mlua::{HookTriggers, Lua, LuaOptions, MultiValue, StdLib, Value as LuaValue, VmState};

use super::functions::{self, Session};
use super::resolver::{FoundFile, Resolver, read_file};
use super::snapshot::Snapshot;
use crate::error::ConfigError;
use crate::value::{Table, Value};

/// Number of instructions between two checks of the running time.
const INSTRUCTIONS_PER_CHECK: u32 = 10_000;
/// Stack size of the thread that runs the interpreter, bytes.
const STACK_SIZE: usize = 8 << 20;

/// Limits of a run.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Running time.
    pub time: Duration,
    /// Memory of the interpreter, bytes.
    pub memory: usize,
}

impl Default for Limits {
    /// Ten seconds and 256 MiB.
    fn default() -> Self {
        Self { time: Duration::from_secs(10), memory: 256 << 20 }
    }
}

/// Result of running a file.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// The main file.
    pub file: String,
    /// The table it returned.
    pub table: Table,
    /// Every file that was read, in order, the main file first; built-in ones as `built-in:NAME`.
    pub files: Vec<String>,
    /// Output of the configuration, line by line; at most 1000 lines are kept.
    pub printed: Vec<String>,
    pub(crate) sources: Vec<FoundFile>,
}

/// Runs a configuration file. Files it includes are searched beside it, then in `directories`, then among the
/// built-in ones. A bare name that is not a file in the working directory is searched in the same way.
pub fn evaluate_file(
    path: &Path,
    directories: &[PathBuf],
    limits: Limits,
) -> Result<Evaluation, ConfigError> {
    let path = path.to_owned();
    let directories = directories.to_vec();
    in_thread(limits, move || {
        let unreadable =
            |error: std::io::Error| ConfigError::Unreadable { path: path.clone(), reason: error.to_string() };
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
        let own_directory = parent.map_or_else(|| PathBuf::from("."), Path::to_owned);
        let read = read_file(&path);
        let on_disk = read.is_ok() || parent.is_some();
        let mut searched = if on_disk { vec![own_directory] } else { Vec::new() };
        searched.extend(directories);
        let resolver = Resolver { directories: searched };
        let main = match read {
            Ok(content) => FoundFile { path: path.display().to_string(), content, built_in: false },
            Err(error) if on_disk => return Err(unreadable(error)),
            Err(_) => resolver.find(&path.to_string_lossy()).ok_or_else(|| ConfigError::FileNotFound {
                name: path.display().to_string(),
                searched: resolver.searched(),
                place: None,
            })?,
        };
        Ok((main, resolver))
    })
}

/// Runs a configuration given as text; `name` is its name in messages.
pub fn evaluate_text(
    name: &str,
    text: &str,
    directories: &[PathBuf],
    limits: Limits,
) -> Result<Evaluation, ConfigError> {
    let main = FoundFile { path: name.to_owned(), content: text.as_bytes().to_vec(), built_in: false };
    let resolver = Resolver { directories: directories.to_vec() };
    in_thread(limits, move || Ok((main, resolver)))
}

/// The value of a numeric Lua expression such as `math.rad(20)`.
pub(crate) fn evaluate_number(expression: &str) -> Option<f64> {
    let limits = Limits { time: Duration::from_secs(5), memory: 16 << 20 };
    let text = format!("return {{ {expression}\n}}");
    let evaluation = evaluate_text("expression", &text, &[], limits).ok()?;
    match evaluation.table.array.as_slice() {
        [Value::Number(number)] if evaluation.table.entries.is_empty() => Some(*number),
        _ => None,
    }
}

/// Runs the interpreter in a thread of its own. An instruction hook ends a run that exceeds its time. What
/// the hook cannot interrupt (a library function, a finaliser, an endless file) is abandoned at the deadline.
fn in_thread(
    limits: Limits,
    find: impl FnOnce() -> Result<(FoundFile, Resolver), ConfigError> + Send + 'static,
) -> Result<Evaluation, ConfigError> {
    let (sender, receiver) = mpsc::channel();
    let run = move || {
        let session = match find() {
            Ok((main, resolver)) => Session::new(main, resolver),
            Err(error) => return drop(sender.send(Err(error))),
        };
        match interpreter(limits) {
            Ok(lua) => {
                // Send before the interpreter is closed: finalisers cannot be interrupted.
                let result = run_main(&lua, &session);
                drop(sender.send(result));
            }
            Err(error) => drop(sender.send(Err(session.explain(&error)))),
        }
    };
    let started =
        std::thread::Builder::new().name("configuration".to_owned()).stack_size(STACK_SIZE).spawn(run);
    if let Err(error) = started {
        return Err(ConfigError::Limit {
            place: None,
            limit: format!("no thread could be started: {error}"),
        });
    }
    let patience = limits.time + Duration::from_millis(500);
    receiver.recv_timeout(patience).unwrap_or_else(|_| {
        Err(ConfigError::Limit {
            place: None,
            limit: format!("no result after {:.1} s", patience.as_secs_f64()),
        })
    })
}

/// Lua 5.2 with only the libraries that compute: without access to files, programs, the environment or the
/// process itself.
fn interpreter(limits: Limits) -> mlua::Result<Lua> {
    let libraries = StdLib::TABLE | StdLib::STRING | StdLib::MATH | StdLib::BIT | StdLib::COROUTINE;
    let lua = Lua::new_with(libraries, LuaOptions::default())?;
    lua.set_memory_limit(limits.memory)?;
    let deadline = Instant::now() + limits.time;
    let seconds = limits.time.as_secs_f64();
    lua.set_global_hook(
        HookTriggers::new().every_nth_instruction(INSTRUCTIONS_PER_CHECK),
        move |lua, debug| {
            if Instant::now() < deadline {
                return Ok(VmState::Continue);
            }
            // Fail after every instruction from now on, so that a protected call cannot catch the error and
            // continue.
            let line = debug.current_line();
            let message = functions::too_long(seconds, &debug.source(), line);
            let stop = message.clone();
            lua.set_global_hook(HookTriggers::new().every_nth_instruction(1), move |_, _| Err(stop.clone()))?;
            Err(message)
        },
    )?;
    Ok(lua)
}

fn run_main(lua: &Lua, session: &Session) -> Result<Evaluation, ConfigError> {
    let main = session.main();
    let outcome = functions::install(lua, session).and_then(|()| {
        lua.load(main.content.as_slice())
            .set_name(functions::chunk_name(&main.path))
            .set_mode(ChunkMode::Text)
            .eval::<MultiValue>()
    });
    let values = outcome.map_err(|error| session.explain(&error))?;
    let Some(LuaValue::Table(table)) = values.back() else {
        let found = match values.back() {
            None => "nothing",
            Some(LuaValue::Integer(_)) => "number",
            Some(other) => other.type_name(),
        }
        .to_owned();
        return Err(ConfigError::NotATable { file: main.path, found });
    };
    let table = Snapshot::new(&main.path).table(table)?;
    let (sources, printed) = session.take();
    let files = sources.iter().map(|source| source.path.clone()).collect();
    Ok(Evaluation { file: main.path, table, files, printed, sources })
}
