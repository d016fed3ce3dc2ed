//! Resamples a texture through an affine map: bilinear, averaged where the image is coarser than the texture.

/// Number of bits of the weights of the bilinear filter, as in usual 8-bit image libraries.
const WEIGHT_BITS: u32 = 7;
/// Number of fractional bits of fixed-point positions in the texture, pixels.
const POSITION_BITS: u32 = 32;
/// Rounds positions to 2⁻¹⁶ pixels before the weights are truncated. A texture whose pixels coincide with
/// those of the image up to rounding errors is thus copied exactly.
const ROUND_POSITION: i64 = 1 << (POSITION_BITS - 17);
/// Maximum ratio of the pixel edge of the image to that of the texture at which each pixel is sampled once.
const MAX_SCALE_WITHOUT_AVERAGE: f64 = 1.0 / 0.75;
/// Maximum number of samples along each edge of a pixel.
const MAX_SAMPLES: usize = 16;
/// Maximum edge of a texture, pixels: larger ones exceed the range of positions and are not painted.
const MAX_EDGE: usize = 1 << 29;

/// A colour of 8 bits per channel, premultiplied: grey, known, alpha.
pub type Sample = [u32; 3];

/// An affine map of the plane: columns for x, y, offset.
pub type Affine = [[f64; 2]; 3];

/// Applies an affine map to a point.
#[inline]
pub fn apply([[ax, ay], [bx, by], [cx, cy]]: Affine, x: f64, y: f64) -> [f64; 2] {
    [ax * x + bx * y + cx, ay * x + by * y + cy]
}

/// Paints one texture into rows of a picture.
pub struct Sampler<'a> {
    pixels: &'a [[u8; 2]],
    width: usize,
    height: usize,
    /// From a position (x, y) in the image to one (column, row) in the texture.
    texture_from_picture: Affine,
    /// Range of image rows that the texture can reach: `[first, end)`.
    rows: [f64; 2],
    /// Samples along each edge of a pixel.
    samples: usize,
}

impl<'a> Sampler<'a> {
    /// `picture_from_texture` has the columns of the affine map for texture column, texture row and offset.
    /// None if the texture has no area in the image.
    pub fn new(
        pixels: &'a [[u8; 2]],
        width: usize,
        height: usize,
        picture_from_texture: Affine,
    ) -> Option<Self> {
        let [a, b, c] = picture_from_texture;
        let determinant = a[0] * b[1] - b[0] * a[1];
        let texture_from_picture = {
            let x = [b[1] / determinant, -a[1] / determinant];
            let y = [-b[0] / determinant, a[0] / determinant];
            [x, y, [-(x[0] * c[0] + y[0] * c[1]), -(x[1] * c[0] + y[1] * c[1])]]
        };
        let finite = texture_from_picture.as_flattened().iter().all(|v| v.is_finite());
        if !finite || width == 0 || height == 0 || width.max(height) > MAX_EDGE {
            return None;
        }
        // The filter reaches half a texture pixel beyond the edge.
        let (w, h) = (width as f64 + 1.0, height as f64 + 1.0);
        let ys = [(-1.0, -1.0), (w, -1.0), (-1.0, h), (w, h)].map(|(x, y)| a[1] * x + b[1] * y + c[1]);
        let rows = [
            ys.iter().fold(f64::INFINITY, |m, y| m.min(*y)).floor(),
            ys.iter().fold(f64::NEG_INFINITY, |m, y| m.max(*y)).ceil(),
        ];
        let [x, y, _] = texture_from_picture;
        let scale = x[0].hypot(y[0]).max(x[1].hypot(y[1]));
        let samples = if scale < MAX_SCALE_WITHOUT_AVERAGE {
            1
        } else {
            (scale.ceil().min(MAX_SAMPLES as f64) as usize).max(2)
        };
        Some(Self { pixels, width, height, texture_from_picture, rows, samples })
    }

    /// Paints the texture into row `y` of the image; `blend` blends one sample into one pixel.
    pub fn paint_row<P>(&self, y: usize, row: &mut [P], blend: impl Fn(&mut P, Sample)) {
        if (y as f64) + 1.0 < self.rows[0] || (y as f64) > self.rows[1] {
            return;
        }
        let Some((first, end)) = self.columns(y as f64, row.len()) else { return };
        let Some(span) = row.get_mut(first..end) else { return };
        if self.samples == 1 {
            let (mut position, step) = (self.position(first as f64 + 0.5, y as f64 + 0.5), self.step(1.0));
            let mut cell = Cell::NONE;
            for pixel in span {
                let sample = self.bilinear(position, &mut cell);
                if sample != [0; 3] {
                    blend(pixel, sample);
                }
                position = advance(position, step);
            }
        } else {
            for (i, pixel) in span.iter_mut().enumerate() {
                blend(pixel, self.average((first + i) as f64, y as f64));
            }
        }
    }

    /// Range of columns of row `y` that the texture can reach: `[first, end)`.
    fn columns(&self, y: f64, length: usize) -> Option<(usize, usize)> {
        let [[ux, uy], [vx, vy], [ox, oy]] = self.texture_from_picture;
        let (width, height) = (self.width as f64, self.height as f64);
        let (mut low, mut high) = (0.0_f64, length as f64);
        for (u, v, o, size) in [(ux, vx, ox, width), (uy, vy, oy, height)] {
            // For all y within the row; -1 and size + 1 are the limits of the filter.
            let at = [v * y + o, v * (y + 1.0) + o];
            let (least, most) = (at[0].min(at[1]), at[0].max(at[1]));
            if u.abs() * length as f64 <= 1e-6 {
                if most < -1.5 || least > size + 1.5 {
                    return None;
                }
                continue;
            }
            let mut ends = [(-1.0 - most) / u, (size + 1.0 - least) / u];
            if u < 0.0 {
                ends = [(size + 1.0 - least) / u, (-1.0 - most) / u];
            }
            low = low.max(ends[0] - 1.0);
            high = high.min(ends[1] + 1.0);
        }
        (low < high).then(|| (low.floor().max(0.0) as usize, (high.ceil() as usize).min(length)))
    }

