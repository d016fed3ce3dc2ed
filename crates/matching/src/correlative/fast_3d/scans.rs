//! The cells of a scan at all yaws of a search, and groups of neighbouring yaws.

use std::ops::Range;

use portolan_geometry::{Point3f, Rigid3f};
use portolan_grids::VoxelLattice;

use super::pyramid::MaxPyramid3d;

/// Indices of cells are clamped to this. With shifts up to [`MAX_SHIFT`] they remain outside of any grid.
const FAR: i32 = 16_000;
/// Maximum number of cells to either side that shifts are searched.
pub(super) const MAX_SHIFT: i32 = 7800;

/// Points of a group that need cubes of the same width.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Segment {
    pub points: Range<usize>,
    /// Level of the cubes; none if there are no cubes so wide.
    pub level: Option<usize>,
}

/// Up to 2^exponent neighbouring yaws. For each point the smallest indices of the cells it is in at any of
/// them.
#[derive(Clone, Debug)]
pub(super) struct Group {
    pub cells: Vec<[i16; 3]>,
    /// Cubes that the points need for boxes of 2^exponent shifts.
    pub segments: Vec<Segment>,
}

/// All groups of 1, 2, 4, … yaws.
pub(super) struct Scans {
    /// By exponent, then by yaw: group i has the yaws from i times 2^exponent on. There is none where no
    /// yaw is searched.
    pub groups: Vec<Vec<Option<Group>>>,
    pub num_points: usize,
}

/// Smallest and largest indices of the cells of each point.
#[derive(Clone)]
struct Bounds {
    low: Vec<[i16; 3]>,
    high: Vec<[i16; 3]>,
}

impl Scans {
    /// `points` at a pose for each yaw that is searched, in groups of up to 2^`max_exponent`.
    pub fn new(
        points: &[Point3f],
        poses: impl Iterator<Item = Option<Rigid3f>>,
        lattice: VoxelLattice,
        pyramid: &MaxPyramid3d,
        max_exponent: u32,
    ) -> Self {
        // Nearest to the axis of rotation first: they need the smallest cubes.
        let mut points = points.to_vec();
        points.sort_by(|a, b| a.coords.xy().norm().total_cmp(&b.coords.xy().norm()));
        let bounds = |pose: Rigid3f| {
            let cell = |p: &Point3f| {
                let place = pose * p;
                lattice.unchecked_cell([place.x, place.y, place.z]).map(|i| i.clamp(-FAR, FAR) as i16)
            };
            let low: Vec<[i16; 3]> = points.iter().map(cell).collect();
            Bounds { high: low.clone(), low }
        };
        let mut bounds: Vec<Option<Bounds>> = poses.map(|pose| pose.map(bounds)).collect();
        let mut groups = Vec::new();
        for exponent in 0..=max_exponent {
            if exponent > 0 {
                bounds = bounds.chunks(2).map(united).collect();
            }
            let group = |b: &Option<Bounds>| {
                let b = b.as_ref()?;
                Some(Group { cells: b.low.clone(), segments: segments(b, exponent, pyramid.num_levels()) })
            };
            groups.push(bounds.iter().map(group).collect());
        }
        Self { groups, num_points: points.len() }
    }
}

/// The bounds of one or two groups together.
fn united(pair: &[Option<Bounds>]) -> Option<Bounds> {
    let mut known = pair.iter().flatten();
    let mut both = known.next()?.clone();
    for other in known {
        for (a, b) in both.low.iter_mut().zip(&other.low) {
            *a = [a[0].min(b[0]), a[1].min(b[1]), a[2].min(b[2])];
        }
        for (a, b) in both.high.iter_mut().zip(&other.high) {
            *a = [a[0].max(b[0]), a[1].max(b[1]), a[2].max(b[2])];
        }
    }
    Some(both)
}

fn segments(bounds: &Bounds, exponent: u32, num_levels: usize) -> Vec<Segment> {
    let mut segments: Vec<Segment> = Vec::new();
    let mut smear = 0;
    for (i, (a, b)) in bounds.low.iter().zip(&bounds.high).enumerate() {
        for axis in 0..3 {
            smear = smear.max(i32::from(b[axis]) - i32::from(a[axis]));
        }
        let level = MaxPyramid3d::level_for((1 << exponent) + smear as u32);
        let level = (level < num_levels).then_some(level);
        match segments.last_mut() {
            Some(s) if s.level == level => s.points.end = i + 1,
            _ => segments.push(Segment { points: i..i + 1, level }),
        }
    }
    segments
}
