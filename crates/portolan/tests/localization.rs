//! Finding simulated drives in a saved map of the building, and not finding them in that of another.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::known;

use std::path::Path;
use std::sync::OnceLock;

use known::gap::{Gap, Scans};
use known::{Known, request};
use portolan::config::Options;
use portolan::geometry::{Duration, Rigid3, Vector3};
use portolan::job::{
    Found, JobError, LOCALIZED_FILES, LocalizeRequest, LocalizedRecording, MapRequest, OutputFolder, Start,
    examine_map, localize, map, unobserved, write_localized,
};
use portolan::localization::{Change, ChangeKind, KnownMap2d, KnownMapError, Reason, StartPose, State};
use portolan::mapfile::{MapLoadSettings, read_map_2d, write_map_2d};
use portolan::mapping::{GraphState, Space2d};
use portolan::recording::{Recording, RecordingWriter, create, open_all};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::{Material, Scene, Shape};

/// A drive through an office; another day, another path through it.
fn drive(building: u64, day: u64, seconds: f64) -> Simulation {
    let options = ScenarioOptions {
        building_seed: Some(building),
        duration: Some(seconds),
        people: Some(2),
        ..ScenarioOptions::new(Scene::Office, day)
    };
    Simulation::new(options).unwrap()
}

/// A map of the whole office, made once.
fn known() -> &'static Known {
    static KNOWN: OnceLock<Known> = OnceLock::new();
    KNOWN.get_or_init(|| Known::new(&drive(1, 1, 240.0)))
}

fn find(recording: &dyn Recording, start: Option<StartPose>) -> LocalizedRecording {
    let request = LocalizeRequest { start: start.map(Start::At), ..request(&known().map()) };
    localize(recording, &request, &mut unobserved).unwrap()
}

#[test]
fn a_robot_is_found_without_a_start() {
    for day in [2, 3] {
        let today = drive(1, day, 40.0);
        let found = find(&today, None);
        assert_eq!(found.found(), Found::Throughout, "day {day}: {:?}", found.state_counts());
        // It stands for the first two seconds.
        assert!(found.found_after_seconds().unwrap() < 8.0, "day {day}: {:?}", found.found_after_seconds());
        let errors = known().errors(&today, &found);
        let largest = errors.iter().map(|e| e.1).fold(0.0, f64::max);
        assert!(errors.len() > 200 && largest < 0.2, "day {day}: {} poses, {largest} m", errors.len());
    }
}

#[test]
fn covariances_match_errors() {
    let today = drive(1, 4, 60.0);
    let found = find(&today, None);
    let localised = found.estimates.iter().filter(|e| e.state == State::Localised);
    let squares: Vec<f64> = localised
        .map(|e| {
            let place = e.place.unwrap();
            let error = known().truth(&today, e.time).unwrap().inverse() * place.map_from_tracking;
            let in_map = place.map_from_tracking.rotation * error.translation.vector;
            let error = Vector3::new(in_map.x, in_map.y, error.rotation.euler_angles().2);
            (error.transpose() * place.covariance_2d().try_inverse().unwrap() * error)[(0, 0)]
        })
        .collect();
    let within = squares.iter().filter(|s| **s < 7.815).count() as f64 / squares.len() as f64;
    assert!(squares.len() > 300 && within > 0.8, "{} poses, {within} within their 95 %", squares.len());
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    assert!((0.2..6.0).contains(&mean), "{mean} in place of 3");
}

#[test]
fn a_wrong_start_costs_seconds() {
    let today = drive(1, 2, 30.0);
    let right = known().truth(&today, today.start_time()).unwrap();
    let given = find(&today, Some(StartPose::new(right)));
    assert_eq!((given.found(), given.start_agrees), (Found::Throughout, Some(true)));
    let wrong =
        Rigid3::translation(4.0, -3.0, 0.0) * right * Rigid3::new(Vector3::zeros(), Vector3::z() * 1.5);
    let corrected = find(&today, Some(StartPose::new(wrong)));
    assert_eq!((corrected.found(), corrected.start_agrees), (Found::Throughout, Some(false)));
    assert!(corrected.found_after_seconds().unwrap() < 10.0, "{:?}", corrected.found_after_seconds());
    let errors = known().errors(&today, &corrected);
    assert!(errors.iter().all(|e| e.1 < 0.2 && e.2 < 0.1), "{errors:?}");
}

