//! Maps that simulated drives are added to, and that are brought up to date by them.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::known;

use std::path::Path;
use std::sync::OnceLock;

use known::{Known, changed, grown, request};
use portolan::geometry::{Duration, Rigid3, Vector2, Vector3};
use portolan::job::{LocalizeRequest, LocalizedRecording, SaveMap, SavedMap, localize, unobserved};
use portolan::localization::{ChangeKind, Growth, GrowthError};
use portolan::mapfile::{LoadedMap, MapLoadSettings, info, read_map_2d};
use portolan::mapping::Space2d;
use portolan::pbstream::MapReader;
use portolan::recording::Recording;
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::{FloorPlan, Material, Scene, Shape};

fn options(day: u64, seconds: f64) -> ScenarioOptions {
    ScenarioOptions {
        building_seed: Some(1),
        duration: Some(seconds),
        people: Some(1),
        ..ScenarioOptions::new(Scene::Office, day)
    }
}

/// The building with barrels in open places of its floor: another set stands elsewhere.
fn plan_with_barrels(set: usize) -> FloorPlan {
    let drive = Simulation::new(options(1, 180.0)).unwrap();
    let mut plan = drive.plan().clone();
    let beside = |second: usize, side: f64| {
        let time = drive.start_time() + Duration::from_seconds(second as f64);
        let pose = drive.truth_at(time).unwrap();
        (pose.translation.vector + pose.rotation * Vector3::new(0.0, side, 0.0)).xy()
    };
    let places = (5..175).flat_map(|second| [1.1, -1.1].map(|side| beside(second, side)));
    let mut open: Vec<Vector2> = Vec::new();
    for place in places {
        let is_open = plan.shapes.iter().all(|shape| shape.distance(&place) > 0.75);
        if is_open && open.iter().all(|other| (other - place).norm() > 2.0) {
            open.push(place);
        }
    }
    for centre in open.into_iter().skip(set).step_by(3) {
        plan.shapes.push(Shape::circle(centre, 0.25, Material::Furniture));
    }
    plan
}

/// A drive of a day through the building with a set of barrels.
fn drive(day: u64, set: usize, seconds: f64) -> Simulation {
    Simulation::in_plan(options(day, seconds), plan_with_barrels(set)).unwrap()
}

/// A map of the building with the first set of barrels.
fn known() -> &'static Known {
    static KNOWN: OnceLock<Known> = OnceLock::new();
    KNOWN.get_or_init(|| Known::new(&drive(1, 0, 180.0)))
}

fn find(
    recording: &dyn Recording,
    map: &Path,
    save: Option<(&Path, Growth)>,
    threads: usize,
) -> LocalizedRecording {
    let save_map = save.map(|(path, growth)| SaveMap { path: path.to_owned(), growth });
    let request = LocalizeRequest { save_map, threads, ..request(map) };
    localize(recording, &request, &mut unobserved).unwrap()
}

fn read(path: &Path) -> LoadedMap<Space2d> {
    read_map_2d(path, &MapLoadSettings::default()).unwrap()
}

/// The poses of the first trajectory of a map.
fn first_poses(map: &LoadedMap<Space2d>) -> Vec<(u32, Rigid3)> {
    let nodes = map.graph.state().nodes.iter().filter(|(id, _)| id.trajectory_id.0 == 0);
    nodes.map(|(id, node)| (id.index, node.map_from_tracking)).collect()
}

#[test]
fn a_recording_becomes_a_trajectory_of_the_map_it_was_localised_in() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("both.pbstream");
    let today = drive(2, 0, 60.0);
    let found = find(&today, &known().map(), Some((&path, Growth::Extend)), 1);
    let grown = grown(&found);
    assert!(grown.extension.submaps >= 3 && grown.extension.ties > 20, "{grown:?}");
    assert!(grown.extension.median_correction < 0.05, "{grown:?}");
    let (before, after) = (read(&known().map()), read(&path));
    assert!(after.issues.iter().next().is_none(), "{:?}", after.issues);
    assert!(first_poses(&before) == first_poses(&after), "the frame of the old map is kept");
    let new = after.graph.state().nodes.iter().filter(|(id, _)| id.trajectory_id.0 == 1);
    let errors: Vec<f64> = new
        .map(|(_, node)| {
            let truth = known().world_from_map.inverse() * today.truth_at(node.data.time).unwrap();
            (truth.inverse() * node.map_from_tracking).translation.vector.norm()
        })
        .collect();
    let worst = errors.iter().copied().fold(0.0, f64::max);
    assert!(errors.len() > 50 && worst < 0.2, "{} nodes, {worst} m", errors.len());
    let ties = after.graph.state().constraints.iter().filter(|c| c.node_id.trajectory_id.0 == 1);
    assert!(ties.filter(|c| c.submap_id.trajectory_id.0 == 0).count() == grown.extension.ties);
}

