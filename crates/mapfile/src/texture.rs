//! Renders single submaps: the textures of `formats.md §4.7`.

use nalgebra::Translation3;
use portolan_geometry::{Quaternion, Rigid3};

use portolan_pbstream::codes::{self, CodeRange};
use portolan_pbstream::gzip;
use portolan_pbstream::proto::mapping::grid2_d::Grid;
use portolan_pbstream::proto::mapping::submap_query::response::SubmapTexture as TextureMessage;
use portolan_pbstream::proto::mapping::{Grid2D, Submap2D};
use portolan_pbstream::{pose_from_proto, pose_to_proto};

/// Maximum number of pixels of a texture; larger ones count as damage: 2 GB in a message, 40 km² at 5 cm.
pub const MAX_TEXTURE_PIXELS: usize = 1 << 28;

/// Image of a submap seen from above.
#[derive(Clone, Debug, PartialEq)]
pub struct SubmapTexture {
    /// `(value, alpha)` row by row; `(0, 0)` is unknown. Free space has a value, occupied space an alpha.
    pub pixels: Vec<[u8; 2]>,
    /// Number of columns; the column grows along −y of the slice.
    pub width: usize,
    /// Number of rows; the row grows along −x of the slice.
    pub height: usize,
    /// Edge of a pixel in metres.
    pub resolution: f64,
    /// Pose in the submap frame of the corner of the first pixel.
    pub submap_from_slice: Rigid3,
}

