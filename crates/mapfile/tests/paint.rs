//! Painted maps against those of Cartographer (`vectors.md §14`).

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use portolan_geometry::Rigid3;
use portolan_mapfile::{
    MapArea, PaintError, PaintOptions, PaintedMap, PlacedTexture, SubmapTexture, load_textures, paint,
    sum_evidence,
};
use portolan_pbstream::MapReader;
use portolan_testing::{real_data, spec_data};

struct Expected {
    name: &'static str,
    slices: usize,
    size: (usize, usize),
    origin: (f64, f64),
    unknown: usize,
    occupied: usize,
    /// Checksums of grey values and occupancy where every pixel is the same.
    exact: Option<(u32, u32)>,
}

const EXPECTED: [Expected; 4] = [
    Expected {
        name: "local2d",
        slices: 2,
        size: (212, 113),
        origin: (105.258812, 105.0),
        unknown: 7716,
        occupied: 753,
        exact: Some((0x92d8_8e93, 0x0842_f5a1)),
    },
    Expected {
        name: "global2d",
        slices: 10,
        size: (217, 121),
        origin: (106.347939, 109.484016),
        unknown: 9702,
        occupied: 717,
        exact: None,
    },
    Expected {
        name: "local2d_tsdf",
        slices: 3,
        size: (229, 138),
        origin: (116.075562, 115.721817),
        unknown: 26645,
        occupied: 905,
        exact: None,
    },
    Expected {
        name: "local3d",
        slices: 3,
        size: (212, 112),
        origin: (107.0, 105.0),
        unknown: 21892,
        occupied: 1677,
        exact: Some((0xc41a_82ef, 0xd2e8_d532)),
    },
];

fn painted(path: &std::path::Path, slices: usize) -> PaintedMap {
    let textures = load_textures(&mut MapReader::open(path).unwrap()).unwrap();
    assert_eq!((textures.textures.len(), textures.skipped.len()), (slices, 0));
    paint(&textures.textures, &PaintOptions::default()).unwrap()
}

#[test]
fn painted_maps_look_like_the_reference() {
    for expected in EXPECTED {
        let name = expected.name;
        let Some(map) = spec_data(&format!("{name}.pbstream")) else { return };
        let Some(image) = spec_data(&format!("{name}.pgm")) else { return };
        let map = painted(&map, expected.slices);
        assert_eq!((map.width, map.height), expected.size, "{name}");
        assert!((map.origin[0] - expected.origin.0).abs() < 1e-5, "{name}: {:?}", map.origin);
        assert!((map.origin[1] - expected.origin.1).abs() < 1e-5, "{name}: {:?}", map.origin);

        let file = std::fs::read(image).unwrap();
        let reference = &file[file.len() - map.width * map.height..];
        let differences: Vec<u8> = map.grey().zip(reference).map(|(a, b)| a.abs_diff(*b)).collect();
        let mean = differences.iter().map(|d| f64::from(*d)).sum::<f64>() / differences.len() as f64;
        let largest = *differences.iter().max().unwrap();
        let different = differences.iter().filter(|d| **d > 0).count();
        let occupancy = map.occupancy();
        let unknown = occupancy.iter().filter(|o| **o < 0).count();
        let occupied = occupancy.iter().filter(|o| **o > 50).count();
        eprintln!(
            "{name}: mean {mean:.4}, largest {largest}, different {different} of {}, unknown {unknown}, \
             occupied {occupied}",
            differences.len(),
        );
        assert!(mean < 0.01 && largest <= 2 && different * 100 < differences.len(), "{name}");
        assert!(unknown.abs_diff(expected.unknown) <= 2, "{name}");
        assert!(occupied.abs_diff(expected.occupied) <= 2, "{name}");
        if let Some((grey, occupancy_crc)) = expected.exact {
            assert_eq!(crc32fast::hash(&map.grey().collect::<Vec<_>>()), grey, "{name}");
            let bytes: Vec<u8> = occupancy.iter().map(|o| o.cast_unsigned()).collect();
            assert_eq!(crc32fast::hash(&bytes), occupancy_crc, "{name}");
        }
    }
}

#[test]
fn crops_show_the_same_pixels() {
    let Some(path) = spec_data("local2d.pbstream") else { return };
    let textures = load_textures(&mut MapReader::open(&path).unwrap()).unwrap().textures;
    let whole = paint(&textures, &PaintOptions::default()).unwrap();
    let [left, low] = whole.lower_left();
    let r = whole.resolution;
    let crop = MapArea {
        min_x: left + 20.0 * r,
        min_y: low + 10.0 * r,
        max_x: left + 70.0 * r,
        max_y: low + 40.0 * r,
    };
    let part = paint(&textures, &PaintOptions { crop: Some(crop), ..PaintOptions::default() }).unwrap();
    assert_eq!((part.width, part.height), (50, 30));
    for y in 0..part.height {
        let start = (y + whole.height - 40) * whole.width + 20;
        let rows = part.pixels[y * 50..][..50].iter().zip(&whole.pixels[start..start + 50]);
        assert!(rows.into_iter().all(|(a, b)| a[0].abs_diff(b[0]) <= 2), "row {y}");
    }
}

