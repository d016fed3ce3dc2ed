//! Walks: smooth, within limits, clear of walls, home in the end.

use portolan_geometry::Vector2;
use portolan_simulator::motion::{Motion, MotionLimits, Walk, Waypoint};
use portolan_simulator::{ScenarioOptions, Simulation};
use portolan_worlds::two_d::Scene;

/// Checks derivatives against differences and values against limits; distance walked.
fn check_smooth(walk: &Walk, limits: &MotionLimits) -> f64 {
    let h = 1e-5;
    let steps = (walk.duration() / 0.05) as usize;
    for i in 0..steps {
        let time = 0.05 * i as f64 + 0.0123;
        let (before, now, after) = (walk.state(time - h), walk.state(time), walk.state(time + h));
        let numeric_velocity =
            (after.map_from_base.translation.vector - before.map_from_base.translation.vector) / (2.0 * h);
        let numeric_acceleration = (after.velocity_in_map - before.velocity_in_map) / (2.0 * h);
        assert!((numeric_velocity - now.velocity_in_map).norm() < 1e-4, "velocity at {time}");
        assert!((numeric_acceleration - now.acceleration_in_map).norm() < 1e-3, "acceleration at {time}");
        let (p, q, r) = (walk.state_2d(time - h), walk.state_2d(time), walk.state_2d(time + h));
        assert!(((r.heading - p.heading) / (2.0 * h) - q.turn_rate).abs() < 1e-4, "turn rate at {time}");
        assert!(((r.turn_rate - p.turn_rate) / (2.0 * h) - q.turn_acceleration).abs() < 2e-3);
        assert!(((r.travelled - p.travelled) / (2.0 * h) - q.speed).abs() < 1e-4, "path at {time}");
        assert!(q.speed >= -1e-9 && q.speed <= limits.speed + 1e-9);
        assert!(q.acceleration.abs() <= 1.001 * limits.acceleration);
        assert!(q.turn_rate.abs() <= limits.turn_rate + 1e-9);
        assert!(q.turn_acceleration.abs() <= limits.turn_acceleration + 1e-9);
    }
    walk.state_2d(walk.duration()).travelled
}

#[test]
fn tours_are_smooth_clear_of_walls_and_come_home() {
    for scene in Scene::ALL {
        for seed in [1, 2] {
            let simulation = Simulation::new(ScenarioOptions::new(scene, seed)).unwrap();
            let walk = simulation.walk();
            let metres = check_smooth(walk, &MotionLimits::default());
            assert!(metres > 100.0, "{scene} {seed}: {metres}");
            let (start, end) = (walk.state_2d(0.0), walk.state_2d(walk.duration()));
            assert!((start.position - end.position).norm() < 1e-9 && end.speed == 0.0);
            let shapes = simulation.world().fixed().shapes();
            let mut nearest = f64::INFINITY;
            for i in 0..(walk.duration() / 0.25) as usize {
                let at = walk.state_2d(0.25 * i as f64).position;
                let distance = shapes.iter().map(|s| s.distance(&at)).fold(f64::INFINITY, f64::min);
                nearest = nearest.min(distance);
            }
            assert!(nearest > 0.2, "{scene} {seed}: {nearest}");
        }
    }
}

#[test]
fn an_office_tour_enters_most_open_rooms_and_closes_loops() {
    for seed in 1..6 {
        let simulation = Simulation::new(ScenarioOptions::new(Scene::Office, seed)).unwrap();
        let (walk, plan) = (simulation.walk(), simulation.plan());
        let seconds = walk.duration() as usize;
        let places: Vec<Vector2> = (0..seconds).map(|t| walk.state_2d(t as f64).position).collect();
        let is_visited = |place: &Vector2| places.iter().any(|p| (p - place).norm() < 1.5);
        let rooms: Vec<Vector2> = plan.places.iter().filter(|p| p.is_room).map(|p| p.position).collect();
        let visited = rooms.iter().filter(|room| is_visited(room)).count();
        assert!(rooms.len() >= 8 && 10 * visited >= 7 * rooms.len(), "{visited} of {}", rooms.len());
        // Junctions are seen again after more than a minute.
        let revisited = plan.places.iter().filter(|p| !p.is_room).filter(|junction| {
            let near = |t: &usize| (places[*t] - junction.position).norm() < 1.5;
            let times: Vec<usize> = (0..seconds).filter(near).collect();
            times.windows(2).any(|pair| pair[1] - pair[0] > 60)
        });
        assert!(revisited.count() >= 3);
    }
}

