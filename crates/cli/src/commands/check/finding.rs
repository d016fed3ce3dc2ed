//! Findings, counted by kind.

use std::collections::BTreeMap;

use serde::Serialize;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// The result may be worse than it could be.
    Warning,
    /// Data are lost, or the result will be wrong.
    Error,
}

/// Something that is wrong.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    pub severity: Severity,
    /// What is wrong; of several of a kind the first.
    pub what: String,
    /// How often.
    pub count: u64,
    /// What follows from it.
    pub effect: &'static str,
    /// What to do.
    pub advice: &'static str,
}

impl Finding {
    /// For people.
    pub fn text(&self) -> String {
        let severity = match self.severity {
            Severity::Warning => "warning",
            Severity::Error => "error",
        };
        let times = if self.count > 1 { format!(" ({} times)", self.count) } else { String::new() };
        format!(
            "  {severity}: {}{times}\n    effect: {}\n    to do:  {}\n",
            self.what, self.effect, self.advice
        )
    }
}

/// A kind of finding.
#[derive(Clone, Copy, Debug)]
pub struct Kind {
    /// Tells kinds apart.
    pub name: &'static str,
    pub severity: Severity,
    pub effect: &'static str,
    pub advice: &'static str,
}

/// More different subjects than this are counted under the last one.
const MAX_FINDINGS: usize = 1000;

/// Collects findings: one for each kind and subject, with the first text and a count.
#[derive(Default)]
pub struct Findings {
    list: Vec<Finding>,
    index: BTreeMap<(&'static str, String), usize>,
}

impl Findings {
    /// Takes a finding about a subject (a topic, a frame).
    pub fn add(&mut self, kind: &Kind, subject: &str, what: impl FnOnce() -> String) {
        let key = (kind.name, subject.to_owned());
        let known = self.index.get(&key).copied();
        let full = (self.list.len() >= MAX_FINDINGS).then(|| self.list.len() - 1);
        if let Some(finding) = known.or(full).and_then(|index| self.list.get_mut(index)) {
            finding.count += 1;
            return;
        }
        self.index.insert(key, self.list.len());
        self.push(Finding {
            severity: kind.severity,
            what: what(),
            count: 1,
            effect: kind.effect,
            advice: kind.advice,
        });
    }

    /// Takes a finding as it is.
    pub fn push(&mut self, finding: Finding) {
        self.list.push(finding);
    }

    /// All findings in the order they were first seen.
    pub fn finish(self) -> Vec<Finding> {
        self.list
    }
}
