//! A hash table of points by voxels, for maps that grow.

use crate::Neighbour;

const EMPTY: u32 = u32::MAX;

#[derive(Clone, Copy, Debug)]
struct Slot {
    key: [i32; 3],
    /// The newest point of the voxel; the others are linked by `next`.
    head: u32,
}

/// Points (metres) by voxels. Takes 16 bytes per point and about 30 per voxel. Points can be added at any
/// time, in contrast to [`crate::KdTree`].
#[derive(Clone, Debug)]
pub struct VoxelMap {
    edge: f32,
    slots: Vec<Slot>,
    used: usize,
    points: Vec<[f32; 3]>,
    next: Vec<u32>,
}

impl VoxelMap {
    /// An empty map with voxels of `edge` metres (a value that is not above zero becomes 1). Searches are
    /// fastest with an edge near their radius.
    pub fn new(edge: f32) -> Self {
        let edge = if edge > 0.0 && edge.is_finite() { edge } else { 1.0 };
        Self {
            edge,
            slots: vec![Slot { key: [0; 3], head: EMPTY }; 16],
            used: 0,
            points: Vec::new(),
            next: Vec::new(),
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Number of voxels with points.
    pub fn voxel_count(&self) -> usize {
        self.used
    }

    /// Bytes in use, including the memory reserved for more points.
    pub fn memory_bytes(&self) -> usize {
        self.slots.capacity() * size_of::<Slot>()
            + self.points.capacity() * size_of::<[f32; 3]>()
            + self.next.capacity() * size_of::<u32>()
    }

    /// The points in the order of insertion.
    pub fn points(&self) -> &[[f32; 3]] {
        &self.points
    }

    /// Adds a point and returns its index, the number of points before it. A point that is not finite is not
    /// added.
    pub fn insert(&mut self, point: [f32; 3]) -> Option<u32> {
        if !point.iter().all(|v| v.is_finite()) || self.points.len() >= EMPTY as usize {
            return None;
        }
        if self.used * 4 >= self.slots.len() * 3 {
            self.grow();
        }
        let index = self.points.len() as u32;
        let key = self.key(point);
        let place = self.place(key);
        let slot = &mut self.slots[place];
        self.used += usize::from(slot.head == EMPTY);
        self.next.push(slot.head);
        self.points.push(point);
        *slot = Slot { key, head: index };
        Some(index)
    }

    /// Calls `found` with every point within `radius` metres.
    pub fn within(&self, query: [f32; 3], radius: f32, mut found: impl FnMut(Neighbour)) {
        if !query.iter().all(|v| v.is_finite()) || radius.is_nan() || radius < 0.0 {
            return;
        }
        let low = self.key(query.map(|v| v - radius));
        let high = self.key(query.map(|v| v + radius));
        let limit = radius * radius;
        let volume = (0..3).map(|k| (i64::from(high[k]) - i64::from(low[k]) + 1) as f64).product::<f64>();
        if volume > self.used as f64 {
            // More voxels in the cube than in use: it is cheaper to visit those in use.
            for slot in self.slots.iter().filter(|s| s.head != EMPTY) {
                self.visit_voxel(slot.head, query, limit, &mut found);
            }
            return;
        }
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    let head = self.slots[self.place([x, y, z])].head;
                    self.visit_voxel(head, query, limit, &mut found);
                }
            }
        }
    }

    /// The `count` nearest points within `max_distance`, nearest first (ties by index).
    pub fn k_nearest(&self, query: [f32; 3], count: usize, max_distance: f32) -> Vec<Neighbour> {
        let mut found: Vec<Neighbour> = Vec::new();
        let mut radius = self.edge.min(max_distance);
        loop {
            found.clear();
            self.within(query, radius, |n| found.push(n));
            if found.len() >= count || radius >= max_distance || found.len() == self.points.len() {
                break;
            }
            radius = (2.0 * radius).min(max_distance);
        }
        found.sort_by(|a, b| a.squared_distance.total_cmp(&b.squared_distance).then(a.index.cmp(&b.index)));
        found.truncate(count);
        found
    }

    fn visit_voxel(&self, head: u32, query: [f32; 3], limit: f32, found: &mut impl FnMut(Neighbour)) {
        let mut index = head;
        while index != EMPTY {
            let p = self.points[index as usize];
            let squared_distance = (0..3).map(|k| (p[k] - query[k]) * (p[k] - query[k])).sum();
            if squared_distance <= limit {
                found(Neighbour { index, squared_distance });
            }
            index = self.next[index as usize];
        }
    }

    fn key(&self, point: [f32; 3]) -> [i32; 3] {
        point.map(|v| (v / self.edge).floor() as i32)
    }

    /// The slot of a voxel, or the free slot where it would be inserted.
    fn place(&self, key: [i32; 3]) -> usize {
        let mask = self.slots.len() - 1;
        let mut place = hash(key) as usize & mask;
        while self.slots[place].head != EMPTY && self.slots[place].key != key {
            place = (place + 1) & mask;
        }
        place
    }

    fn grow(&mut self) {
        let larger = vec![Slot { key: [0; 3], head: EMPTY }; self.slots.len() * 2];
        let old = std::mem::replace(&mut self.slots, larger);
        for slot in old.into_iter().filter(|s| s.head != EMPTY) {
            let place = self.place(slot.key);
            self.slots[place] = slot;
        }
    }
}

fn hash(key: [i32; 3]) -> u64 {
    let mut h = 0u64;
    for k in key {
        h = (h.rotate_left(21) ^ u64::from(k as u32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
    h ^ (h >> 32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn agrees_with_brute_force(
            points in prop::collection::vec([-3.0f32..3.0, -3.0f32..3.0, -3.0f32..3.0], 0..200),
            query in [-3.0f32..3.0, -3.0f32..3.0, -3.0f32..3.0],
            radius in 0.05f32..2.0, count in 1usize..10,
        ) {
            let mut map = VoxelMap::new(0.4);
            for point in &points {
                map.insert(*point);
            }
            let mut all: Vec<Neighbour> = points.iter().enumerate().map(|(i, p)| Neighbour {
                index: i as u32,
                squared_distance: (0..3).map(|k| (p[k] - query[k]) * (p[k] - query[k])).sum(),
            }).collect();
            all.sort_by(|a, b| a.squared_distance.total_cmp(&b.squared_distance).then(a.index.cmp(&b.index)));
            prop_assert_eq!(map.k_nearest(query, count, 100.0), all[..count.min(all.len())].to_vec());
            let mut found = Vec::new();
            map.within(query, radius, |n| found.push(n.index));
            found.sort_unstable();
            let mut expected: Vec<u32> =
                all.iter().filter(|n| n.squared_distance <= radius * radius).map(|n| n.index).collect();
            expected.sort_unstable();
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn what_is_not_a_point_is_not_added() {
        let mut map = VoxelMap::new(0.0);
        assert!(map.insert([f32::NAN, 0.0, 0.0]).is_none() && map.insert([1.0; 3]) == Some(0));
        assert_eq!((map.len(), map.voxel_count()), (1, 1));
    }
}
