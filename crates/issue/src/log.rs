//! Log of issues: equal issues are counted in one entry.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::Arc;

use portolan_geometry::Time;
use serde::{Serialize, Serializer};

use crate::{Datum, Issue, IssueKind, Severity};

/// Maximum number of distinct entries. It bounds the size of a report, whatever a hostile file contains; further kinds
/// are counted as [`IssueKind::FurtherKinds`].
const MAX_ENTRIES: usize = 256;

/// Key of an entry: issues with the same key are counted together.
type Key = (IssueKind, Option<Arc<str>>, Vec<(&'static str, Datum)>, Severity);

/// Issues that occurred: one entry per kind, sensor, data and severity, with the count and the first and last time.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct IssueLog {
    entries: BTreeMap<Key, (u64, Option<(Time, Time)>)>,
}

/// Smallest span that contains both spans.
fn union(a: Option<(Time, Time)>, b: Option<(Time, Time)>) -> Option<(Time, Time)> {
    match (a, b) {
        (Some(a), Some(b)) => Some((a.0.min(b.0), a.1.max(b.1))),
        (a, b) => a.or(b),
    }
}

impl IssueLog {
    /// Adds an issue, or only its kind if nothing more is known. An issue with a count of 0 is ignored.
    pub fn add(&mut self, issue: impl Into<Issue>) {
        let Issue { kind, severity, sensor, data, count, span } = issue.into();
        if count == 0 {
            return;
        }
        let mut key = (kind, sensor, data, severity);
        if self.entries.len() >= MAX_ENTRIES && !self.entries.contains_key(&key) {
            key = (IssueKind::FurtherKinds, None, Vec::new(), severity);
        }
        match self.entries.entry(key) {
            Entry::Vacant(entry) => {
                entry.insert((count, span));
            }
            Entry::Occupied(mut entry) => {
                let (counted, spanned) = entry.get_mut();
                *counted = counted.saturating_add(count);
                *spanned = union(*spanned, span);
            }
        }
    }

    /// Adds `times` occurrences of a kind without sensor, data or time.
    pub fn count(&mut self, kind: IssueKind, times: u64) {
        self.add(Issue::new(kind).times(times));
    }

    /// Adds issues that were counted elsewhere.
    pub fn merge<'a>(&mut self, others: impl IntoIterator<Item = &'a Issue>) {
        others.into_iter().for_each(|issue| self.add(issue.clone()));
    }

    /// Adds all issues of another log.
    pub fn append(&mut self, other: &Self) {
        other.iter().for_each(|issue| self.add(issue));
    }

    /// All issues, ordered by kind, sensor and data.
    pub fn iter(&self) -> impl Iterator<Item = Issue> + '_ {
        self.entries.iter().map(|((kind, sensor, data, severity), (count, span))| Issue {
            kind: *kind,
            severity: *severity,
            sensor: sensor.clone(),
            data: data.clone(),
            count: *count,
            span: *span,
        })
    }

    /// All issues as a list.
    pub fn list(&self) -> Vec<Issue> {
        self.iter().collect()
    }

    /// Number of occurrences of a kind, summed over sensors and data.
    pub fn count_of(&self, kind: IssueKind) -> u64 {
        let of_kind = self.entries.iter().filter(|((k, ..), _)| *k == kind);
        of_kind.fold(0, |sum, (_, (count, _))| sum.saturating_add(*count))
    }

    /// Number of occurrences of each kind, summed over sensors and data.
    pub fn counts(&self) -> BTreeMap<IssueKind, u64> {
        let mut counts = BTreeMap::new();
        for ((kind, ..), (count, _)) in &self.entries {
            let counted: &mut u64 = counts.entry(*kind).or_default();
            *counted = counted.saturating_add(*count);
        }
        counts
    }

    /// Whether the log has no issues.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Whether data were lost: an issue has severity [`Severity::Error`].
    pub fn lost_data(&self) -> bool {
        self.entries.keys().any(|(.., severity)| *severity == Severity::Error)
    }
}

impl FromIterator<Issue> for IssueLog {
    fn from_iter<I: IntoIterator<Item = Issue>>(issues: I) -> Self {
        let mut log = Self::default();
        issues.into_iter().for_each(|issue| log.add(issue));
        log
    }
}

impl Serialize for IssueLog {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_issues_are_one_entry_with_count_and_times() {
        let mut log = IssueLog::default();
        let at =
            |seconds| Issue::new(IssueKind::StampBackward).of("/imu").at(Time::from_unix_seconds(seconds));
        log.add(at(2.0).times(3));
        log.add(at(1.0));
        log.add(at(9.0).with_severity(Severity::Info));
        log.count(IssueKind::NoDistance, 0);
        let list = log.list();
        assert_eq!(list.len(), 2);
        let lost = list.iter().find(|issue| issue.lost_data()).unwrap();
        let span = (Time::from_unix_seconds(1.0), Time::from_unix_seconds(2.0));
        assert_eq!((lost.count, lost.span), (4, Some(span)));
        assert!(log.lost_data());
        assert_eq!(log.count_of(IssueKind::StampBackward), 5);
        let mut twice = log.clone();
        twice.append(&log);
        assert_eq!(twice.count_of(IssueKind::StampBackward), 10);
    }

    #[test]
    fn hostile_input_does_not_make_the_log_grow() {
        let mut log = IssueLog::default();
        for number in 0..10 * MAX_ENTRIES {
            log.add(Issue::new(IssueKind::UnusedLines).with("kind", number));
        }
        assert!(log.list().len() <= MAX_ENTRIES + 1);
        assert!(log.count_of(IssueKind::FurtherKinds) > 0);
    }
}
