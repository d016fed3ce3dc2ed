//! A scan at all yaws of a search, as cells, and groups of neighbouring yaws.

use std::ops::Range;

use portolan_geometry::{Point3f, Rigid3f};

use super::pyramid::MaxPyramid3d;
use crate::grid::VoxelLattice;

/// Cells are clamped to this. With shifts up to [`MAX_SHIFT`] they stay outside of any grid.
const FAR: i32 = 16_000;
/// Shifts are searched up to this many cells to either side.
pub(super) const MAX_SHIFT: i32 = 7800;

/// Points of a group that need cubes of the same width.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Segment {
    pub points: Range<usize>,
    pub level: usize,
}

/// 2^exponent neighbouring yaws. For each point the smallest indices of the cells it is in at any of them.
#[derive(Clone, Debug)]
pub(super) struct Group {
    pub cells: Vec<[i16; 3]>,
    /// What cubes the points need for boxes of 2^exponent shifts.
    pub segments: Vec<Segment>,
}

/// All groups of 1, 2, 4, … yaws.
pub(super) struct Scans {
    /// By exponent, then in the order of yaws.
    pub groups: Vec<Vec<Group>>,
    pub num_points: usize,
}

impl Scans {
    /// `points` at all of `poses`, which are in the order of yaws, in groups of up to 2^`max_exponent` as
    /// far as the pyramid has cubes for them.
    pub fn new(
        points: &[Point3f],
        poses: &[Rigid3f],
        lattice: VoxelLattice,
        pyramid: &MaxPyramid3d,
        max_exponent: u32,
    ) -> Self {
        // Nearest to the axis of rotation first: they need the smallest cubes.
        let mut points = points.to_vec();
        points.sort_by(|a, b| a.coords.xy().norm().total_cmp(&b.coords.xy().norm()));
        let cells = |pose: &Rigid3f| -> Vec<[i16; 3]> {
            let cell = |p: &Point3f| lattice.unchecked_cell((pose * p).into());
            points.iter().map(|p| cell(p).map(|i| i.clamp(-FAR, FAR) as i16)).collect()
        };
        let mut bounds: Vec<[Vec<[i16; 3]>; 2]> =
            poses.iter().map(|pose| [cells(pose), cells(pose)]).collect();
        let mut groups = Vec::new();
        for exponent in 0..=max_exponent {
            if exponent > 0 {
                bounds = bounds.chunks(2).map(united).collect();
            }
            let segments: Vec<Vec<Segment>> = bounds.iter().map(|b| segments(b, exponent)).collect();
            let widest = segments.iter().flatten().map(|s| s.level).max().unwrap_or(0);
            if exponent > 0 && widest >= pyramid.num_levels() {
                break;
            }
            let lows = bounds.iter().map(|[low, _]| low.clone());
            groups.push(lows.zip(segments).map(|(cells, segments)| Group { cells, segments }).collect());
        }
        Self { groups, num_points: points.len() }
    }
}

/// Smallest and largest cells of one or two groups together.
fn united(pair: &[[Vec<[i16; 3]>; 2]]) -> [Vec<[i16; 3]>; 2] {
    let (Some([low, high]), rest) = (pair.first().cloned(), pair.get(1)) else { return Default::default() };
    let Some([low_2, high_2]) = rest else { return [low, high] };
    let zip = |a: Vec<[i16; 3]>, b: &[[i16; 3]], f: fn(i16, i16) -> i16| {
        a.into_iter().zip(b).map(|(a, b)| [0, 1, 2].map(|i| f(a[i], b[i]))).collect()
    };
    [zip(low, low_2, i16::min), zip(high, high_2, i16::max)]
}

fn segments([low, high]: &[Vec<[i16; 3]>; 2], exponent: u32) -> Vec<Segment> {
    let mut segments: Vec<Segment> = Vec::new();
    let mut smear = 0;
    for (i, (a, b)) in low.iter().zip(high).enumerate() {
        let extent = [0, 1, 2].map(|axis| i32::from(b[axis]) - i32::from(a[axis])).into_iter().max();
        smear = smear.max(extent.unwrap_or(0));
        let level = MaxPyramid3d::level_for((1 << exponent) + smear as u32);
        match segments.last_mut() {
            Some(s) if s.level == level => s.points.end = i + 1,
            _ => segments.push(Segment { points: i..i + 1, level }),
        }
    }
    segments
}
