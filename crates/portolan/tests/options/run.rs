//! Short runs of the mapper and what may be observed of them.

use std::collections::BTreeSet;

use portolan::config::Options;
use portolan::geometry::Rigid3;
use portolan::issue::IssueLog;
use portolan::mapping::{Map, Mapper, MapperSettings, MatchingResult, Space, TrajectoryId};
use portolan::sensor::{Measurement, SensorId, SensorKind};

/// What came out of a run.
pub struct Run<S: Space> {
    pub results: Vec<MatchingResult<S>>,
    pub map: Map<S>,
    pub issues: IssueLog,
}

pub fn sensor(kind: SensorKind) -> SensorId {
    let name = match kind {
        SensorKind::Range => "scan",
        SensorKind::Imu => "imu",
        SensorKind::Odometry => "odom",
        SensorKind::FixedFramePose => "fix",
        SensorKind::Landmark => "landmark",
    };
    SensorId::new(kind, name)
}

/// A mapper on one thread; options that contradict each other end the test.
pub fn mapper<S: Space>(options: &Options) -> Mapper<S> {
    options.validate().unwrap_or_else(|errors| panic!("{errors:?}"));
    Mapper::new(options, MapperSettings { threads: 1, ..MapperSettings::default() })
        .unwrap_or_else(|error| panic!("{error}"))
}

/// Starts a trajectory with these kinds of sensors.
pub fn trajectory<S: Space>(mapper: &mut Mapper<S>, kinds: &[SensorKind]) -> TrajectoryId {
    let sensors: BTreeSet<SensorId> = kinds.iter().map(|kind| sensor(*kind)).collect();
    mapper.add_trajectory(&sensors, None).unwrap()
}

/// Maps measurements in the order given, as one trajectory.
pub fn run<S: Space>(options: &Options, measurements: Vec<Measurement>) -> Run<S> {
    let mut mapper = mapper::<S>(options);
    let kinds: BTreeSet<SensorKind> = measurements.iter().map(Measurement::kind).collect();
    let kinds: Vec<SensorKind> = kinds.into_iter().collect();
    let id = trajectory(&mut mapper, &kinds);
    let mut results = Vec::new();
    for measurement in measurements {
        results.extend(mapper.add(id, &sensor(measurement.kind()), measurement).unwrap());
    }
    results.extend(mapper.finish_trajectory(id).unwrap());
    let (map, issues) = mapper.finish().unwrap();
    Run { results, map, issues }
}

impl<S: Space> Run<S> {
    pub fn nodes(&self) -> f64 {
        self.map.graph.state().nodes.len() as f64
    }

    pub fn submaps(&self) -> f64 {
        self.map.graph.state().submaps.len() as f64
    }

    pub fn loops(&self) -> f64 {
        self.map.graph.state().constraints.iter().filter(|c| c.is_loop_closure()).count() as f64
    }

    /// Points of all scans that hit something.
    pub fn returns(&self) -> f64 {
        self.results.iter().map(|r| r.range_data_in_local.returns.len() as f64).sum()
    }

    /// Where local SLAM believes the last scan to be.
    pub fn last_pose(&self) -> Rigid3 {
        self.results.last().unwrap().local_from_tracking
    }

    /// The longest free-space ray of a scan, metres.
    pub fn longest_miss(&self) -> f64 {
        let lengths = self.results.iter().flat_map(|r| {
            let data = &r.range_data_in_local;
            data.misses.points.iter().map(move |p| f64::from((p - data.origin).norm()))
        });
        lengths.fold(0.0, f64::max)
    }

    /// Kinds of sensors whose measurements arrived in the graph's problem, by count.
    pub fn kept_odometry(&self) -> f64 {
        self.map.graph.problem().sensors.values().map(|s| s.odometry.len()).sum::<usize>() as f64
    }
}
