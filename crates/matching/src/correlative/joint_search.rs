//! Branch and bound over angle and shift together, in 2D.

use std::ops::Range;

use super::best_first::{
    self, Branching, Node, Taker, beam_several, best_first, best_first_in_order, best_first_several,
};
use super::max_pyramid::MaxPyramid;
use super::rotated_scans::RotatedScans;
use super::search_window::SearchWindow;

/// One placement of a scan: its angle, and its shift in cells.
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

/// The objective that is maximised. `byte_sum` is the sum of the bytes at the points.
pub(crate) trait Objective {
    /// No placement of `region` scores more, if none has a larger sum than `byte_sum`.
    fn bound(&self, byte_sum: u32, region: &Region) -> f32;
    /// Whether placements of `region` need to be looked at: cheaper than a bound.
    fn is_open(&self, _region: &Region) -> bool {
        true
    }
    /// Offers the placements of `region`, all of the same scan, with their scores. If it is a single
    /// placement, `byte_sum` is its sum.
    fn score(&self, region: &Region, byte_sum: u32, scans: &mut RotatedScans, best: &mut Best);
}

/// The largest score so far and the placements that have it.
pub(crate) type Best = best_first::Best<Placement>;

/// How boxes of placements are made.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SearchOptions {
    /// The search starts with boxes of 2^this angles by as many shifts in x and y.
    pub max_exponent: u32,
    /// Shifts are not split below 2^this; then whole boxes of one scan are scored.
    pub leaf_exponent: u32,
}

/// Which shifts are searched.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ShiftBounds {
    /// All within the window.
    Window,
    /// Those that put at least `min_inside` points inside a grid of this size in x and in y.
    Overlap { size: [i32; 2], min_inside: usize },
    /// Those that put the scanner, which is in the cell with these indices when it is not shifted, inside such a grid.
    OriginInside { size: [i32; 2], origin: [i32; 2] },
}

/// Points with the same uncertainty of position within a group of angles.
#[derive(Clone, Debug)]
struct Segment {
    points: Range<usize>,
    /// Cells by which a point may be off its cell in the middle scan, to either side.
    smear: i32,
    /// Level of the pyramid whose windows are wide enough for smear and shifts.
    level: usize,
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
    leaf_exponent: u32,
    scratch: Vec<i32>,
}

