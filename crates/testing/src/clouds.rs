//! Reproducible random points, the same as those of the golden vectors.

use portolan_geometry::Point3f;

/// Linear congruential generator of the golden vectors.
#[derive(Clone, Debug)]
pub struct Lcg(u32);

impl Lcg {
    /// With a seed.
    pub fn new(seed: u32) -> Self {
        Self(seed)
    }

    /// A number in [0, 1).
    pub fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / 16_777_216.0
    }

    /// A number in [−a, a).
    pub fn symmetric(&mut self, a: f32) -> f32 {
        (self.unit() * 2.0 - 1.0) * a
    }
}

/// `n` random points within ±20 m, ±20 m and ±3 m of the origin in x, y and z; "cloud A" is seed 1 with 1000 points.
pub fn flat_box(seed: u32, n: usize) -> Vec<Point3f> {
    let mut lcg = Lcg::new(seed);
    (0..n).map(|_| Point3f::from([20.0, 20.0, 3.0].map(|a| lcg.symmetric(a)))).collect()
}

/// `n` random points on an oval wall with two flat ends and on a floor; "cloud B" is seed 21 with 2000 points.
pub fn oval_hall(seed: u32, n: usize) -> Vec<Point3f> {
    let mut lcg = Lcg::new(seed);
    let points = (0..n).map(|i| {
        let (a, h) = (lcg.symmetric(std::f32::consts::PI), lcg.symmetric(1.0));
        let (mut x, y, mut z) = (8.0 * a.cos(), 5.0 * a.sin(), 2.0 * h);
        if i % 3 == 0 {
            x = if x > 0.0 { 6.0 } else { -6.0 };
        }
        if i % 7 == 0 {
            z = -2.0;
        }
        Point3f::from([x, y, z].map(|v| (v * 1024.0).round() / 1024.0))
    });
    points.collect()
}

/// CRC-32 of coordinates as little-endian bytes.
pub fn crc(points: &[Point3f]) -> u32 {
    let bytes: Vec<u8> = points.iter().flat_map(|p| [p.x, p.y, p.z]).flat_map(f32::to_le_bytes).collect();
    crc32fast::hash(&bytes)
}
