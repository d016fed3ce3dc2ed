//! Pictures of real maps: size, colours, files.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::Path;

use portolan_export::{
    MapContent, Picture, PictureError, PictureOptions, TrajectoryLine, constraint_lines, draw_map, palette,
    to_bytes, trajectory_lines, tum_line, write_grey_map, write_picture, write_tum,
};
use portolan_geometry::{Rigid3, Time};
use portolan_mapfile::{MapArea, PaintOptions, PlacedTexture, SubmapTexture, load_textures, paint};
use portolan_pbstream::MapReader;
use portolan_testing::{real_data, spec_data};

fn drawn(path: &Path, options: &PictureOptions) -> Picture {
    let mut reader = MapReader::open(path).unwrap();
    let textures = load_textures(&mut reader).unwrap().textures;
    let trajectories = trajectory_lines(reader.pose_graph());
    let constraints = constraint_lines(reader.pose_graph());
    let content = MapContent { textures: &textures, trajectories: &trajectories, constraints: &constraints };
    draw_map(&content, options).unwrap()
}

fn decoded(path: &Path) -> (u32, u32, png::ColorType, Vec<u8>) {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut data).unwrap();
    (info.width, info.height, info.color_type, data)
}

/// Shares of pixels of the colours of free, occupied and unknown space.
fn shares(picture: &Picture) -> [f64; 3] {
    let of = |colour: [u8; 3]| {
        let same = picture.rgb.chunks_exact(3).filter(|p| **p == colour).count();
        same as f64 / (picture.rgb.len() / 3) as f64
    };
    [of([255; 3]), of([0x14, 0x18, 0x1d]), of([0xc6, 0xcb, 0xd1])]
}

#[test]
fn a_picture_comes_back_from_its_file() {
    let Some(map) = real_data("maps/wild/NHK_pr_108.pbstream") else { return };
    let picture = drawn(&map, &PictureOptions::default());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.png");
    write_picture(&path, &picture).unwrap();
    let (width, height, colour, data) = decoded(&path);
    assert_eq!((width as usize, height as usize), (picture.frame.width, picture.frame.height));
    assert!(colour == png::ColorType::Rgb && data == picture.rgb);
    assert!(height == 1200, "small maps are magnified: {height}");
    let [free, occupied, unknown] = shares(&picture);
    assert!(free > 0.2 && occupied > 0.01 && unknown > 0.2, "{free} {occupied} {unknown}");
    // The trajectory is there in its colour, blended a little.
    let blue = to_bytes(palette(0));
    let close = |p: &&[u8]| p.iter().zip(blue).all(|(a, b)| a.abs_diff(b) < 30);
    assert!(picture.rgb.chunks_exact(3).filter(close).count() > 500);
    assert!(write_picture(&folder.path().join("no/map.png"), &picture).is_err());
}

#[test]
fn sizes_and_crops_are_obeyed() {
    let Some(map) = real_data("maps/reference/aces.pbstream") else { return };
    let small = drawn(&map, &PictureOptions { max_edge: 300, ..PictureOptions::default() });
    assert_eq!(small.frame.width.max(small.frame.height), 300);
    // Thin walls stay visible although each pixel is many cells.
    let dark = small.rgb.chunks_exact(3).filter(|p| p[0] < 0x60).count();
    assert!(dark * 100 > small.rgb.len() / 3, "{dark}");
    let crop = MapArea { min_x: -5.0, min_y: -3.0, max_x: 5.0, max_y: 3.0 };
    let options = PictureOptions { crop: Some(crop), resolution: Some(0.02), ..PictureOptions::default() };
    let part = drawn(&map, &options);
    assert_eq!((part.frame.width, part.frame.height), (500, 300));
    assert_eq!(part.frame.pixel([0.0, 0.0]), (250.0, 150.0));
    // Much of the trajectory is far outside.
    let options = PictureOptions { crop: Some(crop), resolution: Some(0.005), ..PictureOptions::default() };
    assert_eq!(drawn(&map, &options).frame.width, 2000);
}

#[test]
fn the_number_of_threads_does_not_change_the_picture() {
    let Some(map) = real_data("maps/reference/small_3d.pbstream") else { return };
    let draw = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| drawn(&map, &PictureOptions { max_edge: 500, ..PictureOptions::default() }))
    };
    assert!(draw(1) == draw(3));
}

