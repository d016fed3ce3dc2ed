//! Localises a recording in a known map while it is being mapped.

use std::collections::BTreeMap;

use portolan_geometry::{Rigid3, Time};
use portolan_mapping::{FoundPlace, GraphState, MatchingResult, Placement, Space, Space3d, SubmapId};

use crate::finder::{Finder, LocalScan};
use crate::known_map::KnownMap;
use crate::known_map_3d::KnownMap3d;
use crate::localizer::StartPose;
use crate::search::Searcher;
use crate::state::Estimate;
use crate::trust::trusted_spans;

/// Localises the scans of a recording that is being mapped, in a map that was known before.
pub trait PlaceTracker<S: Space>: Send {
    /// Takes a scan from local SLAM; returns its place in the map, if it is known by now.
    fn add(&mut self, scan: &MatchingResult<S>) -> Option<FoundPlace>;
    /// Places of scans that are as certain as a match to the map, and that no contradiction soon after calls
    /// into question.
    fn found(&self) -> Vec<FoundPlace>;
    /// Poses of the submaps of the known map when it was loaded.
    fn known_submaps(&self) -> &BTreeMap<SubmapId, Rigid3>;
}

/// A tracker in a known 3D map; none if scans cannot be localised in this map, or no threads can be started
/// (0: as many as there are cores).
pub fn place_tracker_3d(
    known: &GraphState<Space3d>,
    start: Option<StartPose>,
    threads: usize,
) -> Option<Box<dyn PlaceTracker<Space3d>>> {
    let map = KnownMap3d::new(known).ok()?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().ok()?;
    let start = start.map(|s| (s.map_from_tracking, (s.sigma_metres, s.sigma_radians)));
    let submaps = known.submaps.keys().filter_map(|id| Some((*id, known.map_from_submap(*id)?)));
    Some(Box::new(Tracker {
        finder: Finder::new(Searcher { map, pool }, start),
        estimates: Vec::new(),
        placements: Vec::new(),
        submaps: submaps.collect(),
    }))
}

struct Tracker<M: KnownMap> {
    finder: Finder<M>,
    estimates: Vec<Estimate>,
    placements: Vec<FoundPlace>,
    submaps: BTreeMap<SubmapId, Rigid3>,
}

impl<M: KnownMap> PlaceTracker<M::Space> for Tracker<M> {
    fn add(&mut self, scan: &MatchingResult<M::Space>) -> Option<FoundPlace> {
        let estimate = self.finder.add(&LocalScan::of(scan));
        let found = match estimate.placement(M::CERTAIN_PLACE) {
            Placement::Found(map_from_tracking) => Some(FoundPlace { time: scan.time, map_from_tracking }),
            _ => None,
        };
        self.placements.extend(found);
        self.estimates.push(estimate);
        found
    }

    fn found(&self) -> Vec<FoundPlace> {
        let spans = trusted_spans(&self.estimates);
        let is_trusted = |time: &Time| spans.iter().any(|(first, last)| (first..=last).contains(&time));
        self.placements.iter().filter(|place| is_trusted(&place.time)).copied().collect()
    }

    fn known_submaps(&self) -> &BTreeMap<SubmapId, Rigid3> {
        &self.submaps
    }
}
