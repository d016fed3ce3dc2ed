//! Converts submaps and their grids (`formats.md` §4.4, §4.5).

use portolan_geometry::Vector2;
use portolan_grids::{CellBox, CellIndex, Grid2d, GridError, GridParts, GridRepairs, MapLimits, TsdfParts};
use portolan_issue::{IssueKind, IssueLog};
use portolan_mapping::{Space, Space2d};
use portolan_submaps::Submap2d;
use prost::Message as _;

use super::MapConversionError;
use super::values::pose_in_file;
use super::work::FileWork;
use portolan_pbstream::correspondence_cost_bounds;
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::proto::mapping::grid2_d;
use portolan_pbstream::proto::transform::Vector2d;
use portolan_pbstream::{IdInFile, pose_to_proto};

/// A space whose submaps can be stored in files.
pub trait MapFileSpace: Space {
    /// The functions that read and write maps of this space.
    fn file_work() -> &'static FileWork<Self>;

    /// Adds the content of a submap to the message, which already has the id.
    fn submap_to_proto(submap: &Self::Submap, finished: bool, message: &mut m::Submap);

    /// The submap of a message, and whether its insertion is finished. Repairs are counted.
    ///
    /// # Errors
    /// If the message has no submap of this space, or if its pose or grid is not valid.
    fn submap_from_proto(
        message: m::Submap,
        id: IdInFile,
        issues: &mut IssueLog,
    ) -> Result<(Self::Submap, bool), MapConversionError>;
}

static FILE_WORK: FileWork<Space2d> = FileWork::compiled();

impl MapFileSpace for Space2d {
    fn file_work() -> &'static FileWork<Self> {
        &FILE_WORK
    }

    fn submap_to_proto(submap: &Submap2d, finished: bool, message: &mut m::Submap) {
        message.submap_2d = Some(m::Submap2D {
            local_pose: Some(pose_to_proto(&submap.local_from_submap)),
            num_range_data: i32::try_from(submap.num_range_data).unwrap_or(i32::MAX),
            finished,
            grid: Some(grid_to_proto(&submap.grid)),
        });
    }

    fn submap_from_proto(
        message: m::Submap,
        id: IdInFile,
        issues: &mut IssueLog,
    ) -> Result<(Submap2d, bool), MapConversionError> {
        if message.submap_3d.is_some() {
            return Err(MapConversionError::ThreeD);
        }
        let what = "submap";
        let submap = message.submap_2d.ok_or(MapConversionError::Content { what, id })?;
        let local_from_submap =
            pose_in_file(submap.local_pose.as_ref()).ok_or(MapConversionError::Pose { what, id })?;
        let grid = submap.grid.ok_or(MapConversionError::Content { what, id })?;
        let (grid, done) = grid_from_proto(grid, id)?;
        count_repairs(done, issues);
        let num_range_data = u32::try_from(submap.num_range_data).unwrap_or(0);
        let finished = submap.finished;
        Ok((Submap2d::from_parts(local_from_submap, num_range_data, finished, grid), finished))
    }
}

fn count_repairs(done: GridRepairs, issues: &mut IssueLog) {
    issues.count(IssueKind::UpdateMarker, done.markers_removed as u64);
    issues.count(IssueKind::KnownBoxRecomputed, u64::from(done.known_box_recomputed));
    issues.count(IssueKind::CostBoundsReplaced, u64::from(done.cost_bounds_replaced));
}

/// A grid as a serialised `Grid2D`, as in the files of Cartographer's `write_probability_grid`. `origin` is
/// the origin of the grid's frame in the map, metres.
pub fn encode_grid_2d(grid: &Grid2d, origin: &Vector2) -> Vec<u8> {
    let mut message = grid_to_proto(grid);
    if let Some(max) = message.limits.as_mut().and_then(|limits| limits.max.as_mut()) {
        (max.x, max.y) = (max.x + origin.x, max.y + origin.y);
    }
    message.encode_to_vec()
}

/// A grid as a message.
pub(super) fn grid_to_proto(grid: &Grid2d) -> m::Grid2D {
    let parts = grid.to_parts();
    let max = parts.limits.max();
    let number = |v: u32| i32::try_from(v).unwrap_or(i32::MAX);
    let codes = |cells: Vec<u16>| cells.into_iter().map(i32::from).collect();
    m::Grid2D {
        limits: Some(m::MapLimits {
            resolution: parts.limits.resolution(),
            max: Some(Vector2d { x: max.x, y: max.y }),
            cell_limits: Some(m::CellLimits {
                num_x_cells: number(parts.limits.num_x_cells()),
                num_y_cells: number(parts.limits.num_y_cells()),
            }),
        }),
        cells: codes(parts.cells),
        known_cells_box: parts.known_cells_box.map(|b| grid2_d::CellBox {
            max_x: b.max.x,
            max_y: b.max.y,
            min_x: b.min.x,
            min_y: b.min.y,
        }),
        min_correspondence_cost: parts.min_correspondence_cost,
        max_correspondence_cost: parts.max_correspondence_cost,
        grid: Some(match parts.tsdf {
            None => grid2_d::Grid::ProbabilityGrid2d(m::ProbabilityGrid {}),
            Some(tsdf) => grid2_d::Grid::Tsdf2d(m::Tsdf2d {
                truncation_distance: tsdf.truncation_distance,
                max_weight: tsdf.max_weight,
                weight_cells: codes(tsdf.weight_cells),
            }),
        }),
    }
}

/// A grid from its message, and the repairs made.
pub(super) fn grid_from_proto(
    grid: m::Grid2D,
    submap: IdInFile,
) -> Result<(Grid2d, GridRepairs), MapConversionError> {
    let wrong = |source: GridError| MapConversionError::Grid { submap, source };
    let (lower, upper) =
        correspondence_cost_bounds(grid.min_correspondence_cost, grid.max_correspondence_cost);
    let tsdf = match grid.grid.ok_or(MapConversionError::GridType(submap))? {
        grid2_d::Grid::ProbabilityGrid2d(_) => None,
        grid2_d::Grid::Tsdf2d(tsdf) => Some(TsdfParts {
            truncation_distance: tsdf.truncation_distance,
            max_weight: tsdf.max_weight,
            weight_cells: codes_from_proto(&tsdf.weight_cells, submap)?,
        }),
    };
    let parts = GridParts {
        limits: limits_from_proto(&grid.limits.unwrap_or_default()).map_err(wrong)?,
        cells: codes_from_proto(&grid.cells, submap)?,
        known_cells_box: grid.known_cells_box.map(|b| CellBox {
            min: CellIndex::new(b.min_x, b.min_y),
            max: CellIndex::new(b.max_x, b.max_y),
        }),
        min_correspondence_cost: lower,
        max_correspondence_cost: upper,
        tsdf,
    };
    Grid2d::from_parts(parts).map_err(wrong)
}

fn limits_from_proto(limits: &m::MapLimits) -> Result<MapLimits, GridError> {
    let max = limits.max.unwrap_or_default();
    let size = limits.cell_limits.unwrap_or_default();
    // Negative sizes become 0, which is rejected.
    let count = |v: i32| u32::try_from(v).unwrap_or(0);
    MapLimits::new(
        limits.resolution,
        Vector2::new(max.x, max.y),
        count(size.num_x_cells),
        count(size.num_y_cells),
    )
}

fn codes_from_proto(cells: &[i32], submap: IdInFile) -> Result<Vec<u16>, MapConversionError> {
    let code = |value: &i32| {
        u16::try_from(*value).map_err(|_| MapConversionError::CellValue { submap, value: *value })
    };
    cells.iter().map(code).collect()
}
