//! Writes PNG files.

use std::io;
use std::path::Path;

use portolan_atomic_file::{AtomicFile, WriteError};
use portolan_mapfile::PaintedMap;

use crate::picture::Picture;

/// Writes a picture.
///
/// # Errors
/// If the file cannot be written.
pub fn write_picture(path: &Path, picture: &Picture) -> Result<(), WriteError> {
    write_png(path, png::ColorType::Rgb, [picture.frame.width, picture.frame.height], &picture.rgb)
}

/// Writes red, green, blue, row by row from the top.
pub(crate) fn write_rgb(path: &Path, size: [usize; 2], rgb: &[u8]) -> Result<(), WriteError> {
    write_png(path, png::ColorType::Rgb, size, rgb)
}

/// Writes the grey values of a painted map, those of ROS maps, as PNG.
///
/// # Errors
/// If the file cannot be written.
pub fn write_grey_map(path: &Path, map: &PaintedMap) -> Result<(), WriteError> {
    let grey: Vec<u8> = map.grey().collect();
    write_png(path, png::ColorType::Grayscale, [map.width, map.height], &grey)
}

fn write_png(path: &Path, colour: png::ColorType, size: [usize; 2], data: &[u8]) -> Result<(), WriteError> {
    let mut file = AtomicFile::create(path)?;
    match encode(&mut file, colour, size, data) {
        Ok(()) => file.commit(),
        Err(source) => Err(file.error(source)),
    }
}

pub(crate) fn encode(
    sink: impl io::Write,
    colour: png::ColorType,
    size: [usize; 2],
    data: &[u8],
) -> io::Result<()> {
    let [width, height] = size.map(|s| u32::try_from(s).unwrap_or(u32::MAX));
    let mut encoder = png::Encoder::new(sink, width, height);
    encoder.set_color(colour);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(data)?;
    writer.finish()?;
    Ok(())
}
