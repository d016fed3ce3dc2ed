//! Measures how much a refinement improved the cloud.

use portolan_evaluation::cloud::{
    CloudQuality, CloudToJudge, PairedComparison, QualityOptions, WallChange, WallChanges, cloud_quality,
};
use serde::Serialize;

use super::cloud_pair::{CloudPair, PairedPoint};

/// Number of points in which walls are searched.
const WALL_POINTS: usize = 3_000_000;
/// Edge of the cells of walls, metres.
const WALL_CELL: f64 = 0.5;
/// Maximum number of places that are shown.
const PLACES: usize = 4;
/// Minimum distance between them, metres.
const APART: f64 = 5.0;

/// Quality of both clouds.
#[derive(Serialize)]
pub struct Judgement {
    /// Quality of the input.
    pub before: CloudQuality,
    /// Quality of the result.
    pub after: CloudQuality,
    /// Changes, place by place.
    pub changes: Vec<PairedComparison>,
    /// Places where walls changed most.
    pub largest_changes: Vec<WallChange>,
}

impl Judgement {
    /// Evaluates samples of both clouds.
    pub(super) fn of(pair: &CloudPair) -> Self {
        let options = QualityOptions::default();
        let sample = pair.sample(options.sharpness.max_points);
        let seconds: Vec<f64> = sample.iter().map(|p| p.seconds).collect();
        let column = |place: fn(&PairedPoint) -> [f64; 3]| sample.iter().map(place).collect::<Vec<_>>();
        let (before, after) = (column(|p| p.before), column(|p| p.after));
        // Neighbours of both are counted at the places of the second, so that the same points are compared.
        let quality =
            |points| cloud_quality(&CloudToJudge { points, seconds: &seconds, places: &after }, &options);
        let (quality_before, quality_after) = (quality(&before), quality(&after));
        let mut walls = WallChanges::new(WALL_CELL);
        pair.each(WALL_POINTS).for_each(|p| walls.add(p.before, p.after));
        Self {
            changes: quality_before.compared_with(&quality_after),
            before: quality_before,
            after: quality_after,
            largest_changes: walls.largest(PLACES, APART),
        }
    }
}
