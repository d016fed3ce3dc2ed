//! Selects the points of a cloud that are searched.

use portolan_geometry::Point3f;

/// Maximum number of points at all yaws together, twice the need of a thousand points 60 m away at resolution
/// 0.1 m: some hundreds of megabytes.
const MAX_TURNED_POINTS: usize = 1 << 23;

/// As many points, evenly chosen, as this limit allows for `turns` yaws; all of them unless cloud or grid is
/// absurd.
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
