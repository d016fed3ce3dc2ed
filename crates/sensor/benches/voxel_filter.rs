//! How long does it take to thin a 2D scan, one sweep of a 3D lidar, and a scan adaptively?

use std::hint::black_box;

use portolan_geometry::Point3f;
use portolan_sensor::{adaptive_voxel_filter_indices, voxel_filter_points};
use portolan_testing::Stopwatch;

/// Points on the walls of a room of 20 m by 14 m and 3 m height, as a lidar in it would see them.
fn room(rings: usize, columns: usize) -> Vec<Point3f> {
    let mut points = Vec::with_capacity(rings * columns);
    for ring in 0..rings {
        let elevation = (ring as f32 - (rings as f32 - 1.0) / 2.0) * 0.01;
        for column in 0..columns {
            let (s, c) = (column as f32 / columns as f32 * std::f32::consts::TAU).sin_cos();
            let range = (10.0 / c.abs().max(1e-6)).min(7.0 / s.abs().max(1e-6));
            points.push(Point3f::new(range * c, range * s, range * elevation));
        }
    }
    points
}

fn fixed(watch: &Stopwatch) {
    for (name, rings, columns, resolution) in
        [("scan of 1080 at 2.5 cm", 1, 1080, 0.025), ("turn of 64 x 1024 at 15 cm", 64, 1024, 0.15)]
    {
        let cloud = room(rings, columns);
        watch.time(name, || voxel_filter_points(black_box(&cloud), resolution));
    }
}

fn adaptive(watch: &Stopwatch) {
    let cloud = room(1, 1080);
    watch.time("scan of 1080, at least 200 of 0.5 m", || {
        adaptive_voxel_filter_indices(black_box(&cloud), 0.5, 200, 50.0)
    });
}

fn main() {
    let watch = Stopwatch::of_arguments();
    fixed(&watch);
    adaptive(&watch);
}
