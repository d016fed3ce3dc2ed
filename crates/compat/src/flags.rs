//! Parser of command-line flags in the syntax of gflags, as used by Cartographer's programs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Wrong usage: the fault and the usage of the program.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{0}")]
pub struct FlagError(pub String);

/// Flags that a program accepts.
#[derive(Clone, Copy, Debug)]
pub struct KnownFlags {
    /// Flags with a value, and their defaults.
    pub values: &'static [(&'static str, &'static str)],
    /// Boolean flags, and their defaults.
    pub switches: &'static [(&'static str, bool)],
    /// Usage of the program, shown after errors.
    pub usage: &'static str,
}

/// Values of the flags: those given, else the defaults.
#[derive(Clone, Debug)]
pub struct Flags {
    values: BTreeMap<&'static str, String>,
    switches: BTreeMap<&'static str, bool>,
    usage: &'static str,
    /// Arguments that are not flags.
    pub positional: Vec<String>,
}

impl Flags {
    /// Reads `-flag value`, `--flag=value`, `--switch`, `--switch=false` and `--noswitch`. All arguments after `--` are
    /// positional.
    ///
    /// # Errors
    /// If a flag is unknown (as in Cartographer), lacks its value, or is a switch with a value that is not boolean.
    pub fn parse(arguments: &[String], known: &KnownFlags) -> Result<Self, FlagError> {
        let mut flags = Self {
            values: known.values.iter().map(|(name, value)| (*name, (*value).to_owned())).collect(),
            switches: known.switches.iter().copied().collect(),
            usage: known.usage,
            positional: Vec::new(),
        };
        let mut rest = arguments.iter();
        while let Some(argument) = rest.next() {
            if argument == "--" {
                flags.positional.extend(rest.cloned());
                break;
            }
            let Some(flag) = argument.strip_prefix("--").or_else(|| argument.strip_prefix('-')) else {
                flags.positional.push(argument.clone());
                continue;
            };
            flags.flag(flag, &mut rest)?;
        }
        Ok(flags)
    }

    fn flag<'a>(&mut self, flag: &str, rest: &mut impl Iterator<Item = &'a String>) -> Result<(), FlagError> {
        let (name, given) = match flag.split_once('=') {
            Some((name, value)) => (name, Some(value)),
            None => (flag, None),
        };
        let name = name.replace('-', "_");
        if let Some(value) = self.values.get_mut(name.as_str()) {
            let missing = || FlagError(format!("flag '--{name}' is missing its argument"));
            *value = match given {
                Some(given) => given.to_owned(),
                None => rest.next().ok_or_else(missing)?.clone(),
            };
            return Ok(());
        }
        if let Some(switch) = self.switches.get_mut(name.as_str()) {
            *switch = match given {
                None | Some("true" | "t" | "1" | "yes" | "y") => true,
                Some("false" | "f" | "0" | "no" | "n") => false,
                Some(other) => {
                    let text = format!("illegal value '{other}' specified for bool flag '{name}'");
                    return Err(FlagError(text));
                }
            };
            return Ok(());
        }
        if let (Some(switch), None) = (name.strip_prefix("no").and_then(|n| self.switches.get_mut(n)), given)
        {
            *switch = false;
            return Ok(());
        }
        // Flags of the logging library are accepted and ignored.
        if ["logtostderr", "alsologtostderr", "stderrthreshold", "v", "minloglevel", "colorlogtostderr"]
            .contains(&name.as_str())
        {
            return Ok(());
        }
        Err(self.wrong(&format!("unknown command line flag '{name}'")))
    }

    /// Error of wrong usage, with the usage of the program.
    pub fn wrong(&self, what: &str) -> FlagError {
        FlagError(format!("{what}\n{}", self.usage))
    }

    /// The value of a flag that takes one.
    pub fn value(&self, name: &str) -> &str {
        self.values.get(name).map_or("", String::as_str)
    }

    /// The value of a flag that must be given.
    ///
    /// # Errors
    /// If it is empty.
    pub fn required(&self, name: &str) -> Result<&str, FlagError> {
        let value = self.value(name);
        if value.is_empty() { Err(self.wrong(&format!("-{name} is missing."))) } else { Ok(value) }
    }

    /// The path of a file that must be given.
    ///
    /// # Errors
    /// If it is empty.
    pub fn path(&self, name: &str) -> Result<PathBuf, FlagError> {
        self.required(name).map(|value| Path::new(value).to_owned())
    }

    /// The value of a flag as a number.
    ///
    /// # Errors
    /// If it is not a number.
    pub fn number(&self, name: &str) -> Result<f64, FlagError> {
        let value = self.value(name);
        value.parse().map_err(|_| self.wrong(&format!("illegal value '{value}' specified for flag '{name}'")))
    }

    /// Whether a boolean flag is on.
    pub fn is_on(&self, name: &str) -> bool {
        self.switches.get(name).copied().unwrap_or(false)
    }

    /// The value of a flag as a list separated by commas.
    pub fn list(&self, name: &str) -> Vec<String> {
        self.value(name).split(',').filter(|part| !part.is_empty()).map(str::to_owned).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: KnownFlags =
        KnownFlags { values: &[("file", ""), ("size", "0.5")], switches: &[("write", true)], usage: "how" };

    fn parse(text: &str) -> Result<Flags, FlagError> {
        let arguments: Vec<String> = text.split_whitespace().map(str::to_owned).collect();
        Flags::parse(&arguments, &KNOWN)
    }

    #[test]
    fn all_ways_of_writing_flags() {
        for text in ["-file a.b -nowrite c", "--file=a.b --write=false c", "c --file a.b --nowrite"] {
            let Ok(flags) = parse(text) else { panic!("{text}") };
            assert_eq!((flags.value("file"), flags.is_on("write")), ("a.b", false));
            assert_eq!(flags.positional, ["c"]);
            assert!(flags.number("size").is_ok_and(|s| (s - 0.5).abs() < 1e-12));
        }
        assert!(parse("-what 1").is_err() && parse("-file").is_err() && parse("--write=maybe").is_err());
        assert!(parse("").is_ok_and(|f| f.required("file").is_err()));
    }
}
