//! Which points of a cloud are searched for.

use portolan_geometry::Point3f;

/// Points at all yaws together that are searched at most, twice what a thousand points 60 m away at
/// resolution 0.1 m ask for: some hundreds of megabytes.
const MAX_TURNED_POINTS: usize = 1 << 23;

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

/// Range of the farthest point, metres.
pub(super) fn farthest(points: &[Point3f]) -> f32 {
    points.iter().map(|p| p.coords.norm()).fold(0.0, f32::max)
}
