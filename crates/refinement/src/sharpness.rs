//! Sharpness without truth: mean map entropy and mean plane variance (Razlaw et al., "Evaluation of
//! registration methods for sparse 3D laser scans", 2015).

use std::fmt;

use nalgebra::Matrix3;
use portolan_geometry::Vector3;
use rayon::prelude::*;
use serde::Serialize;

use crate::Moments;
use crate::neighbours::KdTree;

/// What sharpness is measured with. Values can only be compared between clouds of equal density measured
/// with equal options.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SharpnessOptions {
    /// Neighbourhood, metres.
    pub radius: f64,
    /// Points with fewer neighbours (themselves included) do not count.
    pub min_neighbours: usize,
    /// Larger clouds are thinned to so many points first.
    pub max_points: usize,
    /// At so many of them the neighbourhood is looked at.
    pub queries: usize,
}

impl Default for SharpnessOptions {
    fn default() -> Self {
        Self { radius: 0.15, min_neighbours: 8, max_points: 300_000, queries: 20_000 }
    }
}

/// How sharp a cloud is; lower is sharper.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sharpness {
    /// Mean of `½ ln det(2πe Σ)` over the neighbourhoods.
    pub mean_map_entropy: f64,
    /// Mean of the smallest eigenvalue of Σ, square metres.
    pub mean_plane_variance: f64,
    /// Standard error of the entropy.
    pub entropy_standard_error: f64,
    /// Points that were thinned to and searched.
    pub points: usize,
    /// Neighbourhoods that counted.
    pub neighbourhoods: usize,
    /// Mean number of points in them.
    pub mean_neighbours: f64,
    /// With which options.
    pub options: SharpnessOptions,
}

/// So many of `count` indices, spread evenly and not in step with any regular order of the points; ascending.
/// The same every time.
pub fn spread_sample(count: usize, wanted: usize) -> Vec<u32> {
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

/// Measures how sharp a cloud is (metres, any frame); none if no neighbourhood has enough points.
pub fn sharpness(points: &[[f64; 3]], options: SharpnessOptions) -> Option<Sharpness> {
    let origin = *points.first()?;
    let chosen = spread_sample(points.len(), options.max_points);
    // Relative to one of the points, so that single precision is enough for the search.
    let near: Vec<[f32; 3]> =
        chosen.iter().map(|i| std::array::from_fn(|k| (points[*i as usize][k] - origin[k]) as f32)).collect();
    let tree = KdTree::new(&near);
    let queries = spread_sample(near.len(), options.queries);
    let entropies: Vec<Option<(f64, f64, f64)>> = queries
        .par_iter()
        .map(|i| {
            let centre = near[*i as usize];
            let mut moments = Moments::default();
            tree.within(centre, options.radius as f32, |n| {
                let p = near[n.index as usize];
                moments
                    .add(&Vector3::from(std::array::from_fn::<f64, 3, _>(|k| f64::from(p[k] - centre[k]))));
            });
            if moments.count < options.min_neighbours.max(4) as f64 {
                return None;
            }
            // The unbiased covariance, as the published figures have it.
            let unbiased = moments.covariance() * (moments.count / (moments.count - 1.0));
            let scaled: Matrix3<f64> = unbiased * (2.0 * std::f64::consts::PI * std::f64::consts::E);
            let determinant = scaled.determinant();
            let plane = moments.plane()?;
            (determinant > 0.0).then(|| (0.5 * determinant.ln(), plane.variances[0], moments.count))
        })
        .collect();
    let found: Vec<(f64, f64, f64)> = entropies.into_iter().flatten().collect();
    let count = found.len() as f64;
    if found.is_empty() {
        return None;
    }
    let mean = |value: fn(&(f64, f64, f64)) -> f64| found.iter().map(value).sum::<f64>() / count;
    let mean_map_entropy = mean(|f| f.0);
    let variance = found.iter().map(|f| (f.0 - mean_map_entropy).powi(2)).sum::<f64>() / count;
    Some(Sharpness {
        mean_map_entropy,
        mean_plane_variance: mean(|f| f.1),
        entropy_standard_error: (variance / count).sqrt(),
        points: near.len(),
        neighbourhoods: found.len(),
        mean_neighbours: mean(|f| f.2),
        options,
    })
}

impl fmt::Display for Sharpness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "Sharpness within {} m, at least {} points ({} neighbourhoods of {:.1} points, {} points searched)",
            self.options.radius,
            self.options.min_neighbours,
            self.neighbourhoods,
            self.mean_neighbours,
            self.points
        )?;
        write!(
            f,
            "  mean map entropy {:.3} ± {:.3}  mean plane thickness {:.2} cm",
            self.mean_map_entropy,
            self.entropy_standard_error,
            100.0 * self.mean_plane_variance.sqrt()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thicker_wall_has_more_entropy() {
        let wall = |thickness: f64| -> Vec<[f64; 3]> {
            (0..20_000)
                .map(|i| {
                    let (a, b) = (f64::from(i % 141), f64::from(i / 141));
                    let noise = (f64::from(i) * 0.754_877_666).fract() - 0.5;
                    [1e4 + noise * thickness, a * 0.02, b * 0.02]
                })
                .collect()
        };
        let sharp = sharpness(&wall(0.01), SharpnessOptions::default()).unwrap();
        let blurred = sharpness(&wall(0.05), SharpnessOptions::default()).unwrap();
        assert!(sharp.mean_map_entropy < blurred.mean_map_entropy - 1.0);
        // The variance of a uniform distribution is width²/12; single precision relative to a point is enough.
        assert!((blurred.mean_plane_variance / (0.05 * 0.05 / 12.0) - 1.0).abs() < 0.1);
        assert!(sharpness(&[[0.0; 3]], SharpnessOptions::default()).is_none());
    }

    #[test]
    fn samples_are_spread_and_distinct() {
        let chosen = spread_sample(1000, 100);
        assert_eq!(chosen.len(), 100);
        assert!(chosen.windows(2).all(|w| w[0] < w[1]) && chosen[0] < 10 && chosen[99] >= 990);
        assert_eq!(spread_sample(3, 10), [0, 1, 2]);
    }
}
