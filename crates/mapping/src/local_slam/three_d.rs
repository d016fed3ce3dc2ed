//! Local SLAM in space (`slam3d.md` §1).
//!
//! Unlike the reference it also works without an IMU: when none has reported for a second of range data,
//! the trajectory starts level where the tracking frame is, and lidar alone tells how it turns.

use std::collections::VecDeque;
use std::sync::Arc;

use portolan_config::TrajectoryBuilder3dOptions;
use portolan_geometry::{Rigid3, Time, interpolate, is_valid_pose};
use portolan_motion::{MotionFilter, PoseExtrapolator};
use portolan_sensor::{
    ImuData, OdometryData, PointCloud, RangeData, RangeDataCollator, SensorId, SynchronizedRanges,
    TimedPointCloudData,
};

use super::two_d::{LocalSlamExtras, first_point_time};
use super::{
    ActiveSubmaps, CUT_SHORT, LocalSlam, MOST_GATHERED_POINTS, MatchingResult, Repairs, count_collated,
    count_extrapolated, motion_filter, take_odometry,
};
use crate::gyroscope_bias::GyroscopeBias;
use crate::gyroscope_range::GyroscopeRange;
use crate::scan_matching_3d::ScanMatcher3d;
use crate::submap_3d::{Inserter3d, Submap3d};
use crate::{InsertionSubmap, MapperError, OpenDirections, Spatial, WeakSpan, WeakSpans};

mod by_surfaces;
mod conclusion;
mod first_sweeps;
mod inertial;
mod posts;
mod standstill;
mod start;
mod surface_tracking;
mod sweep_path;
mod unwarp;
mod upright;

use by_surfaces::BySurfaces;
use inertial::Inertial;
use standstill::Standstill;
use surface_tracking::SurfaceTracker;
use unwarp::{Gathered, Unwarped, unwarp};
use upright::Upright;

/// Without an IMU a scan is unwarped again with the pose it was matched at, so many times.
const STRAIGHTENING_PASSES: u32 = 2;

/// Local SLAM of one trajectory in 3D.
pub struct LocalSlam3d {
    options: TrajectoryBuilder3dOptions,
    extras: LocalSlamExtras,
    collator: RangeDataCollator,
    extrapolator: Option<PoseExtrapolator>,
    has_imu: bool,
    gyroscope_bias: GyroscopeBias,
    gyroscope_range: GyroscopeRange,
    /// When the gyroscope was last at the end of its range.
    saturated_at: Option<Time>,
    standstill: Standstill,
    upright: Upright,
    inertial: Inertial,
    /// Samples from before the start.
    waiting_imu: Vec<ImuData>,
    /// When a scan was last inserted.
    last_inserted: Option<Time>,
    /// How many were inserted since it stands.
    inserted_standing: i32,
    matcher: ScanMatcher3d,
    /// Set if scans are matched to surfaces instead.
    by_surfaces: Option<BySurfaces>,
    inserter: Arc<Inserter3d>,
    active_submaps: ActiveSubmaps<Spatial>,
    motion_filter: MotionFilter,
    /// Messages gathered since the last match, thinned.
    gathered: Vec<Gathered>,
    /// When the last match ended.
    gathering_since: Option<Time>,
    /// Range data that came before it was known whether there is an IMU.
    waiting_ranges: VecDeque<SynchronizedRanges>,
    /// Odometry that came before that.
    waiting_odometry: VecDeque<OdometryData>,
    repairs: Repairs,
    weak_spans: WeakSpans,
}

/// A scan that was matched.
struct MatchedScan {
    local_from_tracking: Rigid3,
    /// In the tracking frame; thinned unless it was matched to surfaces, which take every point.
    scan: RangeData,
    /// The fine and the coarse cloud, if they were needed for matching.
    clouds: Option<[PointCloud; 2]>,
    /// What it left open.
    open: OpenDirections,
}