/// Why a submap has no texture.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TextureError {
    /// The submap is in the pose graph but not in the file.
    #[error("the submap is missing in the file")]
    Missing,
    /// The message has no grid, or in 3D not both.
    #[error("the submap has no grid")]
    NoGrid,
    /// The grid is neither a probability grid nor a TSDF.
    #[error("proto::Submap2D has grid with unknown type.")]
    UnknownGridType,
    /// The arrays do not have the stated lengths.
    #[error("the grid says it has {stated} cells but has {found}")]
    CellCount {
        /// Cells according to the limits of the grid.
        stated: i64,
        /// Cells in the array.
        found: usize,
    },
    /// A resolution, bound or truncation distance is not a positive finite number.
    #[error("the grid's {0} is not a positive finite number")]
    Bounds(&'static str),
    /// The box of known cells is not within the grid.
    #[error("the box of known cells is not inside the grid")]
    KnownCellsBox,
    /// A code that is not a 16-bit number, 0 to 65535. Codes are 0 to 32767; the highest bit is an update
    /// marker, which is ignored.
    #[error("the grid has the cell value {0}, which is outside of 0 to 65535")]
    CellValue(i32),
    /// A pose is missing or not valid.
    #[error("the {0} pose of the submap is missing or not valid")]
    Pose(&'static str),
    /// The cells extend over too large an area.
    #[error("the submap would need {0} pixels, which cannot be right")]
    TooLarge(u64),
}

impl SubmapTexture {
    /// The texture as a message, with compressed pixels.
    ///
    /// # Errors
    /// If the pixels cannot be compressed.
    pub fn to_proto(&self) -> std::io::Result<TextureMessage> {
        Ok(TextureMessage {
            cells: gzip(self.pixels.as_flattened())?,
            width: i32::try_from(self.width).unwrap_or(i32::MAX),
            height: i32::try_from(self.height).unwrap_or(i32::MAX),
            resolution: self.resolution,
            slice_pose: Some(pose_to_proto(&self.submap_from_slice)),
        })
    }
}

/// The texture of a 2D submap, cropped to its known cells.
///
/// # Errors
/// If the submap has no grid, no valid pose, or a grid that is damaged or of an unknown type.
pub fn texture_2d(submap: &Submap2D) -> Result<SubmapTexture, TextureError> {
    let grid = submap.grid.as_ref().ok_or(TextureError::NoGrid)?;
    let local_from_submap = pose_from_proto(submap.local_pose.as_ref()).ok_or(TextureError::Pose("local"))?;
    let view = GridView::new(grid)?;
    let limits = grid.limits.unwrap_or_default();
    let resolution = limits.resolution;
    let corner = limits.max.unwrap_or_default();
    let local_from_slice = Rigid3::from_parts(
        Translation3::new(
            corner.x - resolution * view.offset.1 as f64,
            corner.y - resolution * view.offset.0 as f64,
            0.0,
        ),
        Quaternion::identity(),
    );
    let pixels = match &grid.grid {
        Some(Grid::ProbabilityGrid2d(_)) => {
            let (low, high) =
                codes::correspondence_cost_bounds(grid.min_correspondence_cost, grid.max_correspondence_cost);
            let table = codes::probability_grid_pixels(low, high);
            view.map(|index| lookup(&table, *grid.cells.get(index)?))?
        }
        Some(Grid::Tsdf2d(tsdf)) => {
            let table = TsdfPixels::new(tsdf.truncation_distance, tsdf.max_weight)?;
            if tsdf.weight_cells.len() != grid.cells.len() {
                let stated = grid.cells.len() as i64;
                return Err(TextureError::CellCount { stated, found: tsdf.weight_cells.len() });
            }
            view.map(|index| table.pixel(*grid.cells.get(index)?, *tsdf.weight_cells.get(index)?))?
        }
        None => return Err(TextureError::UnknownGridType),
    };
    Ok(SubmapTexture {
        pixels,
        width: view.width,
        height: view.height,
        resolution,
        submap_from_slice: local_from_submap.inverse() * local_from_slice,
    })
}

fn lookup(table: &[[u8; 2]], code: i32) -> Option<Result<[u8; 2], TextureError>> {
    let pixel = codes::without_marker(code).and_then(|c| table.get(c)).copied();
    Some(pixel.ok_or(TextureError::CellValue(code)))
}

/// The box of known cells of a grid.
struct GridView {
    stride: usize,
    /// First column and row.
    offset: (usize, usize),
    width: usize,
    height: usize,
}

impl GridView {
    fn new(grid: &Grid2D) -> Result<Self, TextureError> {
        let limits = grid.limits.unwrap_or_default();
        let corner = limits.max.unwrap_or_default();
        if !limits.resolution.is_finite() || limits.resolution <= 0.0 {
            return Err(TextureError::Bounds("resolution"));
        }
        if !corner.x.is_finite() || !corner.y.is_finite() {
            return Err(TextureError::Bounds("corner"));
        }
        let size = limits.cell_limits.unwrap_or_default();
        let (columns, rows) = (i64::from(size.num_x_cells), i64::from(size.num_y_cells));
        let stated = columns.saturating_mul(rows);
        if columns < 0 || rows < 0 || usize::try_from(stated) != Ok(grid.cells.len()) {
            return Err(TextureError::CellCount { stated, found: grid.cells.len() });
        }
        let stride = columns as usize;
        // An empty grid becomes one unknown pixel.
        let Some(known) = grid.known_cells_box.filter(|b| b.min_x <= b.max_x && b.min_y <= b.max_y) else {
            return Ok(Self { stride, offset: (0, 0), width: 1, height: 1 });
        };
        let inside = |low: i32, high: i32, n: i64| low >= 0 && i64::from(high) < n;
        if !inside(known.min_x, known.max_x, columns) || !inside(known.min_y, known.max_y, rows) {
            return Err(TextureError::KnownCellsBox);
        }
        Ok(Self {
            stride,
            offset: (known.min_x as usize, known.min_y as usize),
            width: (known.max_x - known.min_x) as usize + 1,
            height: (known.max_y - known.min_y) as usize + 1,
        })
    }

    /// Pixels of all cells, row by row; cells outside of the grid are unknown.
    fn map(
        &self,
        mut pixel: impl FnMut(usize) -> Option<Result<[u8; 2], TextureError>>,
    ) -> Result<Vec<[u8; 2]>, TextureError> {
        let mut pixels = Vec::with_capacity(self.width * self.height);
        for row in self.offset.1..self.offset.1 + self.height {
            let start = row * self.stride + self.offset.0;
            for index in start..start + self.width {
                pixels.push(pixel(index).unwrap_or(Ok([0, 0]))?);
            }
        }
        Ok(pixels)
    }
}

/// Pixels of a truncated signed distance field: darker nearer to a surface and at larger weights.
struct TsdfPixels {
    distances: CodeRange,
    truncation_distance: f32,
    weights: CodeRange,
    max_weight: f32,
}

impl TsdfPixels {
    fn new(truncation_distance: f32, max_weight: f32) -> Result<Self, TextureError> {
        let positive = |v: f32| v.is_finite() && v > 0.0;
        if !positive(truncation_distance) {
            return Err(TextureError::Bounds("truncation distance"));
        }
        if !positive(max_weight) {
            return Err(TextureError::Bounds("maximum weight"));
        }
        let distances = CodeRange::new(-truncation_distance, truncation_distance);
        Ok(Self { distances, truncation_distance, weights: CodeRange::new(0.0, max_weight), max_weight })
    }

    fn pixel(&self, distance: i32, weight: i32) -> Option<Result<[u8; 2], TextureError>> {
        let without_marker = |code| codes::without_marker(code).ok_or(TextureError::CellValue(code));
        let (distance, weight) = match (without_marker(distance), without_marker(weight)) {
            (Ok(0), Ok(_)) | (Ok(_), Ok(0)) => return None,
            (Ok(distance), Ok(weight)) => (distance as i32, weight as i32),
            (Err(error), _) | (_, Err(error)) => return Some(Err(error)),
        };
        let t = (self.distances.value(distance).abs() / self.truncation_distance).sqrt();
        let w = self.weights.value(weight) / self.max_weight;
        Some(Ok(codes::pixel((w * (255.0 * t - 128.0)).round() as i32)))
    }
}
