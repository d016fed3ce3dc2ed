use portolan_grids::CellIndex;

use super::*;
use crate::testing::rooms::{room, rooms};

const WANTED: WantedPlaces = WantedPlaces {
    min_score: 0.3,
    share_of_best: 0.8,
    separation: (0.8, 0.26),
    most: 8,
    most_points: 200,
    beam: 128,
    lookups: 1 << 40,
};

fn index_of(rooms: &[(Grid2d, Rigid2, PointCloud)]) -> PlaceIndex2d {
    let grids: Vec<_> = rooms.iter().map(|(grid, pose, _)| (grid, *pose)).collect();
    PlaceIndex2d::new(&grids, 0.2).unwrap().unwrap()
}

fn is_at(found: &MatchResult<Rigid2>, pose: &Rigid2) -> bool {
    (found.pose.translation - pose.translation).norm() < 0.4
        && normalize_angle(found.pose.angle - pose.angle).abs() < 0.1
}

#[test]
fn each_room_is_found_among_others() {
    let rooms = rooms(&(0..16).collect::<Vec<_>>());
    let index = index_of(&rooms);
    for (_, pose, cloud) in &rooms {
        let found = index.find(cloud, &WANTED);
        assert!(found.is_complete && is_at(&found.places[0], pose), "{pose:?}: {found:?}");
        assert!(found.places[0].score > 0.6, "{found:?}");
    }
}

#[test]
fn all_similar_rooms_are_found_once() {
    let rooms = rooms(&[1, 2, 1, 3, 1]);
    let found = index_of(&rooms).find(&rooms[0].2, &WANTED);
    for room in [0, 2, 4] {
        assert_eq!(found.places.iter().filter(|p| is_at(p, &rooms[room].1)).count(), 1, "{room}: {found:?}");
    }
    for (i, a) in found.places.iter().enumerate() {
        for b in &found.places[..i] {
            let apart = (a.pose.translation - b.pose.translation).norm();
            let turned = normalize_angle(a.pose.angle - b.pose.angle).abs();
            assert!(apart >= WANTED.separation.0 || turned >= WANTED.separation.1, "{found:?}");
            assert!(a.score <= b.score);
        }
    }
}

#[test]
fn a_search_around_a_place_is_limited_to_it() {
    let rooms = rooms(&[1, 2, 1, 3, 1]);
    let index = index_of(&rooms);
    let near = rooms[2].1.translation + Vector2::new(1.0, -0.8);
    let found = index.find_within(&rooms[0].2, &WANTED, &near, 1.5);
    assert!(is_at(&found.places[0], &rooms[2].1), "{found:?}");
    assert!(found.places.iter().all(|p| (p.pose.translation - near).amax() < 1.8), "{found:?}");
    let far_off = index.limits.max() + Vector2::new(500.0, 500.0);
    assert!(index.find_within(&rooms[0].2, &WANTED, &far_off, 1.5).places.is_empty());
}

/// Result of a search through all placements.
fn best_of_all(index: &PlaceIndex2d, cloud: &PointCloud) -> f32 {
    let wanted = WantedPlaces { most_points: 60, ..WANTED };
    let stride = cloud.points.len().div_ceil(wanted.most_points);
    let points: Vec<Point3f> = cloud.points.iter().copied().step_by(stride).collect();
    let window = SearchWindow::new(&points, 0.2, 0.0, std::f64::consts::PI);
    let centre = Rigid2 { translation: index.limits.max(), angle: 0.0 };
    let mut scans = RotatedScans::new(&points, &centre, window, index.limits, [0, 0]);
    let origin = index.limits.cell_index(centre.translation.cast::<f32>());
    let cells = CellIndex::new(index.limits.num_x_cells() as i32, index.limits.num_y_cells() as i32);
    let mut best = f32::MIN;
    for scan in 0..window.num_scans() {
        let turned = scans.cells(scan).to_vec();
        for (x, y) in (0..cells.x).flat_map(|x| (0..cells.y).map(move |y| (x, y))) {
            if index.free.level(0).at(x, y) > 0 {
                let sum = index.pyramid.level(0).sum(&turned, x - origin.x, y - origin.y);
                best = best.max(index.score.of(sum, points.len()));
            }
        }
    }
    best
}

#[test]
fn the_best_placement_is_found() {
    let rooms = rooms(&[4, 5]);
    let index = index_of(&rooms);
    let wanted = WantedPlaces { most: 1, min_score: 0.0, most_points: 60, ..WANTED };
    for seed in [4, 6, 7] {
        let (_, cloud) = room(seed);
        let found = index.find(&cloud, &wanted);
        assert_eq!(found.places[0].score, best_of_all(&index, &cloud), "{seed}");
    }
}

#[test]
fn unmapped_scans_are_not_found() {
    let index = index_of(&rooms(&[1, 2, 3]));
    let strange = PointCloud::new((0..100).map(|i| Point3f::new(0.2 * i as f32, 1.0, 0.0)).collect());
    let wanted = WantedPlaces { min_score: 0.5, ..WANTED };
    assert_eq!(index.find(&strange, &wanted).places, []);
    assert!(index.find(&PointCloud::default(), &WANTED).places.is_empty());
    assert!(PlaceIndex2d::new(&[], 0.2).unwrap().is_none());
}

