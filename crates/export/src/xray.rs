//! X-ray pictures of clouds: the number of occupied voxels along a direction (`spec/formats.md` §6.4).
//!
//! A pixel is darker the more occupied voxels are along its line of sight, on a logarithmic scale. Seen from
//! above walls are dark and floors are faint. There are three differences from Cartographer: a single voxel
//! is not white; the darkest tone is that of the 99.5th percentile instead of the darkest pixel; and each
//! voxel is shared among the four nearest pixels, so that grids rotated relative to each other cause no moiré
//! pattern.

mod sample;

use crate::colour::{Rgb, hsv, mix, rgb, to_bytes};
use crate::overlay::{TrajectoryLine, draw_title, draw_trajectories};
use crate::picture::{Picture, PictureError, compose};
use crate::raster::Frame;
pub use sample::{CloudSample, Extent};

/// Margin around the cloud as a fraction of its longer edge; dimensionless.
const MARGIN: f64 = 0.03;
/// Colours of X-rays: background and darkest tone.
const PAPER: Rgb = rgb(0xffffff);
const INK: Rgb = rgb(0x0d1b2a);
/// Background of coloured pictures.
const NIGHT: Rgb = rgb(0x12161c);
/// Fraction of the pixels that are at most as dark as the darkest tone; dimensionless.
const DARKEST: f64 = 0.995;

/// A viewing direction, horizontal or down, in a rotated map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct XrayView {
    right: [f64; 3],
    up: [f64; 3],
}

impl XrayView {
    /// View from above; `yaw` is the direction in the map that points right, radians.
    pub fn top(yaw: f64) -> Self {
        let (s, c) = yaw.sin_cos();
        Self { right: [c, s, 0.0], up: [-s, c, 0.0] }
    }

    /// Horizontal view; `yaw` is the direction in the map that points right, radians.
    pub fn level(yaw: f64) -> Self {
        let (s, c) = yaw.sin_cos();
        Self { right: [c, s, 0.0], up: [0.0, 0.0, 1.0] }
    }

    /// Projects a position in the map: metres to the right and up.
    #[inline]
    pub fn project(&self, position: [f64; 3]) -> [f64; 2] {
        [self.right, self.up]
            .map(|axis| axis[0] * position[0] + axis[1] * position[1] + axis[2] * position[2])
    }
}

/// A picture to which voxels are added.
#[derive(Clone, Debug)]
pub struct XrayPicture {
    frame: Frame,
    pixels_per_metre: f64,
    weights: Vec<f32>,
    /// Weighted sums of the tints of pixels; empty for black on white.
    tints: Vec<f32>,
}

impl XrayPicture {
    /// A picture of the area between two projected corners (metres to the right and up), with a margin.
    /// Pixels are at least `resolution` metres, and so large that no edge has more than `max_edge` of them.
    pub fn new(from: [f64; 2], to: [f64; 2], resolution: f64, max_edge: usize, is_coloured: bool) -> Self {
        let size = [to[0] - from[0], to[1] - from[1]].map(|s| if s.is_finite() { s.max(0.5) } else { 0.5 });
        let margin = MARGIN * size[0].max(size[1]);
        let size = size.map(|s| s + 2.0 * margin);
        let max_edge = max_edge.clamp(16, crate::MAX_EDGE);
        let resolution = resolution.max(size[0].max(size[1]) / max_edge as f64).max(1e-4);
        let [width, height] = size.map(|s| ((s / resolution).ceil() as usize).clamp(1, max_edge));
        let frame = Frame { width, height, resolution, upper_left: [from[0] - margin, to[1] + margin] };
        let pixels = width * height;
        let tints = if is_coloured { vec![0.0; pixels] } else { Vec::new() };
        Self { frame, pixels_per_metre: 1.0 / resolution, weights: vec![0.0; pixels], tints }
    }

    /// Adds an occupied voxel at a projected position. In coloured pictures `tint` is 0 for the first colour
    /// and 1 for the last; pixels get the mean.
    #[inline]
    pub fn add(&mut self, position: [f64; 2], tint: f64) {
        let [left, top] = self.frame.upper_left;
        let x = ((position[0] - left) * self.pixels_per_metre) as f32 - 0.5;
        let y = ((top - position[1]) * self.pixels_per_metre) as f32 - 0.5;
        let (width, height) = (self.frame.width, self.frame.height);
        if !((-1.0..width as f32).contains(&x) && (-1.0..height as f32).contains(&y)) {
            return;
        }
        // Shifted by one pixel to the left and above, so that truncation rounds down.
        let (column, row) = ((x + 1.0) as usize, (y + 1.0) as usize);
        let (fx, fy) = (x + 1.0 - column as f32, y + 1.0 - row as f32);
        let shares = [[(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy)], [(1.0 - fx) * fy, fx * fy]];
        for (row, [left, right]) in (row..).zip(shares) {
            if !(1..=height).contains(&row) {
                continue;
            }
            let line = (row - 1) * width;
            if column > 0 {
                self.add_to_pixel(line + column - 1, left, tint);
            }
            if column < width {
                self.add_to_pixel(line + column, right, tint);
            }
        }
    }

