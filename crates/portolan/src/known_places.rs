//! Finds a recording that is being mapped in a known map.

use portolan_config::{Engine, Options};
use portolan_geometry::Rigid3;
use portolan_localization::{PlaceTracker, StartPose, place_tracker_3d};
use portolan_mapping::{GraphState, Mapper, MapperError, MatchingResult, Space, Space2d, Space3d};

use crate::pipeline::KnownMap;

/// A space in whose known maps recordings can be found while they are mapped.
pub trait KnownMapSpace: Space {
    /// Tracker that finds scans in a known map, from a start if it is known (`map_from_tracking`). None where
    /// loop closures suffice.
    fn place_tracker(
        known: &GraphState<Self>,
        start: Option<Rigid3>,
        options: &Options,
        threads: usize,
    ) -> Option<Box<dyn PlaceTracker<Self>>>;
}

impl KnownMapSpace for Space2d {
    fn place_tracker(
        _: &GraphState<Self>,
        _: Option<Rigid3>,
        _: &Options,
        _: usize,
    ) -> Option<Box<dyn PlaceTracker<Self>>> {
        None
    }
}

impl KnownMapSpace for Space3d {
    fn place_tracker(
        known: &GraphState<Self>,
        start: Option<Rigid3>,
        options: &Options,
        threads: usize,
    ) -> Option<Box<dyn PlaceTracker<Self>>> {
        let is_wanted = options.engine() == Engine::Planes && !known.submaps.is_empty();
        is_wanted.then(|| place_tracker_3d(known, start.map(StartPose::new), threads))?
    }
}

/// Finds the pose of a recording in a known map while it is mapped, and reports it to the pose graph.
pub(crate) struct KnownPlaces<S: KnownMapSpace> {
    tracker: Option<Box<dyn PlaceTracker<S>>>,
}

impl<S: KnownMapSpace> KnownPlaces<S> {
    /// For a known map, if its pose graph alone does not find places as well; from its start, if known.
    pub fn new(known: &KnownMap<S>, options: &Options, threads: usize) -> Self {
        Self { tracker: S::place_tracker(known.graph.state(), known.start, options, threads) }
    }

    /// From now on the pose graph receives the poses found by the tracker.
    pub fn begin(&self, mapper: &mut Mapper<S>) -> Result<(), MapperError> {
        let Some(tracker) = &self.tracker else { return Ok(()) };
        let known = tracker.known_submaps().clone();
        mapper.enqueue_pose_graph_work(move |graph| graph.leave_to_tracker(known))
    }

    /// Adds the matching results of scans.
    pub fn add(&mut self, scans: &[MatchingResult<S>], mapper: &mut Mapper<S>) -> Result<(), MapperError> {
        let Some(tracker) = &mut self.tracker else { return Ok(()) };
        for scan in scans {
            let found = tracker.add(scan);
            if let Some(place) = found.filter(|_| scan.inserted.is_some()) {
                mapper.enqueue_pose_graph_work(move |graph| graph.look_where_found(&place))?;
            }
        }
        Ok(())
    }

    /// After all scans: connects unambiguous matches to the known map.
    pub fn finish(self, mapper: &mut Mapper<S>) -> Result<(), MapperError> {
        let Some(tracker) = self.tracker else { return Ok(()) };
        let found = tracker.found();
        mapper.enqueue_pose_graph_work(move |graph| {
            graph.tie_found(&found);
        })
    }
}