#[test]
fn a_landmark_of_the_map_is_a_start_like_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.pbstream");
    let today = drive(1, 2, 20.0);
    let at_start = known().truth(&today, today.start_time()).unwrap();
    let mut loaded = read_map_2d(known().map(), &MapLoadSettings::default()).unwrap();
    let turned = Rigid3::new(Vector3::new(0.5, 0.5, 0.0), Vector3::z() * 2.0);
    loaded.graph.set_landmark_pose("dock", at_start * turned, true);
    loaded.graph.set_landmark_pose("gate", Rigid3::translation(40.0, 0.0, 0.0) * at_start, true);
    write_map_2d(&loaded.into_map(Options::default()), &path, true).unwrap();
    let start = |name: &str| {
        let name = name.to_owned();
        let start = Some(Start::Landmark { name, sigma_metres: 2.0, sigma_radians: std::f64::consts::PI });
        localize(&today, &LocalizeRequest { start, ..request(&path) }, &mut unobserved)
    };
    let found = start("dock").unwrap();
    assert_eq!((found.found(), found.start_agrees), (Found::Throughout, Some(true)));
    assert_eq!(start("gate").unwrap().start_agrees, Some(false));
    let error = start("door").err().unwrap().to_string();
    assert!(error.contains("no such landmark; it has dock, gate"), "{error}");
}

/// Offices of one kind look alike: of thirty, three pass for the known one for a while (docs/experiments/2026-11-believing-places.md).
#[test]
fn poses_are_rarely_found_in_another_building() {
    let found_in = |building: u64, start: Option<StartPose>| {
        let found = find(&drive(building, 2, 40.0), start);
        assert_eq!(found.poses().is_empty(), found.found() == Found::Never);
        found.found() != Found::Never
    };
    let found: Vec<u64> = (2..=7).filter(|building| found_in(*building, None)).collect();
    assert!(found.len() <= 1, "in {found:?}");
    assert!(!found_in(2, Some(StartPose::new(Rigid3::identity()))));
}

/// Two drives one right after the other, as if somebody had carried the robot with its eyes closed.
fn kidnapped(folder: &Path) -> (Simulation, Simulation, Box<dyn Recording>) {
    let first = drive(1, 2, 25.0);
    let start_time = first.start_time() + Duration::from_seconds(25.2);
    let second = Simulation::new(ScenarioOptions {
        start_time,
        building_seed: Some(1),
        duration: Some(30.0),
        people: Some(2),
        ..ScenarioOptions::new(Scene::Office, 3)
    })
    .unwrap();
    let paths = [(&first, "first.bag"), (&second, "second.bag")].map(|(drive, name)| {
        let path = folder.join(name);
        let mut writer = create(&path, None).unwrap();
        drive.write_messages(&mut *writer).unwrap();
        writer.finish().unwrap();
        path
    });
    (first, second, open_all(&paths).unwrap())
}

#[test]
fn a_kidnapped_robot_is_reported_lost_and_relocalised() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second, recording) = kidnapped(folder.path());
    let found = find(recording.as_ref(), None);
    assert_eq!(found.found(), Found::InParts);
    let kidnapped_at = second.start_time();
    let is_right = |estimate: &portolan::localization::Estimate| {
        let drive = if estimate.time < kidnapped_at { &first } else { &second };
        let error = known().truth(drive, estimate.time).unwrap().inverse()
            * estimate.place.unwrap().map_from_tracking;
        error.translation.vector.norm() < 0.3
    };
    let localised = || found.estimates.iter().filter(|e| e.state == State::Localised);
    let false_ones: Vec<f64> =
        localised().filter(|e| !is_right(e)).map(|e| e.time.seconds_since(kidnapped_at)).collect();
    assert!(false_ones.iter().all(|t| (0.0..3.0).contains(t)), "{false_ones:?}");
    let again = localised().find(|e| e.time > kidnapped_at && is_right(e)).map(|e| e.time);
    let seconds = again.map(|time| time.seconds_since(kidnapped_at));
    assert!(seconds.is_some_and(|s| s < 12.0), "{seconds:?} {:?}", found.state_counts());
    assert!(found.estimates.iter().any(|e| e.state == State::Lost));
}

