//! Helpers shared by tests.

use portolan_geometry::{Point3f, Rigid3, to_f32};

/// A linear congruential generator: the same numbers on every machine.
pub(crate) struct Lcg(u32);

impl Lcg {
    pub fn new(seed: u32) -> Self {
        Self(seed)
    }

    /// In [0, 1).
    pub fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / 16_777_216.0
    }

    /// In [−a, a).
    pub fn symmetric(&mut self, a: f32) -> f32 {
        (self.unit() * 2.0 - 1.0) * a
    }
}

/// Posts and cars along a street, and rings on the ground that move with the scanner.
pub(crate) fn street(seen_from: &Rigid3) -> Vec<Point3f> {
    let mut points = Vec::new();
    let here = to_f32(&seen_from.inverse());
    for i in 0..12 {
        let x = 5.3 * i as f32 + (i * i % 5) as f32 - 30.0;
        for k in 0..12 {
            let z = 0.25 * k as f32 - 1.7;
            points.push(here * Point3f::new(x, 6.0 + (i % 3) as f32, z));
            points.push(here * Point3f::new(x + 1.7, -5.0 - (i % 2) as f32, z));
        }
    }
    for ring in [4.0_f32, 6.0, 9.0, 14.0] {
        let at = |degree: i32| (degree as f32).to_radians();
        points.extend((0..360).map(|d| Point3f::new(ring * at(d).cos(), ring * at(d).sin(), -1.7)));
    }
    points
}
