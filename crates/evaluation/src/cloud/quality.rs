//! All quality measures of a cloud that need no ground truth.

use std::fmt;

use portolan_spatial::{Neighbourhood, Sharpness, SharpnessOptions, ThinnedCloud};
use serde::Serialize;

use super::comparison::{PairedComparison, PlaceValue, compare_places, place_of};
use super::orthogonality::{MutualOrthogonality, mutual_orthogonality};
use super::passes::{PassDistance, PassDistances, PassOptions, pass_distances};
use super::thickness::{WallThickness, wall_thickness};

/// Edge of the places that a comparison treats as independent, metres.
const PLACE: f64 = 2.0;

/// Options of the quality measures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct QualityOptions {
    /// Options of the neighbourhoods.
    pub sharpness: SharpnessOptions,
    /// Edge of the cells in which wall thickness is measured, metres.
    pub wall_cell: f64,
    /// Criteria for another pass.
    pub passes: PassOptions,
}

impl Default for QualityOptions {
    fn default() -> Self {
        Self { sharpness: SharpnessOptions::default(), wall_cell: 0.5, passes: PassOptions::default() }
    }
}

/// Quality of a cloud, measured from the cloud alone.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CloudQuality {
    /// Number of points of the cloud.
    pub points: usize,
    /// Mean map entropy and mean plane variance.
    pub sharpness: Option<Sharpness>,
    /// Mean plane variance of surfaces at right angles.
    pub orthogonality: Option<MutualOrthogonality>,
    /// Thickness of walls.
    pub walls: Option<WallThickness>,
    /// Distances between passes; `None` without times, or if no place was seen in two passes.
    pub passes: Option<PassDistances>,
    #[serde(skip)]
    values: PlaceValues,
}

/// Values by place, for comparisons.
#[derive(Clone, Debug, Default, PartialEq)]
struct PlaceValues {
    entropy: Vec<PlaceValue>,
    thickness: Vec<PlaceValue>,
    across: Vec<PlaceValue>,
}

/// A cloud to be evaluated.
#[derive(Clone, Copy, Debug)]
pub struct CloudToJudge<'a> {
    /// Metres, any frame.
    pub points: &'a [[f64; 3]],
    /// Times of the points, seconds from any origin; empty if unknown.
    pub seconds: &'a [f64],
    /// Positions that assign the points to places in comparisons. For two clouds of the same points (before
    /// and after), give both the positions of one of them. If empty, `points` is used.
    pub places: &'a [[f64; 3]],
}

/// Measures the quality of a cloud. The result does not depend on the number of threads.
pub fn cloud_quality(cloud: &CloudToJudge, options: &QualityOptions) -> CloudQuality {
    let thinned = ThinnedCloud::new(cloud.points, options.sharpness.max_points);
    let neighbourhoods = thinned.neighbourhoods(&options.sharpness);
    let (passes, distances) = match cloud.seconds.len() == cloud.points.len() {
        true => pass_distances(&thinned, &neighbourhoods, cloud.seconds, options.passes),
        false => (None, Vec::new()),
    };
    CloudQuality {
        points: cloud.points.len(),
        sharpness: Sharpness::of(&neighbourhoods, thinned.near().len(), options.sharpness),
        orthogonality: mutual_orthogonality(&neighbourhoods),
        walls: wall_thickness(cloud.points, options.wall_cell),
        passes,
        values: place_values(cloud, &neighbourhoods, &distances),
    }
}

fn place_values(
    cloud: &CloudToJudge,
    neighbourhoods: &[Neighbourhood],
    distances: &[PassDistance],
) -> PlaceValues {
    let at = if cloud.places.len() == cloud.points.len() { cloud.places } else { cloud.points };
    let place = |index: u32| place_of(at[index as usize], PLACE);
    PlaceValues {
        entropy: neighbourhoods.iter().map(|n| (place(n.index), n.entropy)).collect(),
        thickness: neighbourhoods
            .iter()
            .filter(|n| n.is_planar())
            .map(|n| (place(n.index), 100.0 * n.variances[0].sqrt()))
            .collect(),
        across: distances.iter().map(|d| (place(d.index), 100.0 * d.across)).collect(),
    }
}

impl CloudQuality {
    /// Compares with a cloud of the same places: the changes from this cloud to `after`, with their
    /// probability of chance.
    pub fn compared_with(&self, after: &Self) -> Vec<PairedComparison> {
        let (a, b) = (&self.values, &after.values);
        [
            compare_places("map entropy", &a.entropy, &b.entropy),
            compare_places("thickness of planar places (cm)", &a.thickness, &b.thickness),
            compare_places("distance between passes across the surface (cm)", &a.across, &b.across),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}

impl fmt::Display for CloudQuality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.sharpness {
            Some(sharpness) => write!(f, "{sharpness}")?,
            None => write!(f, "Too few points near each other to measure sharpness; try a larger radius")?,
        }
        match &self.orthogonality {
            Some(orthogonality) => write!(f, "\n{orthogonality}")?,
            None => write!(f, "\nMutual orthogonality: no surfaces of three directions at right angles")?,
        }
        if let Some(walls) = &self.walls {
            write!(f, "\n{walls}")?;
        }
        if let Some(passes) = &self.passes {
            write!(f, "\n{passes}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A corner of a room seen in two passes, the second one moved by `drift`.
    fn room(drift: f64) -> (Vec<[f64; 3]>, Vec<f64>) {
        (0..60_000)
            .map(|i| {
                let random = |k: f64| (f64::from(i) * k).fract();
                let (u, v) = (8.0 * random(0.754_877_666), 8.0 * random(0.569_840_291));
                let noise = 0.01 * (random(0.381_966_011) - 0.5);
                let pass = f64::from(u8::from(random(0.414_213_562) > 0.5));
                let p = match i % 3 {
                    0 => [u, v, noise],
                    1 => [u, noise, v],
                    _ => [noise, u, v],
                };
                (p.map(|x| x + drift * pass), 60.0 * pass)
            })
            .unzip()
    }

    #[test]
    fn every_figure_is_better_for_the_better_cloud() {
        let ((sharp, seconds), (blurred, _)) = (room(0.0), room(0.03));
        let judge = |points: &[[f64; 3]]| {
            cloud_quality(
                &CloudToJudge { points, seconds: &seconds, places: &sharp },
                &QualityOptions::default(),
            )
        };
        let (before, after) = (judge(&blurred), judge(&sharp));
        assert!(
            after.orthogonality.unwrap().mean_plane_variance
                < before.orthogonality.unwrap().mean_plane_variance
        );
        assert!(after.walls.as_ref().unwrap().median < before.walls.as_ref().unwrap().median);
        assert!(after.passes.unwrap().median_across < 0.3 * before.passes.unwrap().median_across);
        let changes = before.compared_with(&after);
        assert!(changes.len() == 3 && changes.iter().all(|c| c.direction() == -1), "{changes:?}");
        assert!(before.compared_with(&before).iter().all(|c| c.direction() == 0));
    }

    #[test]
    fn unusual_clouds_are_handled() {
        let judge = |points: &[[f64; 3]]| {
            cloud_quality(&CloudToJudge { points, seconds: &[], places: &[] }, &QualityOptions::default())
        };
        for points in [vec![], vec![[1.0; 3]], vec![[2.0; 3]; 5000], vec![[f64::NAN; 3]; 50]] {
            let quality = judge(&points);
            assert!(quality.sharpness.is_none() && quality.walls.is_none(), "{quality}");
        }
    }
}