    #[inline(always)]
    fn add_to_pixel(&mut self, at: usize, share: f32, tint: f64) {
        if let Some(sum) = self.weights.get_mut(at) {
            *sum += share;
        }
        if let Some(sum) = self.tints.get_mut(at) {
            *sum += share * tint as f32;
        }
    }

    /// The finished picture with trajectories (projected), a title and a scale bar.
    ///
    /// # Errors
    /// Fails only if there is not enough memory for a picture of that size.
    pub fn finish(&self, trajectories: &[TrajectoryLine], title: &str) -> Result<Picture, PictureError> {
        let full = self.darkest();
        let tone = |weight: f32| (weight.ln_1p() / full.ln_1p()).min(1.0);
        let is_coloured = !self.tints.is_empty();
        let mut ground = Vec::with_capacity(3 * self.weights.len());
        for (i, weight) in self.weights.iter().enumerate() {
            let colour = match self.tints.get(i) {
                Some(sum) if *weight > 0.0 => {
                    let colour = colour_of_share(f64::from(sum / weight));
                    mix(NIGHT, colour, (1.6 * tone(*weight).sqrt()).min(1.0))
                }
                Some(_) => NIGHT,
                None => mix(PAPER, INK, tone(*weight)),
            };
            ground.extend(to_bytes(colour));
        }
        let paper = to_bytes(if is_coloured { NIGHT } else { PAPER });
        compose(self.frame, &ground, paper, true, &mut |canvas, scale| {
            draw_trajectories(canvas, &self.frame, trajectories, 0.7 * scale);
            draw_title(canvas, title, scale);
        })
    }

    /// The weight of the darkest tone.
    fn darkest(&self) -> f32 {
        let mut weights: Vec<f32> = self.weights.iter().copied().filter(|w| *w > 0.05).collect();
        if weights.is_empty() {
            return 1.0;
        }
        let index = ((weights.len() - 1) as f64 * DARKEST) as usize;
        let (_, weight, _) = weights.select_nth_unstable_by(index, f32::total_cmp);
        weight.max(2.0)
    }
}

/// Colour scale from blue at 0, over green and yellow, to red at 1.
pub fn colour_of_share(share: f64) -> Rgb {
    hsv(0.66 * (1.0 - share.clamp(0.0, 1.0) as f32), 0.75, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_are_dark_from_above_and_broad_from_the_side() {
        let mut top = XrayPicture::new([0.0, 0.0], [10.0, 10.0], 0.1, 500, false);
        let view = XrayView::top(0.0);
        // A floor, and a wall along y at x = 5.
        for i in 0..100 {
            for k in 0..100 {
                let (u, v) = (0.05 + 0.1 * f64::from(i), 0.05 + 0.1 * f64::from(k));
                top.add(view.project([u, v, 0.0]), 0.0);
                if k < 30 {
                    top.add(view.project([5.05, u, 0.1 * f64::from(k)]), 0.0);
                }
            }
        }
        let picture = top.finish(&[], "").unwrap();
        let grey = |x: f64, y: f64| {
            let (column, row) = picture.frame.pixel([x, y]);
            picture.rgb[3 * (row as usize * picture.frame.width + column as usize)]
        };
        assert!(
            grey(5.05, 5.0) < 40 && (100..250).contains(&grey(2.0, 5.0)),
            "{} {}",
            grey(5.05, 5.0),
            grey(2.0, 5.0)
        );
        assert_eq!(grey(-0.2, 5.0), 255);
    }

    #[test]
    fn side_views_are_not_mirrored() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-12;
        assert!(near(XrayView::top(0.0).project([1.0, 2.0, 3.0]), [1.0, 2.0]));
        assert!(near(XrayView::top(quarter).project([1.0, 2.0, 3.0]), [2.0, -1.0]));
        assert!(near(XrayView::level(0.0).project([1.0, 2.0, 3.0]), [1.0, 3.0]));
        assert!(near(XrayView::level(quarter).project([1.0, 2.0, 3.0]), [2.0, 3.0]));
    }

    #[test]
    fn sizes_are_bounded_for_any_request() {
        for (to, resolution) in [([1e6, 10.0], 0.01), ([f64::NAN, f64::INFINITY], 0.1), ([0.0, 0.0], 0.0)] {
            let mut picture = XrayPicture::new([0.0, 0.0], to, resolution, 400, true);
            picture.add([f64::NAN, 1e300], 0.0);
            assert!(picture.frame.width <= 400 && picture.frame.height <= 400, "{:?}", picture.frame);
            assert!(picture.finish(&[], "a title that does not fit").is_ok());
        }
    }
}
