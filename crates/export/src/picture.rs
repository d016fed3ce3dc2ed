//! Draws pictures of maps: the background in colours, and over it trajectories, loop closures and a scale bar.

use portolan_mapfile::{MapArea, PaintError, PlacedTexture};
use tiny_skia::{IntSize, Pixmap, PixmapMut, PixmapRef};

use crate::colour::{rgb, to_bytes};
use crate::overlay::{ConstraintLine, ScaleBar, TrajectoryLine, draw_constraints, draw_trajectories};
use crate::raster::{Frame, MapColours, raster};

/// Upper limit of the maximum number of pixels along an edge.
pub const MAX_EDGE: usize = 16384;
/// Margin around the map as a fraction of its longer edge; dimensionless.
const MARGIN: f64 = 0.03;
/// Number of pixels of the longer edge to which small maps are magnified.
const COMFORTABLE_EDGE: usize = 1200;
/// Minimum extent of a map in a picture, metres.
const MIN_EXTENT: f64 = 0.5;

/// Content and size of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureOptions {
    /// Metres per pixel; none: chosen so that the picture is neither small nor larger than `max_edge`.
    pub resolution: Option<f64>,
    /// Maximum number of pixels along an edge, 16 to [`MAX_EDGE`].
    pub max_edge: usize,
    /// Area of the map to draw; none for the whole map.
    pub crop: Option<MapArea>,
    /// Whether there is a scale bar.
    pub scale_bar: bool,
    /// Colours of space; none: chosen by whether the map has free space.
    pub colours: Option<MapColours>,
}

impl Default for PictureOptions {
    fn default() -> Self {
        Self { resolution: None, max_edge: 2400, crop: None, scale_bar: true, colours: None }
    }
}

/// Content of a map picture.
#[derive(Clone, Debug, Default)]
pub struct MapContent<'a> {
    /// Submaps in the order in which they are painted.
    pub textures: &'a [PlacedTexture],
    /// Trajectories over them.
    pub trajectories: &'a [TrajectoryLine],
    /// Loop closures between submaps and trajectories in drawing order.
    pub constraints: &'a [ConstraintLine],
}

/// Why a picture cannot be drawn.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PictureError {
    /// The background cannot be painted.
    #[error(transparent)]
    Paint(#[from] PaintError),
    /// There are neither submaps nor trajectories.
    #[error("there is nothing to draw: no submap has a grid and no trajectory has a node")]
    Empty,
    /// The maximum number of pixels along an edge is out of range.
    #[error("the largest edge must be 16 to {MAX_EDGE} pixels, not {0}")]
    MaxEdge(usize),
    /// The requested resolution makes the picture too large.
    #[error(
        "at {resolution} m a pixel the picture would have {width:.0} x {height:.0} pixels; the longer \
         edge may have {max_edge}: take {enough:.3} m or more, crop, or allow a larger picture"
    )]
    TooLarge {
        /// Requested metres per pixel.
        resolution: f64,
        /// Number of columns required.
        width: f64,
        /// Number of rows required.
        height: f64,
        /// Maximum number of pixels along an edge.
        max_edge: usize,
        /// A resolution that is coarse enough, metres per pixel.
        enough: f64,
    },
}

/// A finished picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Area of the picture in the map.
    pub frame: Frame,
    /// Red, green, blue, row by row from the top.
    pub rgb: Vec<u8>,
}

/// Draws a map, or single submaps of it. The picture does not depend on the number of threads.
///
/// # Errors
/// If there is nothing to draw, or the picture would be too large.
pub fn draw_map(content: &MapContent, options: &PictureOptions) -> Result<Picture, PictureError> {
    let frame = frame(content, options)?;
    let colours = options.colours.unwrap_or_else(|| suitable_colours(content.textures));
    let ground = raster(content.textures, &frame, &colours)?;
    compose(frame, &ground, to_bytes(colours.unknown), options.scale_bar, &mut |canvas, scale| {
        draw_constraints(canvas, &frame, content.constraints, scale);
        draw_trajectories(canvas, &frame, content.trajectories, scale);
    })
}

/// A picture of a background (red, green, blue, row by row) with the overlay of `draw`, which gets the scale
/// of strokes, and a scale bar in the corner with the fewest covered pixels.
pub(crate) fn compose(
    frame: Frame,
    ground: &[u8],
    paper: [u8; 3],
    scale_bar: bool,
    draw: &mut dyn FnMut(&mut PixmapMut, f32),
) -> Result<Picture, PictureError> {
    let mut rgba = vec![255; ground.len() / 3 * 4];
    for (opaque, pixel) in rgba.as_chunks_mut::<4>().0.iter_mut().zip(ground.as_chunks::<3>().0) {
        opaque[..3].copy_from_slice(pixel);
    }
    let size = IntSize::from_wh(frame.width as u32, frame.height as u32);
    let mut pixmap = size
        .and_then(|size| Pixmap::from_vec(rgba, size))
        .ok_or(PictureError::MaxEdge(frame.width.max(frame.height)))?;
    let scale = (frame.width.max(frame.height) as f32 / 1000.0).clamp(0.5, 4.0);
    let mut canvas = pixmap.as_mut();
    draw(&mut canvas, scale);
    if let Some(bar) = ScaleBar::new(&frame, scale).filter(|_| scale_bar) {
        let place = emptiest(canvas.as_ref(), bar.places(&frame), paper);
        bar.draw(&mut canvas, place);
    }
    // Every pixel is opaque, so premultiplied colours equal the colours.
    let mut rgb = vec![0; pixmap.data().len() / 4 * 3];
    for (pixel, &[r, g, b, _]) in rgb.as_chunks_mut::<3>().0.iter_mut().zip(pixmap.data().as_chunks::<4>().0)
    {
        *pixel = [r, g, b];
    }
    Ok(Picture { frame, rgb })
}

