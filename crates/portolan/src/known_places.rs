//! What finds a recording that is mapped in a map that was known before.

use portolan_config::{Engine, Options};
use portolan_geometry::Rigid3;
use portolan_localization::{PlaceTracker, StartPose, place_tracker_in_space};
use portolan_mapping::{GraphState, Planar, Space, Spatial};

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

impl KnownMapSpace for Planar {
    fn place_tracker(
        _: &GraphState<Self>,
        _: Option<Rigid3>,
        _: &Options,
        _: usize,
    ) -> Option<Box<dyn PlaceTracker<Self>>> {
        None
    }
}

impl KnownMapSpace for Spatial {
    fn place_tracker(
        known: &GraphState<Self>,
        start: Option<Rigid3>,
        options: &Options,
        threads: usize,
    ) -> Option<Box<dyn PlaceTracker<Self>>> {
        let is_wanted = options.engine() == Engine::Planes && !known.submaps.is_empty();
        is_wanted.then(|| place_tracker_in_space(known, start.map(StartPose::new), threads))?
    }
}