#[test]
fn coarse_pictures_average_fine_ones() {
    let Some(path) = real_data("maps/reference/aces.pbstream") else { return };
    let textures = load_textures(&mut MapReader::open(&path).unwrap()).unwrap().textures;
    let crop = Some(MapArea { min_x: -20.0, min_y: -20.0, max_x: 20.0, max_y: 20.0 });
    let painted = |resolution: f64| {
        paint(&textures, &PaintOptions { resolution, crop, ..PaintOptions::default() }).unwrap()
    };
    let (fine, coarse) = (painted(0.05), painted(0.2));
    assert_eq!((fine.width, coarse.width), (800, 200));
    let mut difference = 0.0;
    for y in 0..200 {
        for x in 0..200 {
            let block = (0..16).map(|i| f64::from(fine.pixels[(4 * y + i / 4) * 800 + 4 * x + i % 4][0]));
            difference += (block.sum::<f64>() / 16.0 - f64::from(coarse.pixels[y * 200 + x][0])).abs();
        }
    }
    // Not zero: compositing and averaging do not commute.
    assert!(difference / 40000.0 < 4.0, "{}", difference / 40000.0);
}

#[test]
fn a_wall_survives_weak_evidence_of_free_space_in_many_submaps() {
    let submap = |index, pixel| {
        let texture = SubmapTexture {
            pixels: vec![pixel; 64],
            width: 8,
            height: 8,
            resolution: 0.05,
            submap_from_slice: Rigid3::identity(),
        };
        PlacedTexture { id: (0, index), map_from_submap: Rigid3::identity(), texture: texture.into() }
    };
    let options = PaintOptions::default();
    let centre = |map: PaintedMap| map.pixels[map.width * (map.height / 2) + map.width / 2][0];
    let painted = |textures: &[PlacedTexture]| centre(paint(textures, &options).unwrap());
    let summed = |textures: &[PlacedTexture]| centre(sum_evidence(textures, &options).unwrap().painted());
    let (wall, faint) = ([0, 127], [20, 0]);
    // Probabilities of 0.9, 0.65, 0.196 and 0.1: the ends, and the limits that ROS maps name.
    for (pixel, grey) in [(wall, 1), ([0, 36], 92), ([81, 0], 208), ([127, 0], 254)] {
        assert_eq!(summed(&[submap(0, pixel)]), grey, "{pixel:?}");
    }
    let all: Vec<_> = (0..7).map(|i| submap(i, if i == 0 { wall } else { faint })).collect();
    assert!(painted(&all) > 89 && summed(&all) <= 89, "{} {}", painted(&all), summed(&all));
}

#[test]
fn senseless_requests_are_errors() {
    let texture = SubmapTexture {
        pixels: vec![[0, 255]; 4],
        width: 2,
        height: 2,
        resolution: 0.05,
        submap_from_slice: Rigid3::identity(),
    };
    let placed = |x: f64| PlacedTexture {
        id: (0, 0),
        map_from_submap: Rigid3::translation(x, 0.0, 0.0),
        texture: texture.clone().into(),
    };
    let default = PaintOptions::default();
    assert_eq!(paint(&[], &default), Err(PaintError::Empty));
    assert_eq!(paint(&[placed(f64::NAN)], &default), Err(PaintError::Pose((0, 0))));
    assert!(matches!(paint(&[placed(0.0), placed(1e12)], &default), Err(PaintError::TooLarge { .. })));
    assert!(matches!(
        paint(&[placed(0.0)], &PaintOptions { resolution: 1e-9, ..default }),
        Err(PaintError::TooLarge { .. })
    ));
    assert!(matches!(
        paint(&[placed(0.0)], &PaintOptions { resolution: 0.0, ..default }),
        Err(PaintError::Resolution(_))
    ));
    let crop = Some(MapArea { min_x: 0.0, min_y: 0.0, max_x: -1.0, max_y: f64::INFINITY });
    assert_eq!(paint(&[placed(0.0)], &PaintOptions { crop, ..default }), Err(PaintError::Crop));
    let mut wrong = placed(0.0);
    wrong.texture.width = 3;
    assert_eq!(paint(&[wrong], &default), Err(PaintError::Texture((0, 0))));
}
