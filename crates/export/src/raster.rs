//! Draws the background of a map picture: free, occupied and unknown space in colours.

use portolan_mapfile::{MapArea, PaintError, PaintOptions, PlacedTexture, sum_evidence};
use rayon::prelude::*;

use crate::colour::{Rgb, mix, to_bytes};

/// Colours of space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapColours {
    /// Colour of free space.
    pub free: Rgb,
    /// Colour of occupied space.
    pub occupied: Rgb,
    /// Colour of unknown space.
    pub unknown: Rgb,
}

/// Area of the picture in the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Metres per pixel.
    pub resolution: f64,
    /// Map position of the upper left corner, metres.
    pub upper_left: [f64; 2],
}

impl Frame {
    /// Position in the picture, pixels from the upper left corner, of a position in the map.
    pub fn pixel(&self, [x, y]: [f64; 2]) -> (f32, f32) {
        let [left, top] = self.upper_left;
        (((x - left) / self.resolution) as f32, ((top - y) / self.resolution) as f32)
    }
}

/// Maximum factor by which evidence is summed at a finer resolution than that of the picture, if the picture
/// is coarser than the grids. It is then reduced so that thin walls stay visible.
const MAX_REDUCTION: usize = 4;
/// Evidence at which values are clamped before reduction.
const CERTAIN: i16 = 100;
/// Weight of the darkest part, relative to the mean of all parts, in a reduced pixel; 0 to 1.
const WALL_PULL: f32 = 0.6;
/// Number of pixels of evidence that are summed at a time.
const BAND_PIXELS: usize = 16 << 20;

/// Draws the textures as red, green, blue, row by row.
pub fn raster(
    textures: &[PlacedTexture],
    frame: &Frame,
    colours: &MapColours,
) -> Result<Vec<u8>, PaintError> {
    let evidence = evidence(textures, frame)?;
    let tone = Tone::suiting(&evidence, colours);
    let mut rgb = vec![0; 3 * evidence.len()];
    rgb.par_chunks_mut(3 * frame.width).zip(evidence.par_chunks(frame.width)).for_each(|(out, row)| {
        for (pixel, evidence) in out.chunks_exact_mut(3).zip(row) {
            pixel.copy_from_slice(&tone.colour(*evidence));
        }
    });
    Ok(rgb)
}

/// Evidence of each pixel.
fn evidence(textures: &[PlacedTexture], frame: &Frame) -> Result<Vec<i16>, PaintError> {
    let mut evidence = vec![0; frame.width * frame.height];
    let finest = textures.iter().map(|t| t.texture.resolution).fold(f64::INFINITY, f64::min);
    let reduction = ((frame.resolution / finest).round() as usize).clamp(1, MAX_REDUCTION);
    let rows = (BAND_PIXELS / (frame.width * reduction * reduction).max(1)).max(1);
    for (band, out) in evidence.chunks_mut(frame.width * rows).enumerate() {
        let count = out.len() / frame.width;
        let first = band * rows;
        let [left, top] = frame.upper_left;
        let crop = MapArea {
            min_x: left,
            max_x: left + frame.width as f64 * frame.resolution,
            min_y: top - (first + count) as f64 * frame.resolution,
            max_y: top - first as f64 * frame.resolution,
        };
        let options = PaintOptions {
            resolution: frame.resolution / reduction as f64,
            crop: Some(crop),
            max_pixels: u64::MAX,
        };
        let fine = sum_evidence(textures, &options)?;
        let fine_rows: Vec<&[i16]> = fine.evidence.chunks(fine.width.max(1)).collect();
        out.par_chunks_mut(frame.width).zip(fine_rows.par_chunks(reduction)).for_each(|(out, rows)| {
            for (column, pixel) in out.iter_mut().enumerate() {
                let parts = rows.iter().flat_map(|r| r.iter().skip(column * reduction).take(reduction));
                *pixel = reduced(parts.copied());
            }
        });
    }
    Ok(evidence)
}

/// Reduces several values to one: their mean, shifted towards the darkest if that one is occupied.
fn reduced(parts: impl Iterator<Item = i16>) -> i16 {
    let (sum, count, darkest) = parts.fold((0_i32, 0_i32, CERTAIN), |(sum, count, darkest), part| {
        let part = part.clamp(-CERTAIN, CERTAIN);
        (sum + i32::from(part), count + 1, darkest.min(part))
    });
    let mean = sum as f32 / count.max(1) as f32;
    let pulled = if darkest < 0 { mean + WALL_PULL * (f32::from(darkest) - mean) } else { mean };
    pulled.round() as i16
}

/// Maps evidence to colours.
struct Tone {
    /// Colours of −`CERTAIN` to `CERTAIN`.
    colours: Vec<[u8; 3]>,
}

impl Tone {
    /// Adapts the contrast to the map: maps of few scans have little evidence everywhere.
    fn suiting(evidence: &[i16], colours: &MapColours) -> Self {
        let (free, occupied) = (certainty(evidence, 1), certainty(evidence, -1));
        let colour = |e: i16| {
            let strength = |full: f32| (f32::from(e).abs() / full).min(1.0);
            if e > 0 {
                mix(colours.unknown, colours.free, 1.0 - (1.0 - strength(free)).powi(2))
            } else {
                mix(colours.unknown, colours.occupied, 1.0 - (1.0 - strength(occupied)).powi(2))
            }
        };
        Self { colours: (-CERTAIN..=CERTAIN).map(|e| to_bytes(colour(e))).collect() }
    }

    fn colour(&self, evidence: i16) -> [u8; 3] {
        let index = evidence.clamp(-CERTAIN, CERTAIN) + CERTAIN;
        self.colours.get(index.unsigned_abs() as usize).copied().unwrap_or_default()
    }
}

/// Evidence that gets the full colour: the median over the pixels of this sign, within limits.
fn certainty(evidence: &[i16], sign: i16) -> f32 {
    let mut histogram = [0_u64; CERTAIN as usize + 1];
    for e in evidence {
        let strength = e.saturating_mul(sign);
        if strength > 0
            && let Some(count) = histogram.get_mut(strength.min(CERTAIN).unsigned_abs() as usize)
        {
            *count += 1;
        }
    }
    let total: u64 = histogram.iter().sum();
    let mut seen = 0;
    let median = histogram.iter().position(|count| {
        seen += count;
        2 * seen > total
    });
    (median.unwrap_or(0) as f32).clamp(8.0, f32::from(CERTAIN))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colour::rgb;

    #[test]
    fn thin_walls_survive_reduction() {
        assert_eq!(reduced([50, 50, 50, 50].into_iter()), 50);
        assert_eq!(reduced([500, 500, 500, -300].into_iter()), -40);
        assert_eq!(reduced([0, 0, 0, 0].into_iter()), 0);
    }

    #[test]
    fn contrast_follows_the_evidence() {
        let colours = MapColours { free: rgb(0xffffff), occupied: rgb(0x000000), unknown: rgb(0x808080) };
        for strength in [12, 80] {
            let tone = Tone::suiting(&[0, strength, strength, -strength, 1], &colours);
            assert_eq!(tone.colour(strength), [255; 3]);
            assert_eq!(tone.colour(-strength), [0; 3]);
            assert_eq!(tone.colour(0), [128; 3]);
            assert_eq!(tone.colour(i16::MIN), [0; 3]);
        }
    }
}
