//! Finds the degenerate direction of a scan: along a corridor, or along a single wall.
//!
//! Point-to-line constraints along the normals of the surfaces have the information matrix Σ n nᵀ (Censi
//! 2007, "On achievable accuracy for range-finder localization"). Its weakest direction is that of the
//! corridor. Along it a match is weighed with the prediction, as in a Kalman filter, by the evidence of
//! the surfaces that face this direction.

use portolan_geometry::{Rigid2, Vector2};
use portolan_grids::{Grid2d, score_difference};
use portolan_matching::surface_tangents;
use portolan_sensor::PointCloud;

use super::scan::Scan;

/// Fraction of all information below which the weakest direction is degenerate and the prediction is
/// weighed there; dimensionless.
const WEAK: f64 = 0.2;
/// Minimum number of normals for a decision.
const MIN_NORMALS: f64 = 5.0;

/// Component of its normal along the degenerate direction above which a return faces it.
const FACING: f32 = 0.35;
/// Number of other returns kept for each return that faces the degenerate direction, and minimum number of
/// others.
const OTHERS: usize = 2;
const MIN_OTHERS: usize = 40;

/// A direction along which a scan constrains its position only weakly.
pub(super) struct WeakDirection {
    /// Unit vector in the frame of the scan.
    in_scan: Vector2,
    /// For each return the component of its normal along that direction, 0 to 1; 1 for lone returns.
    facing: Vec<f32>,
}

impl WeakDirection {
    /// The direction along which the surfaces of a scan constrain least, if it is degenerate.
    pub fn of(returns: &PointCloud) -> Option<Self> {
        let tangents = surface_tangents(returns);
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for tangent in tangents.iter().flatten() {
            // The normal is (−y, x).
            xx += tangent.y * tangent.y;
            xy -= tangent.x * tangent.y;
            yy += tangent.x * tangent.x;
        }
        let sum = xx + yy;
        let weakest = 0.5 * sum - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        if sum < MIN_NORMALS || weakest > WEAK * sum {
            return None;
        }
        // The strongest direction is the long axis of the ellipse; the weakest is perpendicular to it.
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy) + std::f64::consts::FRAC_PI_2;
        let in_scan = Vector2::new(angle.cos(), angle.sin());
        let facing = |tangent: &Option<Vector2>| tangent.map_or(1.0, |t| t.perp(&in_scan).abs() as f32);
        Some(Self { facing: tangents.iter().map(facing).collect(), in_scan })
    }

    /// Whether a scan rules out poses at this distance from its match along this direction, metres.
    pub fn is_constrained(&self, scan: &Scan, found: &Rigid2, metres: f64) -> bool {
        scan.distinguishes(found, Rigid2 { translation: self.in_scan * metres, angle: 0.0 }, &self.facing)
    }

    /// Unit vector in the frame of the scan.
    pub fn in_scan(&self) -> Vector2 {
        self.in_scan
    }

    /// Fraction of the motion from `predicted` to `found` along this direction to accept: σ² / (σ² + σₘ²),
    /// where σ is the standard deviation of the prediction, metres, and σₘ that of the match, from how
    /// significantly the scan fits better.
    pub fn gain(
        &self,
        grid: &Grid2d,
        returns: &PointCloud,
        (predicted, found): (&Rigid2, &Rigid2),
        sigma: f64,
    ) -> f64 {
        let offset = self.offset(predicted, found);
        let there = self.with_share(predicted, found, 0.0);
        let Some(significance) = score_difference(grid, [found, &there], returns, &self.facing) else {
            return 1.0;
        };
        let weighed = sigma * significance.max(0.0);
        if offset == 0.0 { 1.0 } else { weighed * weighed / (weighed * weighed + offset * offset) }
    }

    /// `found` with this fraction of its offset from `predicted` along this direction.
    pub fn with_share(&self, predicted: &Rigid2, found: &Rigid2, share: f64) -> Rigid2 {
        let along = self.in_grid(found) * (self.offset(predicted, found) * (1.0 - share));
        Rigid2 { translation: found.translation - along, angle: found.angle }
    }

    /// The scan with fewer of the returns that do not constrain this direction, so that those that do
    /// decide there (normal-space sampling, Rusinkiewicz and Levoy 2001, "Efficient variants of the ICP
    /// algorithm").
    pub fn balanced(&self, returns: &PointCloud) -> PointCloud {
        let facing = self.facing.iter().filter(|f| **f > FACING).count();
        let others = returns.points.len() - facing;
        let wanted = (OTHERS * facing).max(MIN_OTHERS).min(others);
        let mut due = 0;
        let keep = |f: &f32| {
            if *f > FACING {
                return true;
            }
            due += wanted;
            let is_due = due >= others;
            due -= if is_due { others } else { 0 };
            is_due
        };
        let kept: Vec<bool> = self.facing.iter().map(keep).collect();
        PointCloud::new(returns.points.iter().zip(kept).filter(|(_, keep)| *keep).map(|(p, _)| *p).collect())
    }

    fn offset(&self, predicted: &Rigid2, found: &Rigid2) -> f64 {
        (found.translation - predicted.translation).dot(&self.in_grid(found))
    }

    fn in_grid(&self, found: &Rigid2) -> Vector2 {
        Rigid2 { translation: Vector2::zeros(), angle: found.angle }.transform_point(&self.in_scan)
    }
}
