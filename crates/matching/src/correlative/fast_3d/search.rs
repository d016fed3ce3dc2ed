//! Branch and bound over yaw and shift together, in 3D.

use super::pyramid::MaxPyramid3d;
use super::scans::Scans;
use crate::correlative::best_first::{Best, Branching, Node};
use crate::correlative::byte_score::ByteScore;

/// One placement of a scan: its yaw, and its shift in cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Placement3d {
    pub scan: u32,
    /// Along z, y, x: in this order placements with the same score are preferred.
    pub shift: [i32; 3],
}

/// The best placements whose coarse scan fits, too.
pub(super) struct Search3d<'a, F> {
    pub pyramid: &'a MaxPyramid3d,
    pub scans: &'a Scans,
    pub score: ByteScore,
    /// Largest shift to either side along z, y, x.
    pub window: [i32; 3],
    /// Whether the coarse scan fits at a placement.
    pub fits: F,
    /// Points of the coarse scan.
    pub num_coarse: usize,
}

impl<F: FnMut(Placement3d) -> bool> Search3d<'_, F> {
    /// Passes on the promising ones of the eight boxes at `first` and its neighbours along each axis, as far
    /// as they start before `end`.
    fn for_eight_boxes(
        &mut self,
        first: Placement3d,
        exponent: u32,
        end: [i32; 3],
        best: &mut Best<Placement3d>,
        emit: &mut dyn FnMut(Node<Placement3d>),
    ) {
        if !best.charge(8 * self.scans.num_points) {
            return;
        }
        let width = 1 << exponent;
        let groups = &self.scans.groups[exponent as usize];
        let Some(Some(group)) = groups.get((first.scan >> exponent) as usize) else { return };
        let [z, y, x] = first.shift;
        let mut sums = [0; 8];
        for segment in &group.segments {
            let part = match segment.level {
                Some(level) => {
                    let cells = &group.cells[segment.points.clone()];
                    self.pyramid.level(level).eight_sums(cells, [x, y, z], width)
                }
                // They may be anywhere.
                None => [255 * segment.points.len() as u32; 8],
            };
            (0..8).for_each(|i| sums[i] += part[i]);
        }
        for (i, sum) in sums.into_iter().enumerate() {
            let shift = [0, 1, 2].map(|axis| first.shift[axis] + width * (i as i32 >> (2 - axis) & 1));
            if (0..3).any(|axis| shift[axis] >= end[axis]) {
                continue;
            }
            let (bound, first) = (self.score.of(sum, self.scans.num_points), Placement3d { shift, ..first });
            if best.is_promising(bound) {
                match exponent {
                    0 if best.charge(self.num_coarse) && (self.fits)(first) => best.offer(first, bound),
                    0 => {}
                    _ => emit(Node { bound, exponent, first }),
                }
            }
        }
    }
}

impl<F: FnMut(Placement3d) -> bool> Branching for Search3d<'_, F> {
    type Placement = Placement3d;

    fn roots(&mut self, best: &mut Best<Placement3d>, emit: &mut dyn FnMut(Node<Placement3d>)) {
        let exponent = self.scans.groups.len() as u32 - 1;
        let (window, end) = (self.window, self.window.map(|n| n + 1));
        let starts = |axis: usize| (-window[axis]..end[axis]).step_by(2 << exponent);
        for group in 0..self.scans.groups[exponent as usize].len() {
            let scan = (group as u32) << exponent;
            for z in starts(0) {
                for y in starts(1) {
                    for x in starts(2) {
                        let first = Placement3d { scan, shift: [z, y, x] };
                        self.for_eight_boxes(first, exponent, end, best, emit);
                    }
                }
            }
        }
    }

    /// Splits a box along all axes.
    fn split(
        &mut self,
        node: &Node<Placement3d>,
        best: &mut Best<Placement3d>,
        emit: &mut dyn FnMut(Node<Placement3d>),
    ) {
        let exponent = node.exponent - 1;
        let (width, first) = (1 << node.exponent, node.first);
        let end = [0, 1, 2].map(|axis| (first.shift[axis] + width).min(self.window[axis] + 1));
        for scan in [first.scan, first.scan + (1 << exponent)] {
            self.for_eight_boxes(Placement3d { scan, ..first }, exponent, end, best, emit);
        }
    }
}
