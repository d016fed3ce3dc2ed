//! What finds a recording that is mapped in a map that was known before.

use portolan_config::{Engine, Options};
use portolan_geometry::Rigid3;
use portolan_localization::{PlaceTracker, StartPose, place_tracker_3d};
use portolan_mapping::{GraphState, Mapper, MapperError, MatchingResult, Space, Space2d, Space3d};

use crate::pipeline::KnownMap;

/// A space in whose known maps recordings are found while they are mapped.
pub trait KnownMapSpace: Space {
    /// What finds scans in a known map from a start that may be known (`map_from_tracking`), where loop closures do not tell as much.
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

/// Where a recording lies in a known map, told to the pose graph while it is mapped.
pub(crate) struct KnownPlaces<S: KnownMapSpace> {
    tracker: Option<Box<dyn PlaceTracker<S>>>,
}

impl<S: KnownMapSpace> KnownPlaces<S> {
    /// In a map, if its pose graph does not find places as well by itself; from a start that may be known.
    pub fn new(known: &KnownMap<S>, options: &Options, threads: usize) -> Self {
        Self { tracker: S::place_tracker(known.graph.state(), known.start, options, threads) }
    }

    /// From now on the pose graph is told where the recording is.
    pub fn begin(&self, mapper: &mut Mapper<S>) -> Result<(), MapperError> {
        let Some(tracker) = &self.tracker else { return Ok(()) };
        let known = tracker.known_submaps().clone();
        mapper.tell_pose_graph(move |graph| graph.leave_to_tracker(known))
    }

    /// Takes what became of scans.
    pub fn add(&mut self, scans: &[MatchingResult<S>], mapper: &mut Mapper<S>) -> Result<(), MapperError> {
        let Some(tracker) = &mut self.tracker else { return Ok(()) };
        for scan in scans {
            let found = tracker.add(scan);
            if let Some(place) = found.filter(|_| scan.inserted.is_some()) {
                mapper.tell_pose_graph(move |graph| graph.look_where_found(&place))?;
            }
        }
        Ok(())
    }

    /// All scans were there: what was found without a doubt is tied to the known map.
    pub fn finish(self, mapper: &mut Mapper<S>) -> Result<(), MapperError> {
        let Some(tracker) = self.tracker else { return Ok(()) };
        let found = tracker.found();
        mapper.tell_pose_graph(move |graph| {
            graph.tie_found(&found);
        })
    }
}
