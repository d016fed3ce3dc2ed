//! Detects occlusion of the mapped surroundings: people close by, a cover, dust.
//!
//! Unexpected objects in front of a scanner make beams shorter, never longer (Thrun, Burgard, Fox:
//! Probabilistic Robotics, 6.3). A beam is occluded if it ends where the map is free, farther before
//! anything solid than the error of the prediction explains (the distance filter of Fox, Burgard, Thrun,
//! Cremers: Position Estimation for Mobile Robots in Dynamic Environments, 1998). A few such beams are a
//! change of the map, such as a chair. Where many beams are occluded, they are left out of matching and of
//! the map. Where most are occluded, and the map explains hardly any other, the scan does not constrain
//! its pose.

use portolan_grids::ScanAgreement;
use portolan_sensor::{PointCloud, UsualReach, log_reach};

/// Fraction of occluded beams from which on they are left out.
pub(super) const MANY_OCCLUDED: f64 = 0.25;
/// Limits for a fully occluded scan: minimum fraction of occluded beams, and maximum fraction of explained
/// ones (docs/experiments/2026-11-occlusion.md).
const MOST_OCCLUDED: f64 = 0.5;
const HARDLY_EXPLAINED: f32 = 0.3;
/// Fraction of explained beams from which on the map explains a scan: more than with a cover that touches
/// a wall.
const MOSTLY_EXPLAINED: f32 = 0.5;
/// Maximum ratio of beams that pass through walls to beams that end at one, in cluttered rooms at the
/// correct pose.
const THROUGH_FOR_EACH_EXPLAINED: f32 = 0.5;

/// How much of the mapped surroundings a scan sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum View {
    Clear,
    /// A part is occluded.
    Part,
    /// So much is occluded that the rest does not constrain the pose.
    Nothing,
}

/// Reach of scans that are not occluded, and of the last one that was.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Occlusion {
    /// Reach of scans that are not fully occluded.
    usual: UsualReach,
    /// Logarithm of the reach of the last scan, if it was fully occluded.
    last: Option<f64>,
}

impl Occlusion {
    /// How much of the mapped surroundings a scan with these returns sees at its predicted pose, from its
    /// agreement with the map there and its fraction of occluded beams. After a fully occluded scan the
    /// reach counts, too, since the surroundings of the scanner may now be unknown.
    pub fn view(&mut self, agreement: &ScanAgreement, occluded: f64, returns: &PointCloud) -> View {
        let sees_nothing = occluded >= MOST_OCCLUDED && agreement.explained <= HARDLY_EXPLAINED
            || agreement.explained < MOSTLY_EXPLAINED && self.is_like_last(returns);
        if sees_nothing {
            self.last = log_reach(returns.points.iter());
            return View::Nothing;
        }
        self.add_clear_view(returns);
        if occluded >= MANY_OCCLUDED { View::Part } else { View::Clear }
    }

    /// Learns the reach of a scan that is not fully occluded.
    pub fn add_clear_view(&mut self, returns: &PointCloud) {
        self.last = None;
        log_reach(returns.points.iter()).into_iter().for_each(|reach| self.usual.add(reach));
    }

    /// Whether the reach of a scan is closer to that of the last scan, which was fully occluded, than to
    /// the usual one.
    fn is_like_last(&self, returns: &PointCloud) -> bool {
        let reach = log_reach(returns.points.iter());
        let (Some(usual), Some(last), Some(reach)) = (self.usual.log_mean(), self.last, reach) else {
            return false;
        };
        (reach - last).abs() < (reach - usual).abs()
    }
}

/// Whether, for each beam that ends at a wall, more beams pass through walls than occlusion explains.
pub(super) fn sees_through(agreement: &ScanAgreement) -> bool {
    agreement.through_solid > THROUGH_FOR_EACH_EXPLAINED * agreement.explained
}

#[cfg(test)]
mod tests {
    use portolan_geometry::Point3f;

    use super::*;

    fn returns(range: f32) -> PointCloud {
        PointCloud::new(vec![Point3f::new(range, 0.0, 0.0), Point3f::new(0.0, -range, 0.0)])
    }

    fn agreement(explained: f32, through_solid: f32) -> ScanAgreement {
        ScanAgreement { explained, in_free_space: 1.0 - explained - through_solid, through_solid }
    }

    #[test]
    fn people_occlude_a_part_and_a_cover_everything() {
        let mut occlusion = Occlusion::default();
        assert_eq!(occlusion.view(&agreement(0.9, 0.0), 0.1, &returns(5.0)), View::Clear);
        assert_eq!(occlusion.view(&agreement(0.6, 0.0), 0.4, &returns(3.0)), View::Part);
        assert_eq!(occlusion.view(&agreement(0.1, 0.0), 0.9, &returns(0.2)), View::Nothing);
        assert_eq!(occlusion.view(&agreement(0.9, 0.0), 0.1, &returns(5.0)), View::Clear);
    }

    #[test]
    fn a_covered_scanner_remains_occluded_beyond_the_map() {
        let unknown = ScanAgreement::default();
        let mut occlusion = Occlusion::default();
        assert_eq!(occlusion.view(&unknown, 0.0, &returns(0.2)), View::Clear);
        for _ in 0..500 {
            occlusion.add_clear_view(&returns(5.0));
        }
        assert_eq!(occlusion.view(&unknown, 0.0, &returns(0.2)), View::Clear);
        assert_eq!(occlusion.view(&agreement(0.0, 0.0), 1.0, &returns(0.2)), View::Nothing);
        assert_eq!(occlusion.view(&unknown, 0.0, &returns(0.25)), View::Nothing);
        // A cover that touches a wall.
        assert_eq!(occlusion.view(&agreement(0.4, 0.0), 0.2, &returns(0.25)), View::Nothing);
        assert_eq!(occlusion.view(&unknown, 0.0, &returns(4.0)), View::Clear);
        assert_eq!(occlusion.view(&unknown, 0.0, &returns(0.25)), View::Clear);
    }

    #[test]
    fn beams_through_walls_show_a_wrong_place() {
        assert!(sees_through(&agreement(0.2, 0.3)) && sees_through(&agreement(0.0, 0.1)));
        assert!(!sees_through(&agreement(0.4, 0.1)) && !sees_through(&agreement(0.0, 0.0)));
    }
}