#[test]
fn trajectories_can_be_drawn_alone() {
    let line = |index, points: Vec<[f64; 2]>| TrajectoryLine { index, points };
    let lines = [
        line(0, vec![[0.0, 0.0], [4.0, 1.0], [f64::NAN, 2.0], [5.0, 3.0]]),
        line(1, vec![[1.0, 1.0]]),
        line(2, vec![]),
    ];
    let content = MapContent { trajectories: &lines, ..MapContent::default() };
    let picture = draw_map(&content, &PictureOptions::default()).unwrap();
    assert_eq!(picture.frame.width, 1200);
    assert!(picture.rgb.chunks_exact(3).any(|p| p == [0x2c, 0xa0, 0x2c]));
}

#[test]
fn senseless_requests_are_errors() {
    let error = |content: &MapContent, options: PictureOptions| draw_map(content, &options).unwrap_err();
    let default = PictureOptions::default;
    assert_eq!(error(&MapContent::default(), default()), PictureError::Empty);
    let lines = [TrajectoryLine { index: 0, points: vec![[0.0, 0.0], [1000.0, 0.0]] }];
    let content = MapContent { trajectories: &lines, ..MapContent::default() };
    assert_eq!(error(&content, PictureOptions { max_edge: 0, ..default() }), PictureError::MaxEdge(0));
    assert!(matches!(
        error(&content, PictureOptions { resolution: Some(0.01), ..default() }),
        PictureError::TooLarge { .. }
    ));
    for resolution in [0.0, -1.0, f64::NAN] {
        let options = PictureOptions { resolution: Some(resolution), ..default() };
        assert!(matches!(error(&content, options), PictureError::Paint(_)));
    }
    let crop = Some(MapArea { min_x: 1.0, min_y: 0.0, max_x: 1.0, max_y: f64::NAN });
    assert!(matches!(error(&content, PictureOptions { crop, ..default() }), PictureError::Paint(_)));
}

#[test]
fn far_away_submaps_only_make_the_picture_coarse() {
    let texture = SubmapTexture {
        pixels: vec![[0, 200]; 100],
        width: 10,
        height: 10,
        resolution: 0.05,
        submap_from_slice: Rigid3::identity(),
    };
    for far in [1e5, 1e9, 1e12, 1e17] {
        let textures = [0.0, far].map(|x| PlacedTexture {
            id: (0, 0),
            map_from_submap: Rigid3::translation(x, 0.0, 0.0),
            texture: texture.clone().into(),
        });
        let content = MapContent { textures: &textures, ..MapContent::default() };
        let picture = draw_map(&content, &PictureOptions::default()).unwrap();
        assert_eq!(picture.frame.width, 2400);
    }
}

#[test]
fn grey_maps_are_those_of_ros() {
    let Some(map) = spec_data("local2d.pbstream") else { return };
    let textures = load_textures(&mut MapReader::open(map).unwrap()).unwrap().textures;
    let painted = paint(&textures, &PaintOptions::default()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.png");
    write_grey_map(&path, &painted).unwrap();
    let (width, height, colour, data) = decoded(&path);
    assert_eq!((width, height, colour), (212, 113, png::ColorType::Grayscale));
    assert!(data.into_iter().eq(painted.grey()));
}

#[test]
fn trajectories_keep_their_exact_times() {
    let poses = [
        (Time::from_ros(1_500_000_000, 200_000_100), Rigid3::translation(1.0, -2.5, 1e-10)),
        (Time::from_ros(1_500_000_000, 300_000_000), Rigid3::identity()),
    ];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("poses.tum");
    write_tum(&path, &poses).unwrap();
    let text = std::fs::read_to_string(path).unwrap();
    assert_eq!(
        text,
        "1500000000.2000001 1.000000000 -2.500000000 0.000000000 0.000000000 0.000000000 0.000000000 \
         1.000000000\n1500000000.3000000 0.000000000 0.000000000 0.000000000 0.000000000 0.000000000 \
         0.000000000 1.000000000\n"
    );
    assert!(text.starts_with(&tum_line(poses[0].0, &poses[0].1)));
    assert!(write_tum(&folder.path().join("no/poses.tum"), &poses).is_err());
}