#[test]
fn the_cost_of_a_search_grows_no_faster_than_the_map() {
    let [small, large] = [20, 200].map(|count| {
        let rooms = rooms(&(0..count).collect::<Vec<_>>());
        let found = index_of(&rooms).find(&rooms[7].2, &WANTED);
        assert!(is_at(&found.places[0], &rooms[7].1), "{found:?}");
        found.lookups
    });
    assert!(large < 12 * small, "{small} and {large} look-ups");
}

#[test]
fn searches_with_too_few_look_ups_are_incomplete() {
    let rooms = rooms(&[1, 2, 3]);
    let found = index_of(&rooms).find(&rooms[0].2, &WantedPlaces { lookups: 10_000, ..WANTED });
    assert!(!found.is_complete);
}

#[test]
fn greedy_results_are_kept_without_a_complete_search() {
    let rooms = rooms(&[1, 2, 1, 3, 1]);
    let found = index_of(&rooms).find(&rooms[0].2, &WantedPlaces { beam: 4096, lookups: 0, ..WANTED });
    assert!(!found.is_complete);
    for room in [0, 2, 4] {
        assert_eq!(found.places.iter().filter(|p| is_at(p, &rooms[room].1)).count(), 1, "{room}: {found:?}");
    }
}

#[test]
fn very_wide_maps_get_larger_cells() {
    let rooms = rooms(&[1]);
    let far = [(&rooms[0].0, Rigid2::identity()), (&rooms[0].0, Rigid2::new(5000.0, 100.0, 0.0))];
    let narrow = PlaceIndex2d::new(&far[..1], 0.2).unwrap().unwrap();
    let wide = PlaceIndex2d::new(&far, 0.01).unwrap().unwrap();
    assert!(narrow.resolution() == 0.2 && wide.resolution() > 0.1 && wide.memory_bytes() < 1 << 30);
}

/// Posts around a scanner, metres. Scanners are tried at corners of cells: there all of these are in the middle of one.
const POSTS: [[f32; 2]; 5] = [[0.1, 0.3], [2.1, 0.7], [0.7, -1.9], [-1.3, 0.9], [-0.5, 2.7]];

/// The posts around places of a map, and how much each post counts there; a map that is longer than wide, in cells of 0.2 m.
fn posts_at(places: &[(Vector2, f32)]) -> (MapLimits, Vec<(CellIndex, f32)>) {
    let limits = MapLimits::new(0.2, Vector2::new(10.0, 6.0), 70, 110).unwrap();
    let post = |place: &Vector2, [x, y]: [f32; 2]| place.cast::<f32>() + nalgebra::Vector2::new(x, y);
    let around =
        |(place, count): &(Vector2, f32)| POSTS.map(|at| (limits.cell_index(post(place, at)), *count));
    (limits, places.iter().flat_map(around).collect())
}

fn best_place(index: &PlaceIndex2d, beam: usize, lookups: u64) -> MatchResult<Rigid2> {
    let points = PointCloud::new(POSTS.map(|[x, y]| Point3f::new(x, y, 0.0)).to_vec());
    let wanted = WantedPlaces { min_score: 0.1, most: 1, beam, lookups, ..WANTED };
    index.find(&points, &wanted).places[0]
}

#[test]
fn points_of_more_weight_decide_and_scanners_are_in_free_space() {
    let [heavier, other] = [Vector2::new(4.0, -3.0), Vector2::new(-7.0, 1.0)];
    let (limits, counts) = posts_at(&[(other, 0.4), (heavier, 0.9)]);
    let near = |cell: CellIndex, place: &Vector2| (limits.cell_center(cell) - place).norm() < 1.0;
    let cells = || (0..limits.num_cells()).map(|i| CellIndex::new((i % 70) as i32, (i / 70) as i32));
    let everywhere = PlaceIndex2d::of_cells(limits, &counts, &vec![true; limits.num_cells()]);
    let open: Vec<bool> = cells().map(|cell| near(cell, &other)).collect();
    let around_the_other = PlaceIndex2d::of_cells(limits, &counts, &open);
    for (beam, lookups) in [(4096, 0), (1, 1 << 40)] {
        for (index, place, count) in [(&everywhere, heavier, 0.9), (&around_the_other, other, 0.4)] {
            let found = best_place(index, beam, lookups);
            assert!((found.pose.translation - place).norm() < 1e-6, "{found:?}");
            assert!(found.pose.angle.abs() < 1e-6 && (found.score - count).abs() < 0.004, "{found:?}");
        }
    }
    let nowhere = PlaceIndex2d::of_cells(limits, &counts, &[]);
    let points = PointCloud::new(POSTS.map(|[x, y]| Point3f::new(x, y, 0.0)).to_vec());
    assert!(nowhere.find(&points, &WANTED).places.is_empty());
}
