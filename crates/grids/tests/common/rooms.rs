//! Rooms side by side, as many as are wanted, and what a scanner sees in them.

use portolan_geometry::{Point3f, Rigid2, Vector2, Vector2f};
use portolan_grids::{Grid2d, MapLimits, ProbabilityGrid};
use portolan_sensor::PointCloud;
use portolan_testing::clouds::Lcg;

/// A room of 8 m by 6 m around its middle with boxes in it, which a seed decides.
pub fn room(seed: u32) -> (ProbabilityGrid, PointCloud) {
    let limits = MapLimits::new(0.05, Vector2::new(5.0, 4.0), 160, 200).unwrap();
    let mut grid = ProbabilityGrid::new(limits);
    let mut lcg = Lcg::new(seed);
    let boxes: Vec<[f32; 4]> = (0..6)
        .map(|_| {
            let (x, y) = (7.0 * lcg.unit() - 3.5, 5.0 * lcg.unit() - 2.5);
            [x, y, x + 0.3 + lcg.unit(), y + 0.3 + lcg.unit()]
        })
        .filter(|[x, y, to_x, to_y]| x.hypot(*y) > 2.0 || to_x.hypot(*to_y) > 2.0)
        .collect();
    let is_solid = |x: f32, y: f32| {
        let in_box = boxes.iter().any(|b| (b[0]..b[2]).contains(&x) && (b[1]..b[3]).contains(&y));
        in_box || x.abs() > 3.9 || y.abs() > 2.9
    };
    let mut points = Vec::new();
    for beam in 0..360u16 {
        let (sin, cos) = f32::from(beam).to_radians().sin_cos();
        let end = (1..200).map(|i| 0.025 * f32::from(i as u16)).find(|r| is_solid(r * cos, r * sin));
        let Some(range) = end else { continue };
        points.push(Point3f::new(range * cos, range * sin, 0.0));
        for i in 0..(range / 0.04) as u16 {
            let at = 0.04 * f32::from(i);
            grid.set_probability(limits.cell_index(Vector2f::new(at * cos, at * sin)), 0.2);
        }
    }
    for p in &points {
        grid.set_probability(limits.cell_index(p.coords.xy()), 0.9);
    }
    (grid, PointCloud::new(points))
}

/// Rooms side by side, each turned, and their poses.
pub fn rooms(seeds: &[u32]) -> Vec<(Grid2d, Rigid2, PointCloud)> {
    let columns = (seeds.len() as f64).sqrt().ceil() as usize;
    let place =
        |i: usize| Rigid2::new(11.0 * (i % columns) as f64, 11.0 * (i / columns) as f64, 0.7 * i as f64);
    let lay = |(i, seed): (usize, &u32)| {
        let (grid, cloud) = room(*seed);
        (Grid2d::Probability(grid), place(i), cloud)
    };
    seeds.iter().enumerate().map(lay).collect()
}
