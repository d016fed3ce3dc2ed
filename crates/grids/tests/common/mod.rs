//! Scenes of the golden vectors, drawn on grids: what tests of this crate and of `portolan-matching` share. They are made
//! of grids and therefore cannot be in `portolan-testing`.

pub mod rooms;

use portolan_geometry::{Point3f, Vector2};
use portolan_sensor::{PointCloud, RangeData};
use portolan_testing::clouds;
pub use portolan_testing::clouds::Lcg;

use portolan_grids::{
    Grid2d, HybridGrid, HybridInserter, HybridInserterOptions, MapLimits, ProbabilityGrid,
    ProbabilityInserter, ProbabilityInserterOptions, Tsdf2d, TsdfInserter, TsdfInserterOptions,
};

/// A box-shaped room with niches, seen from (`ox`, `oy`).
pub fn room(n: usize, ox: f32, oy: f32) -> RangeData {
    let (x0, y0) = (f64::from(ox), f64::from(oy));
    let points = (0..n).map(|i| {
        let a = 2.0 * std::f64::consts::PI * i as f64 / n as f64;
        let (c, s) = (a.cos(), a.sin());
        let mut t = f64::INFINITY;
        for (wall, start, direction) in [(6.0, x0, c), (-4.0, x0, c), (5.0, y0, s), (-3.0, y0, s)] {
            if (wall > 0.0 && direction > 0.0) || (wall < 0.0 && direction < 0.0) {
                t = t.min((wall - start) / direction);
            }
        }
        if i % 50 < 8 {
            t *= 0.6;
        }
        Point3f::new((x0 + t * c) as f32, (y0 + t * s) as f32, 0.0)
    });
    let returns = PointCloud::new(points.collect());
    RangeData { origin: Point3f::new(ox, oy, 0.0), returns, misses: PointCloud::default() }
}

pub fn room1() -> RangeData {
    room(360, 0.3, -0.2)
}

pub fn room2() -> RangeData {
    room(300, 1.5, 0.7)
}

/// Limits of the grid the rooms are drawn on.
pub fn room_limits() -> MapLimits {
    let resolution = f64::from(0.05f32);
    MapLimits::around(resolution, Vector2::new(f64::from(0.3f32), f64::from(-0.2f32))).unwrap()
}

pub fn default_inserter() -> ProbabilityInserter {
    ProbabilityInserter::new(&ProbabilityInserterOptions::default()).unwrap()
}

/// Five times room 1, once room 2, cropped: grid G of the golden vectors.
pub fn grid_g() -> ProbabilityGrid {
    let mut grid = ProbabilityGrid::new(room_limits());
    let inserter = default_inserter();
    for _ in 0..5 {
        inserter.insert(&room1(), &mut grid).unwrap();
    }
    inserter.insert(&room2(), &mut grid).unwrap();
    grid.cropped()
}

/// CRC-32 of codes as little-endian bytes.
pub fn crc_u16(codes: &[u16]) -> u32 {
    crc32fast::hash(&codes.iter().flat_map(|c| c.to_le_bytes()).collect::<Vec<u8>>())
}

/// A room drawn a few times from random places on a grid of either kind, and a scan taken in it.
pub fn random_room(lcg: &mut Lcg, tsdf: bool) -> (Grid2d, PointCloud) {
    let mut place = || room(60 + (lcg.unit() * 100.0) as usize, lcg.symmetric(2.0), lcg.symmetric(2.0));
    let scans = [place(), place(), place()];
    let mut points = place().returns.points;
    // Clutter that fits nowhere.
    for (i, point) in points.iter_mut().enumerate() {
        if i % 7 == 0 {
            *point = Point3f::from(point.coords * 0.7);
        }
    }
    let points = PointCloud::new(points);
    if tsdf {
        let inserter = TsdfInserter::new(&TsdfInserterOptions::default()).unwrap();
        let mut grid = Tsdf2d::new(room_limits(), 0.3, 10.0).unwrap();
        scans.iter().for_each(|s| assert!(inserter.insert(s, &mut grid).is_ok()));
        return (grid.into(), points);
    }
    let mut grid = ProbabilityGrid::new(room_limits());
    scans.iter().for_each(|s| assert!(default_inserter().insert(s, &mut grid).is_ok()));
    (grid.into(), points)
}

/// Cloud B of the golden vectors.
pub fn cloud_b() -> PointCloud {
    oval_hall(21, 2000)
}

/// Random points of an oval wall with two flat ends, above a floor.
pub fn oval_hall(seed: u32, n: usize) -> PointCloud {
    PointCloud::new(clouds::oval_hall(seed, n))
}

/// Cloud B seen from its origin.
pub fn range_data_b() -> RangeData {
    RangeData { origin: Point3f::new(0.25, -0.5, 0.125), returns: cloud_b(), misses: PointCloud::default() }
}

/// Cloud B drawn a few times with the default options.
pub fn drawn_cloud_b(resolution: f32, times: usize) -> HybridGrid {
    let mut grid = HybridGrid::new(resolution).unwrap();
    let inserter = HybridInserter::new(&HybridInserterOptions::default()).unwrap();
    for _ in 0..times {
        inserter.insert(&range_data_b(), f32::INFINITY, &mut grid, None).unwrap();
    }
    grid
}

/// CRC-32 of indices and codes of all known cells in the order of map files.
pub fn crc_cells(grid: &HybridGrid) -> u32 {
    let mut bytes = Vec::new();
    grid.for_each_cell(|[x, y, z], code| {
        bytes.extend([x, y, z, i32::from(code)].into_iter().flat_map(i32::to_le_bytes));
    });
    crc32fast::hash(&bytes)
}

/// Bytes that the cells of a grid take in a map file before compression: three zigzag varints and one
/// plain one per cell.
pub fn stored_bytes(grid: &HybridGrid) -> usize {
    let varint = |v: u32| (32 - (v | 1).leading_zeros() as usize).div_ceil(7);
    let mut bytes = 0;
    grid.for_each_cell(|cell, code| {
        bytes += cell.iter().map(|i| varint((i << 1 ^ i >> 31) as u32)).sum::<usize>();
        bytes += varint(u32::from(code));
    });
    bytes
}
