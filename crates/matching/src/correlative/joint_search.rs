//! Branch and bound over angle and shift together.

use std::ops::Range;

use super::max_pyramid::MaxPyramid;
use super::rotated_scans::RotatedScans;
use super::search_window::SearchWindow;

/// One placement of a scan: which angle, and by how many cells it is shifted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Placement {
    pub scan: i32,
    pub x: i32,
    pub y: i32,
}

/// A box of placements, ends included.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Region {
    pub first: Placement,
    pub last: Placement,
}

/// What is maximised. `byte_sum` is the sum over the points of the bytes they meet.
pub(crate) trait Objective {
    /// No placement of `region` scores more, if none has a larger sum than `byte_sum`.
    fn bound(&self, byte_sum: u32, region: &Region) -> f32;
    /// The score of a placement whose sum is `byte_sum`.
    fn score(&self, placement: Placement, byte_sum: u32, scans: &mut RotatedScans) -> f32;
}

/// Which shifts are searched.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ShiftBounds {
    /// All within the window.
    Window,
    /// Those that put at least `min_inside` points inside a grid of this size in x and in y.
    Overlap { size: [i32; 2], min_inside: usize },
}

/// After this many boxes whose bound only equals the best score, equal placements are no longer looked
/// for: on a plateau there would be no end of them.
const MAX_TIED_BOXES: u32 = 1 << 16;

/// Points with the same uncertainty of place within a group of angles.
#[derive(Clone, Debug)]
struct Segment {
    points: Range<usize>,
    /// Cells by which a point may lie off its cell in the middle scan, to either side.
    smear: i32,
    /// Level of the pyramid whose windows are wide enough for smear and shifts.
    level: usize,
}

struct Node {
    first: Placement,
    bound: f32,
}

/// The best placements by some objective.
pub(crate) struct JointSearch<'a, O> {
    pub scans: RotatedScans,
    pyramid: &'a MaxPyramid,
    window: SearchWindow,
    shifts: ShiftBounds,
    objective: O,
    /// For boxes of 2^i angles by 2^i by 2^i shifts.
    segments: Vec<Vec<Segment>>,
    /// Score to beat, or best score found.
    best: f32,
    best_placements: Vec<Placement>,
    tied_boxes: u32,
    scratch: Vec<i32>,
}

impl<'a, O: Objective> JointSearch<'a, O> {
    /// A search with boxes of at most 2^`max_exponent` steps along each axis.
    pub fn new(
        pyramid: &'a MaxPyramid,
        scans: RotatedScans,
        window: SearchWindow,
        shifts: ShiftBounds,
        objective: O,
        max_exponent: u32,
    ) -> Self {
        let mut segments = Vec::new();
        for exponent in 0..=max_exponent {
            let next = segments_for(&scans, &window, exponent);
            if next.iter().any(|s| s.level >= pyramid.num_levels()) {
                break;
            }
            segments.push(next);
        }
        Self {
            scans,
            pyramid,
            window,
            shifts,
            objective,
            segments,
            best: f32::NEG_INFINITY,
            best_placements: Vec::new(),
            tied_boxes: 0,
            scratch: Vec::new(),
        }
    }

    /// The best score above `min_score` and all placements that have it (some, if there are very many),
    /// in the order of scan, x and y. Empty if there is none.
    pub fn run(&mut self, min_score: f32) -> (f32, Vec<Placement>) {
        self.best = min_score;
        let exponent = self.segments.len() - 1;
        let mut roots = self.roots(exponent);
        sort_by_bound(&mut roots);
        for root in roots {
            if !self.is_promising(root.bound) {
                break;
            }
            self.expand(&root, exponent);
        }
        let mut placements = std::mem::take(&mut self.best_placements);
        placements.sort_unstable();
        (self.best, placements)
    }

    fn is_promising(&self, bound: f32) -> bool {
        let ties_count = !self.best_placements.is_empty() && self.tied_boxes < MAX_TIED_BOXES;
        if ties_count { bound >= self.best } else { bound > self.best }
    }

    /// All boxes of the window that may hold something better than the score to beat.
    fn roots(&mut self, exponent: usize) -> Vec<Node> {
        let width = 1i32 << exponent;
        let mut roots = Vec::new();
        for scan in (0..self.window.num_scans()).step_by(width as usize) {
            let [x_range, y_range] = self.shifts_of_group(scan, exponent);
            for x in x_range.clone().step_by(2 * width as usize) {
                for y in y_range.clone().step_by(2 * width as usize) {
                    self.four_nodes(Placement { scan, x, y }, exponent, [&x_range, &y_range], &mut roots);
                }
            }
        }
        roots
    }

    /// Appends the promising ones of the four boxes at `first` and its neighbours along x and y. Boxes of
    /// one placement are scored at once instead.
    fn four_nodes(
        &mut self,
        first: Placement,
        exponent: usize,
        [x_range, y_range]: [&Range<i32>; 2],
        nodes: &mut Vec<Node>,
    ) {
        let width = 1i32 << exponent;
        let sums = self.group_sums(first, exponent);
        for (i, sum) in sums.into_iter().enumerate() {
            let x = first.x + width * (i as i32 >> 1);
            let y = first.y + width * (i as i32 & 1);
            if x >= x_range.end || y >= y_range.end {
                continue;
            }
            let last = Placement {
                scan: (first.scan + width).min(self.window.num_scans()) - 1,
                x: (x + width).min(x_range.end) - 1,
                y: (y + width).min(y_range.end) - 1,
            };
            let region = Region { first: Placement { x, y, ..first }, last };
            let bound = self.objective.bound(sum, &region);
            if !self.is_promising(bound) {
                continue;
            }
            if exponent == 0 {
                self.score_leaf(region.first, sum);
            } else {
                nodes.push(Node { first: region.first, bound });
            }
        }
    }

