//! Renders 3D submaps as X-ray images from above in the global map (`formats.md §4.7`).

use nalgebra::{Quaternion as RawQuaternion, Translation3, Vector3};
use portolan_geometry::{NearFrame, Quaternion, Rigid3, to_f32};

use crate::texture::{MAX_TEXTURE_PIXELS, SubmapTexture, TextureError};
use portolan_pbstream::codes::{self, MAX_PROBABILITY, MIN_PROBABILITY, PROBABILITIES};
use portolan_pbstream::proto::mapping::{HybridGrid, Submap3D};

/// Probability below which a cell is not occupied: free or uncertain.
const OBSTRUCTED: f32 = 0.501;
/// Minimum height of a column of voxels, in voxels; lower ones contain only floor or ceiling.
const MIN_HEIGHT: i32 = 3;
/// Maximum number of pixels for each occupied voxel, in addition to `LEAST_MAX_PIXELS`; larger images count
/// as damage. Real submaps have a few pixels per voxel.
const MAX_PIXELS_OF_A_VOXEL: u64 = 64;
const LEAST_MAX_PIXELS: u64 = 1 << 20;
/// Weight of a free voxel between occupied ones, relative to an occupied one; dimensionless.
const FREE_SPACE_WEIGHT: f32 = 0.15;

/// The texture of the fine grid of a 3D submap. The projection is along the z axis of the global map, so it
/// depends on the pose `map_from_submap`. A missing coarse grid is an error too, because such a submap is not
/// complete.
///
/// # Errors
/// If one of the two grids is missing, or as for [`xray_texture`].
pub fn texture_3d(submap: &Submap3D, map_from_submap: &Rigid3) -> Result<SubmapTexture, TextureError> {
    submap.low_resolution_hybrid_grid.as_ref().ok_or(TextureError::NoGrid)?;
    let high = submap.high_resolution_hybrid_grid.as_ref().ok_or(TextureError::NoGrid)?;
    xray_texture(high, map_from_submap)
}

/// The X-ray of one hybrid grid.
///
/// # Errors
/// If the grid is damaged, or if its voxels are so far apart that the image would be too large.
pub fn xray_texture(grid: &HybridGrid, map_from_submap: &Rigid3) -> Result<SubmapTexture, TextureError> {
    // Single precision resolves voxels in a near frame. The pose of the image in the submap stays the same.
    let map_from_submap = &NearFrame::around([map_from_submap.translation.vector]).near(map_from_submap);
    let voxels = occupied_voxels(grid, map_from_submap)?;
    let area = Area::around(&voxels);
    // A few voxels far apart must not need more memory than a real submap.
    let most =
        (MAX_PIXELS_OF_A_VOXEL * voxels.len() as u64 + LEAST_MAX_PIXELS).min(MAX_TEXTURE_PIXELS as u64);
    if area.pixels() > most {
        return Err(TextureError::TooLarge(area.pixels()));
    }
    let (width, height) = (area.width as usize, area.height as usize);
    let mut columns = vec![Column::EMPTY; width * height];
    for (index, probability) in &voxels {
        let row = (i64::from(area.max.x) - i64::from(index.x)) as usize;
        let column = (i64::from(area.max.y) - i64::from(index.y)) as usize;
        if let Some(c) = columns.get_mut(row * width + column) {
            c.add(index.z, *probability);
        }
    }
    // In single precision, like the coordinates of voxels.
    let corner = |index: i32| f64::from(index as f32 * grid.resolution);
    let map_from_slice = Rigid3::from_parts(
        Translation3::new(corner(area.max.x), corner(area.max.y), map_from_submap.translation.z),
        Quaternion::identity(),
    );
    Ok(SubmapTexture {
        pixels: columns.iter().map(Column::pixel).collect(),
        width,
        height,
        resolution: f64::from(grid.resolution),
        submap_from_slice: map_from_submap.inverse() * map_from_slice,
    })
}

