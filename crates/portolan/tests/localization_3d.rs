//! Finding simulated walks in saved 3D maps, and not finding them in those of other places.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::known;

use known::{Known, garage, museum, request, walk};
use portolan::job::{
    Found, LOCALIZED_FILES, LocalizeRequest, LocalizedRecording, OutputFolder, SaveMap, SavedMap, Start,
    localize, unobserved, write_localized,
};
use portolan::localization::{Growth, KnownMap3d, KnownMapError, StartPose};
use portolan::mapfile::{MapLoadSettings, read_map};
use portolan::mapping::{GraphState, Space3d};
use portolan::simulator::Simulation3d;
use portolan::worlds::three_d::Scene3d;

fn in_map(known: &Known) -> LocalizeRequest {
    LocalizeRequest { threads: 2, ..request(&known.map()) }
}

fn find(known: &Known, walk: &Simulation3d, start: Option<StartPose>) -> LocalizedRecording {
    let request = LocalizeRequest { start: start.map(Start::At), ..in_map(known) };
    localize(walk, &request, &mut unobserved).unwrap()
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn walks_are_found_without_a_start() {
    for (scene, known) in [(Scene3d::Museum, museum()), (Scene3d::Garage, garage())] {
        let today = walk(scene, 1, 2, 15.0);
        let found = find(known, &today, None);
        assert_ne!(found.found(), Found::Never, "{scene:?}: {:?}", found.state_counts());
        let errors = known.errors(&today, &found);
        let middle = median(errors.iter().map(|e| e.1));
        assert!(errors.len() > 50 && middle < 0.1, "{scene:?}: {} poses, {middle} m", errors.len());
        assert!(errors.iter().all(|e| e.1 < 0.5 && e.2 < 0.17), "{scene:?}: {errors:?}");
        let elsewhere = match scene {
            Scene3d::Museum => walk(scene, 2, 2, 8.0),
            // Car parks differ in their cars alone.
            _ => walk(Scene3d::Museum, 1, 2, 8.0),
        };
        let elsewhere = find(known, &elsewhere, None);
        assert_eq!(elsewhere.found(), Found::Never, "{scene:?}: {:?}", elsewhere.state_counts());
    }
}

#[test]
fn a_walk_becomes_a_trajectory_of_the_map() {
    let known = museum();
    let today = walk(Scene3d::Museum, 1, 2, 25.0);
    let folder = tempfile::tempdir().unwrap();
    let request = |growth| {
        let save_map = Some(SaveMap { path: folder.path().join("both.pbstream"), growth });
        LocalizeRequest { save_map, ..in_map(known) }
    };
    let found = localize(&today, &request(Growth::Extend), &mut unobserved).unwrap();
    let Some(SavedMap::Written { path, grown }) = found.saved_map else { panic!("{:?}", found.saved_map) };
    assert!(grown.extension.ties > 5 && grown.extension.median_correction < 0.1, "{grown:?}");
    let both = read_map::<Space3d>(path, &MapLoadSettings::default()).unwrap();
    let new = both.graph.state().nodes.iter().filter(|(id, _)| id.trajectory_id == grown.trajectory_id);
    let errors = new.map(|(_, node)| {
        let truth = known.world_from_map.inverse() * today.truth_at(node.data.time).unwrap();
        (truth.inverse() * node.map_from_tracking).translation.vector.norm()
    });
    let errors: Vec<f64> = errors.collect();
    assert!(errors.len() > 10 && errors.iter().all(|e| *e < 0.3), "{errors:?}");
}

#[test]
fn a_car_park_with_other_cars_is_recognised() {
    let known = garage();
    let today = walk(Scene3d::Garage, 2, 2, 8.0);
    let found = find(known, &today, None);
    let errors = known.errors(&today, &found);
    assert!(errors.iter().all(|e| e.1 < 0.5 && e.2 < 0.17), "{errors:?}");
}

#[test]
fn files_do_not_depend_on_the_number_of_threads_and_have_six_dimensions() {
    let known = museum();
    let today = walk(Scene3d::Museum, 1, 1, 8.0);
    let files = [1, 2, 4].map(|threads| {
        let request = LocalizeRequest { threads, ..in_map(known) };
        let found = localize(&today, &request, &mut unobserved).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let output = OutputFolder::begin(folder.path(), "localize", &LOCALIZED_FILES, false, &mut unobserved);
        write_localized(&found, &output.unwrap(), 0.0, &mut unobserved).unwrap();
        ["poses.tum", "poses.csv", "path.png", "report.json"]
            .map(|name| std::fs::read(folder.path().join(name)).unwrap())
    });
    assert!(files[0] == files[1] && files[0] == files[2]);
    let table = String::from_utf8(files[0][1].clone()).unwrap();
    let columns: Vec<usize> = table.lines().map(|line| line.split(',').count()).collect();
    assert!(columns.len() > 20 && columns.iter().all(|c| *c == 3 + 6 + 21 + 3), "{columns:?}");
}

#[test]
fn empty_maps_are_reported() {
    let empty = KnownMap3d::new(&GraphState::<Space3d>::default());
    assert!(matches!(empty, Err(KnownMapError::Empty)));
}
