//! The plane engine: lidar odometry on planar voxel maps, with grids beside them for files and wide searches.

use portolan_config::{ImuBasedPoseExtrapolatorOptions, TrajectoryBuilder3dOptions};
use portolan_geometry::{Rigid3, Time, is_valid_pose};
use portolan_issue::{Issue, IssueLog};
use portolan_lidar_odometry::settings::{ExtrapolatorSettings, KeyframeSettings, LocalMapSettings};
use portolan_lidar_odometry::{Fallback, LidarOdometry, OdometrySettings, PlaneMap, RegisteredSweep};
use portolan_motion::{DegenerateInterval, ExtrapolatorCounts, ImuBasedSettings, WaitingSweeps};
use portolan_recall::Memory;
use portolan_sensor::{ImuData, OdometryData, PointCloud, RangeData, voxel_filter};

use super::LocalSlam3dSettings;
use super::deskew::{Gathered, raw_sweep};
use super::grid_matcher::GridMatcher;
use super::keyframe_insertion::{KeyframeInsertion, KeyframeScan, clouds, keyframes_per_half};
use crate::{ActiveSubmaps, Lost};
use crate::{MatchingResult, Space3d};

/// Local SLAM by lidar odometry.
pub(super) struct PlaneEngine {
    options: TrajectoryBuilder3dOptions,
    odometry: LidarOdometry,
    matcher: GridMatcher,
    issues: IssueLog,
}

/// The grids of the older submap, for sweeps that do not fit the planes.
struct Grids<'a> {
    options: &'a TrajectoryBuilder3dOptions,
    matcher: &'a GridMatcher,
    has_imu: bool,
    submaps: &'a mut ActiveSubmaps<Space3d>,
}

impl Fallback for Grids<'_> {
    fn locate(&mut self, deskewed: &PointCloud, local_from_tracking: &Rigid3) -> Option<Rigid3> {
        let submap = self.submaps.matching_submap_mut()?;
        submap.draw_grids();
        let thinned = voxel_filter(deskewed, self.options.voxel_filter_size);
        let [high, low] = clouds(&thinned, self.options);
        if high.is_empty() || low.is_empty() {
            return None;
        }
        let matcher = self.matcher.with_imu(self.has_imu);
        let (matched, _) = matcher.match_scan(local_from_tracking, [&high, &low], Some(submap));
        is_valid_pose(&matched).then_some(matched)
    }

    /// Assumed error of a match: two cells, metres.
    fn error(&self) -> f64 {
        2.0 * self.options.submaps.high_resolution
    }
}

impl PlaneEngine {
    pub fn new(
        options: &TrajectoryBuilder3dOptions,
        settings: &LocalSlam3dSettings,
        voxel_size: f64,
        matcher: GridMatcher,
    ) -> Self {
        let odometry = LidarOdometry::new(odometry_settings(options, settings, voxel_size));
        Self { options: options.clone(), odometry, matcher, issues: IssueLog::default() }
    }

    pub fn remember_with(&mut self, memory: &Memory) {
        self.odometry.remember_with(memory);
    }

    pub fn begin_if_ready(&mut self, waiting: Option<&WaitingSweeps>) -> bool {
        self.odometry.begin_if_ready(waiting)
    }

    pub fn begin(&mut self, waiting: Option<&WaitingSweeps>) {
        self.odometry.begin(waiting);
    }

    pub fn last_pose_time(&self) -> Option<Time> {
        self.odometry.last_pose_time()
    }

    pub fn add_imu(&mut self, data: &ImuData) {
        self.odometry.add_imu(data);
        self.record_issues(data.time);
    }

    pub fn add_odometry(&mut self, data: &OdometryData) {
        self.odometry.add_odometry(data);
        self.record_issues(data.time);
    }

    /// Processes one whole sweep: estimates its pose and inserts it. The first one waits for the second.
    pub fn add_sweep(
        &mut self,
        end: Time,
        gathered: &[Gathered],
        insertion: &mut KeyframeInsertion,
    ) -> Vec<MatchingResult<Space3d>> {
        // The odometry counts sweeps that it cannot register.
        let _ = self.odometry.push(raw_sweep(gathered, end, &self.options));
        let results = self.register(insertion);
        self.record_issues(end);
        results
    }

    /// Registers the first sweep if no second one came.
    pub fn flush(&mut self, insertion: &mut KeyframeInsertion) -> Vec<MatchingResult<Space3d>> {
        self.odometry.end();
        let results = self.register(insertion);
        if let Some(time) = self.last_pose_time() {
            self.record_issues(time);
        }
        results
    }

    fn register(&mut self, insertion: &mut KeyframeInsertion) -> Vec<MatchingResult<Space3d>> {
        let mut results = Vec::new();
        loop {
            let mut grids = Grids {
                options: &self.options,
                matcher: &self.matcher,
                has_imu: self.odometry.has_imu().unwrap_or(true),
                submaps: &mut insertion.submaps,
            };
            let Some(registered) = self.odometry.advance(Some(&mut grids)) else { break };
            results.push(inserted(&self.options, registered, insertion));
        }
        results
    }

