//! Saves the known map together with the recording that was localised in it.

use std::path::{Path, PathBuf};

use portolan_atomic_file::AtomicFile;
use portolan_config::Options;
use portolan_geometry::NearFrame;
use portolan_issue::IssueLog;
use portolan_localization::{Estimate, Grown, Growth, GrowthError, KnownMap, Localizer};
use portolan_mapfile::{Georeference, MapFileSpace, write_map};
use portolan_mapping::{EndedTrajectory, Map, Space, TrajectoryState};
use portolan_pbstream::MapReader;
use portolan_sensor::SensorId;

use super::error::JobError;
use crate::soundness::unsoundness;

/// The map to be saved after localising a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SaveMap {
    /// Its file; may be that of the known map.
    pub path: PathBuf,
    /// How the known map is changed.
    pub growth: Growth,
}

/// A known map, loaded.
pub(super) struct KnownFile<'a, S: Space> {
    /// Its file.
    pub path: &'a Path,
    /// The map, in the near frame.
    pub map: Map<S>,
    /// The near frame.
    pub frame: NearFrame,
}

/// Result of saving the map.
#[derive(Clone, Debug, PartialEq)]
pub enum SavedMap {
    /// It was written.
    Written {
        /// The file.
        path: PathBuf,
        /// What was added and what it replaced.
        grown: Grown,
    },
    /// Nothing can be added; no file was written.
    Refused(GrowthError),
    /// The resulting map is unsound; no file was written.
    Unsound(IssueLog),
    /// It was stopped before the end of the recording; no file was written.
    Interrupted,
}

impl SavedMap {
    /// As in `report.json`.
    pub(super) fn report(&self) -> serde_json::Value {
        match self {
            Self::Refused(reason) => serde_json::json!({ "refused": reason.to_string() }),
            Self::Unsound(issues) => serde_json::json!({ "refused": issues }),
            Self::Interrupted => serde_json::json!({ "refused": "interrupted" }),
            Self::Written { path, grown } => serde_json::json!({
                "file": path,
                "trusted_nodes": grown.trusted_nodes,
                "nodes": grown.nodes,
                "submaps": grown.extension.submaps,
                "ties": grown.extension.ties,
                "median_correction": grown.extension.median_correction,
                "renewal": grown.renewal.map(|renewal| serde_json::json!({
                    "added_submaps": renewal.added_submaps,
                    "removed_submaps": renewal.removed_submaps,
                    "appeared_m2": renewal.appeared,
                    "gone_m2": renewal.gone,
                    "discovered_m2": renewal.discovered,
                })),
            }),
        }
    }
}

impl SaveMap {
    /// Finds errors of the file before the work begins.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(super) fn check(&self) -> Result<(), JobError> {
        AtomicFile::create(&self.path).map(drop).map_err(|error| JobError::file(&self.path, error.source))
    }

    /// Extends a known map, and writes it. Estimates are in the near frame.
    pub(super) fn save<M: KnownMap<Space: MapFileSpace>>(
        &self,
        known: KnownFile<'_, M::Space>,
        localizer: &mut Localizer<M>,
        sensors: Vec<SensorId>,
        estimates: &[Estimate],
    ) -> Result<SavedMap, JobError> {
        let KnownFile { path, mut map, frame } = known;
        let georeference = Georeference::of(&map);
        let grown = match localizer.grow(&mut map.graph, estimates, self.growth) {
            Ok(grown) => grown,
            Err(reason) => return Ok(SavedMap::Refused(reason)),
        };
        map.graph.move_by(&frame.origin());
        let issues = unsoundness(&map.graph)?;
        if !issues.is_empty() {
            return Ok(SavedMap::Unsound(issues));
        }
        let options = map.options.trajectory_builder.clone();
        let added = EndedTrajectory {
            options,
            sensors: sensors.into_iter().collect(),
            scans: Default::default(),
            fixed_frame_on_earth: None,
        };
        map.trajectories.insert(grown.trajectory_id, added);
        if let Some(georeference) = georeference {
            georeference.moved_by(&frame.origin()).apply_to(&mut map, grown.trajectory_id);
        }
        let state = map.graph.state();
        map.trajectories.retain(|id, _| state.trajectory_state(*id) != TrajectoryState::Deleted);
        if let Some(options) = configuration(path) {
            map.options = options;
        }
        write_map(&map, &self.path, true)?;
        Ok(SavedMap::Written { path: self.path.clone(), grown })
    }
}

/// The configuration that a map was made with, if its file has one: it is kept, so that the map is optimised
/// as before.
fn configuration(known: &Path) -> Option<Options> {
    let reader = MapReader::open(known).ok()?;
    Some(reader.configuration())
        .filter(|text| !text.is_empty())
        .and_then(|text| Options::from_json(text).ok())
        .map(|loaded| loaded.options)
}

/// Whether two names are of one file.
pub fn is_same_file(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
