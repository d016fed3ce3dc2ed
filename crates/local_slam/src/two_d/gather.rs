//! Accumulates range data to one scan: de-skews it by the predicted motion, splits it into returns and
//! misses, and aligns it with gravity.

use portolan_config::TrajectoryBuilder2dOptions;
use portolan_geometry::{Duration, Point3f, Quaternion, Rigid2, Rigid3, Rigid3f, Time, to_f32, yaw};
use portolan_sensor::{PointCloud, RangeData, SynchronizedRanges, voxel_filter};

/// Range data accumulated since the last match, in the local map by the predicted poses.
#[derive(Default)]
pub(super) struct Accumulation {
    pub messages: u32,
    pub returns: Vec<Point3f>,
    pub misses: Vec<Point3f>,
    /// Position of the sensor at its newest point.
    scanner: Point3f,
}

/// An accumulated scan in the gravity-aligned tracking frame of its last point.
pub(super) struct GatheredScan {
    pub range_data: RangeData,
    /// Position of the sensor at its newest point.
    scanner: Point3f,
}

impl GatheredScan {
    /// The frame with its origin at the sensor at the newest point and with the x axis of the tracking
    /// frame; the gravity-aligned frame may be turned against it by any yaw.
    pub fn aligned_from_scanner(&self, aligned_from_tracking: &Quaternion) -> Rigid2 {
        Rigid2::new(f64::from(self.scanner.x), f64::from(self.scanner.y), yaw(aligned_from_tracking))
    }
}

/// De-skews every point by the pose of the tracking frame in the local map at its own time, and splits the
/// points into returns and misses. Returns the pose at the last point.
pub(super) fn deskew_into(
    ranges: &SynchronizedRanges,
    mut local_from_tracking: impl FnMut(Time) -> Rigid3,
    options: &TrajectoryBuilder2dOptions,
    accumulated: &mut Accumulation,
) -> Rigid3f {
    let mut pose_time = f32::NAN;
    let mut pose = Rigid3f::identity();
    for p in &ranges.points {
        // Beams of one firing share a time; a scan without times needs a single pose.
        if p.point.time != pose_time {
            pose_time = p.point.time;
            let time = ranges.time + Duration::from_seconds(f64::from(pose_time));
            pose = to_f32(&local_from_tracking(time));
        }
        // Without an origin there is no range; the same where it is NaN. The collator gives every point
        // one.
        let Some(origin_in_tracking) = ranges.origins.get(p.origin_index) else { continue };
        let origin = pose * origin_in_tracking;
        accumulated.scanner = origin;
        let hit = pose * p.point.position;
        let delta = hit - origin;
        let range = delta.norm();
        if range.is_nan() || range < options.min_range {
            continue;
        }
        if range <= options.max_range {
            accumulated.returns.push(hit);
        } else {
            accumulated.misses.push(origin + delta * (options.missing_data_ray_length / range));
        }
    }
    pose
}

/// The accumulated points in the gravity-aligned tracking frame of the last point, cropped in height and
/// down-sampled.
pub(super) fn gravity_aligned(
    accumulated: Accumulation,
    last_local_from_tracking: &Rigid3f,
    gravity: &Quaternion,
    options: &TrajectoryBuilder2dOptions,
) -> GatheredScan {
    let aligned_from_local =
        to_f32(&Rigid3::from_parts(Default::default(), *gravity)) * last_local_from_tracking.inverse();
    let range_data = RangeData {
        origin: Point3f::from(last_local_from_tracking.translation.vector),
        returns: PointCloud::new(accumulated.returns),
        misses: PointCloud::new(accumulated.misses),
    };
    let cropped = range_data.transformed(&aligned_from_local).cropped_z(options.min_z, options.max_z);
    let range_data = RangeData {
        origin: cropped.origin,
        returns: voxel_filter(&cropped.returns, options.voxel_filter_size),
        misses: voxel_filter(&cropped.misses, options.voxel_filter_size),
    };
    GatheredScan { range_data, scanner: aligned_from_local * accumulated.scanner }
}
