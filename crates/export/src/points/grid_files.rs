//! `write_probability_grid`, `write_hybrid_grid` and `write_ros_map` (`formats.md` §6.5, §6.6, §7).

use std::path::PathBuf;

use portolan_atomic_file::{AtomicFile, write_atomically};
use portolan_geometry::{NearFrame, Point3f, Rigid3, Time, Vector2};
use portolan_grids::{
    CellIndex, Grid2d, HybridGrid, HybridInserter, MapLimits, ProbabilityGrid, ProbabilityInserter,
};
use portolan_mapfile::{ImageName, PaintedMap, encode_grid_2d, encode_hybrid_grid, write_ros_map};
use portolan_sensor::{PointCloud, RangeData};
use tiny_skia::{IntSize, Pixmap};

use super::trajectories::draw_trajectory;
use super::{Flush, Log, PointsBatch, PointsError, Stage};
use crate::png_file::write_rgb;

/// Grey value of unknown cells.
const UNKNOWN: u8 = 128;

/// Output of a 2D grid.
pub(super) enum GridOutput2d {
    /// A picture with trajectories.
    Png { path: PathBuf, trajectories: Vec<Vec<(Time, Rigid3)>> },
    /// A serialised `Grid2D`.
    Proto { path: PathBuf },
    /// `.pgm` and `.yaml`.
    RosMap { stem: PathBuf },
}

/// Inserts points and rays into a 2D grid.
pub(super) struct WriteGrid2d {
    grid: ProbabilityGrid,
    /// Origin of the frame of the grid in the map, metres.
    origin: Vector2,
    inserter: ProbabilityInserter,
    output: GridOutput2d,
}

impl WriteGrid2d {
    pub fn new(
        resolution: f64,
        inserter: ProbabilityInserter,
        output: GridOutput2d,
        frame: &NearFrame,
    ) -> Result<Self, PointsError> {
        let limits = MapLimits::around(resolution, Vector2::zeros())?;
        let path = match &output {
            GridOutput2d::Png { path, .. } | GridOutput2d::Proto { path } => path,
            GridOutput2d::RosMap { stem } => stem,
        };
        // Checks before processing that files can be written.
        drop(AtomicFile::create(path)?);
        Ok(Self { grid: ProbabilityGrid::new(limits), origin: frame.origin().xy(), inserter, output })
    }

    /// The known part, in grey.
    fn image(&self) -> GridImage {
        let grid = &self.grid;
        let (offset, size) = grid.known_cells_box().map_or(([0, 0], [1, 1]), |known| {
            let size = [known.num_x_cells() as usize, known.num_y_cells() as usize];
            ([known.min.x, known.min.y], size)
        });
        let mut grey = Vec::with_capacity(size[0] * size[1]);
        for iy in 0..size[1] as i32 {
            for ix in 0..size[0] as i32 {
                let cell = CellIndex::new(offset[0] + ix, offset[1] + iy);
                grey.push(if grid.is_known(cell) { grey_of(grid.probability(cell)) } else { UNKNOWN });
            }
        }
        GridImage { offset, size, grey }
    }

    fn write_png(
        &self,
        path: &std::path::Path,
        trajectories: &[Vec<(Time, Rigid3)>],
    ) -> Result<(), PointsError> {
        let GridImage { offset, size, grey } = self.image();
        let rgba: Vec<u8> = grey.iter().flat_map(|g| [*g, *g, *g, 255]).collect();
        let [width, height] = size.map(|n| n as u32);
        let pixmap = IntSize::from_wh(width, height).and_then(|size| Pixmap::from_vec(rgba, size));
        let reason = || format!("the picture would have {width} x {height} pixels");
        let mut pixmap = pixmap
            .ok_or_else(|| PointsError::TooLarge { action: "write_probability_grid", reason: reason() })?;
        let mut canvas = pixmap.as_mut();
        for (i, trajectory) in trajectories.iter().enumerate() {
            let pixel = |(_, pose): &(Time, Rigid3)| {
                let place = pose.translation.vector.xy().map(|v| v as f32);
                let cell = self.grid.limits().cell_index(place);
                [(cell.x - offset[0]) as f32, (cell.y - offset[1]) as f32]
            };
            draw_trajectory(&mut canvas, i, &trajectory.iter().map(pixel).collect::<Vec<_>>());
        }
        let rgb: Vec<u8> = pixmap.data().chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        Ok(write_rgb(path, size, &rgb)?)
    }