    fn expand(&mut self, node: &Node, exponent: usize) {
        if exponent == 0 {
            return;
        }
        if node.bound == self.best {
            self.tied_boxes += 1;
        }
        let child = exponent - 1;
        let half = 1i32 << child;
        let x_range = node.first.x..self.end_of_window(node.first.x, exponent);
        let y_range = node.first.y..self.end_of_window(node.first.y, exponent);
        let mut children = Vec::with_capacity(8);
        for scan in [node.first.scan, node.first.scan + half] {
            if scan < self.window.num_scans() {
                let first = Placement { scan, ..node.first };
                self.four_nodes(first, child, [&x_range, &y_range], &mut children);
            }
        }
        sort_by_bound(&mut children);
        for node in children {
            if !self.is_promising(node.bound) {
                break;
            }
            self.expand(&node, child);
        }
    }

    /// Where shifts of a box that starts at `first` end.
    fn end_of_window(&self, first: i32, exponent: usize) -> i32 {
        (first + (1i32 << exponent)).min(self.window.num_linear + 1)
    }

    /// Largest sums of bytes that any placement can have in the four boxes at `first`.
    fn group_sums(&mut self, first: Placement, exponent: usize) -> [u32; 4] {
        let width = 1i32 << exponent;
        // The scan in the middle is at most half a group away from all others.
        let middle = (first.scan + width / 2).min(self.window.num_scans() - 1);
        let cells = self.scans.cells(middle);
        let mut sums = [0; 4];
        for segment in &self.segments[exponent] {
            let (x, y) = (first.x - segment.smear, first.y - segment.smear);
            let level = self.pyramid.level(segment.level);
            let part = level.four_sums(&cells[segment.points.clone()], x, y, width);
            (0..4).for_each(|i| sums[i] += part[i]);
        }
        sums
    }

    fn score_leaf(&mut self, placement: Placement, byte_sum: u32) {
        if !self.is_searched(placement) {
            return;
        }
        let score = self.objective.score(placement, byte_sum, &mut self.scans);
        if score > self.best {
            self.best = score;
            self.best_placements.clear();
            self.tied_boxes = 0;
        }
        if score == self.best && (self.best_placements.is_empty() || self.is_promising(score)) {
            self.best_placements.push(placement);
        }
    }

    /// Whether the shift is among those of the scan itself.
    fn is_searched(&mut self, placement: Placement) -> bool {
        let ShiftBounds::Overlap { size, .. } = self.shifts else { return true };
        let [x_range, y_range] = overlap(self.scans.cells(placement.scan), size, 1, 0, &mut self.scratch);
        x_range.contains(&placement.x) && y_range.contains(&placement.y)
    }

    /// The shifts of all scans of a group, in x and y.
    fn shifts_of_group(&mut self, scan: i32, exponent: usize) -> [Range<i32>; 2] {
        let n = self.window.num_linear;
        let ShiftBounds::Overlap { size, min_inside } = self.shifts else { return [-n..n + 1, -n..n + 1] };
        let middle = (scan + (1i32 << exponent) / 2).min(self.window.num_scans() - 1);
        let smear = self.segments[exponent].iter().map(|s| s.smear).max().unwrap_or(0);
        overlap(self.scans.cells(middle), size, min_inside, smear, &mut self.scratch)
            .map(|r| r.start.max(-n)..r.end.min(n + 1))
    }
}

/// Shifts, always with zero among them, that put at least `min_inside` of `cells` inside a grid, where
/// cells may be `smear` cells off.
fn overlap(
    cells: &[[i32; 2]],
    size: [i32; 2],
    min_inside: usize,
    smear: i32,
    scratch: &mut Vec<i32>,
) -> [Range<i32>; 2] {
    let rank = min_inside.clamp(1, cells.len().max(1)) - 1;
    [0, 1].map(|axis| {
        scratch.clear();
        scratch.extend(cells.iter().map(|c| c[axis]));
        if scratch.is_empty() {
            return 0..1;
        }
        let low = *scratch.select_nth_unstable(rank).1;
        let high = *scratch.select_nth_unstable(cells.len() - 1 - rank).1;
        let first = (-high - smear).min(0);
        let last = (size[axis] - 1 - low + smear).max(0);
        first..last + 1
    })
}

fn segments_for(scans: &RotatedScans, window: &SearchWindow, exponent: u32) -> Vec<Segment> {
    let half_group = f64::from((1u32 << exponent) >> 1);
    let mut segments: Vec<Segment> = Vec::new();
    for (i, range) in scans.ranges().iter().enumerate() {
        // The arc along which the point moves is longer than the chord, and rounding to cells adds
        // less than one cell to what is not a whole number.
        let arc = half_group * window.angular_step * f64::from(*range) / window.resolution;
        let smear = if exponent == 0 { 0 } else { (arc + scans.rounding_error()).ceil().min(1e6) as i32 };
        let width = (1u32 << exponent) + 2 * smear as u32;
        let level = width.next_power_of_two().trailing_zeros() as usize;
        match segments.last_mut() {
            Some(s) if s.smear == smear => s.points.end = i + 1,
            _ => segments.push(Segment { points: i..i + 1, smear, level }),
        }
    }
    segments
}

/// Best first; equal ones stay in order.
fn sort_by_bound(nodes: &mut [Node]) {
    nodes.sort_by(|a, b| b.bound.total_cmp(&a.bound));
}
