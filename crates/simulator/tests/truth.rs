//! Truth as files.
#![allow(clippy::unwrap_used)] // helpers of tests fail as tests do

use portolan_geometry::Vector2;
use portolan_simulator::motion::Motion;
use portolan_simulator::{OccupancyPicture, ScenarioOptions, Simulation};
use portolan_worlds::two_d::Scene;

fn simulation(scene: Scene) -> Simulation {
    let options = ScenarioOptions { duration: Some(60.0), ..ScenarioOptions::new(scene, 2) };
    Simulation::new(options).unwrap()
}

#[test]
fn the_trajectory_is_written_as_tum() {
    let simulation = simulation(Scene::Office);
    let mut text = Vec::new();
    simulation.write_truth_tum(&mut text, 100.0).unwrap();
    let text = String::from_utf8(text).unwrap();
    assert_eq!(text.lines().count(), 6001);
    for (i, line) in text.lines().enumerate().step_by(371) {
        let values: Vec<f64> = line.split(' ').map(|v| v.parse().unwrap()).collect();
        assert_eq!(values.len(), 8);
        assert!((values[0] - 1.7e9 - 0.01 * i as f64).abs() < 1e-6);
        let pose = simulation.walk().state(0.01 * i as f64).map_from_base;
        let error = Vector2::new(values[1], values[2]) - pose.translation.vector.xy();
        assert!(error.norm() < 1e-8 && (values[6] - pose.rotation.k).abs() < 1e-9);
    }
    assert!(simulation.truth_at(simulation.end_time()).is_some());
    let too_late = simulation.end_time() + portolan_geometry::Duration::from_ticks(1);
    assert!(simulation.truth_at(too_late).is_none());
}

#[test]
fn walls_are_written_as_segments() {
    let simulation = simulation(Scene::Warehouse);
    let mut text = Vec::new();
    simulation.write_walls_csv(&mut text).unwrap();
    let text = String::from_utf8(text).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("x0,y0,x1,y1,material"));
    let size = simulation.plan().size;
    for line in lines {
        let parts: Vec<&str> = line.split(',').collect();
        let values: Vec<f64> = parts[..4].iter().map(|v| v.parse().unwrap()).collect();
        assert!(values.iter().all(|v| (-1.0..=size.x.max(size.y) + 1.0).contains(v)));
        assert!(["wall", "furniture", "metal", "door", "glass"].contains(&parts[4]));
    }
}

#[test]
fn the_occupancy_picture_has_walls_where_scans_end_and_free_space_at_the_robot() {
    for scene in Scene::ALL {
        let simulation = simulation(scene);
        let picture = simulation.occupancy(0.05);
        for i in 0..60 {
            let at = simulation.walk().state_2d(f64::from(i)).position;
            assert_eq!(picture.pixel_at(&at), Some(OccupancyPicture::FREE), "{scene} at {at}");
        }
        let count = |value| picture.pixels.iter().filter(|p| **p == value).count();
        let free_area = count(OccupancyPicture::FREE) as f64 * 0.05 * 0.05;
        let size = simulation.plan().size;
        let least = if scene == Scene::Corridors { 0.1 } else { 0.4 };
        assert!(free_area > least * size.x * size.y && free_area < size.x * size.y, "{scene}: {free_area}");
        assert_eq!(picture.pixel_at(&Vector2::new(-0.49, -0.49)), Some(OccupancyPicture::UNKNOWN));
        let pgm = picture.to_pgm();
        let header = format!("P5\n{} {}\n255\n", picture.width, picture.height);
        assert!(pgm.starts_with(header.as_bytes()) && pgm.len() == header.len() + picture.pixels.len());
        assert!(picture.to_yaml("truth.pgm").contains("resolution: 0.05\n"));
    }
}
