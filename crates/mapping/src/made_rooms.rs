//! Simulated rooms and scans of them, for tests.

use portolan_geometry::{Point3f, Quaternion, Rigid3, Time, Vector2};
use portolan_grids::{Grid2d, MapLimits, ProbabilityGrid};
use portolan_sensor::PointCloud;
use portolan_submaps::Submap2d;

use crate::NodeData;

/// Scan from (x, y) of a room of this size, metres, around the origin, one of whose corners is cut off by a
/// box of 2 m.
fn scan(size: (f32, f32), (x, y): (f32, f32)) -> PointCloud {
    let (half_x, half_y) = (size.0 / 2.0, size.1 / 2.0);
    let is_free =
        |x: f32, y: f32| x.abs() < half_x && y.abs() < half_y && !(x > half_x - 2.0 && y > half_y - 2.0);
    let ray = |beam: u16| {
        let (sin, cos) = f32::from(beam).to_radians().sin_cos();
        let end = (1..1000).map(|i| 0.02 * f32::from(i as u16)).find(|r| !is_free(x + r * cos, y + r * sin));
        end.map(|r| Point3f::new(r * cos, r * sin, 0.0))
    };
    PointCloud::new((0..360).filter_map(ray).collect())
}

pub(crate) fn submap(size: (f32, f32)) -> Submap2d {
    let limits = MapLimits::new(0.05, Vector2::new(8.0, 8.0), 320, 320).unwrap();
    let mut grid = ProbabilityGrid::new(limits);
    let points = scan(size, (0.0, 0.0)).points;
    let cell = |p: &Point3f, share: f32| limits.cell_index(share * p.coords.xy());
    for (p, i) in points.iter().flat_map(|p| (0..200).map(move |i| (p, i))) {
        grid.set_probability(cell(p, f32::from(i as u16) / 210.0), 0.2);
    }
    // Walls are thicker than a cell.
    for (p, share) in points.iter().flat_map(|p| [1.0, 1.02, 1.04].map(|share| (p, share))) {
        grid.set_probability(cell(p, share), 0.9);
    }
    Submap2d::from_parts(Rigid3::identity(), 10, true, Grid2d::Probability(grid))
}

pub(crate) fn node(size: (f32, f32), at: (f32, f32)) -> NodeData {
    NodeData {
        time: Time::from_ticks(0),
        gravity_alignment: Quaternion::identity(),
        filtered_gravity_aligned_point_cloud: scan(size, at),
        high_resolution_point_cloud: PointCloud::default(),
        low_resolution_point_cloud: PointCloud::default(),
        rotational_scan_matcher_histogram: Vec::new(),
        local_from_tracking: Rigid3::identity(),
        scan: None,
    }
}
