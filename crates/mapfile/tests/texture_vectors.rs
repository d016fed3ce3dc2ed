//! Textures of grids that are built here by the rules alone (`vectors.md §5, §8`).

// Golden values are written as they were printed.
#![allow(clippy::excessive_precision)]
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::collections::BTreeMap;

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use portolan_geometry::Rigid3;
use portolan_mapfile::{SubmapTexture, texture_2d, xray_texture};
use portolan_pbstream::proto::mapping::{
    CellLimits, Grid2D, HybridGrid, MapLimits, ProbabilityGrid, Submap2D, grid2_d,
};
use portolan_pbstream::proto::transform::Vector2d;
use portolan_pbstream::{CodeRange, gunzip, pose_to_proto};

const P_MIN: f32 = 0.1;
const P_MAX: f32 = 1.0 - P_MIN;
const MARK: u16 = 0x8000;

fn odds(p: f32) -> f32 {
    p / (1.0 - p)
}

fn probability(odds: f32) -> f32 {
    odds / (odds + 1.0)
}

/// The update table for observing `odds`; `cost` says whether codes mean one minus probability.
fn table(update: f32, cost: bool) -> Vec<u16> {
    let (low, high) = if cost { (1.0 - P_MAX, 1.0 - P_MIN) } else { (P_MIN, P_MAX) };
    let encode = |p: f32| {
        let x = if cost { 1.0 - p } else { p };
        ((x.clamp(low, high) - low) * (32766.0 / (high - low))).round() as u16 + 1 + MARK
    };
    let range = CodeRange::new(low, high);
    let known = (1..32768).map(|code| {
        let p = if cost { 1.0 - range.value(code) } else { range.value(code) };
        encode(probability(update * odds(p)))
    });
    std::iter::once(encode(probability(update))).chain(known).collect()
}

fn checksum(texture: &SubmapTexture) -> u32 {
    crc32fast::hash(texture.pixels.as_flattened())
}

/// Cloud B.
fn cloud_b() -> Vec<Vector3<f32>> {
    let mut state = 21_u32;
    let mut draw = |a: f32| {
        state = state.wrapping_mul(1664525).wrapping_add(1013904223);
        ((state >> 8) as f32 / 16777216.0 * 2.0 - 1.0) * a
    };
    (0..2000)
        .map(|i| {
            let (a, h) = (draw(std::f32::consts::PI), draw(1.0));
            let (mut x, y, mut z) = (8.0 * a.cos(), 5.0 * a.sin(), 2.0 * h);
            if i % 3 == 0 {
                x = if x > 0.0 { 6.0 } else { -6.0 };
            }
            if i % 7 == 0 {
                z = -2.0;
            }
            Vector3::new(x, y, z).map(|v| (v * 1024.0).round() / 1024.0)
        })
        .collect()
}

fn hybrid_grid(resolution: f32, points: &[Vector3<f32>], times: usize) -> HybridGrid {
    let (hit, miss) = (table(odds(0.55), false), table(odds(0.49), false));
    let cell = |p: &Vector3<f32>| p.map(|v| (v / resolution).round() as i32);
    let origin = cell(&Vector3::new(0.25, -0.5, 0.125));
    let mut cells: BTreeMap<[i32; 9], ([i32; 3], u16)> = BTreeMap::new();
    let update = |cells: &mut BTreeMap<_, _>, c: Vector3<i32>, table: &[u16]| {
        let key = [
            c.z >> 6,
            c.y >> 6,
            c.x >> 6,
            c.z >> 3 & 7,
            c.y >> 3 & 7,
            c.x >> 3 & 7,
            c.z & 7,
            c.y & 7,
            c.x & 7,
        ];
        let entry: &mut ([i32; 3], u16) = cells.entry(key).or_insert(([c.x, c.y, c.z], 0));
        if entry.1 & MARK == 0 {
            entry.1 = table[usize::from(entry.1)];
        }
    };
    for _ in 0..times {
        points.iter().for_each(|p| update(&mut cells, cell(p), &hit));
        for p in points {
            let delta = cell(p) - origin;
            let n = delta.abs().max();
            for k in (n - 2).max(0)..n {
                update(&mut cells, origin + (delta * k).map(|v| v / n), &miss);
            }
        }
        cells.values_mut().for_each(|c| c.1 &= !MARK);
    }
    let mut grid = HybridGrid { resolution, ..HybridGrid::default() };
    for ([x, y, z], value) in cells.values() {
        grid.x_indices.push(*x);
        grid.y_indices.push(*y);
        grid.z_indices.push(*z);
        grid.values.push(i32::from(*value));
    }
    grid
}

#[test]
fn xray_of_hybrid_grids() {
    let cloud = cloud_b();
    let bytes: Vec<u8> = cloud.iter().flat_map(|p| [p.x, p.y, p.z]).flat_map(f32::to_le_bytes).collect();
    assert_eq!(crc32fast::hash(&bytes), 0x89a4_648c);
    let map_from_submap = Rigid3::from_parts(
        Translation3::new(1.0, 2.0, 0.5),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.3),
    );
    let high = xray_texture(&hybrid_grid(0.1, &cloud, 3), &map_from_submap).unwrap();
    assert_eq!((high.width, high.height, checksum(&high)), (131, 157, 0xe46b_dd8b));
    assert_eq!(high.pixels.as_flattened().iter().filter(|b| **b != 0).count(), 448);
    let slice = high.submap_from_slice;
    assert!((slice.translation.vector - Vector3::new(9.372506141, 3.904629511, 0.0)).norm() < 1e-8);
    assert!((slice.rotation.w - 0.988771078).abs() < 1e-9 && (slice.rotation.k + 0.149438132).abs() < 1e-9);
    let low = xray_texture(&hybrid_grid(0.45, &cloud, 3), &map_from_submap).unwrap();
    assert_eq!((low.width, low.height, checksum(&low)), (30, 37, 0x896f_1784));
    let slice = low.submap_from_slice.translation.vector;
    assert!((slice - Vector3::new(9.578349323, 3.893292533, 0.0)).norm() < 1e-8);
    let message = high.to_proto().unwrap();
    assert_eq!(gunzip(&message.cells, 1 << 20).unwrap(), high.pixels.as_flattened());
}