impl LocalSlam3d {
    /// Local SLAM for a trajectory with these range sensors.
    pub fn new(
        options: &TrajectoryBuilder3dOptions,
        range_sensors: &[SensorId],
        extras: LocalSlamExtras,
    ) -> Result<Self, MapperError> {
        let contradiction = |e: &dyn std::error::Error| MapperError::Options(e.to_string());
        let inserter =
            Inserter3d::new(&options.submaps, options.rotational_histogram_size, options.use_intensities);
        let inserter = inserter.map_err(|e| contradiction(&e))?;
        Ok(Self {
            by_surfaces: extras.surface_voxel_size.map(BySurfaces::new),
            extras,
            collator: RangeDataCollator::new(range_sensors.iter().map(|s| s.id.clone())),
            extrapolator: None,
            has_imu: false,
            gyroscope_bias: GyroscopeBias::default(),
            gyroscope_range: GyroscopeRange::default(),
            saturated_at: None,
            standstill: Standstill::default(),
            upright: Upright::default(),
            inertial: Inertial::default(),
            waiting_imu: Vec::new(),
            last_inserted: None,
            inserted_standing: 0,
            matcher: ScanMatcher3d::new(options).map_err(|e| contradiction(&e))?,
            inserter: Arc::new(match extras.surface_voxel_size {
                Some(size) => inserter.with_surfaces(size),
                None => inserter,
            }),
            active_submaps: ActiveSubmaps::new(u32::try_from(options.submaps.num_range_data).unwrap_or(1)),
            motion_filter: motion_filter(&options.motion_filter),
            gathered: Vec::new(),
            gathering_since: None,
            waiting_ranges: VecDeque::new(),
            waiting_odometry: VecDeque::new(),
            repairs: Repairs::new(),
            weak_spans: WeakSpans::default(),
            options: options.clone(),
        })
    }

    fn count(&mut self, what: &'static str) {
        *self.repairs.entry(what).or_default() += 1;
    }

    /// Takes a sample after the start.
    fn follow_imu(&mut self, data: &ImuData) {
        let Some(extrapolator) = self.extrapolator.as_mut() else { return };
        if self.gyroscope_range.is_at_end(&data.angular_velocity) {
            self.saturated_at = self.saturated_at.max(Some(data.time));
        }
        let corrected = self.gyroscope_bias.corrected(data);
        if extrapolator.add_imu(&corrected).is_ok() {
            self.standstill.add_imu(&corrected);
            self.upright.add_imu(&corrected);
            self.inertial.add_imu(&corrected);
        } else {
            self.count("IMU sample older than the last matched scan");
            return;
        }
        if !self.has_imu {
            self.count("IMU sample that came after the start without an IMU; it tells rotation only");
        }
    }

    /// Matches what waited for the start.
    fn match_waiting(&mut self) -> Vec<MatchingResult<Spatial>> {
        if self.extrapolator.is_none() {
            self.start_if_ready();
        }
        if self.extrapolator.is_none() {
            return Vec::new();
        }
        let waiting = std::mem::take(&mut self.waiting_ranges);
        waiting.iter().flat_map(|ranges| self.add_synchronized(ranges)).collect()
    }

    /// One synchronised set of ranges: thin, gather, and match when enough is together.
    fn add_synchronized(&mut self, ranges: &SynchronizedRanges) -> Vec<MatchingResult<Spatial>> {
        let last_pose_time = self.extrapolator.as_ref().and_then(PoseExtrapolator::last_pose_time);
        if last_pose_time.is_some_and(|last| first_point_time(ranges) < last) {
            self.count(match self.has_submap() {
                true => "scan that starts before the last matched scan ends",
                false => "scan before the first IMU sample",
            });
            return Vec::new();
        }
        self.gathered.push(Gathered::new(ranges, 0.5 * self.options.voxel_filter_size));
        let begin = *self.gathering_since.get_or_insert_with(|| first_point_time(ranges));
        // Stamps jitter: nine tenths of the time will do.
        let is_long_enough = ranges.time.seconds_since(begin) >= 0.9 * self.extras.min_scan_duration;
        if self.gathered.len() < self.options.num_accumulated_range_data || !is_long_enough {
            if self.gathered.iter().map(Gathered::len).sum::<usize>() < MOST_GATHERED_POINTS {
                return Vec::new();
            }
            self.count(CUT_SHORT);
        }
        let gathered = std::mem::take(&mut self.gathered);
        self.gathering_since = Some(ranges.time);
        match self.by_surfaces {
            Some(_) => self.match_to_surfaces(ranges.time, &gathered),
            None => {
                let matched = self.match_gathered(ranges.time, &gathered);
                let measured = |_: &_| SurfaceTracker::sweep(&gathered, ranges.time, &self.options);
                let measured = matched.as_ref().map(measured).unwrap_or_default();
                matched.map(|result| MatchingResult { measured, ..result }).into_iter().collect()
            }
        }
    }

    /// Whether a scan has been inserted yet.
    fn has_submap(&self) -> bool {
        self.active_submaps.matching_submap().is_some()
    }

