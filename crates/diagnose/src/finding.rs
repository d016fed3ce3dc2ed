//! Findings about a recording, counted by kind and topic.

use portolan_issue::Severity;
use std::collections::BTreeMap;

/// A fault or remarkable property of a recording that affects mapping.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// The topic; empty if it is about the whole recording.
    pub topic: String,
    /// Number of occurrences.
    pub count: u64,
    /// Description, with the numbers of the first (or worst) case.
    #[serde(rename = "what")]
    pub text: String,
    /// Its effect on mapping.
    pub effect_on_slam: String,
    /// Remedy.
    #[serde(rename = "what_to_do")]
    pub advice: String,
}

/// A kind of finding: the parts that do not depend on the case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Kind {
    pub name: &'static str,
    pub severity: Severity,
    pub effect: &'static str,
    pub to_do: &'static str,
}

/// Maximum number of findings of all topics together; further ones are only counted.
const MAX_FINDINGS: usize = 500;

/// Collects findings: one for each kind and topic.
#[derive(Debug, Default)]
pub(crate) struct Findings {
    list: Vec<Finding>,
    index: BTreeMap<(Kind, String), usize>,
    dropped: u64,
}

impl Findings {
    /// Adds a finding; of several findings of a kind and topic the first text is kept.
    pub fn add(&mut self, kind: &Kind, topic: &str, text: impl FnOnce() -> String) {
        let key = (*kind, topic.to_owned());
        if let Some(finding) = self.index.get(&key).and_then(|i| self.list.get_mut(*i)) {
            finding.count += 1;
            return;
        }
        if self.list.len() >= MAX_FINDINGS {
            self.dropped += 1;
            return;
        }
        self.index.insert(key, self.list.len());
        self.list.push(Finding {
            severity: kind.severity,
            topic: topic.to_owned(),
            count: 1,
            text: text(),
            effect_on_slam: kind.effect.to_owned(),
            advice: kind.to_do.to_owned(),
        });
    }

    /// Adds a finding unchanged.
    pub fn push(&mut self, finding: Finding) {
        if self.list.len() < MAX_FINDINGS {
            self.list.push(finding);
        } else {
            self.dropped += 1;
        }
    }

    /// Returns the findings, the worst first, otherwise in the order in which they were found.
    pub fn finish(mut self) -> Vec<Finding> {
        if self.dropped > 0 {
            self.list.push(Finding {
                severity: Severity::Warning,
                topic: String::new(),
                count: self.dropped,
                text: "there are more findings than are listed".to_owned(),
                effect_on_slam: "not known".to_owned(),
                advice: "solve those that are listed first".to_owned(),
            });
        }
        self.list.sort_by_key(|f| std::cmp::Reverse(f.severity));
        self.list
    }
}

impl Finding {
    /// Three lines of text for the user.
    pub fn to_text(&self) -> String {
        let severity = self.severity.name();
        let about = if self.topic.is_empty() { String::new() } else { format!("{}: ", self.topic) };
        let times = if self.count > 1 { format!(" ({} times)", self.count) } else { String::new() };
        let mut text = format!("{severity}: {about}{}{times}\n", self.text);
        for (label, line) in [("effect", &self.effect_on_slam), ("to do", &self.advice)] {
            if !line.is_empty() {
                text.push_str(&format!("  {label}: {line}\n"));
            }
        }
        text
    }
}

/// All findings as text for the user.
pub fn findings_to_text(findings: &[Finding]) -> String {
    findings.iter().map(Finding::to_text).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn findings_are_counted_and_sorted() {
        let note = Kind { name: "a", severity: Severity::Info, effect: "none", to_do: "" };
        let fault = Kind { name: "b", severity: Severity::Error, effect: "bad", to_do: "mend it" };
        let mut findings = Findings::default();
        findings.add(&note, "/scan", || "first".into());
        findings.add(&note, "/scan", || "second".into());
        findings.add(&fault, "/imu", || "broken".into());
        let list = findings.finish();
        assert_eq!((list[0].text.as_str(), list[1].text.as_str(), list[1].count), ("broken", "first", 2));
        let text = findings_to_text(&list);
        assert_eq!(
            text,
            "error: /imu: broken\n  effect: bad\n  to do: mend it\ninfo: /scan: first (2 times)\n  effect: none\n"
        );
    }
}
