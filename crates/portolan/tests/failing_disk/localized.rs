//! What `localize` leaves, and the map that grows.

use std::path::{Path, PathBuf};

use portolan::RequestedOptions;
use portolan::geometry::{Rigid3, Time};
use portolan::ingest::IngestOptions;
use portolan::job::{
    LOCALIZED_FILES, LocalizeRequest, LocalizedRecording, MapRequest, OutputFolder, SaveMap, SavedMap, Start,
    localize, map, unobserved, write_localized,
};
use portolan::localization::{Change, ChangeKind, Growth, Jumps, StartPose};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;
use portolan_atomic_file::faults::{Failure, Fault, Run, fail_at, fail_everywhere, mend, whole_disk};
use portolan_spool::Spool;
use portolan_testing::is_fast;

use crate::{Content, assert_at_least, compared};

/// A map and the drive that it was made of.
struct Known {
    drive: Simulation,
    folder: tempfile::TempDir,
}

impl Known {
    fn new(seconds: f64) -> Self {
        let options = ScenarioOptions { duration: Some(seconds), ..ScenarioOptions::new(Scene::Office, 1) };
        let drive = Simulation::new(options).unwrap();
        let folder = tempfile::tempdir().unwrap();
        map(&drive, MapRequest::new(folder.path()), &mut unobserved).unwrap();
        Self { drive, folder }
    }

    fn map(&self) -> PathBuf {
        self.folder.path().join("map.pbstream")
    }

    /// Its own drive in this map, which starts where the map does.
    fn request(&self, map: &Path, folder: &Path) -> LocalizeRequest {
        LocalizeRequest {
            map: map.to_owned(),
            folder: folder.to_owned(),
            ingest: IngestOptions::default(),
            requested: RequestedOptions::default(),
            start: Some(Start::At(StartPose::new(Rigid3::identity()))),
            jumps: Some(Jumps::Smooth),
            save_map: None,
            threads: 1,
        }
    }
}

/// Results of a run: the later one found a change, and so many places that they wait in a file in this folder.
fn results(found: &LocalizedRecording, folder: &Path, run: Run) -> LocalizedRecording {
    let change = Change {
        kind: ChangeKind::Gone,
        rings: vec![vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]],
        area: 0.5,
        heights: None,
        seen: (Time::from_ros(1, 0), Time::from_ros(2, 0)),
        scans: 7,
    };
    let (count, changes) = if run == Run::Earlier { (10, Vec::new()) } else { (700, vec![change]) };
    let once: Vec<_> = found.estimates.iter().collect();
    let mut estimates = Spool::in_folder(folder);
    once.iter().cycle().take(count).for_each(|estimate| estimates.push(*estimate));
    LocalizedRecording {
        estimates,
        dimension: found.dimension,
        plan: found.plan.clone(),
        start: found.start,
        starts_at_fix: found.starts_at_fix,
        jumps: found.jumps,
        start_agrees: found.start_agrees,
        changes,
        issues: found.issues.clone(),
        recorded_times: found.recorded_times.clone(),
        textures: found.textures.clone(),
        saved_map: None,
        interrupted: false,
    }
}

#[test]
fn a_failing_disk_leaves_complete_files_of_localisation() {
    let _disk = whole_disk();
    let known = Known::new(2.0);
    let waiting = tempfile::tempdir().unwrap();
    let request = known.request(&known.map(), waiting.path());
    let mut found = localize(&known.drive, &request, &mut unobserved).unwrap();
    // Pictures of two cells are drawn sooner.
    found.textures = Content::new(Run::Later, 0.5).textures;
    let write = |folder: &Path, run: Run| -> Result<(), Failure> {
        let folder = OutputFolder::begin(folder, "localize", &LOCALIZED_FILES, false, &mut unobserved)?;
        let results = results(&found, waiting.path(), run);
        let files = write_localized(&results, &folder, 1.0, &mut unobserved)?;
        assert_eq!(files.len(), LOCALIZED_FILES.len());
        Ok(())
    };
    assert_at_least(70, fail_everywhere(&[Fault::BrokenOnce], compared, write));
}

#[test]
fn a_failing_disk_leaves_the_known_or_the_extended_map() {
    if is_fast() {
        return;
    }
    let _disk = whole_disk();
    let known = Known::new(12.0);
    let before = std::fs::read(known.map()).unwrap();
    // The map takes the place of the known one.
    let grow = |at: u64, fault: Fault| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.pbstream");
        std::fs::write(&path, &before).unwrap();
        let save_map = Some(SaveMap { path: path.clone(), growth: Growth::Extend });
        let request = LocalizeRequest { save_map, ..known.request(&path, folder.path()) };
        fail_at(at, fault);
        let saved = localize(&known.drive, &request, &mut unobserved).map(|found| found.saved_map);
        let operations = mend();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "{fault:?} at {at}");
        let left = std::fs::read(&path).unwrap();
        match saved {
            Ok(saved) => assert!(matches!(saved, Some(SavedMap::Written { .. })), "{saved:?}"),
            Err(error) => {
                let text = error.to_string();
                assert!(left == before, "{fault:?} at {at}");
                assert!(text.contains("map.pbstream") && text.contains("os error"), "{text}");
            }
        }
        (left, operations)
    };
    let (grown, operations) = grow(u64::MAX, Fault::Full);
    assert!(grown != before);
    assert_at_least(6, operations);
    for at in 0..operations {
        let (left, _) = grow(at, Fault::BrokenOnce);
        assert!(left == before || left == grown, "at {at}");
    }
}
