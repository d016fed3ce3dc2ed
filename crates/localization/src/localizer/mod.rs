//! Measurements in, places out.

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

    /// That of a map, in a frame near it.
    pub fn near(self, frame: &NearFrame) -> Self {
        Self { map_from_tracking: frame.near(&self.map_from_tracking), ..self }
    }

    /// That of a frame near the map, in the map.
    pub fn in_map(self, frame: &NearFrame) -> Self {
        Self { map_from_tracking: frame.in_map(&self.map_from_tracking), ..self }
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

/// Finds a lidar in a saved map: a [`KnownMap2d`](crate::KnownMap2d) or a [`KnownMap3d`](crate::KnownMap3d).
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

    /// Takes a measurement; what is known after each scan whose turn has come with it.
    pub fn add(&mut self, sensor_id: &SensorId, measurement: Measurement) -> Vec<Estimate> {
        (M::localizer_work().add)(self, sensor_id, measurement)
    }

    /// Takes a satellite fix: as long as no place is known it is one more place where the scanner may be, which scans have to
    /// confirm.
    pub fn add_fix(&mut self, fix: PositionFix) {
        self.finder.add_fix(fix);
    }

    /// Ends the recording: uses what waits.
    pub fn finish(&mut self) -> Vec<Estimate> {
        (M::localizer_work().finish)(self)
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
        (M::localizer_work().grow)(self, graph, estimates, growth)
    }

    /// What was dropped or repaired so far.
    pub fn issues(&self) -> IssueLog {
        (M::localizer_work().issues)(self)
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
}
