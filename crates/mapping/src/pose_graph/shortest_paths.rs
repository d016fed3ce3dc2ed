//! Shortest paths over a graph with additive edge lengths (Dijkstra).

use std::cmp::Ordering;
use std::collections::{BTreeMap, BinaryHeap};

/// Lengths of the shortest paths from `start` to all places that paths no longer than `longest` lead to
/// (Dijkstra). `edges` gives the neighbours of a place and the lengths of the edges to them, none of them
/// negative.
pub(super) fn shortest_paths<K: Ord + Copy, W: IntoIterator<Item = (K, f64)>>(
    start: K,
    longest: f64,
    edges: impl Fn(K) -> W,
) -> BTreeMap<K, f64> {
    let mut lengths = BTreeMap::new();
    let mut waiting = BinaryHeap::from([Reached { length: 0.0, at: start }]);
    while let Some(Reached { length, at }) = waiting.pop() {
        if lengths.contains_key(&at) {
            continue;
        }
        lengths.insert(at, length);
        for (next, edge) in edges(at) {
            if length + edge <= longest && !lengths.contains_key(&next) {
                waiting.push(Reached { length: length + edge, at: next });
            }
        }
    }
    lengths
}

/// Ordered so that the nearest is the greatest, for a max-heap.
struct Reached<K> {
    length: f64,
    at: K,
}

impl<K: Ord> PartialEq for Reached<K> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl<K: Ord> Eq for Reached<K> {}

impl<K: Ord> Ord for Reached<K> {
    fn cmp(&self, other: &Self) -> Ordering {
        other.length.total_cmp(&self.length).then_with(|| other.at.cmp(&self.at))
    }
}

impl<K: Ord> PartialOrd for Reached<K> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
