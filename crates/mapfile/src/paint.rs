//! Paints submaps into one image of the map (`formats.md §8`).
//!
//! The inputs are plain textures, so that submaps of a file and submaps that are still being built are
//! painted alike.

use portolan_geometry::{NearFrame, Rigid3};
use rayon::prelude::*;

use crate::packed_texture::PackedTexture;
use crate::resample::{Affine, Sample, Sampler, add_evidence, apply, over};
use portolan_pbstream::IdInFile;

/// Margin around the submaps, pixels.
const PADDING: f32 = 5.0;
/// Number of rows that one thread paints as a unit.
const BAND: usize = 32;
/// Maximum number of pixels of the textures that are unpacked at a time, unless a single one has more.
const GROUP_PIXELS: usize = 16 << 20;

/// A texture and the pose of its submap.
#[derive(Clone, Debug)]
pub struct PlacedTexture {
    /// `(trajectory id, index)` of the submap. Textures are painted in the order given, which should be
    /// ascending.
    pub id: IdInFile,
    /// Pose of the submap in the global map.
    pub map_from_submap: Rigid3,
    /// Texture of the submap.
    pub texture: PackedTexture,
}

/// A rectangle in the map frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapArea {
    /// Smallest x.
    pub min_x: f64,
    /// Smallest y.
    pub min_y: f64,
    /// Largest x.
    pub max_x: f64,
    /// Largest y.
    pub max_y: f64,
}

/// Options of painting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaintOptions {
    /// Edge of a pixel in metres.
    pub resolution: f64,
    /// The area to paint; if none, all submaps with a margin of 5 pixels.
    pub crop: Option<MapArea>,
    /// Maximum number of pixels of an image; larger ones are refused. Painting takes two bytes for each.
    pub max_pixels: u64,
}

impl Default for PaintOptions {
    fn default() -> Self {
        Self { resolution: 0.05, crop: None, max_pixels: 1 << 28 }
    }
}

/// Why a map could not be painted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PaintError {
    /// There is no submap with a grid.
    #[error("there is nothing to paint: no submap has a grid")]
    Empty,
    /// The resolution is not positive and finite.
    #[error("the resolution must be a positive number of metres, not {0}")]
    Resolution(f64),
    /// The rectangle to crop to is empty or not finite.
    #[error("the area to paint is empty or not finite")]
    Crop,
    /// A texture has no finite pose.
    #[error("submap ({}, {}) has no finite pose", .0.0, .0.1)]
    Pose(IdInFile),
    /// A texture does not have width times height pixels.
    #[error("the texture of submap ({}, {}) does not have width times height pixels", .0.0, .0.1)]
    Texture(IdInFile),
    /// The image would be too large.
    #[error(
        "the picture would have {width} x {height} pixels, more than the limit of {limit}; take a \
         resolution of {enough:.3} m or crop"
    )]
    TooLarge {
        /// Columns.
        width: f64,
        /// Rows.
        height: f64,
        /// Maximum number of pixels.
        limit: u64,
        /// A resolution that is coarse enough, metres.
        enough: f64,
    },
}

/// A painted map, row by row from the top (largest y).
#[derive(Clone, Debug, PartialEq)]
pub struct PaintedMap {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Edge of a pixel in metres.
    pub resolution: f64,
    /// Origin of the map frame in the image: pixels from the left and from the top.
    pub origin: [f64; 2],
    /// `(grey, known)` for each pixel. Grey is from 0 (occupied) over 128 (unknown) to 255 (free). Known is 0
    /// where no submap has observed cells.
    pub pixels: Vec<[u8; 2]>,
}

impl PaintedMap {
    /// Grey values from 0 (occupied) to 255 (free): the image of ROS maps.
    pub fn grey(&self) -> impl Iterator<Item = u8> + '_ {
        self.pixels.iter().map(|p| p[0])
    }

    /// Occupancy in percent, −1 for unknown; rows from the bottom (smallest y), as in `nav_msgs/OccupancyGrid`.
    pub fn occupancy(&self) -> Vec<i8> {
        let rows = self.pixels.chunks(self.width.max(1)).rev();
        rows.flatten().map(|pixel| occupancy(*pixel)).collect()
    }

    /// Position of the lower left corner of the image in the map frame, metres.
    pub fn lower_left(&self) -> [f64; 2] {
        [-self.origin[0] * self.resolution, (self.origin[1] - self.height as f64) * self.resolution]
    }

    /// Position in the image, pixels from the left and from the top, of a position in the map frame.
    pub fn pixel_from_map(&self, position: [f64; 2]) -> [f64; 2] {
        [position[0] / self.resolution + self.origin[0], self.origin[1] - position[1] / self.resolution]
    }
}

fn occupancy([grey, known]: [u8; 2]) -> i8 {
    if known == 0 {
        return -1;
    }
    ((1.0 - f64::from(grey) / 255.0) * 100.0).round() as i8
}