    /// The image rotated clockwise by 90°, so that x points right and y up.
    fn ros_map(&self) -> PaintedMap {
        let GridImage { offset, size: [old_width, old_height], grey } = self.image();
        let (width, height) = (old_height, old_width);
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (old_height - 1 - x) * old_width + y));
        let limits = self.grid.limits();
        let (resolution, max) = (limits.resolution(), limits.max() + self.origin);
        let left = max.x - (f64::from(offset[1]) + width as f64) * resolution;
        let bottom = max.y - (f64::from(offset[0]) + height as f64) * resolution;
        PaintedMap {
            width,
            height,
            resolution,
            origin: [-left / resolution, bottom / resolution + height as f64],
            pixels: pixels.map(|i| [grey.get(i).copied().unwrap_or(UNKNOWN), 255]).collect(),
        }
    }
}

/// The known part of a grid: column along the first cell index, row along the second.
struct GridImage {
    offset: [i32; 2],
    size: [usize; 2],
    grey: Vec<u8>,
}

/// Grey value of a probability; free is white.
fn grey_of(probability: f32) -> u8 {
    (255.0 * ((1.0 - probability) - 0.1) / 0.8).round().clamp(0.0, 255.0) as u8
}

fn range_data(batch: &PointsBatch) -> RangeData {
    RangeData {
        origin: batch.origin,
        returns: PointCloud::new(batch.points.clone()),
        misses: PointCloud::default(),
    }
}

impl Stage for WriteGrid2d {
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError> {
        self.inserter.insert(&range_data(batch), &mut self.grid)?;
        Ok(true)
    }

    fn end_pass(&mut self, _flush: Flush, log: Log) -> Result<(), PointsError> {
        let path = match &self.output {
            GridOutput2d::Png { path, trajectories } => {
                self.write_png(path, trajectories)?;
                path
            }
            GridOutput2d::Proto { path } => {
                let grid = Grid2d::Probability(self.grid.clone());
                write_atomically(path, &encode_grid_2d(&grid, &self.origin))?;
                path
            }
            GridOutput2d::RosMap { stem } => {
                write_ros_map(stem, &self.ros_map(), ImageName::AsOpened)?;
                stem
            }
        };
        log(&format!("Wrote '{}'.", path.display()));
        Ok(())
    }
}

fn too_far() -> PointsError {
    let reason = "there are points farther than 8192 voxels from the origin".to_owned();
    PointsError::TooLarge { action: "write_hybrid_grid", reason }
}

/// `write_hybrid_grid`.
pub(super) struct WriteHybridGrid {
    grid: HybridGrid,
    inserter: HybridInserter,
    path: PathBuf,
}

impl WriteHybridGrid {
    pub fn new(
        voxel_size: f64,
        inserter: HybridInserter,
        path: PathBuf,
        frame: &NearFrame,
    ) -> Result<Self, PointsError> {
        if !frame.is_map() {
            return Err(too_far());
        }
        drop(AtomicFile::create(&path)?);
        Ok(Self { grid: HybridGrid::new(voxel_size as f32)?, inserter, path })
    }
}

impl Stage for WriteHybridGrid {
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError> {
        let outside = |p: &Point3f| self.grid.cell_index(p).is_none();
        if batch.points.iter().any(outside) {
            return Err(too_far());
        }
        self.inserter.insert(&range_data(batch), f32::INFINITY, &mut self.grid, None)?;
        Ok(true)
    }

    fn end_pass(&mut self, _flush: Flush, log: Log) -> Result<(), PointsError> {
        write_atomically(&self.path, &encode_hybrid_grid(&self.grid))?;
        log(&format!("Wrote '{}'.", self.path.display()));
        Ok(())
    }
}
