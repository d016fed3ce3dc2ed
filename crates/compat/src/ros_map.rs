//! `cartographer_pbstream_to_ros_map`: writes a map as `.pgm` and `.yaml` for ROS.

use std::path::Path;

use portolan_mapfile::{ImageName, PaintOptions, load_textures, paint, write_ros_map};
use portolan_pbstream::MapReader;

use crate::flags::{Flags, KnownFlags};
use crate::{CompatError, Completeness, Console};

/// Writes a map as `.pgm` and `.yaml`.
///
/// # Errors
/// If flags are wrong, the map cannot be read or painted, or a file cannot be written.
pub fn pbstream_to_ros_map(
    arguments: &[String],
    console: &mut dyn Console,
) -> Result<Completeness, CompatError> {
    let flags = Flags::parse(
        arguments,
        &KnownFlags {
            values: &[("pbstream_filename", ""), ("map_filestem", "map"), ("resolution", "0.05")],
            switches: &[],
            usage: "usage: cartographer_pbstream_to_ros_map -pbstream_filename MAP [-map_filestem map] \
                    [-resolution 0.05]",
        },
    )?;
    let map = flags.path("pbstream_filename")?;
    let options = PaintOptions { resolution: flags.number("resolution")?, ..PaintOptions::default() };
    console.info("Loading submap slices from serialized data.");
    let failed = |error| CompatError::in_file(&map, error);
    let mut reader = MapReader::open(&map).map_err(failed)?;
    let loaded = load_textures(&mut reader).map_err(failed)?;
    for (id, reason) in &loaded.skipped {
        console.warning(&format!("submap {},{} is not drawn: {reason}", id.0, id.1));
    }
    console.info("Generating combined map image from submap slices.");
    let painted = paint(&loaded.textures, &options).map_err(|error| CompatError::in_file(&map, error))?;
    write_ros_map(Path::new(flags.value("map_filestem")), &painted, ImageName::AsOpened)?;
    Ok(if loaded.skipped.is_empty() { Completeness::Complete } else { Completeness::WithLoss })
}
