//! Compresses textures that are not being displayed: a map of a thousand submaps has gigabytes of pixels,
//! most of them unknown or equal to their neighbours.

use portolan_geometry::Rigid3;

use crate::texture::SubmapTexture;

/// A [`SubmapTexture`] compressed to a few tenths of its memory.
#[derive(Clone, Debug, PartialEq)]
pub struct PackedTexture {
    /// Number of columns; the column grows along −y of the slice.
    pub width: usize,
    /// Number of rows; the row grows along −x of the slice.
    pub height: usize,
    /// Edge of a pixel in metres.
    pub resolution: f64,
    /// Pose in the submap frame of the corner of the first pixel.
    pub submap_from_slice: Rigid3,
    /// LZ4 of `(value, alpha)` row by row.
    packed: Vec<u8>,
    count: usize,
    known: usize,
    free: usize,
}

impl PackedTexture {
    /// Number of pixels: `width` times `height` if the texture is intact.
    pub fn pixel_count(&self) -> usize {
        self.count
    }

    /// Number of known pixels.
    pub fn known_count(&self) -> usize {
        self.known
    }

    /// Number of pixels with a value above 0: free space.
    pub fn free_count(&self) -> usize {
        self.free
    }

    /// `(value, alpha)` row by row; `(0, 0)` is unknown.
    pub fn pixels(&self) -> Vec<[u8; 2]> {
        let mut pixels = vec![[0; 2]; self.count];
        // Compressed by this type, so decompression does not fail. If it did, the remaining pixels would be
        // unknown.
        let _ = lz4_flex::block::decompress_into(&self.packed, pixels.as_flattened_mut());
        pixels
    }
}

impl From<SubmapTexture> for PackedTexture {
    fn from(texture: SubmapTexture) -> Self {
        let SubmapTexture { pixels, width, height, resolution, submap_from_slice } = texture;
        Self {
            width,
            height,
            resolution,
            submap_from_slice,
            packed: lz4_flex::block::compress(pixels.as_flattened()),
            count: pixels.len(),
            known: pixels.iter().filter(|p| **p != [0, 0]).count(),
            free: pixels.iter().filter(|[value, _]| *value > 0).count(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pixels_come_back(
            runs in prop::collection::vec((any::<[u8; 2]>(), 0usize..200), 0..40), width in 0usize..50
        ) {
            let pixels: Vec<[u8; 2]> = runs.iter().flat_map(|(pixel, n)| vec![*pixel; *n]).collect();
            let known = pixels.iter().filter(|p| **p != [0, 0]).count();
            let texture = SubmapTexture {
                pixels: pixels.clone(),
                width,
                height: 3,
                resolution: 0.05,
                submap_from_slice: Rigid3::identity(),
            };
            let packed = PackedTexture::from(texture);
            prop_assert_eq!((packed.width, packed.height, packed.known_count()), (width, 3, known));
            prop_assert_eq!(packed.pixel_count(), pixels.len());
            prop_assert_eq!(packed.pixels(), pixels);
        }
    }

    #[test]
    fn uniform_textures_take_little_space() {
        let pixels = (0..1 << 20).map(|i| if i % 1024 < 400 { [0, 0] } else { [63, 0] }).collect();
        let texture = SubmapTexture {
            pixels,
            width: 1024,
            height: 1024,
            resolution: 0.05,
            submap_from_slice: Rigid3::identity(),
        };
        assert!(PackedTexture::from(texture).packed.len() < 100_000);
    }
}
