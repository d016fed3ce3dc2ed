//! Voxel filters: at most one point per voxel (`spec/slam2d.md` §6).
//!
//! Bit-exact with Cartographer: the point of a voxel is chosen by reservoir sampling. The generator restarts
//! with every call, so that the same cloud always gives the same result.

mod adaptive;
mod reservoir;
#[cfg(test)]
mod tests;
mod voxel;
mod voxel_count;

pub use adaptive::{adaptive_voxel_filter, adaptive_voxel_filter_indices};

use portolan_geometry::Point3f;

use crate::{PointCloud, TimedPoint};
use reservoir::sample;

/// Keeps one point per voxel of edge `resolution` metres, in the order of the input and with its intensity.
/// Points that are not finite are left out. A resolution that is not positive keeps every point.
pub fn voxel_filter(cloud: &PointCloud, resolution: f32) -> PointCloud {
    let kept = voxel_filter_indices(&cloud.points, |p| *p, resolution);
    select(cloud, &kept)
}

/// [`voxel_filter`] for bare points.
pub fn voxel_filter_points(points: &[Point3f], resolution: f32) -> Vec<Point3f> {
    let kept = voxel_filter_indices(points, |p| *p, resolution);
    kept.iter().filter_map(|i| points.get(*i as usize).copied()).collect()
}

/// [`voxel_filter`] for points with times, which do not affect the choice.
pub fn voxel_filter_timed(points: &[TimedPoint], resolution: f32) -> Vec<TimedPoint> {
    let kept = voxel_filter_indices(points, |p| p.position, resolution);
    kept.iter().filter_map(|i| points.get(*i as usize).copied()).collect()
}

/// Indices of the points that [`voxel_filter`] keeps, ascending, for any items with a position in metres.
pub fn voxel_filter_indices<T>(items: &[T], position: impl Fn(&T) -> Point3f, resolution: f32) -> Vec<u32> {
    sample(items.iter().map(position), resolution)
}

/// The points at `indices` with their intensities.
fn select(cloud: &PointCloud, indices: &[u32]) -> PointCloud {
    PointCloud {
        points: indices.iter().filter_map(|i| cloud.points.get(*i as usize).copied()).collect(),
        intensities: indices.iter().filter_map(|i| cloud.intensities.get(*i as usize).copied()).collect(),
    }
}
