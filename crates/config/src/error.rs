//! Errors and warnings of configurations.

use std::path::PathBuf;

use crate::bounds::Bounds;

/// Position in a Lua file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file, by the name it was given or found by.
    pub file: String,
    /// Line, from 1, if known.
    pub line: Option<usize>,
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.line {
            Some(line) => write!(f, "{}:{line}", self.file),
            None => f.write_str(&self.file),
        }
    }
}

/// A configuration that cannot be used, and what to do about it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("cannot read the configuration {}: {reason}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Message of the operating system.
        reason: String,
    },
    /// A file was found neither in the directories nor among the built-in ones.
    #[error(
        "{}File '{name}' was not found. Searched: {}; {}",
        at(place),
        if searched.is_empty() { "no directory".to_owned() } else { searched.join(", ") },
        built_in_hint(name)
    )]
    FileNotFound {
        /// The name as given to `include` or `read`.
        name: String,
        /// The directories searched.
        searched: Vec<String>,
        /// Position of the call.
        place: Option<Place>,
    },
    /// The interpreter could not load or run the file.
    #[error("{}{message}{}", at(place), hint.as_ref().map(|hint| format!(" ({hint})")).unwrap_or_default())]
    Lua {
        /// Position, if the interpreter gave it.
        place: Option<Place>,
        /// Its message.
        message: String,
        /// Advice.
        hint: Option<String>,
    },
    /// The file exceeded the limit of time or memory.
    #[error(
        "{}the configuration was stopped: {limit}; it should only compute values and return a table",
        at(place)
    )]
    Limit {
        /// Position at that time, if known.
        place: Option<Place>,
        /// The limit that was exceeded.
        limit: String,
    },
    /// The file did not return a table.
    #[error(
        "{file}: Topmost item on Lua stack is not a table! (it is {found}; end the file with `return options`)"
    )]
    NotATable {
        /// The file.
        file: String,
        /// Type of the returned value.
        found: String,
    },
    /// The returned table cannot be read.
    #[error("{file}: {path}: {reason}")]
    Unusable {
        /// The file.
        file: String,
        /// Key path within the returned table.
        path: String,
        /// The reason.
        reason: String,
    },
    /// A key that no option has.
    #[error("{}unknown option `{path}`{}", at(place), nearest.as_ref().map(|key| format!("; did you mean `{key}`?")).unwrap_or_default())]
    UnknownKey {
        /// The path as given.
        path: String,
        /// The nearest known path.
        nearest: Option<String>,
        /// Position of the key.
        place: Option<Place>,
    },
    /// A short path that fits several options.
    #[error("`{path}` fits several options: {}", candidates.join(", "))]
    Ambiguous {
        /// The path as given.
        path: String,
        /// The full paths it fits.
        candidates: Vec<String>,
    },
    /// A required table is missing.
    #[error("{file}: Key '{key}' not in dictionary: {advice}")]
    MissingTable {
        /// The file.
        file: String,
        /// The missing key.
        key: String,
        /// What kind of file this seems to be.
        advice: String,
    },
    /// A value of the wrong type.
    #[error("{}`{path}` must be {expected}, but is {found}", at(place))]
    WrongType {
        /// Full path of the option.
        path: String,
        /// Type of the option.
        expected: String,
        /// Type that was given.
        found: String,
        /// Position of the value.
        place: Option<Place>,
    },
    /// A value out of bounds.
    #[error("{}`{path}` = {value} is out of bounds, it must be {bounds}", at(place))]
    OutOfBounds {
        /// Full path of the option.
        path: String,
        /// The value.
        value: f64,
        /// The allowed values.
        bounds: Bounds,
        /// Position of the value.
        place: Option<Place>,
    },
    /// Options that contradict each other.
    #[error("{message}")]
    Inconsistent {
        /// Paths of the options.
        paths: Vec<String>,
        /// The contradiction.
        message: String,
    },
    /// A setting that is not `path=value`.
    #[error("`{text}` is no setting; write it as path=value, for example constraint_builder.min_score=0.6")]
    NoSetting {
        /// The setting as given.
        text: String,
    },
    /// A dictionary was asked for a key that it does not have.
    #[error("Key '{key}' not in dictionary:\n{dictionary}")]
    MissingKey {
        /// The key.
        key: String,
        /// The dictionary in the text form of Cartographer.
        dictionary: String,
    },
    /// A count that is negative.
    #[error("Key '{key}': {value} is negative.")]
    Negative {
        /// The key.
        key: String,
        /// The value.
        value: i32,
    },
    /// A key of a dictionary was never read, or more than once.
    #[error("Key '{key}' was used the wrong number of times.{}", if *times == 0 { " (nothing reads it: is it misspelt?)" } else { "" })]
    WrongUse {
        /// Path of the key.
        key: String,
        /// How often it was read.
        times: u32,
    },
    /// Text that is not JSON.
    #[error("no valid JSON: {reason}")]
    Json {
        /// Message of the parser.
        reason: String,
    },
    /// Several errors of one file, in the order of the options.
    #[error("{} errors in the configuration:\n{}", errors.len(), errors.iter().map(|error| format!("  {error}")).collect::<Vec<_>>().join("\n"))]
    Several {
        /// The errors.
        errors: Vec<ConfigError>,
    },
}

impl ConfigError {
    /// `Ok` for no errors, the error itself for one, [`ConfigError::Several`] for more.
    pub fn combine(mut errors: Vec<ConfigError>) -> Result<(), ConfigError> {
        match errors.len() {
            0 => Ok(()),
            1 => Err(errors.remove(0)),
            _ => Err(Self::Several { errors }),
        }
    }
}

/// The built-in file that was probably meant, or the list of all.
fn built_in_hint(name: &str) -> String {
    let names = crate::lua::built_in_names();
    match crate::nearest::nearest(name, names.iter().copied()) {
        Some(near) => format!("did you mean the built-in `{near}`?"),
        None => format!("built in are: {}", names.join(", ")),
    }
}

fn at(place: &Option<Place>) -> String {
    place.as_ref().map(|place| format!("{place}: ")).unwrap_or_default()
}

/// A problem in a configuration that does not prevent its use and should be reported.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ConfigWarning {
    /// A key that Cartographer requires is missing.
    #[error("{file}: `{path}` is missing, its default is used: {default}")]
    DefaultUsed {
        /// The main file.
        file: String,
        /// Full path of the option or table.
        path: String,
        /// The default.
        default: String,
    },
    /// A key of another version of the program.
    #[error("{}`{path}` is from another version: {outcome}", at(place))]
    OtherVersion {
        /// Full path as written.
        path: String,
        /// What the key was converted to.
        outcome: String,
        /// Position of the key.
        place: Option<Place>,
    },
    /// An error that was downgraded to a warning.
    #[error("ignored: {error}")]
    Ignored {
        /// The error.
        error: ConfigError,
    },
    /// A number with a fraction where an integer is read.
    #[error("{}`{path}` = {value} is read as {integer}", at(place))]
    Truncated {
        /// Full path of the option.
        path: String,
        /// The value written.
        value: f64,
        /// The value used.
        integer: i32,
        /// Position of the value.
        place: Option<Place>,
    },
    /// Values without a key in a table of options.
    #[error("{file}: {count} value(s) without a key in `{path}` are ignored")]
    Unkeyed {
        /// The main file.
        file: String,
        /// Full path of the table.
        path: String,
        /// Number of values.
        count: usize,
    },
}
