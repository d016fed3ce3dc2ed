//! A static kd-tree of points: buckets of permuted points, split at the median of the widest axis.
//!
//! The shape of the tree depends only on the number of points, so nodes need no pointers: node `i` has
//! children `2i+1` and `2i+2`, and each half contains half of the points. It takes 8 bytes per node and 16
//! per point; with buckets of 8 to 16 points that is less than 18 bytes per point.

use rayon::prelude::*;

/// Maximum number of points in a leaf.
const BUCKET: usize = 16;
/// Subtrees with fewer points are built on one thread.
const PARALLEL: usize = 16_384;

/// Flag in the axis of a node: all points below have the same position and are in the order of their indices.
const COINCIDENT: u32 = 1 << 31;

/// A point found by a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Its index in the points the tree was built from.
    pub index: u32,
    /// Its squared distance, square metres.
    pub squared_distance: f32,
}

#[derive(Clone, Copy, Debug, Default)]
struct Node {
    split: f32,
    axis: u32,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    position: [f32; 3],
    index: u32,
}

/// A static kd-tree of points (metres, any frame). Points that are not finite are left out.
#[derive(Clone, Debug, Default)]
pub struct KdTree {
    nodes: Vec<Node>,
    entries: Vec<Entry>,
    depth: u32,
}

impl Neighbour {
    /// The point `index` of a tree, at `position`, as a neighbour of a query.
    pub fn of(query: [f32; 3], index: u32, position: [f32; 3]) -> Self {
        let [x, y, z] = position;
        let squared_distance = squared_norm([x - query[0], y - query[1], z - query[2]]);
        Self { index, squared_distance }
    }
}