impl<'a, O: Objective> JointSearch<'a, O> {
    /// Prepares a search.
    pub fn new(
        pyramid: &'a MaxPyramid,
        scans: RotatedScans,
        window: SearchWindow,
        shifts: ShiftBounds,
        objective: O,
        options: SearchOptions,
    ) -> Self {
        let mut segments = Vec::new();
        for exponent in 0..=options.max_exponent {
            let next = segments_for(&scans, &window, exponent, options.leaf_exponent);
            if exponent > 0 && next.iter().any(|s| s.level >= pyramid.num_levels()) {
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
            leaf_exponent: options.leaf_exponent,
            scratch: Vec::new(),
        }
    }

    /// The best score above `min_score` and all placements that have it (some, if there are very many),
    /// in the order of scan, x and y. Empty if there is none.
    pub fn run(&mut self, min_score: f32) -> (f32, Vec<Placement>) {
        best_first(self, Best::above(min_score))
    }

    /// All placements that score above `min_score` and above `share` of the best score, the best first; after
    /// `lookups` look-ups of cells those found so far.
    pub fn run_several(&mut self, min_score: f32, share: f32, lookups: u64) -> Vec<(f32, Placement)> {
        best_first_several(self, Best::several_above(min_score, share, lookups))
    }

    /// Passes on placements that score above `min_score`, none above 1, from the best one down, and those in
    /// `found` in any case. Returns how many of `lookups` look-ups of cells are left; zero if they were too
    /// few.
    pub fn run_in_order(
        &mut self,
        min_score: f32,
        lookups: u64,
        found: Vec<Node<Placement>>,
        taker: &mut impl Taker<Placement>,
    ) -> u64 {
        best_first_in_order(self, Best::in_order_above(min_score, lookups), found, taker)
    }

    /// Good placements above `min_score`, not always the best ones: of the boxes of each size only the `width` most
    /// promising ones are split.
    pub fn run_beam(&mut self, min_score: f32, width: usize) -> Vec<Node<Placement>> {
        beam_several(self, Best::in_order_above(min_score, u64::MAX), width)
    }

    /// Shifts along each axis in a box.
    fn num_shifts(&self, exponent: u32) -> i32 {
        1 << exponent.max(self.leaf_exponent)
    }

    /// Passes on the promising ones of the four boxes at `first` and its neighbours along x and y, as far as
    /// they start before `end`. Boxes of one placement are scored at once instead.
    fn for_four_boxes(
        &mut self,
        first: Placement,
        exponent: u32,
        end: [i32; 2],
        best: &mut Best,
        emit: &mut dyn FnMut(Node<Placement>),
    ) {
        let width = self.num_shifts(exponent);
        let last_scan = (first.scan + (1i32 << exponent)).min(self.window.num_scans()) - 1;
        let regions: [Option<Region>; 4] = std::array::from_fn(|i| {
            let x = first.x + width * (i as i32 >> 1);
            let y = first.y + width * (i as i32 & 1);
            let last =
                Placement { scan: last_scan, x: (x + width).min(end[0]) - 1, y: (y + width).min(end[1]) - 1 };
            let region = Region { first: Placement { x, y, ..first }, last };
            (x < end[0] && y < end[1] && self.objective.is_open(&region)).then_some(region)
        });
        if regions.iter().all(Option::is_none) || !best.charge(4 * self.scans.num_points()) {
            return;
        }
        let sums = self.group_sums(first, exponent);
        for (region, sum) in regions.into_iter().zip(sums) {
            let Some(region) = region else { continue };
            let bound = self.objective.bound(sum, &region);
            if best.is_promising(bound) {
                match exponent {
                    0 => self.score_leaf(&region, sum, best),
                    _ => emit(Node { bound, exponent, first: region.first }),
                }
            }
        }
    }

    /// Where shifts of a box that starts at `first` end.
    fn end_of_window(&self, first: i32, exponent: u32) -> i32 {
        (first + self.num_shifts(exponent)).min(self.window.num_linear + 1)
    }

    /// Largest sums of bytes that any placement can have in the four boxes at `first`.
    fn group_sums(&mut self, first: Placement, exponent: u32) -> [u32; 4] {
        let width = self.num_shifts(exponent);
        // The scan in the middle is at most half a group away from all others.
        let middle = (first.scan + (1i32 << exponent) / 2).min(self.window.num_scans() - 1);
        let cells = self.scans.cells(middle);
        let mut sums = [0; 4];
        for segment in &self.segments[exponent as usize] {
            let (x, y) = (first.x - segment.smear, first.y - segment.smear);
            let level = self.pyramid.level(segment.level);
            let part = level.four_sums(&cells[segment.points.clone()], x, y, width);
            (0..4).for_each(|i| sums[i] += part[i]);
        }
        sums
    }

    fn score_leaf(&mut self, region: &Region, byte_sum: u32, best: &mut Best) {
        if self.is_searched(region.first) {
            self.objective.score(region, byte_sum, &mut self.scans, best);
        }
    }

    /// Whether the shift is among those of the scan itself.
    fn is_searched(&mut self, placement: Placement) -> bool {
        let ShiftBounds::Overlap { size, .. } = self.shifts else { return true };
        let [x_range, y_range] = overlap(self.scans.cells(placement.scan), size, 1, 0, &mut self.scratch);
        x_range.contains(&placement.x) && y_range.contains(&placement.y)
    }

    /// The shifts of all scans of a group, in x and y.
    fn shifts_of_group(&mut self, scan: i32, exponent: u32) -> [Range<i32>; 2] {
        let n = self.window.num_linear;
        let (size, min_inside) = match self.shifts {
            ShiftBounds::Window => return [-n..n + 1, -n..n + 1],
            ShiftBounds::OriginInside { size, origin } => {
                return [0, 1].map(|axis| (-origin[axis]).max(-n)..(size[axis] - origin[axis]).min(n + 1));
            }
            ShiftBounds::Overlap { size, min_inside } => (size, min_inside),
        };
        let middle = (scan + (1i32 << exponent) / 2).min(self.window.num_scans() - 1);
        let smear = self.segments[exponent as usize].iter().map(|s| s.smear).max().unwrap_or(0);
        overlap(self.scans.cells(middle), size, min_inside, smear, &mut self.scratch)
            .map(|r| r.start.max(-n)..r.end.min(n + 1))
    }
}

impl<O: Objective> Branching for JointSearch<'_, O> {
    type Placement = Placement;

    fn roots(&mut self, best: &mut Best, emit: &mut dyn FnMut(Node<Placement>)) {
        let exponent = self.segments.len() as u32 - 1;
        let width = self.num_shifts(exponent) as usize;
        for scan in (0..self.window.num_scans()).step_by(1 << exponent) {
            let [x_range, y_range] = self.shifts_of_group(scan, exponent);
            for x in x_range.clone().step_by(2 * width) {
                for y in y_range.clone().step_by(2 * width) {
                    let first = Placement { scan, x, y };
                    self.for_four_boxes(first, exponent, [x_range.end, y_range.end], best, emit);
                }
            }
        }
    }

    /// Splits a box along all axes.
    fn split(&mut self, node: &Node<Placement>, best: &mut Best, emit: &mut dyn FnMut(Node<Placement>)) {
        let exponent = node.exponent - 1;
        let end = [node.first.x, node.first.y].map(|first| self.end_of_window(first, node.exponent));
        for scan in [node.first.scan, node.first.scan + (1i32 << exponent)] {
            if scan < self.window.num_scans() {
                self.for_four_boxes(Placement { scan, ..node.first }, exponent, end, best, emit);
            }
        }
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

fn segments_for(
    scans: &RotatedScans,
    window: &SearchWindow,
    exponent: u32,
    leaf_exponent: u32,
) -> Vec<Segment> {
    let half_group = f64::from((1u32 << exponent) >> 1);
    let mut segments: Vec<Segment> = Vec::new();
    for (i, range) in scans.ranges().iter().enumerate() {
        // The arc along which the point moves is longer than the chord, and rounding to cells adds
        // less than one cell to what is not a whole number.
        let arc = half_group * window.angular_step * f64::from(*range) / window.resolution;
        let smear = if exponent == 0 { 0 } else { (arc + scans.rounding_error()).ceil().min(1e6) as i32 };
        let width = (1u32 << exponent.max(leaf_exponent)) + 2 * smear as u32;
        let level = MaxPyramid::level_for(width);
        match segments.last_mut() {
            Some(s) if s.level == level => (s.points.end, s.smear) = (i + 1, smear),
            _ => segments.push(Segment { points: i..i + 1, smear, level }),
        }
    }
    segments
}
