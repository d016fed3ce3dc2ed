//! Best-first branch and bound, in 2D and in 3D.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::bucket_queue::BucketQueue;

/// Boxes of placements that can be bounded and split.
pub(crate) trait Branching {
    /// One placement of a scan. The order decides among boxes with the same bound.
    type Placement: Copy + Ord;

    /// Passes on all boxes of the search that may hold something better than `best`. Boxes of one placement
    /// are offered to `best` instead.
    fn roots(&mut self, best: &mut Best<Self::Placement>, emit: &mut dyn FnMut(Node<Self::Placement>));

    /// Does the same with the parts of a box.
    fn split(
        &mut self,
        node: &Node<Self::Placement>,
        best: &mut Best<Self::Placement>,
        emit: &mut dyn FnMut(Node<Self::Placement>),
    );
}

/// The largest score so far and the placements that have it.
#[derive(Clone, Debug)]
pub(crate) struct Best<P> {
    score: f32,
    placements: Vec<P>,
    /// Number of boxes that were split although their bound only equalled the best score.
    tied_boxes: u32,
    max_ties: usize,
    /// Look-ups of cells that may still be made.
    lookups_left: u64,
    /// All placements nearly as good as the best, if wanted.
    several: Option<Several<P>>,
    /// Placements that were offered and wait in order of score, if wanted.
    in_order: Option<Vec<Node<P>>>,
}

/// Placements that score at least a fraction of the best score.
#[derive(Clone, Debug)]
struct Several<P> {
    share: f32,
    /// Only scores above this count now.
    floor: f32,
    found: Vec<(f32, P)>,
}

/// Maximum number of placements; of more the better half is kept.
const MAX_SEVERAL: usize = 1 << 17;

impl<P: Copy + Ord> Several<P> {
    fn offer(&mut self, placement: P, score: f32) {
        if score <= self.floor {
            return;
        }
        self.floor = self.floor.max(self.share * score);
        self.found.push((score, placement));
        if self.found.len() > MAX_SEVERAL {
            self.sort();
            self.found.truncate(MAX_SEVERAL / 2);
            self.floor = self.found.last().map_or(self.floor, |(score, _)| self.floor.max(*score));
        }
    }

    /// The best first, among equals in the order of placements.
    fn sort(&mut self) {
        self.found.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    }
}

/// Number of boxes whose bound only equals the best score after which equal placements are no longer
/// searched: on a plateau their number would be unbounded.
const MAX_TIED_BOXES: u32 = 1 << 16;
/// Maximum number of equal placements that are collected.
const MAX_TIES: usize = 1 << 16;
/// Look-ups of cells after which a search is given up and finds nothing: some 0.6 s, several times the time
/// of the widest searches of real scans in buildings. Along a road where everything looks alike, and in grids
/// and clouds that no sensor made, a search would not end.
const MAX_LOOKUPS: u64 = 1 << 29;
/// Maximum number of waiting boxes: some 30 MB.
const MAX_WAITING: usize = 1 << 20;

impl<P: Copy + Ord> Best<P> {
    /// An empty result; only scores above `min_score` count, and all placements with the best one are wanted.
    pub fn above(min_score: f32) -> Self {
        Self {
            score: min_score,
            placements: Vec::new(),
            tied_boxes: 0,
            max_ties: MAX_TIES,
            lookups_left: MAX_LOOKUPS,
            several: None,
            in_order: None,
        }
    }

    /// An empty result; all placements with scores above `min_score` are wanted, from the best one down.
    /// After `lookups` look-ups of cells the search ends with what it has.
    pub fn in_order_above(min_score: f32, lookups: u64) -> Self {
        Self { lookups_left: lookups, in_order: Some(Vec::new()), ..Self::above(min_score) }
    }

    /// An empty result; all placements that score above `min_score` and above `share` of the best score are
    /// wanted. After `lookups` look-ups of cells the search ends with what it has.
    pub fn several_above(min_score: f32, share: f32, lookups: u64) -> Self {
        let several = Some(Several { share, floor: min_score, found: Vec::new() });
        Self { lookups_left: lookups, several, ..Self::above(min_score) }
    }

