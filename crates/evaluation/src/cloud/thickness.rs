//! Thickness of walls: scatter of the points of planar patches across the patch.

use std::collections::BTreeMap;
use std::fmt;

use portolan_geometry::Vector3;
use portolan_spatial::Moments;
use serde::Serialize;

/// Minimum number of points in a patch.
const MIN_POINTS: f64 = 20.0;

/// Thickness (standard deviation across) of the planar patches of a cloud, metres.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WallThickness {
    /// Edge of the cubic cell of a patch, metres.
    pub cell: f64,
    /// Number of planar patches.
    pub patches: usize,
    /// Median over the patches.
    pub median: f64,
    /// 90th percentile over the patches.
    pub percentile_90: f64,
    /// Number of patches in each bin of half a centimetre; the last bin also counts all thicker patches.
    pub histogram_half_centimetres: Vec<u32>,
}

/// Measures the thickness of planar patches in cells of `cell` metres, in the frame of the points; `None` if
/// there is no planar patch.
pub fn wall_thickness(points: &[[f64; 3]], cell: f64) -> Option<WallThickness> {
    const BINS: usize = 20;
    if cell.is_nan() || cell <= 0.0 {
        return None;
    }
    let mut cells: BTreeMap<[i64; 3], Moments> = BTreeMap::new();
    for point in points.iter().filter(|p| p.iter().all(|v| v.is_finite())) {
        let key = point.map(|v| (v / cell).floor() as i64);
        let within = std::array::from_fn::<f64, 3, _>(|k| point[k] - key[k] as f64 * cell);
        cells.entry(key).or_default().add(&Vector3::from(within));
    }
    let mut found: Vec<f64> = cells
        .values()
        .filter(|moments| moments.count >= MIN_POINTS)
        .filter_map(Moments::plane)
        // Wide in two directions and much thinner in the third.
        .filter(|plane| {
            plane.variances[1] > (0.1 * cell).powi(2) && plane.variances[0] < 0.1 * plane.variances[1]
        })
        .map(|plane| plane.variances[0].sqrt())
        .collect();
    found.sort_by(f64::total_cmp);
    let last = found.len().checked_sub(1)?;
    let mut histogram = vec![0; BINS];
    for thickness in &found {
        histogram[((thickness / 0.005) as usize).min(BINS - 1)] += 1;
    }
    Some(WallThickness {
        cell,
        patches: found.len(),
        median: found[last / 2],
        percentile_90: found[last * 9 / 10],
        histogram_half_centimetres: histogram,
    })
}

impl fmt::Display for WallThickness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Thickness of {} planar patches in cells of {} m", self.patches, self.cell)?;
        write!(f, "  median {:.2} cm  90 % {:.2} cm", 100.0 * self.median, 100.0 * self.percentile_90)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_walls_of_known_thickness() {
        let points: Vec<[f64; 3]> = (0..4000)
            .map(|i| {
                let side = if i % 2 == 0 { 0.01 } else { -0.01 };
                [0.25 + side, f64::from(i / 2 % 40) * 0.05, f64::from(i / 80) * 0.04]
            })
            .collect();
        let found = wall_thickness(&points, 0.5).unwrap();
        assert!((found.median - 0.01).abs() < 1e-6 && found.patches >= 12);
        assert!(wall_thickness(&[], 0.5).is_none() && wall_thickness(&points, 0.0).is_none());
    }
}