#[test]
fn moved_furniture_is_moved_in_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("updated.pbstream");
    let found = find(&drive(2, 1, 120.0), &known().map(), Some((&path, Growth::Renew)), 1);
    let renewal = grown(&found).renewal.unwrap();
    assert!(renewal.appeared > 0.3 && renewal.gone > 0.3, "{renewal:?}");
    let next_day = drive(3, 1, 90.0);
    let [in_old, in_new] = [known().map(), path].map(|map| find(&next_day, &map, None, 1));
    for kind in [ChangeKind::Appeared, ChangeKind::Gone] {
        let [old, new] = [&in_old, &in_new].map(|found| changed(found, kind));
        assert!(old > 0.3 && new < 0.35 * old, "{kind:?}: {old} m² in the old map, {new} m² in the new one");
    }
    let [old, new] = [&in_old, &in_new].map(|found| known().error(&next_day, found));
    assert!(new < old + 0.02, "{old} m in the old map, {new} m in the new one");
}

#[test]
fn an_unchanged_building_does_not_change_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("updated.pbstream");
    let found = find(&drive(2, 0, 120.0), &known().map(), Some((&path, Growth::Renew)), 1);
    let renewal = grown(&found).renewal.unwrap();
    assert!(renewal.appeared < 0.2 && renewal.gone < 0.2, "{renewal:?}");
    assert!(renewal.removed_submaps <= 5, "{renewal:?}");
    let (before, after) = (read(&known().map()), read(&path));
    let kept = first_poses(&after);
    let old = first_poses(&before);
    assert!(kept.iter().all(|pose| old.contains(pose)), "what stays keeps its pose");
    assert!(kept.len() as f64 > 0.8 * old.len() as f64, "{} of {} nodes", kept.len(), old.len());
}

#[test]
fn ten_updates_do_not_let_a_map_grow() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("living.pbstream");
    std::fs::copy(known().map(), &path).unwrap();
    let mut sizes = Vec::new();
    let mut error = 0.0;
    for update in 0..10 {
        let today = drive(2 + update % 5, update as usize % 3, 30.0);
        let found = find(&today, &path, Some((&path, Growth::Renew)), 1);
        error = known().error(&today, &found);
        let map = info(&mut MapReader::open(&path).unwrap()).unwrap();
        let submaps: usize = read(&path).graph.state().submaps.len();
        sizes.push((std::fs::metadata(&path).unwrap().len(), submaps, map.trajectories.len()));
    }
    let largest = |range: std::ops::Range<usize>| sizes[range].iter().map(|s| s.0).max().unwrap();
    assert!(largest(6..10) as f64 <= 1.1 * largest(2..6) as f64, "{sizes:?}");
    assert!(error < 0.1, "{error} m after ten updates");
}

#[test]
fn a_map_of_another_building_is_not_touched() {
    let folder = tempfile::tempdir().unwrap();
    let elsewhere = ScenarioOptions { building_seed: Some(2), ..options(2, 40.0) };
    let elsewhere = Simulation::new(elsewhere).unwrap();
    for growth in [Growth::Extend, Growth::Renew] {
        let path = folder.path().join("never.pbstream");
        let found = find(&elsewhere, &known().map(), Some((&path, growth)), 1);
        assert_eq!(found.saved_map, Some(SavedMap::Refused(GrowthError::NeverLocalised)));
        assert!(!path.exists());
    }
}

#[test]
fn maps_do_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let today = drive(2, 1, 25.0);
    for growth in [Growth::Extend, Growth::Renew] {
        let files = [1, 2, 4].map(|threads| {
            let path = folder.path().join(format!("{threads}.pbstream"));
            grown(&find(&today, &known().map(), Some((&path, growth)), threads));
            std::fs::read(path).unwrap()
        });
        assert!(files[0] == files[1] && files[0] == files[2], "{growth:?}");
    }
}