    /// An empty result; only scores above `min_score` count, and one placement with the best one is enough.
    pub fn single_above(min_score: f32) -> Self {
        Self { max_ties: 1, ..Self::above(min_score) }
    }

    /// Whether something with this bound may still change the result.
    #[inline]
    pub fn is_promising(&self, bound: f32) -> bool {
        if let Some(several) = &self.several {
            return bound > several.floor && self.lookups_left > 0;
        }
        if self.in_order.is_some() {
            return bound > self.score && self.lookups_left > 0;
        }
        let is_better = bound > self.score || (bound == self.score && self.collects_ties());
        is_better && self.lookups_left > 0
    }

    /// Counts look-ups of cells; false once there were too many.
    #[inline]
    pub fn charge(&mut self, lookups: usize) -> bool {
        self.lookups_left = self.lookups_left.saturating_sub(lookups as u64);
        self.lookups_left > 0
    }

    fn collects_ties(&self) -> bool {
        let collected = self.placements.len();
        collected > 0 && self.tied_boxes < MAX_TIED_BOXES && collected < self.max_ties
    }

    /// Adds a placement with its score.
    pub fn offer(&mut self, placement: P, score: f32) {
        if let Some(several) = &mut self.several {
            several.offer(placement, score);
        } else if let Some(waiting) = &mut self.in_order {
            let wanted = score > self.score;
            waiting.extend(wanted.then_some(Node { bound: score, exponent: 0, first: placement }));
        } else if score > self.score {
            self.score = score;
            self.placements.clear();
            self.tied_boxes = 0;
            self.placements.push(placement);
        } else if score == self.score && self.collects_ties() {
            self.placements.push(placement);
        }
    }

    /// The best score, and in their order the placements that have it.
    pub fn finish(mut self) -> (f32, Vec<P>) {
        if self.lookups_left == 0 {
            self.placements.clear();
        }
        self.placements.sort_unstable();
        (self.score, self.placements)
    }

    /// All wanted placements with their scores, the best first.
    fn finish_several(self) -> Vec<(f32, P)> {
        let Some(mut several) = self.several else { return Vec::new() };
        several.sort();
        several.found.retain(|(score, _)| *score > several.floor);
        several.found
    }
}

/// A waiting box. The greatest is split next: that with the largest bound, among equals the smallest box,
/// then the first one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Node<P> {
    /// No placement in the box scores more.
    pub bound: f32,
    /// The box is 2^this placements wide along each axis.
    pub exponent: u32,
    /// The first placement of the box.
    pub first: P,
}

impl<P: Ord> Eq for Node<P> {}

impl<P: Ord> Ord for Node<P> {
    fn cmp(&self, other: &Self) -> Ordering {
        let by_bound = self.bound.total_cmp(&other.bound);
        by_bound.then(other.exponent.cmp(&self.exponent)).then(other.first.cmp(&self.first))
    }
}

impl<P: Ord> PartialOrd for Node<P> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Searches until nothing can change `best` any more. Returns the best score and the placements that have it,
/// in their order; none if none is better than the start of `best`.
pub(crate) fn best_first<B: Branching>(
    boxes: &mut B,
    mut best: Best<B::Placement>,
) -> (f32, Vec<B::Placement>) {
    search_best_first(boxes, &mut best);
    best.finish()
}

/// As [`best_first`] with a result started by [`Best::several_above`]: all wanted placements, the best first.
pub(crate) fn best_first_several<B: Branching>(
    boxes: &mut B,
    mut best: Best<B::Placement>,
) -> Vec<(f32, B::Placement)> {
    search_best_first(boxes, &mut best);
    best.finish_several()
}

fn search_best_first<B: Branching>(boxes: &mut B, best: &mut Best<B::Placement>) {
    let mut waiting = BinaryHeap::new();
    boxes.roots(best, &mut |node| waiting.push(node));
    while let Some(node) = waiting.pop()
        && best.is_promising(node.bound)
    {
        split(boxes, &node, best, &mut waiting);
    }
}

