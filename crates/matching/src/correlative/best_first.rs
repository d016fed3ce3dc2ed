//! Branch and bound, the most promising box first; the same in 2D and in 3D.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::bucket_queue::BucketQueue;

/// Boxes of placements that can be bounded and split.
pub(crate) trait Branching {
    /// One placement of a scan. The order decides among boxes that promise the same.
    type Placement: Copy + Ord;

    /// Hands on all boxes of the search that may hold something better than `best`. Boxes of one placement
    /// are offered to `best` instead.
    fn roots(&mut self, best: &mut Best<Self::Placement>, hand_on: &mut dyn FnMut(Node<Self::Placement>));

    /// Does the same with the parts of a box.
    fn split(
        &mut self,
        node: &Node<Self::Placement>,
        best: &mut Best<Self::Placement>,
        hand_on: &mut dyn FnMut(Node<Self::Placement>),
    );
}

/// The largest score so far and the placements that have it.
#[derive(Clone, Debug)]
pub(crate) struct Best<P> {
    score: f32,
    placements: Vec<P>,
    /// How many boxes were split whose bound only equalled the best score.
    tied_boxes: u32,
    max_ties: usize,
    /// Look-ups of cells that may still be made.
    lookups_left: u64,
    /// Everything nearly as good as the best, where that is wanted.
    several: Option<Several<P>>,
    /// Placements that were offered and wait for their turn, where they are wanted in order.
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

/// Of more placements than this the better half is kept.
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

/// After this many boxes whose bound only equals the best score, equal placements are no longer looked
/// for: on a plateau there would be no end of them.
const MAX_TIED_BOXES: u32 = 1 << 16;
/// After this many equal placements no more are collected.
const MAX_TIES: usize = 1 << 16;
/// After so many look-ups of cells a search is given up and finds nothing: some 0.6 s, several times what the widest searches of
/// real scans in buildings take. Along a road where everything looks alike, and in grids and clouds that no sensor made, there
/// would be no end.
const MAX_LOOKUPS: u64 = 1 << 29;
/// How many boxes may wait at the same time: some 30 MB.
const MAX_WAITING: usize = 1 << 20;

impl<P: Copy + Ord> Best<P> {
    /// Nothing yet; only scores above `min_score` count, and all placements with the best one are wanted.
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

    /// Nothing yet; wanted is what scores above `min_score`, placement by placement from the best one down. After so many
    /// look-ups of cells the search ends with what it has.
    pub fn in_order_above(min_score: f32, lookups: u64) -> Self {
        Self { lookups_left: lookups, in_order: Some(Vec::new()), ..Self::above(min_score) }
    }

    /// Nothing yet; wanted is all that scores above `min_score` and above `share` of the best score. After
    /// so many look-ups of cells the search ends with what it has.
    pub fn several_above(min_score: f32, share: f32, lookups: u64) -> Self {
        let several = Some(Several { share, floor: min_score, found: Vec::new() });
        Self { lookups_left: lookups, several, ..Self::above(min_score) }
    }

    /// Nothing yet; only scores above `min_score` count, and one placement with the best one is enough.
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

    /// Takes a placement into account.
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

    /// All placements that were wanted with their scores, the best first.
    fn finish_several(self) -> Vec<(f32, P)> {
        let Some(mut several) = self.several else { return Vec::new() };
        several.sort();
        several.found.retain(|(score, _)| *score > several.floor);
        several.found
    }
}

/// A box that waits to be split. The greatest is split next: that with the largest bound, among equals
/// the smallest box, then the first one.
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

/// Searches until nothing can change `best` any more. The best score and the placements that have it, in
/// their order; none if none is better than what `best` started with.
pub(crate) fn best_first<B: Branching>(
    boxes: &mut B,
    mut best: Best<B::Placement>,
) -> (f32, Vec<B::Placement>) {
    search_best_first(boxes, &mut best);
    best.finish()
}

/// As [`best_first`] with what [`Best::several_above`] started: everything that was wanted, the best first.
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

/// Who takes placements from the best one down.
pub(crate) trait Taker<P> {
    /// Whether nothing in this box is wanted, because of what was taken already.
    fn is_needless(&self, node: &Node<P>) -> bool;

    /// Takes the best placement that is left. From then on only larger scores than the one returned are wanted; none: it is
    /// enough.
    fn take(&mut self, score: f32, placement: P) -> Option<f32>;
}

/// Hands over placements from the best one down, without looking at more boxes than the last one needs; no score is above 1.
/// Those that were `found` before wait for their turn from the beginning, so that they are handed over even if the look-ups
/// that [`Best::in_order_above`] allows are too few to look at all that is wanted. Returns how many of these are left; none
/// if they were too few.
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
            // Once the look-ups are used up only placements are left to be handed over.
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

/// Searches in bounded time what [`Best::in_order_above`] started: of the boxes of each size only the `width` most promising ones are
/// split. Gives all placements that it came upon, in no order. What is best may be missed where everything looks alike.
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

/// Splits a box. Its parts wait, too, unless very many do: then they are split at once, which finds the
/// same but keeps memory in bounds.
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
