//! Satellite fixes as starts in maps that were made with fixes.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::known;

use std::path::Path;

use known::request;
use portolan::geometry::{Duration, EastNorthUp, GeodeticPosition, Rigid3, Vector3};
use portolan::job::{
    JobError, LocalizeRequest, LocalizedRecording, MapRequest, Start, localize, map, unobserved,
};
use portolan::localization::State;
use portolan::recording::{Header, MemoryRecording, Message, NavSatFix, RecordedMessage, Recording};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

const ORIGIN: GeodeticPosition =
    GeodeticPosition { latitude_degrees: 49.78, longitude_degrees: 9.97, altitude: 250.0 };
/// Standard deviation that fixes say they have, metres.
const SIGMA: f64 = 1.5;

/// A drive with a receiver whose fixes are off by so much.
struct Day {
    drive: Simulation,
    recording: MemoryRecording,
}

impl Day {
    fn new(day: u64, seconds: f64, off: Vector3) -> Self {
        let options = ScenarioOptions {
            building_seed: Some(1),
            duration: Some(seconds),
            people: Some(1),
            ..ScenarioOptions::new(Scene::Office, day)
        };
        let drive = Simulation::new(options).unwrap();
        let mut messages: Vec<RecordedMessage> = Vec::new();
        let mut reader = drive.read(&|_| true).unwrap();
        while let Some(message) = reader.next_message().unwrap() {
            messages.push(message);
        }
        messages.extend(fixes(&drive, &off));
        Self { drive, recording: MemoryRecording::new(messages) }
    }
}

/// Twice a second, with errors of a metre that go round.
fn fixes(drive: &Simulation, off: &Vector3) -> Vec<RecordedMessage> {
    let earth = EastNorthUp::at(&ORIGIN);
    let fix = |k: u32| {
        let seconds = 0.5 * f64::from(k);
        let stamp = drive.start_time() + Duration::from_seconds(seconds);
        let truth = drive.truth_at(stamp)?.translation.vector;
        let error = Vector3::new((0.3 * seconds).cos(), (0.3 * seconds).sin(), 2.0);
        let place = earth.to_geodetic(&(truth + error + off));
        let variance = SIGMA * SIGMA;
        let message = Message::NavSatFix(NavSatFix {
            header: Header { stamp, frame_id: "gnss".into() },
            status: 0,
            service: 1,
            latitude_degrees: place.latitude_degrees,
            longitude_degrees: place.longitude_degrees,
            altitude: place.altitude,
            position_covariance: [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 4.0 * variance],
            position_covariance_type: 2,
        });
        Some(RecordedMessage { topic: "/fix".into(), log_time: stamp, message })
    };
    (0..240).map_while(fix).collect()
}

fn find(recording: &dyn Recording, map: &Path, start: Option<Start>) -> Result<LocalizedRecording, JobError> {
    let request = LocalizeRequest { start, ..request(map) };
    localize(recording, &request, &mut unobserved)
}

/// Metres by which the last localised pose is off.
fn last_error(found: &LocalizedRecording, today: &Day, world_from_map: &Rigid3) -> f64 {
    let last = found.estimates.iter().filter(|e| e.state == State::Localised).last().unwrap();
    let truth = world_from_map.inverse() * today.drive.truth_at(last.time).unwrap();
    (truth.inverse() * last.place.unwrap().map_from_tracking).translation.vector.norm()
}

#[test]
fn a_recording_starts_at_its_fix_and_a_wrong_fix_costs_seconds() {
    let folder = tempfile::tempdir().unwrap();
    let first_day = Day::new(1, 120.0, Vector3::zeros());
    let mut request = MapRequest::new(folder.path());
    request.ingest.use_nav_sat = Some(true);
    map(&first_day.recording, request, &mut unobserved).unwrap();
    let path = folder.path().join("map.pbstream");
    let world_from_map = first_day.drive.truth_at(first_day.drive.start_time()).unwrap();

    let today = Day::new(2, 20.0, Vector3::zeros());
    let by_itself = find(&today.recording, &path, None).unwrap();
    let start = by_itself.start.unwrap();
    assert!(by_itself.starts_at_fix && by_itself.start_agrees == Some(true), "{start:?}");
    assert!((SIGMA..2.0 * SIGMA).contains(&start.sigma_metres), "{start:?}");
    let place = world_from_map * start.map_from_tracking;
    let offset =
        place.translation.vector - today.drive.truth_at(today.drive.start_time()).unwrap().translation.vector;
    assert!(offset.xy().norm() < 10.0, "the fix is on the path of today: {offset}");
    assert!(last_error(&by_itself, &today, &world_from_map) < 0.2);

    let searched = find(&today.recording, &path, Some(Start::Unknown)).unwrap();
    assert!(searched.start.is_none() && searched.start_agrees.is_none());
    let (with, without) = (by_itself.found_after_seconds().unwrap(), searched.found_after_seconds().unwrap());
    assert!(with <= without, "{with} s with fixes, {without} s without");

    let astray = Day::new(2, 20.0, Vector3::new(-9.0, 7.0, 0.0));
    let found = find(&astray.recording, &path, Some(Start::Fixes)).unwrap();
    assert_eq!(found.start_agrees, Some(false), "{:?}", found.start);
    let wrong = found.found_after_seconds().unwrap();
    assert!(wrong < without + 5.0, "{wrong} s with wrong fixes, {without} s without");
    assert!(last_error(&found, &astray, &world_from_map) < 0.2);
}

#[test]
fn a_map_without_fixes_refuses_starts_at_fixes() {
    let folder = tempfile::tempdir().unwrap();
    let day = Day::new(1, 20.0, Vector3::zeros());
    map(&day.drive, MapRequest::new(folder.path()), &mut unobserved).unwrap();
    let path = folder.path().join("map.pbstream");
    let error = find(&day.recording, &path, Some(Start::Fixes)).err().unwrap();
    assert!(error.to_string().contains("is not georeferenced"), "{error}");
    let found = find(&day.recording, &path, None).unwrap();
    assert!(found.start.is_none() && !found.starts_at_fix);
}
