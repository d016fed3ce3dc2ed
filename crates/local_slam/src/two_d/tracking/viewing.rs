//! Determines how much of the mapped surroundings a scan sees at its predicted pose.

use portolan_geometry::{Point3f, Rigid2};
use portolan_grids::{ends_in_the_open, is_at_solid, scan_agreement};
use portolan_sensor::PointCloud;

use super::super::motion::{Motion, WIDEST};
use super::super::occlusion::{MANY_OCCLUDED, View, sees_through};
use super::super::pose_status::refutes_place;
use super::super::prediction_error::PredictionSigmas;
use super::super::scan::Scan;
use super::{Tracker, WITHIN_SIGMAS};

/// Minimum distance of an occluding object from a wall, metres: walls are rough, and ranges are noisy.
const BEFORE_WALLS: f64 = 0.3;

impl Tracker {
    /// How much of the mapped surroundings the scan sees at its predicted pose, and its returns without
    /// the occluding ones if it is occluded in part. To be called once for each scan.
    pub fn view(&mut self, extrapolated: Rigid2, motion: Motion, scan: &Scan) -> (View, Option<PointCloud>) {
        let prediction = self.predicted(extrapolated, &motion, None);
        let sigmas = self.prediction_error.sigmas(&motion.to(&prediction));
        let agreement = scan_agreement(&scan.submap.grid, &prediction, scan.cloud);
        // A constant-velocity prediction is too uncertain for what the scan should see.
        let is_there =
            |a: &_| motion.is_measured() && is_expected(&sigmas) && !(refutes_place(a) && sees_through(a));
        let Some(agreement) = agreement.filter(is_there) else {
            self.occlusion.add_clear_view(scan.returns);
            return (View::Clear, None);
        };
        let mut occluded = share_occluded(scan, &prediction, &sigmas);
        // The prediction may be off instead. A cover may fit walls, but no scanner is inside a wall.
        if occluded >= MANY_OCCLUDED {
            let found = self.search_ahead(prediction, motion, *scan);
            self.discard_cached_search();
            let found = found.filter(|pose| !is_at_solid(&scan.submap.grid, &pose.translation));
            occluded = found.map_or(occluded, |pose| occluded.min(share_occluded(scan, &pose, &sigmas)));
        }
        match self.occlusion.view(&agreement, occluded, scan.returns) {
            View::Part => {
                let is_clear = |point: &Point3f| !is_occluded(scan, &prediction, &sigmas, (point, 0.0));
                let clear = scan.returns.retained(is_clear);
                if clear.is_empty() { (View::Nothing, None) } else { (View::Part, Some(clear)) }
            }
            view => (view, None),
        }
    }
}

/// Whether the prediction is certain to within the maximum search window.
fn is_expected(sigmas: &PredictionSigmas) -> bool {
    WITHIN_SIGMAS * sigmas.translation <= WIDEST.linear && WITHIN_SIGMAS * sigmas.rotation <= WIDEST.angular
}

/// Whether the beam to a point ends in free space, at least this distance, metres, before anything solid,
/// and farther than the error there of a pose with these standard deviations.
fn is_occluded(
    scan: &Scan,
    pose: &Rigid2,
    sigmas: &PredictionSigmas,
    (point, metres): (&Point3f, f64),
) -> bool {
    let range = f64::from(point.x.hypot(point.y));
    let off = WITHIN_SIGMAS * sigmas.translation.hypot(sigmas.rotation * range);
    ends_in_the_open(&scan.submap.grid, pose, point, off.max(metres))
}

fn share_occluded(scan: &Scan, pose: &Rigid2, sigmas: &PredictionSigmas) -> f64 {
    let points = &scan.cloud.points;
    let occluded = points.iter().filter(|point| is_occluded(scan, pose, sigmas, (point, BEFORE_WALLS)));
    occluded.count() as f64 / points.len().max(1) as f64
}
