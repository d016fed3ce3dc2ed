//! A scan as it is found in the map, and the last ones on the way.

use std::collections::VecDeque;

use portolan_geometry::{Point3f, Rigid2, Time, Vector2, normalize_angle};
use portolan_matching::surface_tangents;
use portolan_sensor::{PointCloud, voxel_filter_indices, voxel_filter_points};

/// Points of a scan are thinned to voxels of this edge, metres, and to this number.
const VOXEL: f32 = 0.1;
const MOST_POINTS: usize = 180;
/// Scans are kept after this way, metres, or this turn, radians, so many of them.
const KEY_WAY: f64 = 0.4;
const KEY_TURN: f64 = 0.35;
const KEPT: usize = 12;
/// The cloud of all kept scans: reach, metres, voxels, metres, and points.
const REACH: f32 = 25.0;
const JOINT_VOXEL: f32 = 0.2;
const MOST_JOINT_POINTS: usize = 320;

/// A scan in its own level frame.
#[derive(Clone, Debug)]
pub(crate) struct Scan {
    /// Some of its points, metres.
    pub cloud: PointCloud,
    /// The same in the plane.
    pub points: Vec<Vector2>,
    /// Which way the surface runs at each of them, where that is known.
    pub tangents: Vec<Option<Vector2>>,
}

impl Scan {
    /// Of all returns in the order in which they were measured, in the level frame of the scanner.
    pub fn new(returns: &PointCloud) -> Self {
        let tangents = surface_tangents(returns);
        let kept = voxel_filter_indices(&returns.points, |p| *p, VOXEL);
        let stride = kept.len().div_ceil(MOST_POINTS).max(1);
        let kept: Vec<usize> = kept.into_iter().step_by(stride).map(|i| i as usize).collect();
        let flat = |i: &usize| Point3f::new(returns.points[*i].x, returns.points[*i].y, 0.0);
        let cloud = PointCloud::new(kept.iter().map(flat).collect());
        let points = cloud.points.iter().map(plane).collect();
        Self { cloud, points, tangents: kept.iter().map(|i| tangents[*i]).collect() }
    }
}

fn plane(p: &Point3f) -> Vector2 {
    Vector2::new(f64::from(p.x), f64::from(p.y))
}

/// A scan that is kept for judging places.
#[derive(Clone, Debug)]
pub(crate) struct KeyScan {
    pub time: Time,
    pub local_from_scan: Rigid2,
    pub scan: Scan,
}

/// The last scans on the way, oldest first.
#[derive(Clone, Debug, Default)]
pub(crate) struct RecentScans {
    scans: VecDeque<KeyScan>,
}

/// What became of a scan that was offered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Offered {
    /// It is like the last one.
    LeftOut,
    /// It is kept; whether the oldest one went for it.
    Kept { oldest_left: bool },
}

impl RecentScans {
    pub fn offer(&mut self, scan: KeyScan) -> Offered {
        if let Some(last) = self.scans.back() {
            let motion = last.local_from_scan.inverse() * scan.local_from_scan;
            let turn = normalize_angle(motion.angle).abs();
            if motion.translation.norm() < KEY_WAY && turn < KEY_TURN {
                return Offered::LeftOut;
            }
        }
        self.scans.push_back(scan);
        let oldest_left = self.scans.len() > KEPT;
        if oldest_left {
            self.scans.pop_front();
        }
        Offered::Kept { oldest_left }
    }

    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &KeyScan> + ExactSizeIterator {
        self.scans.iter()
    }

    pub fn clear(&mut self) {
        self.scans.clear();
    }

    /// Forgets scans before a time.
    pub fn forget_before(&mut self, time: Time) {
        self.scans.retain(|scan| scan.time >= time);
    }

    /// Way and turn from the first kept scan to the last, metres and radians, along the kept scans.
    pub fn motion(&self) -> (f64, f64) {
        let steps = self.scans.iter().zip(self.scans.iter().skip(1));
        steps.fold((0.0, 0.0), |(way, turn), (a, b)| {
            let step = a.local_from_scan.inverse() * b.local_from_scan;
            (way + step.translation.norm(), turn + normalize_angle(step.angle).abs())
        })
    }

    /// All kept scans as one cloud in the frame of the newest.
    pub fn joint(&self) -> PointCloud {
        let Some(newest) = self.scans.back() else { return PointCloud::default() };
        let mut points: Vec<Point3f> = Vec::new();
        for kept in self.scans.iter().rev() {
            let newest_from_scan = newest.local_from_scan.inverse() * kept.local_from_scan;
            let moved = kept.scan.points.iter().map(|p| newest_from_scan.transform_point(p).cast::<f32>());
            points.extend(moved.filter(|p| p.norm() < REACH).map(|p| Point3f::new(p.x, p.y, 0.0)));
        }
        let thinned = voxel_filter_points(&points, JOINT_VOXEL);
        let stride = thinned.len().div_ceil(MOST_JOINT_POINTS).max(1);
        PointCloud::new(thinned.into_iter().step_by(stride).collect())
    }
}