/// The points of a room seen from `(ox, oy)`.
fn room(n: usize, ox: f64, oy: f64) -> Vec<[f32; 2]> {
    (0..n)
        .map(|i| {
            let (s, c) = (2.0 * std::f64::consts::PI * i as f64 / n as f64).sin_cos();
            let mut t = f64::INFINITY;
            if c > 0.0 {
                t = t.min((6.0 - ox) / c);
            } else if c < 0.0 {
                t = t.min((-4.0 - ox) / c);
            }
            if s > 0.0 {
                t = t.min((5.0 - oy) / s);
            } else if s < 0.0 {
                t = t.min((-3.0 - oy) / s);
            }
            if i % 50 < 8 {
                t *= 0.6;
            }
            [(ox + t * c) as f32, (oy + t * s) as f32]
        })
        .collect()
}

/// The full cells met by the segment between the centres of two subpixels (scale 1000), by exact
/// comparison of the crossing points with the borders of the columns.
fn ray_cells(mut b: [i64; 2], mut e: [i64; 2]) -> Vec<[i64; 2]> {
    const S: i64 = 1000;
    if b[0] > e[0] {
        std::mem::swap(&mut b, &mut e);
    }
    let (first, last) = (b[0] / S, e[0] / S);
    if first == last {
        let (low, high) = (b[1].min(e[1]) / S, b[1].max(e[1]) / S);
        return (low..=high).map(|y| [first, y]).collect();
    }
    let (dx, dy) = (e[0] - b[0], e[1] - b[1]);
    let mut cells = Vec::new();
    for column in first..=last {
        // y at an x, both in half subpixels, times dx.
        let y_at = |x: i64| (2 * b[1] + 1) * dx + dy * (x - 2 * b[0] - 1);
        let left = y_at((2 * S * column).max(2 * b[0] + 1));
        let right = y_at((2 * S * (column + 1)).min(2 * e[0] + 1));
        let cell = 2 * S * dx;
        let (low, high) = (left.min(right), left.max(right));
        // A corner that is only touched belongs to neither side.
        let mut rows = low.div_euclid(cell)..=high.div_euclid(cell);
        if high.rem_euclid(cell) == 0 && high > low {
            rows = *rows.start()..=rows.end() - 1;
        }
        cells.extend(rows.map(|row| [column, row]));
    }
    cells
}

#[test]
fn texture_of_a_probability_grid() {
    let (hit, miss) = (table(odds(0.55), true), table(odds(0.49), true));
    let resolution = f64::from(0.05_f32);
    let origin = [f64::from(0.3_f32), f64::from(-0.2_f32)];
    // The grid after growing, as stated with the vectors.
    let (size, max) = (400_i64, [10.300000160932541, 9.8000001460313797]);
    let index = |p: [f32; 2], scale: f64| {
        let r = resolution / scale;
        [
            ((max[1] - f64::from(p[1])) / r - 0.5).round() as i64,
            ((max[0] - f64::from(p[0])) / r - 0.5).round() as i64,
        ]
    };
    let points = room(360, origin[0], origin[1]);
    let mut cells = vec![0_u16; (size * size) as usize];
    let update = |cells: &mut [u16], [x, y]: [i64; 2], table: &[u16]| {
        let cell = &mut cells[(size * y + x) as usize];
        if *cell & MARK == 0 {
            *cell = table[usize::from(*cell)];
        }
    };
    for _ in 0..5 {
        let begin = index([0.3, -0.2], 1000.0);
        let ends: Vec<_> = points.iter().map(|p| index(*p, 1000.0)).collect();
        ends.iter().for_each(|e| update(&mut cells, e.map(|v| v / 1000), &hit));
        for end in &ends {
            ray_cells(begin, *end).into_iter().for_each(|c| update(&mut cells, c, &miss));
        }
        cells.iter_mut().for_each(|c| *c &= !MARK);
    }
    let bytes: Vec<u8> = cells.iter().flat_map(|c| c.to_le_bytes()).collect();
    assert_eq!(crc32fast::hash(&bytes), 0x157c_abb1);

    let submap = Submap2D {
        local_pose: Some(pose_to_proto(&Rigid3::translation(origin[0], origin[1], 0.0))),
        num_range_data: 5,
        finished: true,
        grid: Some(Grid2D {
            limits: Some(MapLimits {
                resolution,
                max: Some(Vector2d { x: max[0], y: max[1] }),
                cell_limits: Some(CellLimits { num_x_cells: size as i32, num_y_cells: size as i32 }),
            }),
            cells: cells.iter().map(|c| i32::from(*c)).collect(),
            known_cells_box: Some(grid2_d::CellBox { min_x: 96, max_x: 255, min_y: 86, max_y: 285 }),
            grid: Some(grid2_d::Grid::ProbabilityGrid2d(ProbabilityGrid {})),
            min_correspondence_cost: 1.0 - P_MAX,
            max_correspondence_cost: P_MAX,
        }),
    };
    let texture = texture_2d(&submap).unwrap();
    assert_eq!((texture.width, texture.height, checksum(&texture)), (160, 200, 0x6828_9e54));
    let slice = texture.submap_from_slice.translation.vector;
    assert!((slice - Vector3::new(5.70000008, 5.20000008, 0.0)).norm() < 1e-8, "{slice}");
}
