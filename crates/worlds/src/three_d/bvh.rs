//! A bounding volume hierarchy of solids, so that a ray is tested against few of them.
//!
//! Built top down with the surface area heuristic over 16 bins per axis (Wald, "On fast construction of
//! SAH-based bounding volume hierarchies", 2007). Boxes are in single precision and a millimetre too large,
//! so that no hit is lost by rounding; ranges are computed in double precision.

use portolan_geometry::Vector3;

use super::primitive::{Bounds, Hit3, Ray3, Solid};

const BINS: usize = 16;
/// Margin of a box around its contents on each side, metres.
const MARGIN: f64 = 1e-3;
const MOST_IN_A_LEAF: usize = 4;
/// Maximum depth of the hierarchy; a node at this depth is a leaf of any size.
const MAX_DEPTH: usize = 60;

#[derive(Clone, Copy, Debug)]
struct Node {
    min: [f32; 3],
    max: [f32; 3],
    /// Index of the first solid of a leaf, or of the second child of a branch (the first child follows the
    /// branch).
    next: u32,
    /// Number of solids in a leaf; 0 in a branch.
    count: u32,
}

/// Static solids in a bounding volume hierarchy.
#[derive(Clone, Debug)]
pub struct Hierarchy {
    nodes: Vec<Node>,
    solids: Vec<Solid>,
}

struct Item {
    solid: Solid,
    bounds: Bounds,
    centre: Vector3,
}

impl Hierarchy {
    /// Builds the hierarchy.
    pub fn new(solids: Vec<Solid>) -> Self {
        let item = |solid: Solid| {
            let bounds = solid.body.bounds();
            Item { solid, bounds, centre: bounds.centre() }
        };
        let mut items: Vec<Item> = solids.into_iter().map(item).collect();
        let mut nodes = Vec::with_capacity(2 * items.len());
        if !items.is_empty() {
            build(&mut items, 0, 0, &mut nodes);
        }
        Self { nodes, solids: items.into_iter().map(|item| item.solid).collect() }
    }

    /// All solids, in the order of the hierarchy.
    pub fn solids(&self) -> &[Solid] {
        &self.solids
    }

    /// The first hit of a ray nearer than `limit` metres.
    pub fn cast(&self, ray: &Ray3, limit: f64) -> Option<Hit3> {
        let query = Query::new(ray);
        let mut nearest: Option<(f64, Vector3, usize)> = None;
        let mut limit = limit;
        let mut stack = [(0_u32, 0.0_f32); MAX_DEPTH + 4];
        let mut depth = 0;
        let mut at = 0_u32;
        if self.nodes.first().is_none_or(|root| query.enters(root) > limit as f32) {
            return None;
        }
        loop {
            let node = &self.nodes[at as usize];
            if node.count > 0 {
                let first = node.next as usize;
                for (index, solid) in self.solids[first..first + node.count as usize].iter().enumerate() {
                    if let Some((range, normal)) = solid.body.meet(ray, limit) {
                        limit = range;
                        nearest = Some((range, normal, first + index));
                    }
                }
            } else {
                let (mut near, mut far) = (at + 1, node.next);
                let (mut near_range, mut far_range) =
                    (query.enters(&self.nodes[near as usize]), query.enters(&self.nodes[far as usize]));
                if far_range < near_range {
                    (near, far) = (far, near);
                    (near_range, far_range) = (far_range, near_range);
                }
                if near_range <= limit as f32 {
                    if far_range <= limit as f32 {
                        stack[depth] = (far, far_range);
                        depth += 1;
                    }
                    at = near;
                    continue;
                }
            }
            // The next node on the stack that is not behind the nearest hit so far.
            loop {
                if depth == 0 {
                    return nearest.map(|(range, normal, index)| Hit3 {
                        range,
                        normal,
                        material: self.solids[index].material,
                    });
                }
                depth -= 1;
                let (node, range) = stack[depth];
                if range <= limit as f32 {
                    at = node;
                    break;
                }
            }
        }
    }
}

/// A ray in single precision, for tests of boxes.
struct Query {
    origin: [f32; 3],
    inverse: [f32; 3],
}

impl Query {
    fn new(ray: &Ray3) -> Self {
        // A direction of exactly zero would make 0 · ∞ on the face of a box.
        let inverse = |d: f64| 1.0 / (if d.abs() < 1e-18 { 1e-18 } else { d }) as f32;
        let (o, d) = (ray.origin, ray.direction);
        Self {
            origin: [o.x as f32, o.y as f32, o.z as f32],
            inverse: [inverse(d.x), inverse(d.y), inverse(d.z)],
        }
    }