/// The first of the rectangles with the fewest pixels that differ from the background colour.
fn emptiest(canvas: PixmapRef, places: [[f32; 4]; 4], ground: [u8; 3]) -> [f32; 4] {
    let width = canvas.width() as usize;
    let covered = |[x, y, w, h]: [f32; 4]| {
        let rows = canvas.data().chunks_exact(4 * width).skip(y as usize).take(h as usize);
        let pixels = rows.flat_map(|r| r.chunks_exact(4).skip(x as usize).take(w as usize));
        pixels.filter(|p| !p.starts_with(&ground)).count()
    };
    // `min_by_key` returns the first of equal minima.
    places.into_iter().min_by_key(|p| covered(*p)).unwrap_or(places[0])
}

/// White background if only walls are known (3D seen from above), grey if free space is known.
pub(crate) fn suitable_colours(textures: &[PlacedTexture]) -> MapColours {
    let (mut free, mut known) = (0_u64, 0_u64);
    for placed in textures {
        free += placed.texture.free_count() as u64;
        known += placed.texture.known_count() as u64;
    }
    let unknown = if 4 * free < known { rgb(0xf4f5f7) } else { rgb(0xc6cbd1) };
    MapColours { free: rgb(0xffffff), occupied: rgb(0x14181d), unknown }
}

pub(crate) fn frame(content: &MapContent, options: &PictureOptions) -> Result<Frame, PictureError> {
    if !(16..=MAX_EDGE).contains(&options.max_edge) {
        return Err(PictureError::MaxEdge(options.max_edge));
    }
    let area = match &options.crop {
        Some(area) => {
            let size = [area.max_x - area.min_x, area.max_y - area.min_y];
            if !size.iter().all(|s| s.is_finite() && *s > 0.0) {
                return Err(PaintError::Crop.into());
            }
            *area
        }
        None => with_margin(extent(content)?),
    };
    let size = [area.max_x - area.min_x, area.max_y - area.min_y];
    let longer = size[0].max(size[1]);
    let coarsest = longer / options.max_edge as f64;
    let resolution = match options.resolution {
        Some(resolution) if !(resolution.is_finite() && resolution > 0.0) => {
            return Err(PaintError::Resolution(resolution).into());
        }
        Some(resolution) if resolution < coarsest * (1.0 - 1e-9) => {
            let [width, height] = size.map(|s| s / resolution);
            let max_edge = options.max_edge;
            return Err(PictureError::TooLarge { resolution, width, height, max_edge, enough: coarsest });
        }
        Some(resolution) => resolution,
        None => {
            let native = content.textures.iter().map(|t| t.texture.resolution).fold(f64::INFINITY, f64::min);
            let comfortable = longer / COMFORTABLE_EDGE.min(options.max_edge) as f64;
            native.min(comfortable).max(coarsest)
        }
    };
    let [width, height] = size.map(|s| ((s / resolution - 1e-6).ceil() as usize).clamp(1, options.max_edge));
    Ok(Frame { width, height, resolution, upper_left: [area.min_x, area.max_y] })
}

fn with_margin(area: MapArea) -> MapArea {
    let centre = [(area.min_x + area.max_x) / 2.0, (area.min_y + area.max_y) / 2.0];
    let size = [area.max_x - area.min_x, area.max_y - area.min_y];
    let margin = MARGIN * size[0].max(size[1]);
    let half = size.map(|s| s.max(MIN_EXTENT) / 2.0 + margin);
    MapArea {
        min_x: centre[0] - half[0],
        min_y: centre[1] - half[1],
        max_x: centre[0] + half[0],
        max_y: centre[1] + half[1],
    }
}

/// The rectangle that contains all submaps and trajectories.
///
/// # Errors
/// There are none.
pub fn extent(content: &MapContent) -> Result<MapArea, PictureError> {
    let corners = content.textures.iter().flat_map(|placed| {
        let texture = &placed.texture;
        let map_from_slice = placed.map_from_submap * texture.submap_from_slice;
        let (w, h) = (texture.width as f64, texture.height as f64);
        [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)].map(|(column, row)| {
            let (x, y) = (-row * texture.resolution, -column * texture.resolution);
            let p = map_from_slice * portolan_geometry::nalgebra::Point3::new(x, y, 0.0);
            [p.x, p.y]
        })
    });
    let points = content.trajectories.iter().flat_map(|t| t.points.iter().copied());
    let mut all = corners.chain(points).filter(|p| p.iter().all(|v| v.is_finite()));
    let first = all.next().ok_or(PictureError::Empty)?;
    let start = MapArea { min_x: first[0], max_x: first[0], min_y: first[1], max_y: first[1] };
    Ok(all.fold(start, |a, [x, y]| MapArea {
        min_x: a.min_x.min(x),
        max_x: a.max_x.max(x),
        min_y: a.min_y.min(y),
        max_y: a.max_y.max(y),
    }))
}