    /// Fixed-point texture position of an image position, shifted by half a pixel, so that the four
    /// neighbours are at the integers around it.
    fn position(&self, x: f64, y: f64) -> [i64; 2] {
        apply(self.texture_from_picture, x, y).map(|v| fixed(v - 0.5))
    }

    fn step(&self, dx: f64) -> [i64; 2] {
        self.texture_from_picture[0].map(|u| fixed(u * dx))
    }

    fn average(&self, x: f64, y: f64) -> Sample {
        let n = self.samples;
        let distance = 1.0 / n as f64;
        let step = self.step(distance);
        let (mut sum, mut cell) = ([0; 3], Cell::NONE);
        for j in 0..n {
            let mut position = self.position(x + 0.5 * distance, y + (j as f64 + 0.5) * distance);
            for _ in 0..n {
                let sample = self.bilinear(position, &mut cell);
                for (total, part) in sum.iter_mut().zip(&sample) {
                    *total += part;
                }
                position = advance(position, step);
            }
        }
        let count = (n * n) as u32;
        sum.map(|s| (s + count / 2) / count)
    }

    /// Bilinear sample; outside of the texture all is transparent. `cell` caches the four neighbours of the
    /// previous sample: images that magnify a texture have many samples between the same pixels.
    #[inline]
    fn bilinear(&self, position: [i64; 2], cell: &mut Cell) -> Sample {
        let [x, y] = position.map(|v| v.saturating_add(ROUND_POSITION));
        let at = [x >> POSITION_BITS, y >> POSITION_BITS];
        if cell.at != at {
            let neighbours = self.neighbours(at[0], at[1]);
            *cell = Cell { at, neighbours, is_empty: neighbours == [[0, 0]; 4] };
        }
        if cell.is_empty {
            return [0; 3];
        }
        let neighbours = cell.neighbours;
        let fraction = |v: i64| ((v >> (POSITION_BITS - WEIGHT_BITS)) & ((1 << WEIGHT_BITS) - 1)) as u32;
        // Weights in 256ths.
        let (dx, dy) = (fraction(x) << (8 - WEIGHT_BITS), fraction(y) << (8 - WEIGHT_BITS));
        let weights = [(256 - dx) * (256 - dy), dx * (256 - dy), (256 - dx) * dy, dx * dy];
        let mut sum = [0; 3];
        for (weight, [value, alpha]) in weights.into_iter().zip(neighbours) {
            let known = if value == 0 && alpha == 0 { 0 } else { 255 };
            let colour = [u32::from(value), known, u32::from(alpha)];
            for (total, part) in sum.iter_mut().zip(&colour) {
                *total += weight * part;
            }
        }
        sum.map(|s| s >> 16)
    }

    /// The pixel at a column and row, and those right of it, below it, and right below it.
    #[inline]
    fn neighbours(&self, column: i64, row: i64) -> [[u8; 2]; 4] {
        let inside = (column as u64) < self.width as u64 - 1 && (row as u64) < self.height as u64 - 1;
        if inside {
            let start = row as usize * self.width + column as usize;
            let upper = self.pixels.get(start..start + 2);
            let lower = self.pixels.get(start + self.width..start + self.width + 2);
            if let (Some([a, b]), Some([c, d])) = (upper, lower) {
                return [*a, *b, *c, *d];
            }
        }
        [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| self.pixel(column + i, row + j))
    }

    fn pixel(&self, column: i64, row: i64) -> [u8; 2] {
        let inside = (column as u64) < self.width as u64 && (row as u64) < self.height as u64;
        if !inside {
            return [0, 0];
        }
        self.pixels.get(row as usize * self.width + column as usize).copied().unwrap_or_default()
    }
}

/// Four neighbouring pixels of a texture, between which samples are interpolated.
struct Cell {
    /// Column and row of the first pixel.
    at: [i64; 2],
    neighbours: [[u8; 2]; 4],
    /// Whether all four are unknown.
    is_empty: bool,
}

impl Cell {
    /// Out of the range of positions, which have been shifted right.
    const NONE: Self = Self { at: [i64::MAX; 2], neighbours: [[0; 2]; 4], is_empty: true };
}

/// Saturates, because textures may be extremely far away.
fn advance(position: [i64; 2], step: [i64; 2]) -> [i64; 2] {
    [position[0].saturating_add(step[0]), position[1].saturating_add(step[1])]
}

fn fixed(v: f64) -> i64 {
    (v * (1_i64 << POSITION_BITS) as f64).round() as i64
}

/// The OVER operator: `source + destination * (1 - alpha)` for each channel of a pixel `(grey, known)`.
#[inline]
pub fn over(destination: &mut [u8; 2], [grey, known, alpha]: Sample) {
    let keep = 255 - alpha.min(255);
    let blend = |d: u8, s: u32| {
        // d * keep / 255, rounded.
        let product = u32::from(d) * keep + 128;
        (s + ((product + (product >> 8)) >> 8)).min(255) as u8
    };
    *destination = [blend(destination[0], grey), blend(destination[1], known)];
}

/// Adds up evidence: free is positive, occupied negative. Free space has half weight, because a wall that is
/// slightly displaced in one submap is free space in another.
#[inline]
pub fn add_evidence(sum: &mut i16, [grey, _, alpha]: Sample) {
    *sum = sum.saturating_add((grey / 2) as i16 - alpha as i16);
}
