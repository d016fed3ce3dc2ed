//! Priority queue of boxes of a search, roughly the most promising first.
//!
//! A heap of millions of boxes costs more than scoring them, because each of its steps is somewhere else in
//! memory. Sorting boxes into a thousand classes by their bound costs nothing, and is as good: a search
//! splits all boxes of a class anyway before it can be sure that a placement of that class is the best.

use super::best_first::Node;

/// Classes between the least bound and the largest.
const CLASSES: usize = 1024;
/// Maximum number of waiting boxes, some 40 MB; further ones are split at once, which finds the same.
const MAX_WAITING: usize = 1 << 21;

/// Boxes and single placements with bounds in classes.
pub(super) struct BucketQueue<P> {
    lowest: f32,
    classes_per_unit: f32,
    classes: Vec<Class<P>>,
    /// All higher classes are empty.
    highest: usize,
    waiting: usize,
}

#[derive(Clone)]
struct Class<P> {
    boxes: Vec<Node<P>>,
    placements: Vec<Node<P>>,
    is_sorted: bool,
}

impl<P: Copy + Ord> BucketQueue<P> {
    /// For bounds from `lowest` to `highest`; bounds outside belong to the classes at the ends.
    pub fn new(lowest: f32, highest: f32) -> Self {
        let empty = Class { boxes: Vec::new(), placements: Vec::new(), is_sorted: false };
        let classes_per_unit = CLASSES as f32 / (highest - lowest).max(f32::EPSILON);
        Self { lowest, classes_per_unit, classes: vec![empty; CLASSES], highest: 0, waiting: 0 }
    }

    /// Boxes have exponents above 0.
    pub fn push(&mut self, node: Node<P>) {
        let class = ((node.bound - self.lowest) * self.classes_per_unit).max(0.0) as usize;
        let is_box = node.exponent > 0;
        let class = if is_box && self.waiting >= MAX_WAITING { self.highest } else { class.min(CLASSES - 1) };
        self.highest = self.highest.max(class);
        let Some(class) = self.classes.get_mut(class) else { return };
        if is_box {
            self.waiting += 1;
            class.boxes.push(node);
        } else {
            class.placements.push(node);
            class.is_sorted = false;
        }
    }

    /// A box of the highest class; where there is none, the best placement, among equals the first one.
    pub fn pop(&mut self) -> Option<Node<P>> {
        loop {
            let class = self.classes.get_mut(self.highest)?;
            if let Some(node) = class.boxes.pop() {
                self.waiting -= 1;
                return Some(node);
            }
            if !class.is_sorted {
                class.placements.sort_unstable();
                class.is_sorted = true;
            }
            if let Some(node) = class.placements.pop() {
                return Some(node);
            }
            self.highest = self.highest.checked_sub(1)?;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(bound: f32, exponent: u32, first: u32) -> Node<u32> {
        Node { bound, exponent, first }
    }

    #[test]
    fn placements_come_in_order_after_the_boxes_that_may_hold_better_ones() {
        let mut queue = BucketQueue::new(0.0, 1.0);
        for (i, bound) in [0.5, 0.9, 0.90001, 0.2, 2.0, 0.9].into_iter().enumerate() {
            queue.push(node(bound, 0, i as u32));
        }
        queue.push(node(0.9, 3, 10));
        queue.push(node(0.3, 1, 11));
        queue.push(node(-1.0, 1, 12));
        let order: Vec<u32> = std::iter::from_fn(|| queue.pop()).map(|node| node.first).collect();
        assert_eq!(order, [4, 10, 2, 1, 5, 0, 11, 3, 12]);
    }

    #[test]
    fn too_many_boxes_are_split_at_once() {
        let mut queue = BucketQueue::new(0.0, 1.0);
        queue.push(node(0.8, 1, 0));
        (1..MAX_WAITING).for_each(|_| queue.push(node(0.1, 1, 1)));
        queue.push(node(0.1, 1, 2));
        assert_eq!(queue.pop().map(|node| node.first), Some(2));
        assert_eq!(queue.pop().map(|node| node.first), Some(0));
    }
}
