//! How sharp a point cloud is: without truth by what lies around each point, with truth by the distance to
//! the true surfaces.

mod boxes;
mod sharpness;
mod surface;
mod thickness;

pub use boxes::{SolidBox, read_boxes};
pub use sharpness::{Sharpness, SharpnessOptions, sharpness};
pub use surface::{SurfaceErrors, surface_errors};
pub use thickness::{WallThickness, wall_thickness};

/// So many of `count` indices, spread evenly and not in step with any regular order of the points; ascending.
/// The same every time.
pub(crate) fn sample(count: usize, wanted: usize) -> Vec<u32> {
    if count <= wanted {
        return (0..count as u32).collect();
    }
    // One index out of each of `wanted` equal parts, at a place within it that a fixed generator chooses.
    let mut state = 0x2545_f491_4f6c_dd1du64;
    let part = count as f64 / wanted as f64;
    (0..wanted)
        .map(|i| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let within = (state >> 11) as f64 / (1u64 << 53) as f64;
            (((i as f64 + within) * part) as usize).min(count - 1) as u32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::sample;

    #[test]
    fn samples_are_spread_and_distinct() {
        let chosen = sample(1000, 100);
        assert_eq!(chosen.len(), 100);
        assert!(chosen.windows(2).all(|w| w[0] < w[1]) && chosen[0] < 10 && chosen[99] >= 990);
        assert_eq!(sample(3, 10), [0, 1, 2]);
    }
}
