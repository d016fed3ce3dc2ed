//! `write_xray_image`: the number of occupied voxels along the x axis (`formats.md` §6.4).

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::path::PathBuf;

use portolan_atomic_file::AtomicFile;
use portolan_geometry::{Point3f, Rigid3, Rigid3f, Time, to_f32};
use tiny_skia::{IntSize, Pixmap};

use super::batch::voxel_of;
use super::floors::Floor;
use super::trajectories::draw_trajectory;
use super::{Flush, Log, PointsBatch, PointsError, Stage};
use crate::colour::{Rgb, mix, to_bytes};
use crate::png_file::write_rgb;

const ACTION: &str = "write_xray_image";
/// Maximum number of occupied voxels, of some 20 bytes each.
const MAX_VOXELS: usize = 1 << 26;
const MAX_PIXELS: u64 = 1 << 27;

/// Options of the stage.
pub(super) struct XrayOptions {
    /// Path without `.png`.
    pub file: PathBuf,
    /// Edge of a voxel, metres.
    pub voxel_size: f32,
    /// Transform from the frame of the points to the view; the picture looks along the x axis of the view.
    pub view_from_points: Rigid3,
    pub saturation_factor: f32,
    /// Floors with one picture each; empty for a single picture of everything.
    pub floors: Vec<Floor>,
    /// Trajectories to be drawn over the picture.
    pub trajectories: Vec<Vec<(Time, Rigid3)>>,
}

/// Draws one picture, or one for each floor.
pub(super) struct WriteXray {
    options: XrayOptions,
    view_from_points: Rigid3f,
    pictures: Vec<Columns>,
    /// Smallest and largest (y, z) of all voxels.
    bounds: Option<[[i32; 2]; 2]>,
}

/// Content along all lines of sight.
#[derive(Default)]
struct Columns {
    columns: HashMap<[i32; 2], Column>,
    voxels: HashSet<[i32; 3]>,
}

/// Content of a pixel.
#[derive(Clone, Copy, Default)]
struct Column {
    sum: Rgb,
    points: u32,
    voxels: u32,
}

impl WriteXray {
    pub fn new(options: XrayOptions) -> Result<Self, PointsError> {
        let pictures = (0..options.floors.len().max(1)).map(|_| Columns::default()).collect();
        let xray =
            Self { view_from_points: to_f32(&options.view_from_points), options, pictures, bounds: None };
        // Checks before processing that files can be written.
        drop(AtomicFile::create(xray.file(0))?);
        Ok(xray)
    }

    fn file(&self, picture: usize) -> PathBuf {
        let mut name = self.options.file.clone().into_os_string();
        if !self.options.floors.is_empty() {
            name.push(picture.to_string());
        }
        name.push(".png");
        name.into()
    }

    fn add(&mut self, batch: &PointsBatch, picture: usize) -> Result<(), PointsError> {
        let Some(columns) = self.pictures.get_mut(picture) else { return Ok(()) };
        for (i, point) in batch.points.iter().enumerate() {
            let Some(voxel) = voxel_of(&(self.view_from_points * point), self.options.voxel_size) else {
                continue;
            };
            let [_, y, z] = voxel;
            let [min, max] = self.bounds.get_or_insert([[y, z]; 2]);
            *min = [min[0].min(y), min[1].min(z)];
            *max = [max[0].max(y), max[1].max(z)];
            columns.add(voxel, batch.colors.get(i).copied().unwrap_or_default());
        }
        if columns.voxels.len() > MAX_VOXELS {
            let reason = format!("there are points in more than {MAX_VOXELS} voxels");
            return Err(PointsError::TooLarge { action: ACTION, reason });
        }
        Ok(())
    }