/// Receiver of placements from the best one down.
pub(crate) trait Taker<P> {
    /// Whether no placement of this box is wanted, given those taken already.
    fn is_needless(&self, node: &Node<P>) -> bool;

    /// Takes the best placement that is left. Returns the score above which further placements are wanted;
    /// none if no more are.
    fn take(&mut self, score: f32, placement: P) -> Option<f32>;
}

/// Passes placements to `taker` from the best one down, without looking at more boxes than the last one
/// needs; no score is above 1. Those in `found` wait in order from the beginning, so that they are passed on
/// even if the look-ups that [`Best::in_order_above`] allows are too few for the whole search. Returns the
/// number of look-ups left; zero if they were too few.
pub(crate) fn best_first_in_order<B: Branching>(
    boxes: &mut B,
    mut best: Best<B::Placement>,
    found: Vec<Node<B::Placement>>,
    taker: &mut impl Taker<B::Placement>,
) -> u64 {
    let mut waiting = BucketQueue::new(best.score, 1.0);
    found.into_iter().for_each(|node| waiting.push(node));
    boxes.roots(&mut best, &mut |node| waiting.push(node));
    loop {
        best.in_order.iter_mut().flat_map(|offered| offered.drain(..)).for_each(|node| waiting.push(node));
        let Some(node) = waiting.pop() else { return best.lookups_left };
        if node.bound <= best.score {
            continue;
        }
        if taker.is_needless(&node) {
            continue;
        }
        if node.exponent > 0 {
            // Once the look-ups are used up only placements are passed on.
            if best.lookups_left > 0 {
                boxes.split(&node, &mut best, &mut |part| waiting.push(part));
            }
            continue;
        }
        match taker.take(node.bound, node.first) {
            Some(floor) => best.score = best.score.max(floor),
            None => return best.lookups_left,
        }
    }
}

/// Greedy (beam) search in bounded time for a result started by [`Best::in_order_above`]: of the boxes of
/// each size only the `width` most promising ones are split. Returns all placements that it found, in no
/// order. The best one may be missed where everything looks alike.
pub(crate) fn beam_several<B: Branching>(
    boxes: &mut B,
    mut best: Best<B::Placement>,
    width: usize,
) -> Vec<Node<B::Placement>> {
    search_beam(boxes, &mut best, width);
    best.in_order.unwrap_or_default()
}

fn search_beam<B: Branching>(boxes: &mut B, best: &mut Best<B::Placement>, width: usize) {
    let mut waiting: Vec<Node<B::Placement>> = Vec::new();
    boxes.roots(best, &mut |node| waiting.push(node));
    while !waiting.is_empty() {
        if waiting.len() > width {
            waiting.select_nth_unstable_by(width, |a, b| b.cmp(a));
            waiting.truncate(width);
        }
        // The most promising first: a good placement spares the rest.
        waiting.sort_unstable_by(|a, b| b.cmp(a));
        let mut parts = Vec::new();
        for node in waiting.iter().filter(|node| node.exponent > 0) {
            if best.is_promising(node.bound) {
                boxes.split(node, best, &mut |part| parts.push(part));
            }
        }
        waiting = parts;
    }
}

/// Splits a box. Its parts wait, too, unless very many already do: then they are split at once, which finds
/// the same but bounds memory.
fn split<B: Branching>(
    boxes: &mut B,
    node: &Node<B::Placement>,
    best: &mut Best<B::Placement>,
    waiting: &mut BinaryHeap<Node<B::Placement>>,
) {
    if node.bound == best.score {
        best.tied_boxes += 1;
    }
    if waiting.len() < MAX_WAITING {
        boxes.split(node, best, &mut |part| waiting.push(part));
        return;
    }
    let mut parts = Vec::new();
    boxes.split(node, best, &mut |part| parts.push(part));
    parts.sort_unstable();
    for part in parts.iter().rev() {
        if best.is_promising(part.bound) {
            split(boxes, part, best, waiting);
        }
    }
}

#[cfg(test)]
mod tests;
