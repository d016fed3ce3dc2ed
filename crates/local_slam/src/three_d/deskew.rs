//! Messages accumulated to a sweep, and their de-skewing in the grid engine: every point by the pose at
//! its own time.

use portolan_config::TrajectoryBuilder3dOptions;
use portolan_geometry::{Duration, Point3f, Rigid3, Rigid3f, Time, to_f32};
use portolan_lidar_odometry::{Sweep, SweepPoint};
use portolan_sensor::{PointCloud, RangeData, SynchronizedRanges, voxel_filter, voxel_filter_indices};

/// A message down-sampled with small voxels in the tracking frame.
pub(super) struct Gathered {
    pub points: Vec<GatheredPoint>,
}

/// A point of a message.
pub(super) struct GatheredPoint {
    pub time: Time,
    /// In the tracking frame at its own time, as the origin of its beam.
    pub position: Point3f,
    pub origin: Point3f,
    pub intensity: f32,
}

impl Gathered {
    pub fn len(&self) -> usize {
        self.points.len()
    }

    pub fn new(ranges: &SynchronizedRanges, voxel_size: f32) -> Self {
        let kept = voxel_filter_indices(&ranges.points, |p| p.point.position, voxel_size);
        let mut points = Vec::with_capacity(kept.len());
        for i in kept {
            let Some(p) = ranges.points.get(i as usize) else { continue };
            let Some(origin) = ranges.origins.get(p.origin_index) else { continue };
            points.push(GatheredPoint {
                time: ranges.time + Duration::from_seconds(f64::from(p.point.time)),
                position: p.point.position,
                origin: *origin,
                intensity: ranges.intensities.get(i as usize).copied().unwrap_or(0.0),
            });
        }
        Self { points }
    }
}

/// The raw points in range of a sweep that ends at `end`.
pub(super) fn raw_sweep(gathered: &[Gathered], end: Time, options: &TrajectoryBuilder3dOptions) -> Sweep {
    let in_range = options.min_range..=options.max_range;
    let mut sweep = Vec::with_capacity(gathered.iter().map(Gathered::len).sum());
    for message in gathered {
        for p in message.points.iter().filter(|p| in_range.contains(&(p.position - p.origin).norm())) {
            let time = p.time.seconds_since(end).min(0.0) as f32;
            sweep.push(SweepPoint { time, position: p.position, intensity: p.intensity });
        }
    }
    Sweep { end, points: sweep }
}

/// A sweep in the local map.
#[derive(Default)]
pub(super) struct Deskewed {
    returns: PointCloud,
    misses: PointCloud,
    /// Number of points older than a pose already predicted.
    pub times_raised: u64,
}

/// De-skews all accumulated messages with the poses of the tracking frame in the local map, at times from
/// `start` on. Splits the points into returns and misses by their range.
pub(super) fn deskew(
    gathered: &[Gathered],
    start: Time,
    mut local_from_tracking_at: impl FnMut(Time) -> Rigid3,
    options: &TrajectoryBuilder3dOptions,
) -> Deskewed {
    let mut deskewed = Deskewed::default();
    let mut newest = start;
    let mut pose_time = None;
    let mut pose = Rigid3f::identity();
    for point in gathered.iter().flat_map(|message| &message.points) {
        deskewed.times_raised += u64::from(point.time < newest);
        newest = newest.max(point.time);
        // Beams of one firing share a time; a scan without times needs a single pose.
        if pose_time != Some(newest) {
            pose_time = Some(newest);
            pose = to_f32(&local_from_tracking_at(newest));
        }
        let (hit, origin) = (pose * point.position, pose * point.origin);
        let delta = hit - origin;
        let range = delta.norm();
        if range.is_nan() || range < options.min_range {
            continue;
        }
        if range <= options.max_range {
            deskewed.returns.points.push(hit);
            if options.use_intensities {
                deskewed.returns.intensities.push(point.intensity);
            }
        } else {
            deskewed.misses.points.push(origin + delta * (options.max_range / range));
        }
    }
    deskewed
}

impl Deskewed {
    /// The sweep, down-sampled in the local map, in the tracking frame at its end, which is also assumed
    /// to be the origin of the rays.
    pub fn in_tracking(&self, local_from_tracking: &Rigid3, voxel_size: f32) -> RangeData {
        let thinned = RangeData {
            origin: Point3f::from(to_f32(local_from_tracking).translation.vector),
            returns: voxel_filter(&self.returns, voxel_size),
            misses: voxel_filter(&self.misses, voxel_size),
        };
        thinned.transformed(&to_f32(local_from_tracking).inverse())
    }
}
