//! Distances of points to true surfaces.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;

use super::search::ShapeTree;
use super::{ReferenceCloud, SolidBox, Triangle};

/// Distances of the points of a cloud to the true surfaces, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SurfaceErrors {
    /// Number of points that were measured.
    pub count: usize,
    /// Number of points that were left out because they are too far from every surface, or not finite.
    pub beyond: usize,
    /// Mean distance.
    pub mean: f64,
    /// Root of the mean square.
    pub rms: f64,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub percentile_95: f64,
    /// Fraction of points within 5 cm, 0 to 1.
    pub within_5_cm: f64,
}

/// The true surfaces.
#[derive(Clone, Debug)]
pub struct TrueSurfaces(Surfaces);

#[derive(Clone, Debug)]
enum Surfaces {
    Boxes(ShapeTree<SolidBox>),
    Triangles(ShapeTree<Triangle>),
    Cloud(ReferenceCloud),
}

impl TrueSurfaces {
    /// Surfaces of solid boxes; none without boxes.
    pub fn boxes(boxes: Vec<SolidBox>) -> Option<Self> {
        (!boxes.is_empty()).then(|| Self(Surfaces::Boxes(ShapeTree::new(boxes))))
    }

    /// Surfaces of a mesh; none without triangles.
    pub fn triangles(triangles: Vec<Triangle>) -> Option<Self> {
        (!triangles.is_empty()).then(|| Self(Surfaces::Triangles(ShapeTree::new(triangles))))
    }

    /// Surfaces of a more accurate cloud.
    pub fn cloud(cloud: ReferenceCloud) -> Self {
        Self(Surfaces::Cloud(cloud))
    }

    /// Distance of each point to the nearest surface, metres, in their order; infinite for points that are not
    /// finite.
    pub fn distances(&self, points: &[[f64; 3]]) -> Vec<f64> {
        match &self.0 {
            Surfaces::Boxes(tree) => points.par_iter().map(|p| tree.distance(*p)).collect(),
            Surfaces::Triangles(tree) => points.par_iter().map(|p| tree.distance(*p)).collect(),
            Surfaces::Cloud(cloud) => {
                points.par_iter().map_init(Vec::new, |found, p| cloud.distance(*p, found)).collect()
            }
        }
    }
}

/// Measures points (in the frame of the boxes) against boxes; none if there are no points or no boxes.
pub fn surface_errors(points: &[[f64; 3]], boxes: &[SolidBox]) -> Option<SurfaceErrors> {
    SurfaceErrors::of(TrueSurfaces::boxes(boxes.to_vec())?.distances(points), f64::INFINITY)
}

impl SurfaceErrors {
    /// Summarises distances. Distances beyond `reach` metres (points of something that the truth does not
    /// contain) and those that are not finite are only counted. `None` if no others remain.
    pub fn of(mut distances: Vec<f64>, reach: f64) -> Option<Self> {
        let all = distances.len();
        distances.retain(|d| d.is_finite() && *d <= reach);
        distances.par_sort_unstable_by(f64::total_cmp);
        let count = distances.len();
        if count == 0 {
            return None;
        }
        let quantile = |q: f64| {
            let place = q * (count - 1) as f64;
            let (low, high) = (distances[place.floor() as usize], distances[place.ceil() as usize]);
            low + (high - low) * place.fract()
        };
        Some(Self {
            count,
            beyond: all - count,
            mean: distances.iter().sum::<f64>() / count as f64,
            rms: (distances.iter().map(|d| d * d).sum::<f64>() / count as f64).sqrt(),
            median: quantile(0.5),
            percentile_95: quantile(0.95),
            within_5_cm: distances.partition_point(|d| *d < 0.05) as f64 / count as f64,
        })
    }
}

impl fmt::Display for SurfaceErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Distance to the true surfaces of {} points", self.count)?;
        if self.beyond > 0 {
            write!(f, " ({} more were too far from any)", self.beyond)?;
        }
        write!(
            f,
            "\n  mean {:.2} cm  rms {:.2} cm  median {:.2} cm  95 % {:.2} cm  within 5 cm {:.1} %",
            100.0 * self.mean,
            100.0 * self.rms,
            100.0 * self.median,
            100.0 * self.percentile_95,
            100.0 * self.within_5_cm
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_known_distances() {
        let floor = SolidBox { low: [-10.0, -10.0, -1.0], high: [10.0, 10.0, 0.0] };
        let points: Vec<[f64; 3]> = (0..=10).map(|i| [0.0, 0.0, f64::from(i) * 0.01]).collect();
        let errors = surface_errors(&points, &[floor]).unwrap();
        assert!((errors.mean - 0.05).abs() < 1e-12 && (errors.median - 0.05).abs() < 1e-12);
        assert!((errors.percentile_95 - 0.095).abs() < 1e-12);
        assert!(surface_errors(&[], &[floor]).is_none() && surface_errors(&points, &[]).is_none());
    }
}
