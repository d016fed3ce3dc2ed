//! Loads maps that a recording is added to.

use std::path::PathBuf;

use portolan_config::Options;
use portolan_geometry::Rigid3;
use portolan_input::regular_file;
use portolan_mapfile::{FrozenTrajectories, MapFileSpace, load_map};
use portolan_pbstream::MapReader;

use super::error::JobError;
use super::event::{Observer, Remark, remark};
use crate::pipeline::KnownMap;

/// Existing maps that a recording is added to.
#[derive(Clone, Debug, Default)]
pub struct KnownMaps {
    /// Their files (`.pbstream`).
    pub files: Vec<PathBuf>,
    /// Which of their trajectories are frozen: with all of them frozen, the recording is only localised in
    /// them and extends them. Single trajectories can be named for one map only.
    pub frozen: FrozenTrajectories,
    /// Pose in them at which the recording starts (`map_from_tracking`); without it, the pose is searched.
    pub start: Option<Rigid3>,
}

impl KnownMaps {
    /// Number of submaps of all maps together.
    ///
    /// # Errors
    /// A map that cannot be read.
    pub fn count_submaps(&self) -> Result<usize, JobError> {
        let mut submaps = 0;
        for path in &self.files {
            let failed = |reason| JobError::KnownMap { path: path.clone(), reason };
            regular_file(path).map_err(|source| JobError::file(path, source))?;
            let reader = MapReader::open(path).map_err(|e| failed(e.into()))?;
            submaps += reader.pose_graph().trajectory.iter().map(|t| t.submap.len()).sum::<usize>();
        }
        Ok(submaps)
    }

    /// Loads them, in a near frame; remarks report their content and repairs.
    ///
    /// # Errors
    /// A map that is damaged or of the other dimension; single trajectories to be frozen of several maps.
    pub fn load<S: MapFileSpace>(
        &self,
        options: &Options,
        observe: &mut Observer,
    ) -> Result<KnownMap<S>, JobError> {
        if matches!(self.frozen, FrozenTrajectories::Only(_)) && self.files.len() > 1 {
            return Err(JobError::AmbiguousFrozen);
        }
        let mut known = KnownMap { start: self.start, ..KnownMap::empty(options) };
        for path in &self.files {
            let failed = |reason| JobError::KnownMap { path: path.clone(), reason };
            let mut reader = MapReader::open(path).map_err(|e| failed(e.into()))?;
            let loaded = load_map(&mut reader, &mut known.graph, &self.frozen).map_err(failed)?;
            for issue in loaded.issues.iter() {
                known.issues.add(issue.clone().of(path.display().to_string()));
                remark(observe, Remark::KnownMapIssue { path: path.clone(), issue });
            }
            let trajectories = loaded.trajectory_ids.iter().map(|(old, new)| (*old, *new)).collect();
            remark(observe, Remark::KnownMapLoaded { path: path.clone(), trajectories });
            known.trajectories.extend(loaded.trajectories);
        }
        known.bring_near();
        Ok(known)
    }
}