    /// Range at which the ray enters a box, slightly too small (0 inside the box); infinite if it misses
    /// the box.
    fn enters(&self, node: &Node) -> f32 {
        let (mut enter, mut leave) = (0.0_f32, f32::INFINITY);
        for axis in 0..3 {
            let a = (node.min[axis] - self.origin[axis]) * self.inverse[axis];
            let b = (node.max[axis] - self.origin[axis]) * self.inverse[axis];
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        // Single precision has 24 bits, of which the last four may be wrong after two operations.
        if enter <= leave * 1.000_001 { enter * 0.999_999 } else { f32::INFINITY }
    }
}

/// Builds the branch of `items`, the first of which is solid number `first`.
fn build(items: &mut [Item], first: usize, depth: usize, nodes: &mut Vec<Node>) {
    let bounds = items.iter().fold(Bounds::empty(), |all, item| all.union(&item.bounds));
    let at = nodes.len();
    nodes.push(Node {
        min: [0, 1, 2].map(|axis| (bounds.min[axis] - MARGIN) as f32),
        max: [0, 1, 2].map(|axis| (bounds.max[axis] + MARGIN) as f32),
        next: first as u32,
        count: items.len() as u32,
    });
    if items.len() <= 1 || depth >= MAX_DEPTH {
        return;
    }
    let Some(split) = split(items, &bounds) else { return };
    let (left, right) = items.split_at_mut(split);
    build(left, first, depth + 1, nodes);
    nodes[at].next = nodes.len() as u32;
    nodes[at].count = 0;
    build(right, first + split, depth + 1, nodes);
}

/// Splits items in two where the expected cost of a search is least. Gives the number of items in the first
/// part; none if a leaf is cheaper.
fn split(items: &mut [Item], bounds: &Bounds) -> Option<usize> {
    let centres = items
        .iter()
        .fold(Bounds::empty(), |all, item| all.union(&Bounds { min: item.centre, max: item.centre }));
    let extent = centres.max - centres.min;
    let bin_of = |axis: usize, item: &Item| {
        (((item.centre[axis] - centres.min[axis]) / extent[axis] * BINS as f64) as usize).min(BINS - 1)
    };
    let mut best: Option<(f64, usize, usize)> = None;
    for axis in (0..3).filter(|axis| extent[*axis] > 1e-9) {
        let mut bins = [(Bounds::empty(), 0_usize); BINS];
        for item in items.iter() {
            let bin = &mut bins[bin_of(axis, item)];
            *bin = (bin.0.union(&item.bounds), bin.1 + 1);
        }
        // Costs of all items from each bin on; then a pass from the other side.
        let mut above = [0.0; BINS];
        let (mut all, mut count) = (Bounds::empty(), 0);
        for i in (1..BINS).rev() {
            (all, count) = (all.union(&bins[i].0), count + bins[i].1);
            above[i] = all.half_area() * count as f64;
        }
        let (mut all, mut count) = (Bounds::empty(), 0);
        for i in 1..BINS {
            (all, count) = (all.union(&bins[i - 1].0), count + bins[i - 1].1);
            let cost = all.half_area() * count as f64 + above[i];
            if count > 0 && count < items.len() && best.is_none_or(|(least, _, _)| cost < least) {
                best = Some((cost, axis, i));
            }
        }
    }
    let leaf_cost = bounds.half_area() * items.len() as f64;
    match best {
        // A branch costs about half as much as the test of a solid.
        Some((cost, axis, bin))
            if items.len() > MOST_IN_A_LEAF || cost + 0.5 * bounds.half_area() < leaf_cost =>
        {
            // A stable sort gives the same hierarchy on every platform.
            items.sort_by_key(|item| bin_of(axis, item) >= bin);
            Some(items.partition_point(|item| bin_of(axis, item) < bin))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Random;
    use crate::three_d::Body;
    use crate::two_d::Material;

    fn random_solid(random: &mut Random) -> Solid {
        let mut vector = |scale: f64| {
            Vector3::new(
                random.between(-scale, scale),
                random.between(-scale, scale),
                random.between(-scale, scale),
            )
        };
        let (centre, size, other) = (vector(20.0), vector(1.5), vector(1.5));
        let size = size.map(f64::abs).add_scalar(0.05);
        let (s, c) = libm::sincos(other.x);
        let body = match random.below(4) {
            0 => Body::Box { centre, half: size, turn: [c, s] },
            1 => Body::Triangle { corner: centre, edges: [size, other] },
            2 => Body::Cylinder { base: centre, radius: size.x, height: size.y },
            _ => Body::Ball { centre, radius: size.z },
        };
        Solid { body, material: Material::Wall }
    }

    #[test]
    fn the_hierarchy_agrees_with_brute_force() {
        let mut random = Random::new(3, "bvh", 0);
        let solids: Vec<Solid> = (0..700).map(|_| random_solid(&mut random)).collect();
        let hierarchy = Hierarchy::new(solids.clone());
        let mut hits = 0;
        for i in 0..4000 {
            let mut direction = Vector3::new(random.gaussian(), random.gaussian(), random.gaussian());
            if i % 3 == 0 {
                direction[i % 9 / 3] = 0.0;
            }
            let origin = Vector3::new(
                random.between(-25.0, 25.0),
                random.between(-25.0, 25.0),
                random.between(-25.0, 25.0),
            );
            let ray = Ray3 { origin, direction: direction.normalize() };
            let limit = random.between(1.0, 60.0);
            let slow =
                solids.iter().filter_map(|s| s.body.meet(&ray, limit)).map(|h| h.0).min_by(f64::total_cmp);
            assert_eq!(hierarchy.cast(&ray, limit).map(|h| h.range), slow);
            hits += usize::from(slow.is_some());
        }
        assert!(hits > 500);
        assert!(
            Hierarchy::new(Vec::new())
                .cast(&Ray3 { origin: Vector3::zeros(), direction: Vector3::x() }, 9.0)
                .is_none()
        );
    }

    #[test]
    fn coinciding_solids_are_no_endless_branch() {
        let solid =
            Solid { body: Body::Ball { centre: Vector3::x(), radius: 0.5 }, material: Material::Wall };
        let hierarchy = Hierarchy::new(vec![solid; 1000]);
        let ray = Ray3 { origin: Vector3::zeros(), direction: Vector3::x() };
        assert_eq!(hierarchy.cast(&ray, 9.0).map(|h| h.range), Some(0.5));
    }
}
