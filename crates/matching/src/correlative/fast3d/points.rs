//! Which points of a cloud are searched for.

use std::collections::BTreeMap;

use portolan_geometry::{Point3f, Rigid3f};

/// Points at all yaws together that are searched at most, twice what a thousand points 60 m away at
/// resolution 0.1 m ask for: some hundreds of megabytes.
const MAX_TURNED_POINTS: usize = 1 << 23;
/// Height of the slices of which as many points each are chosen, metres.
const SLICE_HEIGHT: f32 = 0.3;

/// As many points, evenly chosen, as can be turned so often; all of them unless cloud or grid is absurd.
pub(super) fn thinned(mut points: Vec<Point3f>, turns: usize) -> Vec<Point3f> {
    let most = (MAX_TURNED_POINTS / turns.max(1)).max(1);
    let (stride, mut index) = (points.len().div_ceil(most).max(1), 0);
    points.retain(|_| {
        index += 1;
        (index - 1) % stride == 0
    });
    points
}

/// At most about `most` points, chosen so that as many as possible are of each height (slices of
/// [`SLICE_HEIGHT`] after a level rotation).
pub(super) fn evenly_over_heights(points: &[Point3f], level: &Rigid3f, most: usize) -> Vec<Point3f> {
    let slice = |p: &Point3f| ((level.rotation * p).z / SLICE_HEIGHT).floor() as i32;
    let mut slices: BTreeMap<i32, Vec<Point3f>> = BTreeMap::new();
    for point in points {
        slices.entry(slice(point)).or_default().push(*point);
    }
    // The largest fraction of each slice with which all of them together are few enough.
    let kept = |share: usize| slices.values().map(|s| s.len().min(share)).sum::<usize>();
    let largest = slices.values().map(Vec::len).max().unwrap_or(0);
    let share = (1..=largest).rev().find(|share| kept(*share) <= most).unwrap_or(1);
    let evenly = |slice: &Vec<Point3f>| {
        let count = slice.len().min(share);
        (0..count).filter_map(|i| slice.get(i * slice.len() / count).copied()).collect::<Vec<_>>()
    };
    slices.values().flat_map(evenly).collect()
}

/// Range of the farthest point, metres.
pub(super) fn farthest(points: &[Point3f]) -> f32 {
    points.iter().map(|p| p.coords.norm()).fold(0.0, f32::max)
}
