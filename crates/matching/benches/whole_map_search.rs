//! Where in a 2D map of many rooms a scan was taken: a known room, and one that is not in the map.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr)]

#[path = "../tests/common/mod.rs"]
#[allow(dead_code)]
mod common;

use portolan_matching::{PlaceIndex2d, WantedPlaces};
use portolan_testing::Stopwatch;

const WANTED: WantedPlaces = WantedPlaces {
    min_score: 0.5,
    share_of_best: 0.8,
    separation: (0.8, 0.26),
    most: 8,
    most_points: 200,
    beam: 128,
    lookups: 1 << 40,
};

fn search(watch: &Stopwatch) {
    for count in [50, 500] {
        let rooms = common::rooms::rooms(&(0..count).collect::<Vec<_>>());
        let grids: Vec<_> = rooms.iter().map(|(grid, pose, _)| (grid, *pose)).collect();
        let index = PlaceIndex2d::new(&grids, 0.2).unwrap().unwrap();
        let unknown = common::rooms::room(99_999).1;
        for (name, cloud) in [("known", &rooms[7].2), ("unknown", &unknown)] {
            let found = index.find(cloud, &WANTED);
            eprintln!("{count} rooms, {name}: {} look-ups, {:?}", found.lookups, found.places);
            watch.time(&format!("{count} rooms, {name}"), || index.find(cloud, &WANTED));
        }
    }
}

fn main() {
    let watch = Stopwatch::of_arguments();
    search(&watch);
}
