//! The clouds of the golden vectors (`spec/vectors.md`).

use portolan_geometry::Point3f;

/// Linear congruential generator of the golden vectors.
pub struct Lcg(pub u32);

impl Lcg {
    /// Uniform in [−a, a).
    pub fn uniform(&mut self, a: f32) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let u = (self.0 >> 8) as f32 / 16_777_216.0;
        (u * 2.0 - 1.0) * a
    }
}

/// `n` points within 20 m, 20 m and 3 m of the origin; "cloud A" is seed 1 with 1000 points.
pub fn lcg_cloud(seed: u32, n: usize) -> Vec<Point3f> {
    let mut lcg = Lcg(seed);
    (0..n)
        .map(|_| {
            let (x, y) = (lcg.uniform(20.0), lcg.uniform(20.0));
            Point3f::new(x, y, lcg.uniform(3.0))
        })
        .collect()
}

/// CRC-32 of the coordinates as little-endian bytes.
pub fn crc(points: &[Point3f]) -> u32 {
    let bytes: Vec<u8> = points.iter().flat_map(|p| p.coords.data.0[0]).flat_map(f32::to_le_bytes).collect();
    crc32fast::hash(&bytes)
}
