//! A scan to be matched, and the weight of its match against the prediction.

use portolan_geometry::Rigid2;
use portolan_grids::score_difference;
use portolan_sensor::PointCloud;
use portolan_submaps::Submap2d;

use super::independent_measurements::IndependentMeasurements;
use super::posterior::MotionPrior;

/// Minimum difference of the fits of two poses that distinguishes them, in standard errors.
const SIGNIFICANT: f64 = 2.0;

/// Input of a search: the scan and the submap.
#[derive(Clone, Copy)]
pub(super) struct Scan<'a> {
    /// The points to match, metres, gravity-aligned.
    pub cloud: &'a PointCloud,
    /// All returns; `cloud` is a selection of them.
    pub returns: &'a PointCloud,
    /// Submap to match against.
    pub submap: &'a Submap2d,
    /// Number of independent measurements among the returns.
    pub independent_measurements: IndependentMeasurements,
}

impl<'a> Scan<'a> {
    pub fn new(cloud: &'a PointCloud, returns: &'a PointCloud, submap: &'a Submap2d) -> Self {
        Self { cloud, returns, submap, independent_measurements: IndependentMeasurements::of(returns) }
    }

    /// Whether the scan constrains its pose against this offset: the map fits significantly worse at the
    /// offset to either side of the match, with weights for the returns. The offset is in the frame of the
    /// scan.
    pub fn distinguishes(&self, found: &Rigid2, offset: Rigid2, weights: &[f32]) -> bool {
        [offset, offset.inverse()].iter().all(|offset| {
            let poses = [found, &(*found * *offset)];
            score_difference(&self.submap.grid, poses, self.returns, weights).is_none_or(|s| s > SIGNIFICANT)
        })
    }

    /// Fraction of the motion from the prediction to the match to accept. Both measure the pose: the
    /// prediction with its standard deviations, the scan by how significantly the map fits better at the
    /// match.
    pub fn match_share(&self, prior: &MotionPrior, found: &Rigid2) -> f64 {
        let poses = [found, &prior.prediction];
        let weights = vec![1.0; self.returns.points.len()];
        let Some(significance) = score_difference(&self.submap.grid, poses, self.returns, &weights) else {
            return 1.0;
        };
        let (of_match, of_motion) = (significance.max(0.0).powi(2), prior.deviation(found).powi(2));
        if of_motion > 0.0 { of_match / (of_match + of_motion) } else { 1.0 }
    }
}

/// Interpolated pose, at this fraction of the motion from one pose to another.
pub(super) fn with_share(from: &Rigid2, to: &Rigid2, share: f64) -> Rigid2 {
    let offset = from.inverse() * *to;
    *from * Rigid2 { translation: offset.translation * share, angle: offset.normalized_angle() * share }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_interpolates_from_the_prediction_to_the_match() {
        let (predicted, found) = (Rigid2::new(1.0, 2.0, 3.0), Rigid2::new(1.5, 1.0, -3.0));
        for (share, pose) in [(0.0, predicted), (1.0, found)] {
            let off = with_share(&predicted, &found, share).inverse() * pose;
            assert!(off.translation.norm() < 1e-9 && off.normalized_angle().abs() < 1e-9);
        }
    }
}
