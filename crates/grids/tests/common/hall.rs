//! A hall with pillars and two spinning lidars walking through it.

use portolan_geometry::{Point3f, Rigid3, Vector3, rotation_from_roll_pitch_yaw, to_f32};
use portolan_grids::{HybridGrid, HybridInserter, HybridInserterOptions};
use portolan_sensor::{PointCloud, RangeData, adaptive_voxel_filter, voxel_filter};

use super::common::Lcg;

/// Opposite corners of boxes, metres; the first one is seen from inside, the others from outside.
const BOXES: [[[f64; 3]; 2]; 12] = [
    [[-16.0, -11.0, 0.0], [14.0, 9.0, 5.0]],
    [[-10.0, -6.0, 0.0], [-9.2, -5.2, 5.0]],
    [[-2.0, -6.5, 0.0], [-1.2, -5.7, 5.0]],
    [[6.0, -6.0, 0.0], [6.8, -5.2, 5.0]],
    [[-10.0, 4.0, 0.0], [-9.2, 4.8, 5.0]],
    [[-2.5, 3.5, 0.0], [-1.7, 4.3, 5.0]],
    [[6.0, 4.0, 0.0], [6.8, 4.8, 5.0]],
    [[1.0, -1.0, 0.0], [4.0, 0.5, 1.1]],
    [[-14.0, -2.0, 0.0], [-13.0, 3.0, 2.2]],
    [[9.0, 2.0, 0.0], [9.3, 9.0, 3.0]],
    [[-6.0, -11.0, 0.0], [-5.0, -8.0, 2.5]],
    [[-16.0, 8.0, 3.5], [14.0, 9.0, 4.0]],
];

/// How far a ray goes in direction `d` before it meets something, metres.
fn cast(o: &Vector3, d: &Vector3) -> f64 {
    let crossing = |[low, high]: &[[f64; 3]; 2]| {
        (0..3).fold((f64::NEG_INFINITY, f64::INFINITY), |(enter, leave), a| {
            let (t0, t1) = ((low[a] - o[a]) / d[a], (high[a] - o[a]) / d[a]);
            (enter.max(t0.min(t1)), leave.min(t0.max(t1)))
        })
    };
    let walls = crossing(&BOXES[0]).1;
    BOXES[1..].iter().map(crossing).fold(walls, |nearest, (enter, leave)| {
        if 0.0 < enter && enter < leave { nearest.min(enter) } else { nearest }
    })
}

/// What a level and a tilted lidar of 16 beams see from the tracking frame at `map_from_tracking`, in that
/// frame, with noise of 1 cm.
pub fn sweep(map_from_tracking: &Rigid3, azimuths: usize, lcg: &mut Lcg) -> PointCloud {
    let mut points = Vec::with_capacity(32 * azimuths);
    for (translation, pitch) in [([0.0, 0.0, 0.2], -0.17), ([0.2, 0.0, 0.0], 1.4)] {
        let tracking_from_lidar =
            Rigid3::from_parts(translation.into(), rotation_from_roll_pitch_yaw(0.0, pitch, 0.0));
        let map_from_lidar = map_from_tracking * tracking_from_lidar;
        for azimuth in 0..azimuths {
            let angle = std::f64::consts::TAU * azimuth as f64 / azimuths as f64;
            for beam in 0..16 {
                let elevation = f64::from(2 * beam - 15).to_radians();
                let (s, c) = (elevation.sin(), elevation.cos());
                let ray = Vector3::new(c * angle.cos(), c * angle.sin(), s);
                let range = cast(&map_from_lidar.translation.vector, &(map_from_lidar.rotation * ray));
                let range = range + f64::from(lcg.symmetric(0.02));
                let point = tracking_from_lidar * nalgebra::Point3::from(ray * range);
                points.push(point.cast::<f32>());
            }
        }
    }
    PointCloud::new(points)
}

/// A walk around the pillars with swaying; `t` in seconds at 1 m/s.
pub fn walk(t: f64) -> Rigid3 {
    let a = t / 8.0;
    let (x, y) = (-1.0 + 6.0 * a.cos(), -1.0 + 4.0 * a.sin());
    let sway = (0.06 * (3.0 * t).sin(), 0.05 * (2.3 * t).cos());
    Rigid3::from_parts(
        [x, y, 1.5 + 0.03 * (6.0 * t).sin()].into(),
        rotation_from_roll_pitch_yaw(sway.0, sway.1, a + std::f64::consts::FRAC_PI_2),
    )
}

/// The grids of a submap whose frame is that of the map.
pub struct HallSubmap {
    pub high: HybridGrid,
    pub low: HybridGrid,
}

impl HallSubmap {
    pub fn new() -> Self {
        Self { high: HybridGrid::new(0.1).unwrap(), low: HybridGrid::new(0.45).unwrap() }
    }

    /// Draws a sweep as local SLAM does, after filtering with voxels of 15 cm.
    pub fn insert(&mut self, map_from_tracking: &Rigid3, sweep: &PointCloud) {
        let data = range_data(map_from_tracking, &voxel_filter(sweep, 0.15));
        self.insert_range_data(&data);
    }

    pub fn insert_range_data(&mut self, data: &RangeData) {
        let inserter = HybridInserter::new(&HybridInserterOptions::default()).unwrap();
        inserter.insert(data, 20.0, &mut self.high, None).unwrap();
        inserter.insert(data, f32::INFINITY, &mut self.low, None).unwrap();
    }

    /// Drawn while walking for some seconds, twice a second.
    pub fn of_walk(seconds: f64, azimuths: usize) -> Self {
        let (mut submap, mut lcg) = (Self::new(), Lcg::new(1));
        for i in 0..(2.0 * seconds) as usize {
            let pose = walk(i as f64 / 2.0);
            submap.insert(&pose, &sweep(&pose, azimuths, &mut lcg));
        }
        submap
    }
}

/// A cloud as range data in the map.
pub fn range_data(map_from_tracking: &Rigid3, cloud: &PointCloud) -> RangeData {
    let data = RangeData { origin: Point3f::origin(), returns: cloud.clone(), ..Default::default() };
    data.transformed(&to_f32(map_from_tracking))
}

/// The clouds that are matched with the fine and with the coarse grid.
pub fn matching_clouds(sweep: &PointCloud) -> [PointCloud; 2] {
    let filtered = voxel_filter(sweep, 0.15);
    [adaptive_voxel_filter(&filtered, 2.0, 150, 15.0), adaptive_voxel_filter(&filtered, 4.0, 200, 60.0)]
}
