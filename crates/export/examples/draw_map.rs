//! Draws a map file: `draw_map <map.pbstream> <picture.png> [metres per pixel]`.

use std::path::Path;

use portolan_export::{
    MapContent, PictureOptions, constraint_lines, draw_map, trajectory_lines, write_picture,
};
use portolan_mapfile::load_textures;
use portolan_pbstream::MapReader;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, picture, rest @ ..] = &arguments[..] else {
        return Err("usage: draw_map <map.pbstream> <picture.png> [metres per pixel]".into());
    };
    let mut reader = MapReader::open(map)?;
    let textures = load_textures(&mut reader)?.textures;
    let (trajectories, constraints) =
        (trajectory_lines(reader.pose_graph()), constraint_lines(reader.pose_graph()));
    let content = MapContent { textures: &textures, trajectories: &trajectories, constraints: &constraints };
    let resolution = rest.first().map(|r| r.parse()).transpose()?;
    let drawn = draw_map(&content, &PictureOptions { resolution, ..PictureOptions::default() })?;
    write_picture(Path::new(picture), &drawn)?;
    Ok(())
}