/// Evidence summed over all submaps, row by row from the top (largest y).
#[derive(Clone, Debug, PartialEq)]
pub struct EvidenceMap {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Edge of a pixel in metres.
    pub resolution: f64,
    /// Origin of the map frame in the image: pixels from the left and from the top.
    pub origin: [f64; 2],
    /// Sums of log odds: positive is free, negative is occupied, 0 is unknown. One submap contributes from
    /// −127 (probability 0.9) to 63 (probability 0.1, at half weight).
    pub evidence: Vec<i16>,
}

impl EvidenceMap {
    /// The map in grey, linear in log odds: 0 for probabilities of 0.9 or more, 255 for 0.1 or less.
    pub fn painted(&self) -> PaintedMap {
        let pixel = |evidence: &i16| {
            let value = if *evidence > 0 { evidence.saturating_mul(2) } else { *evidence };
            let grey = 128 + value.clamp(-128, 127);
            [grey as u8, if *evidence == 0 { 0 } else { 255 }]
        };
        PaintedMap {
            width: self.width,
            height: self.height,
            resolution: self.resolution,
            origin: self.origin,
            pixels: self.evidence.iter().map(pixel).collect(),
        }
    }
}

/// Paints textures one over the other, in the order given. The result does not depend on the number of threads.
///
/// A texture seen exactly from the side (of a submap tilted by 90°) has no area and is not painted.
///
/// # Errors
/// If there is nothing to paint, the image would be too large, or an option or a texture is not valid.
pub fn paint(textures: &[PlacedTexture], options: &PaintOptions) -> Result<PaintedMap, PaintError> {
    let (layout, pixels) = blend_all(textures, options, [128, 0], over)?;
    let Layout { width, height, origin } = layout;
    Ok(PaintedMap { width, height, resolution: options.resolution, origin, pixels })
}

/// Adds up the evidence of all submaps at each pixel, as a Bayesian filter does. Where submaps disagree, a
/// map of [`paint`] shows the last one without a measure of certainty, and free space that many submaps
/// observed from afar erases walls that few observed from nearby. The sum shows the state that most evidence
/// supports.
///
/// # Errors
/// As for [`paint`].
pub fn sum_evidence(textures: &[PlacedTexture], options: &PaintOptions) -> Result<EvidenceMap, PaintError> {
    let (layout, evidence) = blend_all(textures, options, 0, add_evidence)?;
    let Layout { width, height, origin } = layout;
    Ok(EvidenceMap { width, height, resolution: options.resolution, origin, evidence })
}

/// Size of an image and position of the map's origin in it.
struct Layout {
    width: usize,
    height: usize,
    origin: [f64; 2],
}

fn blend_all<P: Copy + Send>(
    textures: &[PlacedTexture],
    options: &PaintOptions,
    ground: P,
    blend: impl Fn(&mut P, Sample) + Sync,
) -> Result<(Layout, Vec<P>), PaintError> {
    let resolution = options.resolution;
    if !resolution.is_finite() || resolution <= 0.0 {
        return Err(PaintError::Resolution(resolution));
    }
    // Far from the origin single precision does not resolve pixels: work in a near frame.
    let frame = NearFrame::around(textures.iter().map(|t| t.map_from_submap.translation.vector));
    let slices = textures.iter().map(|t| Slice::new(t, &frame, resolution)).collect::<Result<Vec<_>, _>>()?;
    let off = [frame.origin().x / resolution, -frame.origin().y / resolution];
    let (size, origin) = match &options.crop {
        Some(area) => {
            let (size, [x, y]) = cropped(area, resolution)?;
            (size, [x + off[0], y + off[1]])
        }
        None => bounds(&slices).ok_or(PaintError::Empty)?,
    };
    if size[0] * size[1] > options.max_pixels as f64 || size[0] > 1e9 || size[1] > 1e9 {
        let enough = resolution * (size[0] * size[1] / options.max_pixels as f64).sqrt() * 1.01;
        let [width, height] = size;
        return Err(PaintError::TooLarge { width, height, limit: options.max_pixels, enough });
    }
    let (width, height) = (size[0] as usize, size[1] as usize);
    let mut pixels = vec![ground; width * height];
    let mut rest: &[Slice] = &slices.into_iter().filter(|s| s.reaches(size, origin)).collect::<Vec<_>>();
    while let Some((group, after)) = first_group(rest) {
        blend_group(group, origin, width, &mut pixels, &blend);
        rest = after;
    }
    let origin = [origin[0] - off[0], origin[1] - off[1]];
    Ok((Layout { width, height, origin }, pixels))
}

/// The slices that are painted next, and the rest.
fn first_group<'a, 'b>(slices: &'b [Slice<'a>]) -> Option<(&'b [Slice<'a>], &'b [Slice<'a>])> {
    let mut sum = 0_usize;
    let fitting = slices.iter().take_while(|s| {
        sum = sum.saturating_add(s.texture.pixel_count());
        sum <= GROUP_PIXELS
    });
    let count = fitting.count().max(1);
    (!slices.is_empty()).then(|| slices.split_at(count))
}

