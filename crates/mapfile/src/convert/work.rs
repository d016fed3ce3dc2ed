//! Functions that read and write maps, compiled in this crate once for each space.

use std::collections::BTreeMap;
use std::path::Path;

use portolan_config::Options;
use portolan_mapping::{EndedTrajectory, PoseGraph, TrajectoryId};
use portolan_pbstream::{Finding, MapReader};

use super::grid::MapFileSpace;
use super::read::{FrozenTrajectories, LoadedTrajectories, load_map_here};
use super::write::{WriteReport, check_graph_here, write_graph_here};
use crate::MapConversionError;

/// The functions behind [`load_map`](crate::load_map), [`write_graph`](crate::write_graph) and
/// [`check_graph`](crate::check_graph). Every crate and program that calls a generic function compiles it
/// again; [`MapFileSpace::file_work`] returns the instances compiled in this crate.
#[allow(clippy::type_complexity)]
pub struct FileWork<S: MapFileSpace> {
    pub(super) load: fn(
        &mut MapReader,
        &mut PoseGraph<S>,
        &FrozenTrajectories,
    ) -> Result<LoadedTrajectories, MapConversionError>,
    pub(super) write: fn(
        &PoseGraph<S>,
        &BTreeMap<TrajectoryId, EndedTrajectory>,
        &Options,
        &Path,
        bool,
    ) -> Result<WriteReport, MapConversionError>,
    pub(super) check: fn(&PoseGraph<S>) -> Result<Vec<Finding>, MapConversionError>,
}

impl<S: MapFileSpace> FileWork<S> {
    /// To be used for a static item of the space.
    pub(super) const fn compiled() -> Self {
        Self { load: load_map_here, write: write_graph_here, check: check_graph_here }
    }
}
