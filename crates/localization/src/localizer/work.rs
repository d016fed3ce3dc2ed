//! The functions of a localizer, compiled in this crate once for each kind of map.

use std::collections::BTreeSet;

use portolan_config::Options;
use portolan_issue::IssueLog;
use portolan_mapping::{
    LocalSlam, LocalTrack, MatchingResult, Placement, PoseGraph, SensorCollation, Space, TrajectoryId,
};
use portolan_sensor::{Measurement, SensorId, SensorKind};

use super::{Localizer, LocalizerError, LocalizerSettings};
use crate::finder::{Finder, LocalScan};
use crate::growth::{Grown, Growth, GrowthError, grow};
use crate::known_map::KnownMap;
use crate::search::Searcher;
use crate::state::Estimate;

/// The functions behind the methods of [`Localizer`], by their names. Every crate and program that calls a
/// generic function compiles it again; [`KnownMap::localizer_work`] gives them as compiled here.
#[allow(clippy::type_complexity)]
pub struct LocalizerWork<M: KnownMap> {
    pub(super) new:
        fn(M, &Options, &BTreeSet<SensorId>, &LocalizerSettings) -> Result<Localizer<M>, LocalizerError>,
    pub(super) add: fn(&mut Localizer<M>, &SensorId, Measurement) -> Vec<Estimate>,
    pub(super) finish: fn(&mut Localizer<M>) -> Vec<Estimate>,
    pub(super) grow:
        fn(&mut Localizer<M>, &mut PoseGraph<M::Space>, &[Estimate], Growth) -> Result<Grown, GrowthError>,
    pub(super) issues: fn(&Localizer<M>) -> IssueLog,
}

impl<M: KnownMap> LocalizerWork<M> {
    /// For a static item of the map.
    pub(crate) const fn compiled() -> Self {
        Self {
            new: Localizer::new_here,
            add: Localizer::add_here,
            finish: Localizer::finish_here,
            grow: Localizer::grow_here,
            issues: Localizer::issues_here,
        }
    }
}

/// The only trajectory.
const TRAJECTORY: TrajectoryId = TrajectoryId(0);

impl<M: KnownMap> Localizer<M> {
    fn new_here(
        map: M,
        options: &Options,
        sensors: &BTreeSet<SensorId>,
        settings: &LocalizerSettings,
    ) -> Result<Self, LocalizerError> {
        let ranges: Vec<SensorId> = sensors.iter().filter(|s| s.kind == SensorKind::Range).cloned().collect();
        let mut collation = SensorCollation::new(options.map_builder.collate_by_trajectory);
        // Fixes are processed on arrival: scans do not wait for them.
        let ordered = sensors.iter().filter(|s| s.kind != SensorKind::FixedFramePose).cloned().collect();
        collation.add_trajectory(TRAJECTORY, &ordered, &options.trajectory_builder);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(settings.threads).build()?;
        let searcher = Searcher { map, pool };
        let start = settings.start.map(|s| (s.map_from_tracking, (s.sigma_metres, s.sigma_radians)));
        Ok(Self {
            collation,
            local_slam: M::Space::new_local_slam(options, &ranges)?,
            finder: Finder::new(searcher, start).counting_changes(),
            track: settings.keeps_track.then(LocalTrack::default),
            sweeps: Vec::new(),
        })
    }

    fn add_here(&mut self, sensor_id: &SensorId, measurement: Measurement) -> Vec<Estimate> {
        if sensor_id.kind == SensorKind::FixedFramePose {
            return Vec::new();
        }
        let ready = self.collation.add(TRAJECTORY, sensor_id, measurement);
        ready.into_iter().flat_map(|(_, id, measurement)| self.dispatch(&id, measurement)).collect()
    }

    fn finish_here(&mut self) -> Vec<Estimate> {
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

    fn grow_here(
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

    fn issues_here(&self) -> IssueLog {
        let mut issues = self.local_slam.issues();
        issues.append(&self.collation.issues());
        issues
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
            let local = LocalScan::of(&scan);
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