    /// Draws a picture of the part of the view between the bounds.
    fn draw(&self, picture: usize, [min, max]: [[i32; 2]; 2]) -> Result<Pixmap, PointsError> {
        let size = [0, 1].map(|i| i64::from(max[i]) - i64::from(min[i]) + 1);
        let too_large = || PointsError::TooLarge {
            action: ACTION,
            reason: format!("the picture would have {} x {} pixels", size[0], size[1]),
        };
        let edges = size.map(|n| u32::try_from(n).unwrap_or(u32::MAX));
        if u64::from(edges[0]).saturating_mul(u64::from(edges[1])) > MAX_PIXELS {
            return Err(too_large());
        }
        let white = vec![255; 4 * edges[0] as usize * edges[1] as usize];
        let size = IntSize::from_wh(edges[0], edges[1]);
        let mut pixmap = size.and_then(|size| Pixmap::from_vec(white, size)).ok_or_else(too_large)?;
        if let Some(columns) = self.pictures.get(picture) {
            let width = edges[0] as usize;
            columns.draw(self.options.saturation_factor, pixmap.data_mut(), |[y, z]| {
                (max[1] - z) as usize * width + (max[0] - y) as usize
            });
        }
        let mut canvas = pixmap.as_mut();
        for (i, trajectory) in self.options.trajectories.iter().enumerate() {
            let floor = self.options.floors.get(picture);
            let on_floor = trajectory.iter().filter(|(time, _)| floor.is_none_or(|f| f.contains(*time)));
            let pixel = |(_, pose): &(Time, Rigid3)| {
                let place: Point3f = self.view_from_points * (to_f32(pose) * Point3f::origin());
                let [_, y, z] = voxel_of(&place, self.options.voxel_size)?;
                Some([max[0] as f32 - y as f32, max[1] as f32 - z as f32])
            };
            draw_trajectory(&mut canvas, i, &on_floor.filter_map(pixel).collect::<Vec<_>>());
        }
        Ok(pixmap)
    }
}

impl Columns {
    fn add(&mut self, voxel: [i32; 3], colour: Rgb) {
        let column = match self.columns.entry([voxel[1], voxel[2]]) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => new.insert(Column::default()),
        };
        column.sum = [0, 1, 2].map(|i| column.sum[i] + colour[i]);
        column.points += 1;
        column.voxels += u32::from(self.voxels.insert(voxel));
    }

    /// Colours pixels of four bytes; `place` gives the pixel of a column.
    fn draw(&self, saturation_factor: f32, pixels: &mut [u8], place: impl Fn([i32; 2]) -> usize) {
        let strength = |c: &Column| f64::from(c.voxels).ln() as f32;
        // The order of the columns changes neither the maximum nor any pixel.
        let most = self.columns.values().map(strength).fold(f32::MIN_POSITIVE, f32::max);
        for (at, column) in &self.columns {
            let saturation = (strength(column) / most * saturation_factor).min(1.0);
            let mean = column.sum.map(|v| v / column.points as f32);
            let colour = to_bytes(mix([1.0; 3], mean, saturation));
            let start = 4 * place(*at);
            if let Some(pixel) = pixels.get_mut(start..start + 3) {
                pixel.copy_from_slice(&colour);
            }
        }
    }
}

impl Stage for WriteXray {
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError> {
        if self.options.floors.is_empty() {
            self.add(batch, 0)?;
            return Ok(true);
        }
        for floor in 0..self.options.floors.len() {
            if self.options.floors[floor].contains(batch.start_time) {
                self.add(batch, floor)?;
            }
        }
        Ok(true)
    }

    fn end_pass(&mut self, _flush: Flush, log: Log) -> Result<(), PointsError> {
        let Some(bounds) = self.bounds else {
            log(&format!("Not writing '{}': there were no points.", self.file(0).display()));
            return Ok(());
        };
        for picture in 0..self.pictures.len() {
            let path = self.file(picture);
            let pixmap = self.draw(picture, bounds)?;
            let rgb: Vec<u8> = pixmap.data().chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
            write_rgb(&path, [pixmap.width() as usize, pixmap.height() as usize], &rgb)?;
            log(&format!("Wrote '{}'.", path.display()));
        }
        Ok(())
    }
}
