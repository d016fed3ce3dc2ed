//! Converts 3D submaps and their grids (`formats.md` §4.6).

use portolan_grids::{HybridGrid, HybridGridParts, HybridGridRepairs};
use portolan_issue::{IssueKind, IssueLog};
use portolan_mapping::Space3d;
use portolan_submaps::Submap3d;
use prost::Message as _;

use super::planes::{planes_from_proto, planes_to_proto};
use super::values::pose_in_file;
use super::work::FileWork;
use super::{MapConversionError, MapFileSpace};
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::{IdInFile, pose_to_proto};

static FILE_WORK: FileWork<Space3d> = FileWork::compiled();

impl MapFileSpace for Space3d {
    fn file_work() -> &'static FileWork<Self> {
        &FILE_WORK
    }

    fn submap_to_proto(submap: &Submap3d, finished: bool, message: &mut m::Submap) {
        message.submap_3d = Some(m::Submap3D {
            local_pose: Some(pose_to_proto(&submap.local_from_submap)),
            num_range_data: i32::try_from(submap.num_range_data).unwrap_or(i32::MAX),
            finished,
            high_resolution_hybrid_grid: Some(hybrid_grid_to_proto(&submap.high_resolution_grid)),
            low_resolution_hybrid_grid: Some(hybrid_grid_to_proto(&submap.low_resolution_grid)),
            rotational_scan_matcher_histogram: submap.rotational_histogram.clone(),
            planes: submap.planes.as_ref().map(planes_to_proto),
        });
    }

    fn submap_from_proto(
        message: m::Submap,
        id: IdInFile,
        issues: &mut IssueLog,
    ) -> Result<(Submap3d, bool), MapConversionError> {
        if message.submap_2d.is_some() {
            return Err(MapConversionError::TwoD);
        }
        let what = "submap";
        let submap = message.submap_3d.ok_or(MapConversionError::Content { what, id })?;
        let local_from_submap =
            pose_in_file(submap.local_pose.as_ref()).ok_or(MapConversionError::Pose { what, id })?;
        let mut grid = |grid: Option<m::HybridGrid>| {
            let grid = grid.ok_or(MapConversionError::Content { what, id })?;
            hybrid_grid_from_proto(grid, id, issues)
        };
        let grids = [grid(submap.high_resolution_hybrid_grid)?, grid(submap.low_resolution_hybrid_grid)?];
        let histogram = submap.rotational_scan_matcher_histogram;
        if histogram.is_empty() {
            issues.count(IssueKind::WallDirectionsMissing, 1);
        }
        let num_range_data = u32::try_from(submap.num_range_data).unwrap_or(0);
        let finished = submap.finished;
        let planes = submap.planes.as_ref().and_then(|message| {
            let planes = planes_from_proto(message);
            issues.count(IssueKind::PlanesDamaged, planes.is_none().into());
            planes
        });
        let mut submap = Submap3d::from_parts(local_from_submap, num_range_data, finished, grids, histogram);
        submap.planes = planes;
        Ok((submap, finished))
    }
}

/// A grid as a serialised `HybridGrid`, as in the files of Cartographer's `write_hybrid_grid`.
pub fn encode_hybrid_grid(grid: &HybridGrid) -> Vec<u8> {
    hybrid_grid_to_proto(grid).encode_to_vec()
}

/// A hybrid grid as a message.
pub(super) fn hybrid_grid_to_proto(grid: &HybridGrid) -> m::HybridGrid {
    let HybridGridParts { resolution, x_indices, y_indices, z_indices, values } = grid.to_parts();
    m::HybridGrid { resolution, x_indices, y_indices, z_indices, values }
}

/// A hybrid grid from its message. Repairs are counted.
fn hybrid_grid_from_proto(
    grid: m::HybridGrid,
    submap: IdInFile,
    issues: &mut IssueLog,
) -> Result<HybridGrid, MapConversionError> {
    let m::HybridGrid { resolution, x_indices, y_indices, z_indices, values } = grid;
    let parts = HybridGridParts { resolution, x_indices, y_indices, z_indices, values };
    let (grid, done) =
        HybridGrid::from_parts(&parts).map_err(|source| MapConversionError::Grid { submap, source })?;
    let HybridGridRepairs { outside, invalid_values, markers_removed, repeated } = done;
    for (kind, count) in [
        (IssueKind::CellOutside, outside),
        (IssueKind::CellInvalid, invalid_values),
        (IssueKind::UpdateMarker, markers_removed),
        (IssueKind::CellRepeated, repeated),
    ] {
        issues.count(kind, count as u64);
    }
    Ok(grid)
}
