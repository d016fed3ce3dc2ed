//! Draws a path over a map in colours that show what was known along it.

use portolan_mapfile::PlacedTexture;

use crate::colour::{Rgb, to_bytes};
use crate::overlay::{TrajectoryLine, draw_coloured};
use crate::picture::{MapContent, Picture, PictureError, PictureOptions, compose, frame, suitable_colours};
use crate::raster::raster;

/// A part of a path in one colour.
#[derive(Clone, Debug, PartialEq)]
pub struct ColouredLine {
    /// Colour of the line.
    pub colour: Rgb,
    /// Map positions in order of time, metres; a single one is a dot.
    pub points: Vec<[f64; 2]>,
}

/// Draws lines over a map, the last on top. The picture does not depend on the number of threads.
///
/// # Errors
/// If there is nothing to draw, or the picture would be too large.
pub fn draw_path(
    textures: &[PlacedTexture],
    lines: &[ColouredLine],
    options: &PictureOptions,
) -> Result<Picture, PictureError> {
    let extents: Vec<TrajectoryLine> =
        lines.iter().map(|line| TrajectoryLine { index: 0, points: line.points.clone() }).collect();
    let content = MapContent { textures, trajectories: &extents, constraints: &[] };
    let frame = frame(&content, options)?;
    let colours = options.colours.unwrap_or_else(|| suitable_colours(textures));
    let ground = raster(textures, &frame, &colours)?;
    compose(frame, &ground, to_bytes(colours.unknown), options.scale_bar, &mut |canvas, scale| {
        draw_coloured(canvas, &frame, lines, scale);
    })
}