#[test]
fn a_covered_scanner_moves_with_odometry_and_is_not_found_elsewhere() {
    let folder = tempfile::tempdir().unwrap();
    let (today, bag) = (drive(1, 2, 40.0), folder.path().join("covered.bag"));
    let at = |seconds| today.start_time() + Duration::from_seconds(seconds);
    let mut writer = Gap {
        inner: create(&bag, None).unwrap(),
        between: [at(20.0), at(28.0)],
        scans: Scans::Covered,
        stalled: None,
    };
    today.write_messages(&mut writer).unwrap();
    Box::new(writer).finish().unwrap();
    let found = find(open_all(&[bag]).unwrap().as_ref(), None);
    let hidden = found.estimates.iter().filter(|e| e.reason == Reason::PlaceHidden);
    let (hidden, states) = (hidden.map(|e| e.state).collect::<Vec<_>>(), found.state_counts());
    // All that are covered, and those of the second in which the place becomes certain again.
    assert!((80..=90).contains(&hidden.len()), "{}", hidden.len());
    assert!(hidden.contains(&State::Uncertain) && !hidden.contains(&State::Lost), "{states:?}");
    assert_eq!(found.estimates.last().map(|e| e.state), Some(State::Localised));
    let largest = known().errors(&today, &found).iter().map(|e| e.1).fold(0.0, f64::max);
    assert!(largest < 0.25, "{largest} m");
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let today = drive(1, 5, 15.0);
    let files = [1, 2, 4].map(|threads| {
        let request = LocalizeRequest { threads, ..request(&known().map()) };
        let found = localize(&today, &request, &mut unobserved).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let output = OutputFolder::begin(folder.path(), "localize", &LOCALIZED_FILES, false, &mut unobserved);
        write_localized(&found, &output.unwrap(), 0.0, &mut unobserved).unwrap();
        ["poses.tum", "poses.csv", "path.png", "report.json", "changes.geojson"]
            .map(|name| std::fs::read(folder.path().join(name)).unwrap())
    });
    assert!(files[0][1].len() > 5_000 && files[0] == files[1] && files[0] == files[2]);
}

#[test]
fn bad_maps_are_reported_with_their_fault() {
    let empty = KnownMap2d::new(&GraphState::<Space2d>::default());
    assert!(matches!(empty, Err(KnownMapError::Empty)));
    let folder = tempfile::tempdir().unwrap();
    let damaged = folder.path().join("damaged.pbstream");
    let whole = std::fs::read(known().map()).unwrap();
    std::fs::write(&damaged, &whole[..whole.len() / 3]).unwrap();
    let today = drive(1, 2, 3.0);
    let error = |path: &Path| localize(&today, &request(path), &mut unobserved).err().unwrap();
    assert!(matches!(error(&damaged), JobError::KnownMap { .. }), "{}", error(&damaged));
    assert!(error(&folder.path().join("missing.pbstream")).to_string().contains("missing.pbstream"));
}

#[test]
fn estimates_without_a_place_have_a_reason() {
    let elsewhere = drive(2, 2, 10.0);
    let found = find(&elsewhere, None);
    let reasons = [Reason::NoPlaceFits, Reason::SeveralPlacesFit, Reason::TooLittleSeen];
    assert!(found.estimates.iter().all(|e| reasons.contains(&e.reason)));
    assert!(found.estimates.iter().all(|e| e.place.is_some() == (e.state == State::Tentative)));
}

