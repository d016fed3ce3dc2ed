//! Real scans with poses, from a log in CARMEN format and the poses another program found for it.

use std::collections::HashMap;
use std::io::Read;

use portolan_geometry::{Point3f, Rigid2, embed_3d, to_f32};
use portolan_grids::{Grid2d, MapLimits, ProbabilityGrid, ProbabilityInserter};
use portolan_sensor::{PointCloud, RangeData, adaptive_voxel_filter};
use portolan_testing::real_data;

/// A scan in the frame of the laser, and where the laser was.
pub struct PosedScan {
    pub time: f64,
    pub map_from_laser: Rigid2,
    pub points: PointCloud,
}

/// Beams longer than this saw nothing.
const MAX_RANGE: f32 = 30.0;

/// All scans of a log over 180° (`<name>/<name>.clf.bz2`) for which a reference pose is known.
pub fn posed_scans(name: &str) -> Option<Vec<PosedScan>> {
    let log = real_data(&format!("lidar2d/{name}/{name}.clf.bz2"))?;
    let poses = real_data(&format!("lidar2d/{name}/reference_poses.csv"))?;
    let poses = std::fs::read_to_string(poses).ok()?;
    let numbers = |line: &str, separator: char| -> Vec<f64> {
        line.split(separator).filter_map(|f| f.trim().parse().ok()).collect()
    };
    let poses: HashMap<u64, Rigid2> = poses
        .lines()
        .map(|line| numbers(line, ','))
        .filter(|f| f.len() >= 5)
        .map(|f| ((f[0] * 1e6).round() as u64, Rigid2::new(f[2], f[3], f[4])))
        .collect();
    let mut text = String::new();
    bzip2::read::BzDecoder::new(std::fs::File::open(log).ok()?).read_to_string(&mut text).ok()?;
    let scan = |line: &str| {
        let fields: Vec<&str> = line.split_ascii_whitespace().collect();
        let count: usize = fields.get(1)?.parse().ok()?;
        let time: f64 = fields.get(count + 8)?.parse().ok()?;
        let map_from_laser = *poses.get(&((time * 1e6).round() as u64))?;
        let point = |i: usize| {
            let range: f32 = fields[2 + i].parse().ok()?;
            let angle = (-90.0 + 180.0 * i as f32 / count as f32).to_radians();
            (range < MAX_RANGE).then(|| Point3f::new(range * angle.cos(), range * angle.sin(), 0.0))
        };
        let points = PointCloud::new((0..count).filter_map(point).collect());
        Some(PosedScan { time, map_from_laser, points })
    };
    Some(text.lines().filter(|l| l.starts_with("FLASER")).filter_map(scan).collect())
}

impl PosedScan {
    /// What the scan saw, in the frame of the map.
    pub fn range_data_in_map(&self) -> RangeData {
        let data = RangeData { returns: self.points.clone(), ..Default::default() };
        data.transformed(&to_f32(&embed_3d(&self.map_from_laser)))
    }

    /// The points a node keeps for loop closure.
    pub fn filtered(&self) -> PointCloud {
        adaptive_voxel_filter(&self.points, 0.9, 100, 50.0)
    }
}

/// Scans drawn one after the other, as a submap draws them.
pub fn submap(scans: &[PosedScan], inserter: &ProbabilityInserter) -> ProbabilityGrid {
    let resolution = f64::from(0.05f32);
    let limits = MapLimits::around(resolution, scans[0].map_from_laser.translation).unwrap();
    let mut grid = ProbabilityGrid::new(limits);
    for scan in scans {
        inserter.insert(&scan.range_data_in_map(), &mut grid).unwrap();
    }
    grid
}

/// A finished submap of 90 scans from index `start` on, and the first scan that comes by its middle more
/// than a minute later.
pub fn loop_closure(
    scans: &[PosedScan],
    inserter: &ProbabilityInserter,
    start: usize,
) -> Option<(Grid2d, usize)> {
    let part = scans.get(start..start + 90)?;
    let middle = part[45].map_from_laser.translation;
    let later = scans.iter().position(|s| {
        s.time > part[89].time + 60.0 && (s.map_from_laser.translation - middle).norm() < 1.0
    })?;
    Some((submap(part, inserter).cropped().into(), later))
}
