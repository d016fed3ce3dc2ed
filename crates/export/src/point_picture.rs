//! Draws pictures of clouds: points counted by pixel in a parallel projection from any side, of a slab or of
//! all points.

use std::io;

/// Darkness of a pixel with one point as a fraction of black, so that thin walls stay visible; dimensionless.
const FAINTEST: f64 = 0.25;
/// Step to which grey values are rounded: files compress better, with no visible difference.
const STEP: u8 = 8;
/// Fraction of the pixels with points that are below full black; dimensionless.
const STRONG: f64 = 0.97;

/// View of a cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointView {
    /// Position at the centre of the picture, metres.
    pub centre: [f64; 3],
    /// Unit vector that points to the right.
    pub right: [f64; 3],
    /// Unit vector that points up, at a right angle to `right`.
    pub up: [f64; 3],
    /// Distance in front of or behind the centre beyond which points are left out, metres.
    pub half_depth: f64,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Metres per pixel.
    pub resolution: f64,
}

impl PointView {
    /// A view of `size` metres (width, height), with at most `max_edge` pixels along an edge and no pixel
    /// smaller than `finest` metres.
    pub fn new(
        centre: [f64; 3],
        [right, up]: [[f64; 3]; 2],
        size: [f64; 2],
        max_edge: usize,
        finest: f64,
    ) -> Self {
        let resolution = (size[0].max(size[1]) / max_edge.max(1) as f64).max(finest);
        let pixels = |metres: f64| ((metres / resolution).ceil() as usize).clamp(1, max_edge.max(1));
        let (width, height) = (pixels(size[0]), pixels(size[1]));
        Self { centre, right, up, half_depth: f64::INFINITY, width, height, resolution }
    }

    /// The same view of a slab about the centre.
    pub fn with_half_depth(self, half_depth: f64) -> Self {
        Self { half_depth, ..self }
    }

    /// Position in pixels to the right and down from the upper left corner; it may be outside of the picture.
    pub fn place(&self, point: [f64; 3]) -> [f64; 2] {
        let from = self.offset(point);
        [
            0.5 * self.width as f64 + dot(from, self.right) / self.resolution,
            0.5 * self.height as f64 - dot(from, self.up) / self.resolution,
        ]
    }

    /// Row-major index of the pixel of a point; none outside of picture or slab.
    #[inline]
    pub fn pixel(&self, point: [f64; 3]) -> Option<usize> {
        let [x, y] = self.place(point);
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        if !inside || (self.half_depth.is_finite() && self.depth(point).abs() > self.half_depth) {
            return None;
        }
        Some(y as usize * self.width + x as usize)
    }

    fn offset(&self, point: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| point[k] - self.centre[k])
    }

    /// Distance from the centre towards the viewer, metres.
    fn depth(&self, point: [f64; 3]) -> f64 {
        let ([a, b, c], [u, v, w]) = (self.right, self.up);
        dot(self.offset(point), [b * w - c * v, c * u - a * w, a * v - b * u])
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Numbers of points by pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PointImage {
    counts: Vec<u32>,
}

impl PointImage {
    /// An image of a view without points.
    pub fn new(view: &PointView) -> Self {
        Self { counts: vec![0; view.width * view.height] }
    }

    /// Counts a point; `view` must be that of the image.
    #[inline]
    pub fn add(&mut self, view: &PointView, point: [f64; 3]) {
        if let Some(count) = view.pixel(point).and_then(|pixel| self.counts.get_mut(pixel)) {
            *count = count.saturating_add(1);
        }
    }

    /// Adds the counts of another image of the same view.
    pub fn merge(&mut self, other: &Self) {
        for (a, b) in self.counts.iter_mut().zip(&other.counts) {
            *a = a.saturating_add(*b);
        }
    }

    /// The count that is drawn black: nearly all pixels with points have fewer. Images to be compared use the
    /// larger one of theirs.
    pub fn strong_count(&self) -> u32 {
        let mut hit: Vec<u32> = self.counts.iter().copied().filter(|c| *c > 0).collect();
        let place = (hit.len() as f64 * STRONG) as usize;
        if hit.is_empty() {
            return 1;
        }
        let place = place.min(hit.len() - 1);
        *hit.select_nth_unstable(place).1
    }

    /// Grey values row by row: white without points, black from `strong` points on, logarithmic in between.
    pub fn grey(&self, strong: u32) -> Vec<u8> {
        let full = f64::from(strong.max(1)).ln_1p();
        let grey = |count: &u32| match count {
            0 => 255,
            count => {
                let share = (f64::from(*count).ln_1p() / full).min(1.0);
                let grey = 255.0 * (1.0 - FAINTEST - (1.0 - FAINTEST) * share);
                grey as u8 / STEP * STEP
            }
        };
        self.counts.iter().map(grey).collect()
    }
}

/// The bytes of a PNG file with grey values.
///
/// # Errors
/// Fails if the size is not that of the values.
pub fn encode_grey(width: usize, height: usize, grey: &[u8]) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    crate::png_file::encode(&mut bytes, png::ColorType::Grayscale, [width, height], grey)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_projected_to_pixels() {
        let from_above = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let view = PointView::new([10.0, 5.0, 1.0], from_above, [4.0, 2.0], 40, 0.01);
        assert_eq!((view.width, view.height), (40, 20));
        assert_eq!(view.pixel([8.05, 5.95, 99.0]), Some(0));
        assert_eq!(view.pixel([11.95, 4.05, 0.0]), Some(799));
        assert_eq!(view.pixel([12.05, 5.0, 0.0]), None);
        assert_eq!(view.pixel([f64::NAN, 5.0, 0.0]), None);
        let slab = view.with_half_depth(0.2);
        assert_eq!((slab.pixel([10.0, 5.0, 1.1]).is_some(), slab.pixel([10.0, 5.0, 1.3])), (true, None));
        // View from the front: x to the right, z up, y away.
        let front = PointView::new([0.0; 3], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [2.0, 2.0], 20, 0.01)
            .with_half_depth(0.5);
        assert_eq!(front.pixel([-0.95, 0.4, 0.95]), Some(0));
        assert_eq!(front.pixel([-0.95, 0.6, 0.95]), None);
    }

    #[test]
    fn more_points_are_darker() {
        let view = PointView::new([0.0; 3], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [3.0, 1.0], 3, 0.01);
        let mut image = PointImage::new(&view);
        image.add(&view, [0.0; 3]);
        (0..100).for_each(|_| image.add(&view, [1.0, 0.0, 0.0]));
        let mut twice = image.clone();
        twice.merge(&image);
        assert_eq!((image.strong_count(), twice.strong_count()), (100, 200));
        let grey = image.grey(image.strong_count());
        assert!(grey[0] == 255 && grey[1] < 200 && grey[2] == 0, "{grey:?}");
        let png = encode_grey(3, 1, &grey).unwrap();
        assert!(png.starts_with(b"\x89PNG") && encode_grey(9, 9, &grey).is_err());
    }
}
