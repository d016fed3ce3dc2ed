//! Chooses the angle by which the beams of a lidar are raised.

use super::{Chosen, SensorPlan};
use crate::beam_elevation::{BeamElevation, ElevationOffset};
use crate::options::IngestOptions;

/// Angle that is added to the elevations of the beams of a sensor, radians. With a configuration of
/// Cartographer, clouds are used unchanged.
pub(super) fn beam_elevation(
    chosen: &Chosen,
    is_cloud: bool,
    options: &IngestOptions,
    plan: &mut SensorPlan,
) -> f64 {
    match options.beam_elevation {
        _ if !is_cloud => 0.0,
        BeamElevation::Fixed(radians) => radians,
        BeamElevation::Auto if options.configured.is_some() => 0.0,
        BeamElevation::Auto => {
            let statistics = chosen.survey.range.as_ref().filter(|range| range.is_spinning());
            let offset = statistics.and_then(|range| range.skew?.elevation);
            let Some(offset) = offset.filter(ElevationOffset::is_clear) else { return 0.0 };
            plan.note(
                format!(
                    "the beams of {} are raised by {:.2}° (sigma {:.2}°): with this correction the ground is flat \
                     at every distance",
                    chosen.topic(),
                    offset.radians.to_degrees(),
                    offset.uncertainty().to_degrees()
                ),
                "--beam-elevation off",
            );
            offset.radians
        }
    }
}
