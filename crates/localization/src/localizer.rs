//! Measurements in, places out.

use std::collections::BTreeSet;

use portolan_config::Options;
use portolan_geometry::Rigid3;
use portolan_issue::IssueLog;
use portolan_mapping::{
    LocalSlam, LocalTrack, MapperError, MatchingResult, Placement, PoseGraph, SensorCollation, Space,
    TrajectoryId,
};
use portolan_sensor::{Measurement, SensorId, SensorKind};

use crate::changes::Change;
use crate::finder::{Finder, LocalScan};
use crate::growth::{Grown, Growth, GrowthError, grow};
use crate::known_map::KnownMap;
use crate::search::{PositionFix, Searcher};
use crate::state::Estimate;
use crate::voxel_changes::KeptSweep;

/// Where a recording starts, as far as somebody knows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartPose {
    /// Pose of the tracking frame in the map at the first scan.
    pub map_from_tracking: Rigid3,
    /// Standard deviation of the position along each axis, metres.
    pub sigma_metres: f64,
    /// Standard deviation of the heading, radians.
    pub sigma_radians: f64,
}

impl StartPose {
    /// A start that somebody read off a picture: half a metre and ten degrees.
    pub fn new(map_from_tracking: Rigid3) -> Self {
        Self { map_from_tracking, sigma_metres: 0.5, sigma_radians: 10f64.to_radians() }
    }
}

/// How to localise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LocalizerSettings {
    /// Where the recording starts; searched in the whole map if that is not known, or wrong.
    pub start: Option<StartPose>,
    /// Threads for searching; 0 for as many as there are cores. What is found does not depend on it.
    pub threads: usize,
    /// Whether what local SLAM makes of the recording is kept, to be added to the map; memory then grows with time.
    pub keeps_track: bool,
}

