//! Uses satellite fixes of a recording in a map that was made with fixes.

use portolan_ingest::{IngestError, IngestOptions, Ingestion, Inventory, SensorPlan, plan};
use portolan_localization::PositionFix;
use portolan_mapfile::Georeference;
use portolan_mapping::{Map, Space};
use portolan_sensor::Measurement;

use super::error::JobError;
use super::localize::{LocalizeRequest, Start};
use crate::pipeline::PipelineError;

/// Typical error of fixes from receivers that do not report an accuracy, metres.
const USUAL_SIGMA: f64 = 5.0;
/// Minimum error of a fix, metres: the antenna is beside the tracking frame, and a fix is taken for the
/// position of that frame.
const LEAST_SIGMA: f64 = 1.0;

/// Converts fixes to positions in the map.
pub(super) struct FixesInMap {
    georeference: Georeference,
}

impl FixesInMap {
    /// Chooses the topic of fixes, if there is one and the map is georeferenced. None otherwise, or if fixes
    /// are switched off or another start was given.
    ///
    /// # Errors
    /// If the user wants to start at a fix and that is not possible.
    pub fn of<S: Space>(
        request: &LocalizeRequest,
        map: &Map<S>,
        inventory: &Inventory,
        chosen: &mut SensorPlan,
    ) -> Result<Option<Self>, JobError> {
        let must_be = match &request.start {
            None if request.ingest.use_nav_sat == Some(false) => return Ok(None),
            None => false,
            Some(Start::Fixes) => true,
            Some(_) => return Ok(None),
        };
        let Some(georeference) = Georeference::of(map) else {
            return if must_be { Err(JobError::NotGeoreferenced(request.map.clone())) } else { Ok(None) };
        };
        let with_fixes = IngestOptions { use_nav_sat: Some(true), ..request.ingest.clone() };
        match plan(inventory, &with_fixes).map(|plan| plan.nav_sat) {
            Ok(Some(fixes)) => chosen.nav_sat = Some(fixes),
            Err(error) if must_be => return Err(PipelineError::from(IngestError::from(error)).into()),
            Ok(None) if must_be => return Err(JobError::NoFixes),
            Ok(None) | Err(_) => return Ok(None),
        }
        Ok(Some(Self { georeference }))
    }

    /// The fix of this measurement, if it has one.
    pub fn newest(&self, ingestion: &Ingestion, measurement: &Measurement) -> Option<PositionFix> {
        let Measurement::FixedFramePose(data) = measurement else { return None };
        let fix = ingestion.satellite_fix(data.time)?;
        let sigma = fix.horizontal_sigma.unwrap_or(USUAL_SIGMA);
        let of_map = self.georeference.sigma().unwrap_or(0.0);
        Some(PositionFix {
            time: fix.time,
            position: self.georeference.in_map(&fix.place),
            sigma_metres: sigma.hypot(of_map).max(LEAST_SIGMA),
        })
    }
}
