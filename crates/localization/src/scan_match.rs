//! Matching a scan to the map, and what the match tells.

use nalgebra as na;
use portolan_geometry::{Rigid2, Vector2};
use portolan_matching::{
    GradientMatcher2d, GradientMatcherOptions2d, MatcherOptionError, ScanAgreement, scan_agreement,
};
use portolan_sensor::PointCloud;

use crate::belief::Matrix3;
use crate::likelihood::Window;
use crate::plane_map::PlanarMap;
use crate::scan::Scan;

/// Descent that leaves the place which the search found is not believed beyond this, metres and radians.
const FARTHEST_DESCENT: f64 = 0.25;
const WIDEST_DESCENT: f64 = 0.1;
/// Standard deviation of the distance of one point from its wall, metres; so large because neighbours on one wall err
/// together.
const POINT_SIGMA: f64 = 0.1;
/// Normals are off by some 10°: so much of the information of the strongest direction appears in the weakest
/// without anything being there, and is taken off.
const SPURIOUS: f64 = 0.04;
/// A point tells something if the field at its place is at least this: within some 15 cm of a wall.
const NEAR_WALL: f64 = 0.45;

/// A scan found in the map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScanMatch {
    pub pose: Rigid2,
    /// Information of (x, y, yaw) in the map; nothing along directions that the scan leaves open.
    pub information: Matrix3,
    pub agreement: ScanAgreement,
}

/// Matches scans to a map.
pub(crate) struct Matcher {
    gradient: GradientMatcher2d,
}

impl Matcher {
    pub fn new() -> Result<Self, MatcherOptionError> {
        let options = GradientMatcherOptions2d {
            occupied_space_weight: 1.0,
            translation_weight: 0.5,
            rotation_weight: 0.5,
            ..GradientMatcherOptions2d::default()
        };
        Ok(Self { gradient: GradientMatcher2d::new(&options)? })
    }

    /// Finds a scan in a window around a guess.
    pub fn find(&self, map: &PlanarMap, scan: &Scan, guess: &Rigid2, window: Window) -> ScanMatch {
        let pose = self.place(map, &scan.cloud, &scan.points, guess, window);
        ScanMatch { pose, information: information(map, scan, &pose), agreement: agreement(map, scan, &pose) }
    }

    /// The same of any cloud: the pose alone.
    pub fn place(
        &self,
        map: &PlanarMap,
        cloud: &PointCloud,
        points: &[Vector2],
        guess: &Rigid2,
        window: Window,
    ) -> Rigid2 {
        let searched = map.field.search(points, guess, window);
        let descended = self.gradient.match_scan(searched.translation, &searched, cloud, &map.grid).pose;
        let is_near = descended.is_finite()
            && (descended.translation - searched.translation).norm() < FARTHEST_DESCENT
            && (descended.angle - searched.angle).abs() < WIDEST_DESCENT;
        if is_near { descended } else { searched }
    }
}

/// What the map says to a scan at a pose.
pub(crate) fn agreement(map: &PlanarMap, scan: &Scan, pose: &Rigid2) -> ScanAgreement {
    scan_agreement(&map.grid, pose, &scan.cloud).unwrap_or_default()
}

/// Point-to-line constraints along the normals of what is seen (Censi 2007, "On achievable accuracy for range-finder
/// localization"), of the points that lie at walls.
fn information(map: &PlanarMap, scan: &Scan, pose: &Rigid2) -> Matrix3 {
    let rotation = pose.rotation_matrix();
    let mut sum = Matrix3::zeros();
    for (point, tangent) in scan.points.iter().zip(&scan.tangents) {
        let Some(tangent) = tangent else { continue };
        let lever = rotation * point;
        if map.field.at(&(lever + pose.translation)) < NEAR_WALL {
            continue;
        }
        let along = rotation * tangent;
        let normal = Vector2::new(-along.y, along.x);
        let row = na::Vector3::new(normal.x, normal.y, normal.y * lever.x - normal.x * lever.y);
        sum += row * row.transpose();
    }
    without_spurious(sum) / (POINT_SIGMA * POINT_SIGMA)
}

/// Takes off what errors of normals add in every direction.
fn without_spurious(information: Matrix3) -> Matrix3 {
    let scale = na::Vector3::new(1.0, 1.0, lever_scale(&information));
    let scaled = information.component_mul(&(scale * scale.transpose()).map(|v: f64| 1.0 / v));
    let eigen = scaled.symmetric_eigen();
    let most = eigen.eigenvalues.max();
    let kept = eigen.eigenvalues.map(|value| (value - SPURIOUS * most).max(0.0));
    let reduced = eigen.eigenvectors * Matrix3::from_diagonal(&kept) * eigen.eigenvectors.transpose();
    reduced.component_mul(&(scale * scale.transpose()))
}

/// How far, metres, the points lie that a turn moves, so that turns can be compared with shifts.
fn lever_scale(information: &Matrix3) -> f64 {
    let shifts = 0.5 * (information[(0, 0)] + information[(1, 1)]);
    if shifts > 0.0 { (information[(2, 2)] / shifts).sqrt().max(0.1) } else { 1.0 }
}