    /// Time since which sweeps have not fitted the map, if the last ones did not when the trajectory
    /// ended.
    pub fn lost_since(&self) -> Option<Time> {
        self.odometry.lost_since()
    }

    /// The planes of the active local maps, oldest first.
    pub fn growing_maps(&self) -> impl Iterator<Item = PlaneMap> {
        self.odometry.local_maps().map(|map| map.planes.now().compacted())
    }

    pub fn degenerate_intervals(&self) -> Vec<DegenerateInterval> {
        self.odometry.degenerate_intervals()
    }

    pub fn extrapolator_counts(&self) -> ExtrapolatorCounts {
        self.odometry.extrapolator_counts()
    }

    /// Ratio of the distance by odometry to that by sweeps, where it differs significantly from one.
    pub fn odometry_factor(&self) -> Option<f64> {
        self.odometry.odometry_factor()
    }

    /// Issues of the odometry so far.
    pub fn issues(&self) -> &IssueLog {
        &self.issues
    }

    /// Adds the issues of the odometry since the last call, with this time.
    fn record_issues(&mut self, time: Time) {
        for (issue, count) in self.odometry.issues().iter() {
            let kind = issue.kind();
            let new = count.saturating_sub(self.issues.count_of(kind));
            self.issues.add(Issue::new(kind).at(time).times(new));
        }
    }
}

/// Inserts a key frame as a node; other sweeps are not inserted.
fn inserted(
    options: &TrajectoryBuilder3dOptions,
    mut registered: RegisteredSweep,
    insertion: &mut KeyframeInsertion,
) -> MatchingResult<Space3d> {
    let lost = registered.new_piece.take().map(|piece| Lost {
        since: piece.since,
        remaining: insertion.restart(piece.maps.into_iter()),
        old_from_new: piece.old_from_new,
        bridge: None,
    });
    let RegisteredSweep { sweep, local_from_tracking, gravity_from_tracking, deskewed, .. } = registered;
    let result = match registered.keyframe {
        None => MatchingResult::not_inserted(sweep.end, local_from_tracking, registered.in_local),
        Some(keyframe) => insertion.insert(KeyframeScan {
            time: sweep.end,
            local_from_tracking,
            gravity_from_tracking,
            scan: RangeData {
                returns: voxel_filter(&deskewed.returns, options.voxel_filter_size),
                ..deskewed
            },
            clouds: None,
            open: registered.observability,
            completed_map: keyframe.completed_map,
        }),
    };
    MatchingResult { measured: sweep.points, lost, ..result }
}

/// Settings of the lidar odometry from these options.
fn odometry_settings(
    options: &TrajectoryBuilder3dOptions,
    settings: &LocalSlam3dSettings,
    voxel_size: f64,
) -> OdometrySettings {
    let filter = &options.motion_filter;
    OdometrySettings {
        keeps_intensities: options.use_intensities,
        extrapolator: extrapolator_settings(options, settings),
        local_map: LocalMapSettings { voxel_size, keyframes_per_half: keyframes_per_half(options) },
        keyframes: KeyframeSettings {
            max_time: filter.max_time_seconds,
            max_distance: filter.max_distance_meters,
            max_angle: filter.max_angle_radians,
        },
        ..OdometrySettings::default()
    }
}

/// Settings of the extrapolator from these options.
pub(super) fn extrapolator_settings(
    options: &TrajectoryBuilder3dOptions,
    settings: &LocalSlam3dSettings,
) -> ExtrapolatorSettings {
    let options = &options.pose_extrapolator;
    ExtrapolatorSettings {
        pose_queue_duration: options.constant_velocity.pose_queue_duration,
        gravity_time_constant: options.constant_velocity.imu_gravity_time_constant,
        use_all_odometry: settings.use_all_odometry,
        imu_based: options.use_imu_based.then(|| imu_based_settings(&options.imu_based)),
    }
}

fn imu_based_settings(options: &ImuBasedPoseExtrapolatorOptions) -> ImuBasedSettings {
    let solver = &options.solver_options;
    ImuBasedSettings {
        pose_queue_duration: options.pose_queue_duration,
        gravity_constant: options.gravity_constant,
        pose_translation_weight: options.pose_translation_weight,
        pose_rotation_weight: options.pose_rotation_weight,
        imu_acceleration_weight: options.imu_acceleration_weight,
        imu_rotation_weight: options.imu_rotation_weight,
        odometry_translation_weight: options.odometry_translation_weight,
        odometry_rotation_weight: options.odometry_rotation_weight,
        max_num_iterations: u32::try_from(solver.max_num_iterations).unwrap_or(u32::MAX),
        use_nonmonotonic_steps: solver.use_nonmonotonic_steps,
    }
}
