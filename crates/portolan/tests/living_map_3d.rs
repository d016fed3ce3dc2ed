//! 3D maps that are brought up to date by simulated walks.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::known;

use std::path::Path;

use known::{changed, garage, grown, request};
use portolan::job::{LocalizeRequest, LocalizedRecording, SaveMap, localize, unobserved};
use portolan::localization::{ChangeKind, Growth};
use portolan::mapfile::{MapLoadSettings, read_map};
use portolan::mapping::Space3d;
use portolan::simulator::Simulation3d;
use portolan::worlds::three_d::Scene3d;

/// A walk through a car park; the cars of another building stand in other places.
fn walk(cars: u64, day: u64, seconds: f64) -> Simulation3d {
    known::walk(Scene3d::Garage, cars, day, seconds)
}

fn find(today: &Simulation3d, map: &Path, update: Option<&Path>, threads: usize) -> LocalizedRecording {
    let save_map = update.map(|path| SaveMap { path: path.to_owned(), growth: Growth::Renew });
    let request = LocalizeRequest { save_map, threads, ..request(map) };
    localize(today, &request, &mut unobserved).unwrap()
}

#[test]
fn cars_that_moved_are_moved_in_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("updated.pbstream");
    let unchanged = find(&walk(1, 2, 22.0), &garage().map(), None, 2);
    let second_day = find(&walk(2, 2, 34.0), &garage().map(), Some(&path), 2);
    let renewal = grown(&second_day).renewal.unwrap();
    assert!(renewal.appeared > 1.0 && renewal.gone > 1.0, "{renewal:?}");
    let third_day = walk(2, 3, 22.0);
    let [in_old, in_new] = [garage().map(), path].map(|map| find(&third_day, &map, None, 2));
    for kind in [ChangeKind::Appeared, ChangeKind::Gone] {
        let [none, old, new] = [&unchanged, &in_old, &in_new].map(|found| changed(found, kind));
        println!("{kind:?}: {none} m² of nothing, {old} m² in the old map, {new} m² in the new one");
        assert!(none < 0.2 * old, "{kind:?}: {none} m² where nothing has changed, {old} m² where cars have");
        assert!(old > 1.0 && new < 0.4 * old, "{kind:?}: {old} m² in the old map, {new} m² in the new one");
    }
    let low = in_old.changes.iter().all(|c| c.heights.is_some_and(|[from, to]| from < to && to - from < 4.0));
    assert!(low, "cars are not as high as that: {:?}", in_old.changes);
    let [old, new] = [&in_old, &in_new].map(|found| garage().error(&third_day, found));
    println!("{old} m off in the old map, {new} m in the new one");
    assert!(new < old + 0.02, "{old} m in the old map, {new} m in the new one");
}

#[test]
fn updates_do_not_let_a_map_in_3d_grow() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("living.pbstream");
    std::fs::copy(garage().map(), &path).unwrap();
    let mut sizes = Vec::new();
    let mut error = 0.0;
    for update in 0..6 {
        let today = walk(1 + update % 3, 2 + update % 2, 18.0);
        let found = find(&today, &path, Some(&path), 2);
        error = garage().error(&today, &found);
        let graph = read_map::<Space3d>(&path, &MapLoadSettings::default()).unwrap().graph;
        let (submaps, nodes) = (graph.state().submaps.len(), graph.state().nodes.len());
        sizes.push((std::fs::metadata(&path).unwrap().len(), submaps, nodes));
    }
    println!("{sizes:?}, {error} m");
    let largest = |range: std::ops::Range<usize>| sizes[range].iter().map(|s| s.0).max().unwrap();
    assert!(largest(4..6) as f64 <= 1.05 * largest(1..4) as f64, "{sizes:?}");
    assert!(error < 0.1, "{error} m after six updates");
}

#[test]
fn updated_maps_in_3d_do_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let today = walk(2, 2, 18.0);
    let files = [1, 2, 4].map(|threads| {
        let path = folder.path().join(format!("{threads}.pbstream"));
        grown(&find(&today, &garage().map(), Some(&path), threads));
        std::fs::read(path).unwrap()
    });
    assert!(files[0] == files[1] && files[0] == files[2]);
}