/// Why localisation cannot begin, or go on.
#[derive(Debug, thiserror::Error)]
pub enum LocalizerError {
    /// Local SLAM.
    #[error(transparent)]
    Mapper(#[from] MapperError),
    /// Threads could not be started.
    #[error("cannot start threads for searching: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}

/// Finds a lidar in a saved map: a [`PlanarMap`](crate::PlanarMap) or a [`SpatialMap`](crate::SpatialMap).
///
/// Local SLAM gives the motion from scan to scan; what it draws is forgotten. Memory does not grow with time.
pub struct Localizer<M: KnownMap> {
    collation: SensorCollation,
    local_slam: <M::Space as Space>::LocalSlam,
    finder: Finder<M>,
    track: Option<LocalTrack<M::Space>>,
    /// What is kept with the track to renew the map by.
    sweeps: Vec<KeptSweep>,
}

/// The one trajectory.
const TRAJECTORY: TrajectoryId = TrajectoryId(0);

impl<M: KnownMap> Localizer<M> {
    /// For a recording with these sensors.
    ///
    /// # Errors
    /// If options contradict each other or threads cannot be started.
    pub fn new(
        map: M,
        options: &Options,
        sensors: &BTreeSet<SensorId>,
        settings: &LocalizerSettings,
    ) -> Result<Self, LocalizerError> {
        let ranges: Vec<SensorId> = sensors.iter().filter(|s| s.kind == SensorKind::Range).cloned().collect();
        let mut collation = SensorCollation::new(options.map_builder.collate_by_trajectory);
        // Fixes are taken as they come: scans do not wait for them.
        let ordered = sensors.iter().filter(|s| s.kind != SensorKind::FixedFramePose).cloned().collect();
        collation.add_trajectory(TRAJECTORY, &ordered, &options.trajectory_builder);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(settings.threads).build()?;
        let searcher = Searcher { map, pool };
        let start = settings.start.map(|s| (s.map_from_tracking, (s.sigma_metres, s.sigma_radians)));
        Ok(Self {
            collation,
            local_slam: M::Space::new_local_slam(options, &ranges)?,
            finder: Finder::new(searcher, start),
            track: settings.keeps_track.then(LocalTrack::default),
            sweeps: Vec::new(),
        })
    }

    /// Takes a measurement; what is known after each scan whose turn has come with it.
    pub fn add(&mut self, sensor_id: &SensorId, measurement: Measurement) -> Vec<Estimate> {
        if sensor_id.kind == SensorKind::FixedFramePose {
            return Vec::new();
        }
        let ready = self.collation.add(TRAJECTORY, sensor_id, measurement);
        ready.into_iter().flat_map(|(_, id, measurement)| self.dispatch(&id, measurement)).collect()
    }

    /// Takes a satellite fix: as long as no place is known it is one more place where the scanner may be, which scans have to
    /// confirm.
    pub fn add_fix(&mut self, fix: PositionFix) {
        self.finder.add_fix(fix);
    }

    /// Ends the recording: uses what waits.
    pub fn finish(&mut self) -> Vec<Estimate> {
        let ready = self.collation.finish_trajectory(TRAJECTORY);
        let mut estimates: Vec<Estimate> =
            ready.into_iter().flat_map(|(_, id, measurement)| self.dispatch(&id, measurement)).collect();
        let late = self.local_slam.flush();
        estimates.extend(self.find(late));
        if let Some(track) = &mut self.track {
            track.finish(&self.local_slam.finish());
        }
        estimates
    }

    /// Adds what was localised to the pose graph that holds the map, as one more trajectory; after [`Localizer::finish`], if
    /// the track was to be kept. `estimates` are all that it gave. Nothing of the graph changes if that is not possible.
    ///
    /// # Errors
    /// If nothing was localised surely enough to be added, or the map cannot be renewed.
    pub fn grow(
        &mut self,
        graph: &mut PoseGraph<M::Space>,
        estimates: &[Estimate],
        growth: Growth,
    ) -> Result<Grown, GrowthError> {
        let track = self.track.take().unwrap_or_default();
        let sweeps = std::mem::take(&mut self.sweeps);
        let searcher = self.finder.searcher();
        searcher.pool.install(|| grow(&searcher.map, graph, (track, &sweeps), estimates, growth))
    }

    /// What was dropped or repaired so far.
    pub fn issues(&self) -> IssueLog {
        let mut issues = self.local_slam.issues();
        issues.append(&self.collation.issues());
        issues
    }

    /// Where scans contradicted the map while it was localised.
    pub fn changes(&self) -> Vec<Change> {
        self.finder.changes()
    }

    /// Whether the start that was told agrees with the place that is known; none while none is known, or none was told.
    pub fn start_agrees(&self) -> Option<bool> {
        self.finder.start_agrees()
    }

    /// Where the recording was told to be when it was last looked for: the start, or a satellite fix.
    pub fn told(&self) -> Option<StartPose> {
        let (map_from_tracking, (sigma_metres, sigma_radians)) = self.finder.told()?;
        Some(StartPose { map_from_tracking, sigma_metres, sigma_radians })
    }

    fn dispatch(&mut self, sensor_id: &SensorId, measurement: Measurement) -> Vec<Estimate> {
        let matched = match measurement {
            Measurement::Range(data) => self.local_slam.add_range_data(sensor_id, data),
            Measurement::Odometry(data) => self.local_slam.add_odometry_data(&data),
            Measurement::Imu(data) => {
                self.local_slam.add_imu_data(&data);
                if let Some(track) = &mut self.track {
                    track.add_imu(&data);
                }
                Vec::new()
            }
            Measurement::FixedFramePose(_) | Measurement::Landmark(_) => Vec::new(),
        };
        self.find(matched)
    }

    fn find(&mut self, matched: Vec<MatchingResult<M::Space>>) -> Vec<Estimate> {
        let (finder, track, sweeps) = (&mut self.finder, &mut self.track, &mut self.sweeps);
        let find = |scan: MatchingResult<M::Space>| {
            let local = LocalScan {
                time: scan.time,
                local_from_tracking: scan.local_from_tracking,
                returns: &scan.range_data_in_local.returns,
                origin: scan.range_data_in_local.origin,
                begins_anew: scan.lost.as_ref().is_some_and(|lost| lost.bridge.is_none()),
            };
            let estimate = finder.add(&local);
            if let Some(track) = track {
                let placement = estimate.placement(M::CERTAIN_PLACE);
                if let Placement::Found(place) = placement
                    && !sweeps.last().is_some_and(|last| last.is_like(&place))
                {
                    sweeps.extend(M::kept_sweep(&local, &place));
                }
                track.add(&scan, placement);
            }
            estimate
        };
        matched.into_iter().map(find).collect()
    }
}
