//! Loads a configuration: defaults, then a file, then single settings.

use std::path::{Path, PathBuf};

use crate::check::Findings;
use crate::engine::Engine;
use crate::error::{ConfigError, ConfigWarning};
use crate::legacy::modernise;
use crate::locate::locate;
use crate::lua::{Evaluation, Limits, evaluate_file, evaluate_text};
use crate::node::Section;
use crate::options::{MapBuilderServerOptions, Options};
use crate::read::{Reader, Strictness};
use crate::value::{Table, Value};

/// Loaded options with the warnings and files of loading.
#[derive(Clone, Debug)]
pub struct LoadedConfig<T = Options> {
    /// The options, checked.
    pub options: T,
    /// Warnings for the user, in the order in which they occurred.
    pub warnings: Vec<ConfigWarning>,
    /// Every file that was read, the main file first; built-in ones as `built-in:NAME`.
    pub files: Vec<String>,
    /// Output of the file, line by line.
    pub printed: Vec<String>,
}

/// How configurations are loaded.
#[derive(Clone, Debug, Default)]
pub struct Loader {
    /// Directories in which included files are searched after the directory of the main file and before the
    /// built-in ones.
    pub directories: Vec<PathBuf>,
    /// Handling of unknown keys.
    pub strictness: Strictness,
    /// Limits of time and memory for the file.
    pub limits: Limits,
    /// Settings `path=value` that override the file, in order; see [`Options::set`].
    pub settings: Vec<String>,
}

impl Loader {
    /// Loads a robot's file. In 3D scans are matched to planes unless the file sets `match_surfaces = false`
    /// in the table `portolan`; [`Options::set_engine`] changes that. A bare name that is not a file in the
    /// working directory may be one of the built-in files, such as `backpack_2d.lua`.
    ///
    /// # Errors
    /// If the file cannot be read or run, lacks what is required, or has values or unknown keys that are errors, or if a
    /// setting does not fit.
    pub fn load(&self, path: &Path) -> Result<LoadedConfig, ConfigError> {
        self.finish_options(evaluate_file(path, &self.directories, self.limits)?)
    }

    /// Loads a robot's configuration given as text; `name` is its name in messages.
    ///
    /// # Errors
    /// As for [`Self::load`].
    pub fn load_text(&self, name: &str, text: &str) -> Result<LoadedConfig, ConfigError> {
        self.finish_options(evaluate_text(name, text, &self.directories, self.limits)?)
    }

    /// Uses options from another source, for instance [`Options::for_2d`], and applies the settings.
    ///
    /// # Errors
    /// If a setting or a value does not fit.
    pub fn load_options(&self, base: Options) -> Result<LoadedConfig, ConfigError> {
        let config =
            LoadedConfig { options: base, warnings: Vec::new(), files: Vec::new(), printed: Vec::new() };
        self.finish(config, &|_| None)
    }

    /// Loads the file of a map builder server. Settings are not applied.
    ///
    /// # Errors
    /// As for [`Self::load`].
    pub fn load_server(&self, path: &Path) -> Result<LoadedConfig<MapBuilderServerOptions>, ConfigError> {
        let evaluation = evaluate_file(path, &self.directories, self.limits)?;
        let mut config = self.fill(&evaluation, &["map_builder"], MapBuilderServerOptions::default())?;
        let findings = config.options.findings();
        report(findings, &mut config.warnings, &|path| locate(&evaluation, path))?;
        Ok(config)
    }

    /// Reads JSON as written by [`Options::to_json`]. Missing keys keep their default. A table that may be
    /// absent (a trimmer, an intensity table) becomes absent if the table around it is given without it.
    ///
    /// # Errors
    /// If the text is not JSON, or as for [`Self::load`].
    pub fn load_json(&self, name: &str, text: &str) -> Result<LoadedConfig, ConfigError> {
        let mut reader = self.reader(name, &|_| None);
        let mut options = Options::default();
        reader.read(&mut options, &crate::json::parse(text)?, "");
        ConfigError::combine(reader.errors)?;
        let is_reported = |warning: &ConfigWarning| !matches!(warning, ConfigWarning::DefaultUsed { .. });
        let warnings = reader.warnings.into_iter().filter(is_reported).collect();
        let config = LoadedConfig { options, warnings, files: vec![name.to_owned()], printed: Vec::new() };
        self.finish(config, &|_| None)
    }

    fn finish_options(&self, evaluation: Evaluation) -> Result<LoadedConfig, ConfigError> {
        let required = ["map_builder", "trajectory_builder"];
        let config = self.fill(&evaluation, &required, Options::of_files())?;
        self.finish(config, &|path| locate(&evaluation, path))
    }

