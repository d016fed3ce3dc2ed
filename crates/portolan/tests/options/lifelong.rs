//! Round and round in one hall: what is kept follows the area, not the time.

use std::collections::BTreeSet;

use portolan::config::Options;
use portolan::geometry::{Rigid3, Time};
use portolan::mapping::{Map, Mapper, MapperSettings, Space, Space2d, Space3d};
use portolan::sensor::{Measurement, SensorKind};

use crate::run::sensor;
use crate::world::{at, distance, on_circle};

/// A map, and at which times it was matched.
struct Mapped<S: Space> {
    map: Map<S>,
    times: Vec<Time>,
}

fn mapped<S: Space>(options: &Options, measurements: Vec<Measurement>, threads: usize) -> Mapped<S> {
    let folder = tempfile::tempdir().unwrap();
    let mut mapper =
        Mapper::<S>::new(options, MapperSettings { threads, ..MapperSettings::default() }).unwrap();
    mapper.spool_in(folder.path()).unwrap();
    let kinds: BTreeSet<SensorKind> = measurements.iter().map(Measurement::kind).collect();
    let id = mapper.add_trajectory(&kinds.into_iter().map(sensor).collect(), None).unwrap();
    let mut times = Vec::new();
    for measurement in measurements {
        let results = mapper.add(id, &sensor(measurement.kind()), measurement).unwrap();
        times.extend(results.iter().map(|result| result.time));
    }
    times.extend(mapper.finish_trajectory(id).unwrap().iter().map(|result| result.time));
    Mapped { map: mapper.finish().unwrap().0, times }
}

impl<S: Space> Mapped<S> {
    /// Nodes, submaps and constraints.
    fn sizes(&self) -> [usize; 3] {
        let state = self.map.graph.state();
        [state.nodes.len(), state.submaps.len(), state.constraints.len()]
    }

    fn poses(&self) -> Vec<(Time, Rigid3)> {
        let state = self.map.graph.state();
        state.trajectories.keys().flat_map(|id| self.map.scan_poses(*id)).collect()
    }

    /// How far poses are from where the scans were taken, root mean square; every scan has one.
    fn error(&self) -> f64 {
        let poses = self.poses();
        assert!(poses.iter().map(|(time, _)| time).eq(&self.times), "{} scans", self.times.len());
        let off = |time: &Time, pose: &Rigid3| distance(pose, &on_circle(time.seconds_since(at(0.0))));
        let squares: f64 = poses.iter().map(|(time, pose)| off(time, pose).powi(2)).sum();
        (squares / poses.len() as f64).sqrt()
    }
}

fn check_rounds<S: Space>(options: &Options, laps: fn(u32) -> Vec<Measurement>, steps: u32) {
    let mut lifelong = options.clone();
    lifelong.set("portolan.submaps_per_place=1").unwrap();
    let [short, long] = [steps, 2 * steps].map(|steps| mapped::<S>(&lifelong, laps(steps), 1));
    for (short, long) in short.sizes().into_iter().zip(long.sizes()) {
        // Those that are being filled come and go.
        assert!(4 * long <= 5 * short, "{short}, {long}");
    }
    let ([nodes, ..], scans) = (long.sizes(), long.times.len());
    assert!(3 * nodes < scans, "{nodes} of {scans}");
    let everything = mapped::<S>(options, laps(2 * steps), 1);
    let (error, of_everything) = (long.error(), everything.error());
    assert!(error < 1.5 * of_everything + 0.05, "{error} m, {of_everything} m with everything kept");
    let threads = mapped::<S>(&lifelong, laps(2 * steps), 3);
    assert_eq!(threads.sizes(), long.sizes());
    assert!(threads.poses() == long.poses());
    assert!(threads.map.graph.state().constraints == long.map.graph.state().constraints);
}

#[test]
fn in_2d_the_graph_is_bounded_and_the_trajectory_whole() {
    let mut options = crate::graph::base();
    options.map_builder.pose_graph.optimize_every_n_nodes = 12;
    check_rounds::<Space2d>(&options, crate::graph::laps, 110);
}

#[test]
fn in_3d_the_graph_is_bounded_and_the_trajectory_whole() {
    let mut options = crate::graph_3d::base();
    options.map_builder.pose_graph.optimize_every_n_nodes = 12;
    check_rounds::<Space3d>(&options, crate::graph_3d::laps, 70);
}