    /// One whole scan: unwarp, thin, match, insert.
    fn match_gathered(&mut self, time: Time, gathered: &[Gathered]) -> Option<MatchingResult<Spatial>> {
        let extrapolator = self.extrapolator.as_mut()?;
        extrapolator.prepare(time);
        let last = extrapolator.last_pose();
        let start = extrapolator.last_extrapolated_time().unwrap_or(Time::MIN);
        let unwarped = unwarp(gathered, start, |t| extrapolator.extrapolate_pose(t), &self.options);
        let prediction = extrapolator.extrapolate_pose(time);
        let measured_gravity = self.has_imu.then(|| extrapolator.estimate_gravity_orientation(time));
        if unwarped.times_raised > 0 {
            self.count("scan with points older than ones already used; their poses are the last known one");
        }
        let mut matched = self.match_unwarped(&unwarped, &prediction)?;
        if let Some((last_time, last_pose)) = last.filter(|_| !self.has_imu && self.has_submap()) {
            // How the scanner moved on the way is known only now.
            for _ in 0..STRAIGHTENING_PASSES {
                let end = matched.local_from_tracking;
                let on_the_way =
                    |t: Time| interpolate(last_time, &last_pose, time, &end, t.clamp(last_time, time));
                let straightened = unwarp(gathered, last_time, on_the_way, &self.options);
                matched = self.match_unwarped(&straightened, &end).unwrap_or(matched);
            }
        }
        self.extrapolator.as_mut()?.add_pose(time, matched.local_from_tracking);
        Some(self.conclude(time, matched, measured_gravity))
    }

    /// Thins an unwarped scan and matches it near a predicted pose.
    fn match_unwarped(&mut self, unwarped: &Unwarped, prediction: &Rigid3) -> Option<MatchedScan> {
        let scan = unwarped.in_tracking(prediction, self.options.voxel_filter_size);
        if scan.returns.is_empty() {
            self.count("scan without a single return");
            return None;
        }
        let [high, low] = self.clouds(&scan.returns);
        if high.is_empty() || low.is_empty() {
            self.count("scan without a return in matching range");
            return None;
        }
        let submap = self.active_submaps.matching_submap();
        let (matched, _) = self.matcher.match_scan(prediction, [&high, &low], submap);
        let local_from_tracking = if is_valid_pose(&matched) { matched } else { *prediction };
        if !is_valid_pose(&local_from_tracking) {
            self.count("scan whose pose could not be determined");
            return None;
        }
        let clouds = Some([high, low]);
        let open = OpenDirections::default();
        Some(MatchedScan { local_from_tracking, scan, clouds, open })
    }
}

impl LocalSlam<Spatial> for LocalSlam3d {
    fn add_range_data(
        &mut self,
        sensor_id: &SensorId,
        data: TimedPointCloudData,
    ) -> Vec<MatchingResult<Spatial>> {
        let Some(ranges) = self.collator.add(&sensor_id.id, data) else { return Vec::new() };
        if ranges.points.is_empty() {
            self.count("scan without points");
            return Vec::new();
        }
        if self.options.use_intensities && ranges.intensities.is_empty() {
            self.count("scan without intensities, matched by its shape alone");
        }
        self.waiting_ranges.push_back(ranges);
        self.match_waiting()
    }

    fn add_imu_data(&mut self, data: &ImuData) {
        if self.extrapolator.is_some() {
            self.follow_imu(data);
            return;
        }
        let mut values = data.linear_acceleration.iter().chain(data.angular_velocity.iter());
        if !values.all(|v| v.is_finite()) {
            self.count("IMU sample that is not finite");
        } else if self.waiting_imu.last().is_some_and(|last| data.time < last.time) {
            self.count("IMU sample older than the last matched scan");
        } else {
            self.waiting_imu.push(*data);
            self.start_if_ready();
        }
    }

    fn add_odometry_data(&mut self, data: &OdometryData) -> Vec<MatchingResult<Spatial>> {
        if !take_odometry(data, self.extrapolator.as_mut(), &mut self.waiting_odometry) {
            self.count("odometry pose older than the last matched scan");
        }
        Vec::new()
    }

    fn flush(&mut self) -> Vec<MatchingResult<Spatial>> {
        if self.extrapolator.is_none() {
            self.start();
        }
        let mut results = self.match_waiting();
        results.extend(self.insert_waiting_first());
        results
    }

    fn finish(&mut self) -> Vec<InsertionSubmap<Spatial>> {
        self.active_submaps.finish()
    }

    fn active_submaps(&self) -> Vec<(u32, Submap3d)> {
        let drawn = |submap: &Submap3d| {
            let mut submap = submap.clone();
            submap.draw_grids();
            submap
        };
        self.active_submaps.iter().map(|(index, submap)| (index, drawn(submap))).collect()
    }

    fn repairs(&self) -> Repairs {
        let mut repairs = self.repairs.clone();
        self.active_submaps.count_into(&mut repairs);
        count_collated(self.collator.counts(), &mut repairs);
        count_extrapolated(self.extrapolator.as_ref(), &mut repairs);
        repairs
    }

    fn weak_spans(&self) -> Vec<WeakSpan> {
        self.weak_spans.spans().to_vec()
    }
}

#[cfg(test)]
mod tests;