/// Indices in the global map, in cells, and probabilities of the occupied voxels.
fn occupied_voxels(
    grid: &HybridGrid,
    map_from_submap: &Rigid3,
) -> Result<Vec<(Vector3<i32>, f32)>, TextureError> {
    if !grid.resolution.is_finite() || grid.resolution <= 0.0 {
        return Err(TextureError::Bounds("resolution"));
    }
    for indices in [&grid.x_indices, &grid.y_indices, &grid.z_indices] {
        if indices.len() != grid.values.len() {
            return Err(TextureError::CellCount { stated: grid.values.len() as i64, found: indices.len() });
        }
    }
    let pose = to_f32(map_from_submap);
    let (q, t) = (pose.rotation.into_inner(), pose.translation.vector);
    let indices = grid.x_indices.iter().zip(&grid.y_indices).zip(&grid.z_indices);
    let mut voxels = Vec::new();
    for (((x, y), z), code) in indices.zip(&grid.values) {
        let probability = codes::without_marker(*code).and_then(|c| PROBABILITIES.get(c));
        let probability = *probability.ok_or(TextureError::CellValue(*code))?;
        if probability < OBSTRUCTED {
            continue;
        }
        let centre = Vector3::new(*x as f32, *y as f32, *z as f32) * grid.resolution;
        let index = (rotate(&q, &centre) + t) / grid.resolution;
        // `as` saturates; voxels that far out are rejected by the size of the area.
        voxels.push((index.map(|c| c.round() as i32), probability));
    }
    Ok(voxels)
}

/// Rotates a vector in this order of operations, so that voxels on the border between two pixels are assigned
/// as by other programs.
fn rotate(q: &RawQuaternion<f32>, v: &Vector3<f32>) -> Vector3<f32> {
    let axis = q.vector();
    let uv = axis.cross(v);
    let uv = uv + uv;
    v + q.w * uv + axis.cross(&uv)
}

/// The cells covered by the image.
struct Area {
    max: Vector3<i32>,
    width: u64,
    height: u64,
}

impl Area {
    fn around(voxels: &[(Vector3<i32>, f32)]) -> Self {
        let Some((first, _)) = voxels.first() else {
            return Self { max: Vector3::zeros(), width: 1, height: 1 };
        };
        let (min, max) = voxels.iter().fold((*first, *first), |(lo, hi), (v, _)| (lo.inf(v), hi.sup(v)));
        let extent = |lo: i32, hi: i32| (i64::from(hi) - i64::from(lo)) as u64 + 1;
        Self { max, width: extent(min.y, max.y), height: extent(min.x, max.x) }
    }

    fn pixels(&self) -> u64 {
        self.width.saturating_mul(self.height)
    }
}

/// Statistics of the voxels along one vertical line.
#[derive(Clone, Copy)]
struct Column {
    count: i32,
    min_z: i32,
    max_z: i32,
    probability_sum: f32,
    max_probability: f32,
}

impl Column {
    const EMPTY: Self =
        Self { count: 0, min_z: i32::MAX, max_z: i32::MIN, probability_sum: 0.0, max_probability: 0.5 };

    fn add(&mut self, z: i32, probability: f32) {
        self.count = self.count.saturating_add(1);
        self.min_z = self.min_z.min(z);
        self.max_z = self.max_z.max(z);
        self.probability_sum += probability;
        self.max_probability = self.max_probability.max(probability);
    }

    fn pixel(&self) -> [u8; 2] {
        let height = if self.count == 0 { 0 } else { self.max_z.saturating_sub(self.min_z) };
        if height < MIN_HEIGHT {
            return [0, 0];
        }
        let free = height.saturating_sub(self.count).max(0) as f32;
        let free_weight = FREE_SPACE_WEIGHT * free;
        let total = self.probability_sum + (1.0 - self.max_probability) * free_weight;
        let average = total / (self.count as f32 + free_weight);
        codes::probability_pixel(average.clamp(MIN_PROBABILITY, MAX_PROBABILITY))
    }
}
