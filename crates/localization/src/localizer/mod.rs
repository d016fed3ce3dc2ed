//! Takes measurements of a recording and returns its poses in a known map.

mod work;

use std::collections::BTreeSet;

pub use work::LocalizerWork;

use portolan_config::Options;
use portolan_geometry::{NearFrame, Rigid3};
use portolan_issue::IssueLog;
use portolan_mapping::{LocalTrack, MapperError, PoseGraph, SensorCollation, Space};
use portolan_sensor::{Measurement, SensorId};

use crate::changes::Change;
use crate::finder::Finder;
use crate::growth::{Grown, Growth, GrowthError};
use crate::known_map::KnownMap;
use crate::search::PositionFix;
use crate::state::Estimate;
use crate::voxel_changes::KeptSweep;

/// Start of a recording in the map, given by the user.
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
    /// A start that the user read off a picture: half a metre and ten degrees.
    pub fn new(map_from_tracking: Rigid3) -> Self {
        Self { map_from_tracking, sigma_metres: 0.5, sigma_radians: 10f64.to_radians() }
    }

    /// Converts a start in the map to a frame near it.
    pub fn near(self, frame: &NearFrame) -> Self {
        Self { map_from_tracking: frame.near(&self.map_from_tracking), ..self }
    }

    /// Converts a start in a frame near the map to the map.
    pub fn in_map(self, frame: &NearFrame) -> Self {
        Self { map_from_tracking: frame.in_map(&self.map_from_tracking), ..self }
    }
}

/// Settings of localisation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LocalizerSettings {
    /// Start of the recording; the whole map is searched if it is not given, or wrong.
    pub start: Option<StartPose>,
    /// Number of threads for searching; 0 for as many as there are cores. Results do not depend on it.
    pub threads: usize,
    /// Whether the track of local SLAM is kept, to be added to the map; memory then grows with time.
    pub keeps_track: bool,
}

/// Why localisation cannot begin or continue.
#[derive(Debug, thiserror::Error)]
pub enum LocalizerError {
    /// Local SLAM failed.
    #[error(transparent)]
    Mapper(#[from] MapperError),
    /// Threads could not be started.
    #[error("cannot start threads for searching: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}

/// Localises a lidar in a saved map: a [`KnownMap2d`](crate::KnownMap2d) or a
/// [`KnownMap3d`](crate::KnownMap3d).
///
/// Local SLAM gives the motion from scan to scan; its submaps are dropped. Memory does not grow with time.
pub struct Localizer<M: KnownMap> {
    collation: SensorCollation,
    local_slam: <M::Space as Space>::LocalSlam,
    finder: Finder<M>,
    track: Option<LocalTrack<M::Space>>,
    /// Scans kept with the track, to renew the map.
    sweeps: Vec<KeptSweep>,
}

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
        (M::localizer_work().new)(map, options, sensors, settings)
    }

    /// Takes a measurement; returns an estimate for each scan that could be processed with it.
    pub fn add(&mut self, sensor_id: &SensorId, measurement: Measurement) -> Vec<Estimate> {
        (M::localizer_work().add)(self, sensor_id, measurement)
    }

    /// Takes a satellite fix: while no place is known, it gives one more candidate, which scans have to
    /// confirm.
    pub fn add_fix(&mut self, fix: PositionFix) {
        self.finder.add_fix(fix);
    }

    /// Ends the recording: processes all measurements that are still waiting.
    pub fn finish(&mut self) -> Vec<Estimate> {
        (M::localizer_work().finish)(self)
    }

    /// Adds the localised scans to the pose graph that holds the map, as one more trajectory. To be called
    /// after [`Localizer::finish`], if the settings keep the track. `estimates` are all that this localizer
    /// returned. If it fails, the graph stays unchanged.
    ///
    /// # Errors
    /// If no localised scans are trusted enough to be added, or the map cannot be renewed.
    pub fn grow(
        &mut self,
        graph: &mut PoseGraph<M::Space>,
        estimates: &[Estimate],
        growth: Growth,
    ) -> Result<Grown, GrowthError> {
        (M::localizer_work().grow)(self, graph, estimates, growth)
    }

    /// Issues so far: data that was dropped or repaired.
    pub fn issues(&self) -> IssueLog {
        (M::localizer_work().issues)(self)
    }

    /// Regions where localised scans contradicted the map.
    pub fn changes(&self) -> Vec<Change> {
        self.finder.changes()
    }

    /// Whether the given start agrees with the known place; none while no place is known, or if no start was
    /// given.
    pub fn start_agrees(&self) -> Option<bool> {
        self.finder.start_agrees()
    }

    /// The start or satellite fix that was searched around last.
    pub fn searched_start(&self) -> Option<StartPose> {
        let (map_from_tracking, (sigma_metres, sigma_radians)) = self.finder.searched_start()?;
        Some(StartPose { map_from_tracking, sigma_metres, sigma_radians })
    }
}
