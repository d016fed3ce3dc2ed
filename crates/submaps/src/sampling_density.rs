//! Selects the points of a scan on densely sampled surfaces.
//!
//! Far along a wall the hits of neighbouring beams are metres apart. In a grid they form a dotted line, and
//! the next scan fits best dot on dot: as if the robot had not moved. Such points constrain the heading, but
//! must not constrain the motion along the wall.

use portolan_sensor::PointCloud;

/// Minimum number of returns around a point, including itself.
const MIN_RETURNS: usize = 3;

/// The points of `cloud` that have other returns around them, within one to two times `spacing` metres in 2D.
/// None, for all of them, if no point is left out, or less than `min_share` of them would be left.
pub fn densely_sampled(
    cloud: &PointCloud,
    returns: &PointCloud,
    spacing: f32,
    min_share: f64,
) -> Option<PointCloud> {
    let key = |x: f32, y: f32| ((x / spacing).floor() as i32, (y / spacing).floor() as i32);
    let mut cells: Vec<(i32, i32)> = returns.points.iter().map(|p| key(p.x, p.y)).collect();
    cells.sort_unstable();
    let count = |cell: (i32, i32)| {
        let start = cells.partition_point(|c| *c < cell);
        cells.iter().skip(start).take(MIN_RETURNS).take_while(|c| **c == cell).count()
    };
    let dense = cloud.points.iter().filter(|p| {
        let (x, y) = key(p.x, p.y);
        let around = (x - 1..=x + 1).flat_map(|x| (y - 1..=y + 1).map(move |y| (x, y)));
        let mut seen = 0;
        around.map(count).any(|n| {
            seen += n;
            seen >= MIN_RETURNS
        })
    });
    let kept: Vec<_> = dense.copied().collect();
    let enough = kept.len() as f64 >= min_share * cloud.points.len() as f64 && !kept.is_empty();
    (enough && kept.len() < cloud.points.len()).then(|| PointCloud::new(kept))
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Point3f;

    fn wall(beams: usize) -> PointCloud {
        // A wall 1 m to the left, seen by beams a degree apart from abeam to nearly along it.
        let hits = (0..beams).map(|i| {
            let along = (i as f32).to_radians().tan();
            Point3f::new(along, 1.0, 0.0)
        });
        PointCloud::new(hits.collect())
    }

    #[test]
    fn the_far_end_of_a_wall_is_sampled_thinly() {
        let wall = wall(86);
        let dense = densely_sampled(&wall, &wall, 0.15, 0.1).unwrap();
        assert!(dense.points.iter().all(|p| p.x < 5.0));
        assert!(dense.points.iter().any(|p| p.x > 2.0));
        assert!(wall.points.iter().filter(|p| p.x < 1.5).all(|p| dense.points.contains(p)));
    }

    #[test]
    fn too_few_points_give_no_selection() {
        let wall = wall(86);
        assert_eq!(densely_sampled(&wall, &wall, 0.15, 0.99), None);
        assert_eq!(densely_sampled(&PointCloud::default(), &wall, 0.15, 0.1), None);
    }
}
