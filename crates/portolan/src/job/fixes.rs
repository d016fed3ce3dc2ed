//! Satellite fixes of a recording in a map that was made with fixes.

use portolan_ingest::{IngestError, IngestOptions, Ingestion, Inventory, SensorPlan, plan};
use portolan_localization::PositionFix;
use portolan_mapfile::Georeference;
use portolan_mapping::{Map, Space};
use portolan_sensor::Measurement;

use super::error::JobError;
use super::localize::{LocalizeRequest, Start};
use crate::pipeline::PipelineError;

/// Receivers that do not say how good a fix is have errors of about this, metres.
const USUAL_SIGMA: f64 = 5.0;
/// No fix is better than this, metres: the antenna lies beside the tracking frame, and a fix is taken for the place of that.
const LEAST_SIGMA: f64 = 1.0;

/// What turns fixes into places of the map.
pub(super) struct FixesInMap {
    georeference: Georeference,
}

impl FixesInMap {
    /// Chooses the topic of fixes, if there is one and the map is georeferenced; nothing if that, or another start, was told.
    ///
    /// # Errors
    /// If the recording was to start at a fix and that is not possible.
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

    /// The fix that was measured just now, if one was.
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