/// The drive of a day past something round that was put beside its path, and where that stands in the building.
fn drive_past_a_barrel(day: u64, seconds: f64) -> (Simulation, Vector3) {
    let before = drive(1, day, seconds);
    let mut plan = before.plan().clone();
    let beside = |second: u32, side: f64| {
        let time = before.start_time() + Duration::from_seconds(f64::from(second));
        let pose = before.truth_at(time).unwrap();
        pose.translation.vector + pose.rotation * Vector3::new(0.0, side, 0.0)
    };
    let places = (10..seconds as u32 - 10).flat_map(|s| [1.0, -1.0].map(|side| beside(s, side)));
    let is_open = |p: &Vector3| plan.shapes.iter().all(|shape| shape.distance(&p.xy()) > 0.7);
    let centre = places.into_iter().find(is_open).unwrap();
    plan.shapes.push(Shape::circle(centre.xy(), 0.3, Material::Furniture));
    let options = ScenarioOptions {
        building_seed: Some(1),
        duration: Some(seconds),
        people: Some(2),
        ..ScenarioOptions::new(Scene::Office, day)
    };
    (Simulation::in_plan(options, plan).unwrap(), centre)
}

/// Changes of a kind within 0.6 m of a point of the map.
fn changes_near<'a>(found: &'a LocalizedRecording, kind: ChangeKind, at: &Vector3) -> Vec<&'a Change> {
    let is_near = |p: &[f64; 2]| (p[0] - at.x).hypot(p[1] - at.y) < 0.6;
    found.changes.iter().filter(|c| c.kind == kind && c.rings[0].iter().any(is_near)).collect()
}

#[test]
fn added_objects_are_detected_with_few_false_changes() {
    let unchanged = find(&drive(1, 2, 60.0), None);
    let area = |found: &LocalizedRecording| found.changes.iter().map(|c| c.area).sum::<f64>();
    let (today, centre) = drive_past_a_barrel(2, 60.0);
    let found = find(&today, None);
    let map_from_world = known().world_from_map.inverse();
    let centre = map_from_world.translation.vector + map_from_world.rotation * centre;
    let barrel = changes_near(&found, ChangeKind::Appeared, &centre);
    assert!(barrel.iter().any(|c| c.scans >= 4), "{:?}", found.changes);
    assert!(area(&unchanged) < 0.3, "{:?}", unchanged.changes);
}

#[test]
fn removed_objects_are_detected() {
    let folder = tempfile::tempdir().unwrap();
    let (first_day, centre) = drive_past_a_barrel(2, 60.0);
    map(&first_day, MapRequest::new(folder.path()), &mut unobserved).unwrap();
    let map_from_world = first_day.truth_at(first_day.start_time()).unwrap().inverse();
    let centre = map_from_world.translation.vector + map_from_world.rotation * centre;
    let today = drive(1, 2, 60.0);
    let found = localize(&today, &request(&folder.path().join("map.pbstream")), &mut unobserved).unwrap();
    let barrel = changes_near(&found, ChangeKind::Gone, &centre);
    assert!(barrel.iter().any(|c| c.scans >= 4), "{:?}", found.changes);
    assert!(changes_near(&found, ChangeKind::Appeared, &centre).is_empty(), "{:?}", found.changes);
}

#[test]
fn a_recording_has_no_changes_in_its_own_map() {
    let own = find(&drive(1, 1, 120.0), None);
    let area: f64 = own.changes.iter().map(|c| c.area).sum();
    assert!(area < 0.05, "{:?}", own.changes);
}

#[test]
fn places_are_the_same_for_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    map(&drive(1, 1, 30.0), MapRequest::new(folder.path()), &mut unobserved).unwrap();
    let path = folder.path().join("map.pbstream");
    let [one, three] = [1, 3].map(|threads| examine_map(&path, threads, &mut unobserved).unwrap());
    assert!(one.places.len() > 3, "{}", one.places.len());
    assert_eq!(one.places, three.places);
    let of_path: f64 = one.counts().iter().map(|(_, count)| count.fraction_of_path).sum();
    assert!((of_path - 1.0).abs() < 1e-9, "{of_path}");
    assert!(examine_map(&folder.path().join("none"), 1, &mut unobserved).is_err());
}