    /// Reads the table that a file returned.
    fn fill<T: Section>(
        &self,
        evaluation: &Evaluation,
        required: &[&str],
        mut options: T,
    ) -> Result<LoadedConfig<T>, ConfigError> {
        let file = &evaluation.file;
        let mut table = evaluation.table.clone();
        if let Some(key) = required.iter().find(|key| !table.entries.contains_key(**key)) {
            let (file, key) = (file.clone(), (*key).to_owned());
            return Err(ConfigError::MissingTable { file, key, advice: advice(&table).to_owned() });
        }
        let find = |path: &str| locate(evaluation, path);
        let mut reader = self.reader(file, &find);
        for old in modernise(&mut table) {
            let place = find(&old.path);
            reader.warnings.push(ConfigWarning::OtherVersion { path: old.path, outcome: old.outcome, place });
        }
        reader.read(&mut options, &table, "");
        ConfigError::combine(reader.errors)?;
        Ok(LoadedConfig {
            options,
            warnings: reader.warnings,
            files: evaluation.files.clone(),
            printed: evaluation.printed.clone(),
        })
    }

    fn reader<'a>(&self, file: &str, locate: crate::read::Locate<'a>) -> Reader<'a> {
        Reader {
            file: file.to_owned(),
            strictness: self.strictness,
            locate,
            errors: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// Applies the settings and checks the result.
    fn finish(
        &self,
        mut config: LoadedConfig,
        locate: crate::read::Locate<'_>,
    ) -> Result<LoadedConfig, ConfigError> {
        let set = |setting: &String| config.options.set(setting).err();
        ConfigError::combine(self.settings.iter().filter_map(set).collect())?;
        report(config.options.findings(), &mut config.warnings, locate)?;
        Ok(config)
    }
}

fn report(
    findings: Findings,
    warnings: &mut Vec<ConfigWarning>,
    locate: crate::read::Locate<'_>,
) -> Result<(), ConfigError> {
    let placed = |error: ConfigError| match error {
        ConfigError::OutOfBounds { path, value, bounds, place: None } => {
            let place = locate(&path);
            ConfigError::OutOfBounds { path, value, bounds, place }
        }
        other => other,
    };
    warnings.extend(findings.unused.into_iter().map(|error| ConfigWarning::Ignored { error: placed(error) }));
    ConfigError::combine(findings.errors.into_iter().map(placed).collect())
}

/// What kind of file a file without `map_builder` or `trajectory_builder` seems to be.
fn advice(table: &Table) -> &'static str {
    let has = |key: &str| table.entries.contains_key(key);
    if has("pipeline") {
        "this is a pipeline of the assets writer, not the configuration of a robot"
    } else if has("num_grpc_threads") {
        "this is the configuration of a map builder server, not that of a robot"
    } else if has("use_trajectory_builder_2d") || has("trajectory_builder_2d") {
        "this is only a part; return a table with map_builder = MAP_BUILDER, trajectory_builder = \
         TRAJECTORY_BUILDER and the frames and sensors of the robot"
    } else {
        "the configuration of a robot is a table with map_builder, trajectory_builder, frames and sensors"
    }
}

impl Options {
    /// Defaults for Lua files: scans are matched to planes, because files are written for a robot's sensors,
    /// frames and weights, and the engine is a separate choice.
    pub(crate) fn of_files() -> Self {
        let mut options = Self::default();
        options.set_engine(Engine::Planes);
        options
    }

    /// Loads a robot's Lua file; unknown keys are errors. Included files are searched beside it, then in
    /// `directories`, then among the built-in ones.
    ///
    /// # Errors
    /// As for [`Loader::load`].
    pub fn from_lua_file(path: &Path, directories: &[PathBuf]) -> Result<LoadedConfig, ConfigError> {
        Loader { directories: directories.to_vec(), ..Loader::default() }.load(path)
    }

    /// Loads a robot's Lua configuration given as text.
    ///
    /// # Errors
    /// As for [`Loader::load`].
    pub fn from_lua(name: &str, text: &str) -> Result<LoadedConfig, ConfigError> {
        Loader::default().load_text(name, text)
    }

    /// Loads JSON as written by [`Options::to_json`].
    ///
    /// # Errors
    /// As for [`Loader::load_json`].
    pub fn from_json(text: &str) -> Result<LoadedConfig, ConfigError> {
        Loader::default().load_json("JSON", text)
    }

    /// The options as a tree of values.
    pub fn to_value(&self) -> Value {
        crate::node::section_to_value(self)
    }
}
