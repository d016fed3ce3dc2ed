//! Puts messages into order of time within a bounded window.

use std::collections::BTreeMap;

use portolan_geometry::{Duration, Time};

/// A message is released once one this much later has arrived (10 s) and more than [`AT_LEAST`] messages
/// wait.
const WINDOW: Duration = Duration::from_ticks(10 * 10_000_000);
/// Number of waiting messages above which messages are released in order of time; see [`WINDOW`].
const AT_LEAST: usize = 64;
/// Limits on waiting messages, as a number and in bytes; above either one the earliest is released at once.
const AT_MOST: usize = 4096;
const AT_MOST_BYTES: usize = 64 << 20;

/// Orders items by time, then by rank, then by arrival.
#[derive(Debug)]
pub(crate) struct Reorder<T> {
    waiting: BTreeMap<(Time, u32, u64), (usize, T)>,
    bytes: usize,
    sequence: u64,
    newest: Time,
    released: Time,
}

impl<T> Default for Reorder<T> {
    fn default() -> Self {
        Self { waiting: BTreeMap::new(), bytes: 0, sequence: 0, newest: Time::MIN, released: Time::MIN }
    }
}

impl<T> Reorder<T> {
    /// Adds an item with its size in bytes; returns whether an item of a later time had come before it.
    pub fn push(&mut self, time: Time, rank: u32, bytes: usize, item: T) -> bool {
        let late = time < self.newest;
        self.newest = self.newest.max(time);
        self.waiting.insert((time, rank, self.sequence), (bytes, item));
        self.bytes += bytes;
        self.sequence += 1;
        late
    }

    /// The next item, if its place is certain or `at_end`. The time returned never decreases: an item that
    /// came too late gets the time of the item before it, and `true`.
    pub fn pop(&mut self, at_end: bool) -> Option<(Time, T, bool)> {
        let (&(time, ..), _) = self.waiting.first_key_value()?;
        let settled = self.waiting.len() > AT_LEAST && time <= self.newest - WINDOW;
        let full = self.waiting.len() > AT_MOST || self.bytes > AT_MOST_BYTES;
        if !(at_end || settled || full) {
            return None;
        }
        let (_, (bytes, item)) = self.waiting.pop_first()?;
        self.bytes -= bytes;
        let too_late = time < self.released;
        self.released = self.released.max(time);
        Some((self.released, item, too_late))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn ties_are_ordered_by_rank() {
        let mut reorder = Reorder::default();
        assert!(!reorder.push(Time::from_ticks(5), 1, 9, 'b'));
        assert!(!reorder.push(Time::from_ticks(5), 0, 9, 'a'));
        assert!(reorder.push(Time::from_ticks(4), 9, 9, '-'));
        assert!(reorder.pop(false).is_none());
        let order: String = std::iter::from_fn(|| reorder.pop(true)).map(|x| x.1).collect();
        assert_eq!(order, "-ab");
    }

    proptest! {
        #[test]
        fn no_line_is_lost_and_times_ascend(seconds in prop::collection::vec(-40i64..4000, 1..6000)) {
            let mut reorder = Reorder::default();
            let mut out = Vec::new();
            for s in &seconds {
                reorder.push(Time::from_ticks(s * 10_000_000), 0, 8, *s);
                while let Some((time, item, _)) = reorder.pop(false) {
                    out.push((time, item));
                }
                prop_assert!(reorder.waiting.len() <= AT_MOST);
            }
            while let Some((time, item, _)) = reorder.pop(true) {
                out.push((time, item));
            }
            prop_assert!(out.windows(2).all(|w| w[0].0 <= w[1].0));
            let mut items: Vec<i64> = out.iter().map(|x| x.1).collect();
            let mut expected = seconds.clone();
            items.sort();
            expected.sort();
            prop_assert_eq!(items, expected);
        }
    }
}