fn blend_group<P: Copy + Send>(
    group: &[Slice],
    origin: [f64; 2],
    width: usize,
    pixels: &mut [P],
    blend: &(impl Fn(&mut P, Sample) + Sync),
) {
    let unpacked: Vec<Vec<[u8; 2]>> = group.par_iter().map(|s| s.texture.pixels()).collect();
    let samplers: Vec<Sampler> =
        group.iter().zip(&unpacked).filter_map(|(s, pixels)| s.sampler(pixels, origin)).collect();
    pixels.par_chunks_mut(width.max(1) * BAND).enumerate().for_each(|(band, rows)| {
        for sampler in &samplers {
            for (i, row) in rows.chunks_mut(width.max(1)).enumerate() {
                sampler.paint_row(band * BAND + i, row, blend);
            }
        }
    });
}

/// A texture in the near frame, with the affine map from its pixels to the image before the shift by the
/// origin.
struct Slice<'a> {
    texture: &'a PackedTexture,
    /// Columns of the affine map: per texture column, per texture row, offset.
    picture_from_texture: Affine,
}

impl<'a> Slice<'a> {
    fn new(placed: &'a PlacedTexture, frame: &NearFrame, resolution: f64) -> Result<Self, PaintError> {
        let texture = &placed.texture;
        if texture.width.checked_mul(texture.height) != Some(texture.pixel_count()) {
            return Err(PaintError::Texture(placed.id));
        }
        let near_from_slice = frame.near(&placed.map_from_submap) * texture.submap_from_slice;
        let columns: [[f64; 4]; 4] = near_from_slice.to_homogeneous().into();
        let [[xx, yx, ..], [xy, yy, ..], _, [x, y, ..]] = columns;
        let (r, s) = (texture.resolution / resolution, 1.0 / resolution);
        let picture_from_texture = [[r * yx, r * xx], [-r * yy, -r * xy], [s * x, -s * y]];
        if !picture_from_texture.as_flattened().iter().all(|v| v.is_finite()) {
            return Err(PaintError::Pose(placed.id));
        }
        Ok(Self { texture, picture_from_texture })
    }

    fn corners(&self) -> [[f32; 2]; 4] {
        let (w, h) = (self.texture.width as f64, self.texture.height as f64);
        [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)]
            .map(|(x, y)| apply(self.picture_from_texture, x, y).map(|v| v as f32))
    }

    /// Whether it can paint any pixel of an image of this size. The filter reaches less than a texture pixel
    /// beyond the corners.
    fn reaches(&self, size: [f64; 2], origin: [f64; 2]) -> bool {
        let [[ax, ay], [bx, by], _] = self.picture_from_texture;
        let corners = self.corners();
        let xs = corners.map(|[x, _]| f64::from(x) + origin[0]);
        let ys = corners.map(|[_, y]| f64::from(y) + origin[1]);
        [(xs, size[0], ax, bx), (ys, size[1], ay, by)].iter().all(|(positions, size, a, b)| {
            let margin = 2.0 * (a.abs() + b.abs()) + 2.0;
            positions.iter().any(|p| *p >= -margin) && positions.iter().any(|p| *p <= size + margin)
        })
    }

    /// `pixels` are the unpacked pixels of its texture.
    fn sampler<'p>(&self, pixels: &'p [[u8; 2]], origin: [f64; 2]) -> Option<Sampler<'p>> {
        let [a, b, [x, y]] = self.picture_from_texture;
        let (width, height) = (self.texture.width, self.texture.height);
        Sampler::new(pixels, width, height, [a, b, [x + origin[0], y + origin[1]]])
    }
}

type SizeAndOrigin = ([f64; 2], [f64; 2]);

/// Size of the image and position of the map's origin in it, in single precision as in the format.
fn bounds(slices: &[Slice]) -> Option<SizeAndOrigin> {
    let mut corners = slices.iter().flat_map(Slice::corners);
    let first = corners.next()?;
    let (min, max) = corners.fold((first, first), |(lo, hi), c| {
        ([lo[0].min(c[0]), lo[1].min(c[1])], [hi[0].max(c[0]), hi[1].max(c[1])])
    });
    let extent = [max[0] - min[0], max[1] - min[1]];
    let size = extent.map(|e| f64::from(e.ceil()) + 2.0 * f64::from(PADDING));
    Some((size, min.map(|m| f64::from(PADDING - m))))
}

fn cropped(area: &MapArea, resolution: f64) -> Result<SizeAndOrigin, PaintError> {
    let size = [area.max_x - area.min_x, area.max_y - area.min_y];
    if !size.iter().all(|s| s.is_finite() && *s > 0.0) {
        return Err(PaintError::Crop);
    }
    Ok((
        size.map(|s| (s / resolution - 1e-6).ceil().max(1.0)),
        [-area.min_x / resolution, area.max_y / resolution],
    ))
}