#[test]
fn durations_are_kept() {
    for duration in [10.0, 90.0, 300.0, 1500.0] {
        let options = ScenarioOptions { duration: Some(duration), ..ScenarioOptions::default() };
        let simulation = Simulation::new(options).unwrap();
        assert_eq!(simulation.duration(), duration);
        let walk = simulation.walk();
        if duration >= 90.0 {
            let (start, end) = (walk.state_2d(0.0), walk.state_2d(duration));
            let off = (start.position - end.position).norm();
            assert!(off < 1e-9, "{off} m from home after {duration} s of {}", walk.duration());
            assert!((walk.duration() - duration).abs() < 1e-6, "{} of {duration} s", walk.duration());
            // It does not stand about for long at the end.
            let moved = walk.state_2d(duration).travelled - walk.state_2d(0.75 * duration - 10.0).travelled;
            assert!(moved > 1.0, "moved {moved} m in the last quarter of {duration} s");
        }
        assert!(walk.state_2d(0.9 * duration).travelled > 0.3 * duration.min(8.0) - 1.0);
    }
}

#[test]
fn stops_are_reached_and_unusual_waypoints_handled() {
    let waypoint = |x: f64, y: f64, stop: Option<f64>| Waypoint { position: Vector2::new(x, y), stop };
    let limits = MotionLimits::default();
    let points = [
        waypoint(0.0, 0.0, None),
        waypoint(0.0, 0.0, None),
        waypoint(2.0, 0.0, None),
        waypoint(2.0, 2.0, Some(3.0)),
        waypoint(2.0, 0.5, None),
        waypoint(2.0, 0.51, None),
        waypoint(-1.0, 0.5, None),
    ];
    let walk = Walk::through(&points, &limits, 1.0, None).unwrap();
    check_smooth(&walk, &limits);
    let stands_at_stop = (0..(walk.duration() / 0.1) as usize).any(|i| {
        let state = walk.state_2d(0.1 * i as f64);
        state.speed == 0.0 && (state.position - Vector2::new(2.0, 2.0)).norm() < 1e-9
    });
    assert!(stands_at_stop);
    assert!((walk.state_2d(1e9).position - Vector2::new(-1.0, 0.5)).norm() < 1e-9);
    assert!(Walk::through(&[], &limits, 1.0, None).is_none());
    assert!(Walk::through(&points, &MotionLimits { speed: 0.0, ..limits }, 1.0, None).is_none());
    assert!(Walk::through(&[waypoint(f64::NAN, 0.0, None)], &limits, 1.0, None).is_none());
    assert_eq!(Walk::through(&points[..1], &limits, 1.0, None).unwrap().duration(), 2.0);
}

#[test]
fn small_and_crowded_and_large_buildings_can_be_walked() {
    for scene in Scene::ALL {
        for seed in 0..4 {
            let small = ScenarioOptions {
                size: Some(scene.minimum_size()),
                clutter: [0.0, 3.0][seed as usize % 2],
                closed_doors: [0.0, 1.0][seed as usize / 2],
                ..ScenarioOptions::new(scene, seed)
            };
            let simulation = Simulation::new(small).unwrap();
            let metres = simulation.walk().state_2d(simulation.duration()).travelled;
            assert!(metres > 5.0, "{scene} {seed}: {metres} m");
        }
        let large = ScenarioOptions {
            size: Some([120.0, 90.0]),
            duration: Some(200.0),
            ..ScenarioOptions::new(scene, 1)
        };
        let simulation = Simulation::new(large).unwrap();
        assert!(simulation.walk().state_2d(200.0).travelled > 40.0);
    }
}