impl KdTree {
    /// Builds a tree; large ones on all threads of the current pool. The result does not depend on
    /// the number of threads.
    pub fn new(points: &[[f32; 3]]) -> Self {
        let finite = points.iter().enumerate().filter(|(_, p)| p.iter().all(|v| v.is_finite()));
        let mut entries: Vec<Entry> = finite.map(|(i, p)| Entry { position: *p, index: i as u32 }).collect();
        entries.shrink_to_fit();
        let mut depth = 0;
        while entries.len() >> depth > BUCKET {
            depth += 1;
        }
        let mut nodes = vec![Node::default(); (1 << depth) - 1];
        let levels = level_slices(&mut nodes, depth);
        build(&mut entries, levels);
        Self { nodes, entries, depth }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Bytes in use.
    pub fn memory_bytes(&self) -> usize {
        self.nodes.capacity() * size_of::<Node>() + self.entries.capacity() * size_of::<Entry>()
    }

    /// The nearest point within `max_distance` (metres); of several at the same distance the one with the
    /// lowest index.
    pub fn nearest(&self, query: [f32; 3], max_distance: f32) -> Option<Neighbour> {
        self.nearest_of(query, max_distance, 1, |_| true)
    }

    /// Like [`Self::nearest`]; faster if `near` is one of the points and close to the query.
    pub fn nearest_from(&self, query: [f32; 3], max_distance: f32, near: Neighbour) -> Option<Neighbour> {
        let limit = max_distance * max_distance;
        if near.squared_distance.is_nan() || near.squared_distance > limit {
            return self.nearest(query, max_distance);
        }
        let mut best = near;
        self.visit(query, near.squared_distance, 1, |candidate, limit| {
            if (candidate.squared_distance, candidate.index) < (best.squared_distance, best.index) {
                best = candidate;
                *limit = candidate.squared_distance;
            }
        });
        Some(best)
    }

    /// The nearest point within `max_distance` among those whose index `accept` accepts.
    pub fn nearest_where(
        &self,
        query: [f32; 3],
        max_distance: f32,
        accept: impl FnMut(u32) -> bool,
    ) -> Option<Neighbour> {
        self.nearest_of(query, max_distance, usize::MAX, accept)
    }

    fn nearest_of(
        &self,
        query: [f32; 3],
        max_distance: f32,
        first: usize,
        mut accept: impl FnMut(u32) -> bool,
    ) -> Option<Neighbour> {
        let mut best: Option<Neighbour> = None;
        let limit = max_distance * max_distance;
        self.visit(query, limit, first, |candidate, limit| {
            let better = match best {
                Some(b) => (candidate.squared_distance, candidate.index) < (b.squared_distance, b.index),
                None => candidate.squared_distance <= *limit,
            };
            if better && accept(candidate.index) {
                best = Some(candidate);
                *limit = candidate.squared_distance;
            }
        });
        best
    }

    /// Whether there is a point within `max_distance` metres; cheaper than the nearest point.
    pub fn has_within(&self, query: [f32; 3], max_distance: f32) -> bool {
        let squared = max_distance * max_distance;
        let mut found = false;
        self.visit(query, squared, 1, |candidate, limit| {
            if candidate.squared_distance <= squared {
                found = true;
                // Ends the search: no distance is within this limit.
                *limit = -1.0;
            }
        });
        found
    }

    /// The nearest point within `max_distance` metres, and a lower bound of the distance of all others,
    /// metres (at most `max_distance`).
    pub fn nearest_two(&self, query: [f32; 3], max_distance: f32) -> Option<(Neighbour, f32)> {
        let limit = max_distance * max_distance;
        let mut best: Option<Neighbour> = None;
        let mut second = limit;
        self.visit(query, limit, 2, |candidate, limit| {
            let key = (candidate.squared_distance, candidate.index);
            match best {
                Some(b) if (b.squared_distance, b.index) <= key => {
                    second = second.min(candidate.squared_distance)
                }
                Some(b) => {
                    second = second.min(b.squared_distance);
                    best = Some(candidate);
                }
                None if candidate.squared_distance <= *limit => best = Some(candidate),
                None => return,
            }
            *limit = second;
        });
        best.map(|nearest| (nearest, second.sqrt()))
    }

    /// Writes the `count` nearest points within `max_distance` into `found`, nearest first (ties by index),
    /// and reuses its capacity.
    pub fn k_nearest(&self, query: [f32; 3], count: usize, max_distance: f32, found: &mut Vec<Neighbour>) {
        found.clear();
        if count == 0 {
            return;
        }
        let key = |n: &Neighbour| (n.squared_distance, n.index);
        self.visit(query, max_distance * max_distance, count, |candidate, limit| {
            if candidate.squared_distance > *limit {
                return;
            }
            let place = found.partition_point(|n| key(n) < key(&candidate));
            if place < count {
                found.insert(place, candidate);
                found.truncate(count);
                if let Some(last) = found.get(count - 1) {
                    *limit = last.squared_distance;
                }
            }
        });
    }

    /// Calls `found` with every point within `radius` (metres). The order depends only on the points.
    pub fn within(&self, query: [f32; 3], radius: f32, mut found: impl FnMut(Neighbour)) {
        self.visit(query, radius * radius, usize::MAX, |candidate, limit| {
            if candidate.squared_distance <= *limit {
                found(candidate);
            }
        });
    }

    /// Number of points within `radius` (metres), counted up to `most`.
    pub fn count_within(&self, query: [f32; 3], radius: f32, most: usize) -> usize {
        let (squared, mut count) = (radius * radius, 0);
        self.visit(query, squared, usize::MAX, |candidate, limit| {
            if candidate.squared_distance <= *limit {
                count += 1;
            }
            if count >= most {
                // Ends the search: no distance is within this limit.
                *limit = -1.0;
            }
        });
        count.min(most)
    }

    /// Calls `candidate` with every point of every bucket that the current limit of the squared distance does
    /// not exclude; `candidate` may lower the limit. Of many points at the same position at least the `first`
    /// ones (by index) are visited, and not all: a million of them would slow down every search.
    fn visit(
        &self,
        query: [f32; 3],
        mut limit: f32,
        first: usize,
        mut candidate: impl FnMut(Neighbour, &mut f32),
    ) {
        let mut stack = [Pending::default(); DEEPEST];
        stack[0].end = self.entries.len();
        let mut height = usize::from(!self.entries.is_empty());
        while height > 0 {
            height -= 1;
            let mut part = stack[height];
            if squared_norm(part.offsets) > limit {
                continue;
            }
            while part.level < self.depth {
                let far = self.descend(&mut part, query, first);
                if let Some(far) = far
                    && squared_norm(far.offsets) <= limit
                    && height < DEEPEST
                {
                    stack[height] = far;
                    height += 1;
                }
            }
            for entry in &self.entries[part.start..part.end] {
                let [x, y, z] = entry.position;
                let d = [x - query[0], y - query[1], z - query[2]];
                candidate(Neighbour { index: entry.index, squared_distance: squared_norm(d) }, &mut limit);
            }
        }
    }

    /// Descends to the half of a part that contains the query, and returns the other half if it must be
    /// searched, too. Of coincident points one half suffices if it has `first` points.
    #[inline]
    fn descend(&self, part: &mut Pending, query: [f32; 3], first: usize) -> Option<Pending> {
        let Node { split, axis } = self.nodes[part.node];
        let middle = part.start + (part.end - part.start) / 2;
        let (left, right) = (2 * part.node + 1, 2 * part.node + 2);
        part.level += 1;
        if axis & COINCIDENT != 0 && middle - part.start >= first {
            (part.node, part.end) = (left, middle);
            return None;
        }
        let axis = (axis & !COINCIDENT) as usize;
        let difference = query[axis] - split;
        let mut far = *part;
        far.offsets[axis] = difference;
        if difference < 0.0 {
            (part.node, part.end) = (left, middle);
            (far.node, far.start) = (right, middle);
        } else {
            (part.node, part.start) = (right, middle);
            (far.node, far.end) = (left, middle);
        }
        Some(far)
    }
}

/// Maximum number of levels: a deeper tree would hold more points than fit into memory.
const DEEPEST: usize = 40;

/// A part of the tree that has not been searched yet.
#[derive(Clone, Copy, Default)]
struct Pending {
    node: usize,
    /// Number of levels above it.
    level: u32,
    /// Range of its points.
    start: usize,
    end: usize,
    /// Distance of the query from the part along each axis, metres.
    offsets: [f32; 3],
}

#[inline]
fn squared_norm(v: [f32; 3]) -> f32 {
    v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
}

/// The nodes of each level, root first.
fn level_slices(nodes: &mut [Node], depth: u32) -> Vec<&mut [Node]> {
    let mut rest = nodes;
    let mut levels = Vec::with_capacity(depth as usize);
    for level in 0..depth {
        let (own, below) = rest.split_at_mut(1 << level);
        levels.push(own);
        rest = below;
    }
    levels
}

fn build(entries: &mut [Entry], levels: Vec<&mut [Node]>) {
    let mut levels = levels.into_iter();
    let Some([node]) = levels.next() else { return };
    let (axis, extent) = widest_axis(entries);
    let is_coincident = extent == 0.0;
    let middle = entries.len() / 2;
    let order = |a: &Entry, b: &Entry| {
        // Zeros of both signs are the same position.
        let by_place = a.position[axis].total_cmp(&b.position[axis]);
        if is_coincident { a.index.cmp(&b.index) } else { by_place.then(a.index.cmp(&b.index)) }
    };
    let (_, median, _) = entries.select_nth_unstable_by(middle, order);
    let flag = if is_coincident { COINCIDENT } else { 0 };
    *node = Node { split: median.position[axis], axis: axis as u32 | flag };
    let (mut left_levels, mut right_levels) = (Vec::new(), Vec::new());
    for level in levels {
        let (left, right) = level.split_at_mut(level.len() / 2);
        left_levels.push(left);
        right_levels.push(right);
    }
    let parallel = entries.len() > PARALLEL;
    let (left, right) = entries.split_at_mut(middle);
    if parallel {
        rayon::join(|| build(left, left_levels), || build(right, right_levels));
    } else {
        build(left, left_levels);
        build(right, right_levels);
    }
}

/// The axis along which the points extend most, and their extent along it.
fn widest_axis(entries: &[Entry]) -> (usize, f32) {
    let bounds = |entries: &[Entry]| {
        entries.iter().fold(([f32::MAX; 3], [f32::MIN; 3]), |(low, high), e| {
            (
                std::array::from_fn(|k| low[k].min(e.position[k])),
                std::array::from_fn(|k| high[k].max(e.position[k])),
            )
        })
    };
    let (low, high): ([f32; 3], [f32; 3]) = if entries.len() > PARALLEL {
        entries.par_chunks(PARALLEL).map(bounds).reduce(
            || ([f32::MAX; 3], [f32::MIN; 3]),
            |a, b| (std::array::from_fn(|k| a.0[k].min(b.0[k])), std::array::from_fn(|k| a.1[k].max(b.1[k]))),
        )
    } else {
        bounds(entries)
    };
    let extent = |k: usize| high[k] - low[k];
    let mut axis = 0;
    for k in 1..3 {
        if extent(k) > extent(axis) {
            axis = k;
        }
    }
    (axis, extent(axis))
}

#[cfg(test)]
mod tests;
