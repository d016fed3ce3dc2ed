//! What tests of localisation share: a map of a simulated day, its pose in the world, and the errors of other
//! days found in it.

#![allow(clippy::unwrap_used, clippy::panic)] // failures of tests are panics

pub mod gap;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use portolan::RequestedOptions;
use portolan::geometry::{Quaternion, Rigid3, Time, Vector3, nalgebra, rotation_angle};
use portolan::ingest::IngestOptions;
use portolan::job::{LocalizeRequest, LocalizedRecording, MapRequest, SavedMap, map, unobserved};
use portolan::localization::{ChangeKind, Grown, State};
use portolan::recording::Recording;
use portolan::simulator::{Scenario3dOptions, Simulation, Simulation3d};
use portolan::worlds::three_d::Scene3d;

/// A recording of which the truth is known.
pub trait Day: Recording {
    /// The tracking frame in the world.
    fn truth(&self, time: Time) -> Option<Rigid3>;
}

impl Day for Simulation {
    fn truth(&self, time: Time) -> Option<Rigid3> {
        self.truth_at(time)
    }
}

impl Day for Simulation3d {
    fn truth(&self, time: Time) -> Option<Rigid3> {
        self.truth_at(time)
    }
}

/// A map, and its pose in the world.
pub struct Known {
    folder: tempfile::TempDir,
    pub world_from_map: Rigid3,
}

impl Known {
    /// The map of a day.
    pub fn new(first_day: &dyn Day) -> Self {
        // Maps that all tests share are never dropped: what is left of them is in a folder that `.ci/run` empties.
        let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
        map(first_day, MapRequest::new(folder.path()), &mut unobserved).unwrap();
        let trajectory = std::fs::read_to_string(folder.path().join("trajectory.tum")).unwrap();
        let line = trajectory.lines().next().unwrap();
        let first: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
        let rotation = nalgebra::Quaternion::new(first[7], first[4], first[5], first[6]);
        let place = Vector3::new(first[1], first[2], first[3]);
        let map_from_tracking = Rigid3::from_parts(place.into(), Quaternion::from_quaternion(rotation));
        let truth = first_day.truth(Time::from_unix_seconds(first[0])).unwrap();
        Self { folder, world_from_map: truth * map_from_tracking.inverse() }
    }

    pub fn map(&self) -> PathBuf {
        self.folder.path().join("map.pbstream")
    }

    /// The tracking frame in the map.
    pub fn truth(&self, day: &dyn Day, time: Time) -> Option<Rigid3> {
        Some(self.world_from_map.inverse() * day.truth(time)?)
    }

    /// Metres and radians by which localised poses are off, with their times.
    pub fn errors(&self, day: &dyn Day, found: &LocalizedRecording) -> Vec<(Time, f64, f64)> {
        let localised = found.estimates.iter().filter(|e| e.state == State::Localised);
        let off = localised.filter_map(|e| {
            let error = self.truth(day, e.time)?.inverse() * e.place?.map_from_tracking;
            Some((e.time, error.translation.vector.norm(), rotation_angle(&error)))
        });
        off.collect()
    }

    /// The median of the metres by which localised poses are off.
    pub fn error(&self, day: &dyn Day, found: &LocalizedRecording) -> f64 {
        let mut off: Vec<f64> = self.errors(day, found).iter().map(|(_, metres, _)| *metres).collect();
        off.sort_by(f64::total_cmp);
        off[off.len() / 2]
    }
}

/// A walk through a place in 3D; another day, another path through it. In a car park the cars of another
/// building stand in other places.
pub fn walk(scene: Scene3d, building: u64, day: u64, seconds: f64) -> Simulation3d {
    let mut options = Scenario3dOptions::new(scene, day, 1);
    options.building_seed = Some(building);
    options.duration = Some(seconds);
    for lidar in &mut options.lidars {
        lidar.beams.columns = 450;
    }
    Simulation3d::new(options).unwrap()
}

/// The map of a museum, made once for all tests.
pub fn museum() -> &'static Known {
    static KNOWN: OnceLock<Known> = OnceLock::new();
    KNOWN.get_or_init(|| Known::new(&walk(Scene3d::Museum, 1, 1, 60.0)))
}

/// The map of a car park, made once for all tests.
pub fn garage() -> &'static Known {
    static KNOWN: OnceLock<Known> = OnceLock::new();
    KNOWN.get_or_init(|| Known::new(&walk(Scene3d::Garage, 1, 1, 40.0)))
}

/// What localises in a map without a start, on one thread.
pub fn request(map: &Path) -> LocalizeRequest {
    LocalizeRequest {
        map: map.to_owned(),
        folder: PathBuf::new(),
        ingest: IngestOptions::default(),
        requested: RequestedOptions::default(),
        start: None,
        jumps: None,
        save_map: None,
        threads: 1,
    }
}

/// What was written of a map that grew.
#[track_caller]
pub fn grown(found: &LocalizedRecording) -> Grown {
    match &found.saved_map {
        Some(SavedMap::Written { grown, .. }) => *grown,
        other => panic!("{other:?}"),
    }
}

/// Square metres that have changed.
pub fn changed(found: &LocalizedRecording, kind: ChangeKind) -> f64 {
    found.changes.iter().filter(|c| c.kind == kind).map(|c| c.area).sum()
}
