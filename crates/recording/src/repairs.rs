//! Counting what was repaired or lost while reading.

use std::collections::BTreeMap;

use crate::Repair;

/// Repairs and losses by kind.
#[derive(Clone, Debug, Default)]
pub struct RepairLog {
    counts: BTreeMap<(String, bool), u64>,
}

/// So many kinds are told apart; a hostile file cannot make the report grow beyond.
const MAX_KINDS: usize = 256;

impl RepairLog {
    /// Counts a repair after which nothing is missing.
    pub fn repaired(&mut self, what: impl Into<String>) {
        self.add(what, false, 1);
    }

    /// Counts a loss of data.
    pub fn lost(&mut self, what: impl Into<String>) {
        self.add(what, true, 1);
    }

    /// Adds what another log counted.
    pub fn merge(&mut self, other: &[Repair]) {
        for repair in other {
            self.add(repair.what.as_str(), repair.lost_data, repair.count);
        }
    }

    /// Counts `count` repairs of one kind.
    pub fn add(&mut self, what: impl Into<String>, lost_data: bool, count: u64) {
        let mut key = (what.into(), lost_data);
        if self.counts.len() >= MAX_KINDS && !self.counts.contains_key(&key) {
            key = ("further kinds of damage".to_owned(), lost_data);
        }
        let counted = self.counts.entry(key).or_default();
        *counted = counted.saturating_add(count);
    }

    /// The counts in ascending order.
    pub fn list(&self) -> Vec<Repair> {
        let repair = |((what, lost_data), count): (&(String, bool), &u64)| Repair {
            what: what.clone(),
            count: *count,
            lost_data: *lost_data,
        };
        self.counts.iter().map(repair).collect()
    }
}
