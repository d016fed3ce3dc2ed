//! What stands between the scanner and the place that the map knows: people close by, a cover, dust.
//!
//! Unexpected things in front of a scanner make beams shorter, never longer (Thrun, Burgard, Fox: Probabilistic Robotics, 6.3). A
//! beam that ends where the map knows that nothing is, farther before anything solid than its prediction can be off, hit such a
//! thing (the distance filter of Fox, Burgard, Thrun, Cremers: Position Estimation for Mobile Robots in Dynamic Environments,
//! 1998). One chair more is a change of the map. Where many beams end so, they are left out of matching and of the map; where
//! most do, and the map explains hardly any other, the scan says nothing of its pose.

use portolan_grids::ScanAgreement;
use portolan_sensor::{PointCloud, UsualReach, log_reach};

/// Beams are left out if so many of them are occluded …
pub(super) const MANY_OCCLUDED: f64 = 0.25;
/// … and a scan sees nothing of the place if so many are, and the map explains so few
/// (docs/experiments/2026-11-occlusion.md).
const MOST_OCCLUDED: f64 = 0.5;
const HARDLY_EXPLAINED: f32 = 0.3;
/// The map explains a scan if it explains so many of its beams: more than a cover does that touches a wall.
const MOSTLY_EXPLAINED: f32 = 0.5;
/// So many beams pass through walls for each that ends at one in cluttered rooms, where the scan was taken where it is expected.
const THROUGH_FOR_EACH_EXPLAINED: f32 = 0.5;

/// How much a scan sees of the place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum View {
    Clear,
    /// Part of it is hidden.
    Part,
    /// So much of it that what is left says nothing of the pose.
    Nothing,
}

/// How far scans see that see the place, and the last one that did not.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Occlusion {
    /// Of scans that see the place.
    usual: UsualReach,
    /// Logarithm of the reach of the last scan, if it saw nothing of it.
    last: Option<f64>,
}

impl Occlusion {
    /// What a scan with these returns sees where it is expected: how the map agrees with it there, and the share of its beams that
    /// are occluded. After one that saw nothing of the place, how far it sees counts, too: the map may not know where it is now.
    pub fn view(&mut self, agreement: &ScanAgreement, occluded: f64, returns: &PointCloud) -> View {
        let sees_nothing = occluded >= MOST_OCCLUDED && agreement.explained <= HARDLY_EXPLAINED
            || agreement.explained < MOSTLY_EXPLAINED && self.is_like_last(returns);
        if sees_nothing {
            self.last = log_reach(returns.points.iter());
            return View::Nothing;
        }
        self.sees_place(returns);
        if occluded >= MANY_OCCLUDED { View::Part } else { View::Clear }
    }

    /// Takes a scan that sees the place.
    pub fn sees_place(&mut self, returns: &PointCloud) {
        self.last = None;
        log_reach(returns.points.iter()).into_iter().for_each(|reach| self.usual.add(reach));
    }

    /// Whether a scan sees rather as far as the last one, which saw nothing of the place, than as far as those that do.
    fn is_like_last(&self, returns: &PointCloud) -> bool {
        let reach = log_reach(returns.points.iter());
        let (Some(usual), Some(last), Some(reach)) = (self.usual.log_mean(), self.last, reach) else {
            return false;
        };
        (reach - last).abs() < (reach - usual).abs()
    }
}

/// Whether so many beams pass through walls, for each that ends at one, that what is occluded does not explain it.
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
    fn people_hide_a_part_and_a_cover_everything() {
        let mut occlusion = Occlusion::default();
        assert_eq!(occlusion.view(&agreement(0.9, 0.0), 0.1, &returns(5.0)), View::Clear);
        assert_eq!(occlusion.view(&agreement(0.6, 0.0), 0.4, &returns(3.0)), View::Part);
        assert_eq!(occlusion.view(&agreement(0.1, 0.0), 0.9, &returns(0.2)), View::Nothing);
        assert_eq!(occlusion.view(&agreement(0.9, 0.0), 0.1, &returns(5.0)), View::Clear);
    }

    #[test]
    fn what_is_covered_stays_so_where_the_map_ends() {
        let unknown = ScanAgreement::default();
        let mut occlusion = Occlusion::default();
        assert_eq!(occlusion.view(&unknown, 0.0, &returns(0.2)), View::Clear);
        for _ in 0..500 {
            occlusion.sees_place(&returns(5.0));
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
    fn who_sees_through_walls_is_elsewhere() {
        assert!(sees_through(&agreement(0.2, 0.3)) && sees_through(&agreement(0.0, 0.1)));
        assert!(!sees_through(&agreement(0.4, 0.1)) && !sees_through(&agreement(0.0, 0.0)));
    }
}
