//! Distances between points measured in different passes: with drift, a wall measured twice appears twice.

use std::fmt;

use portolan_spatial::{Neighbourhood, ThinnedCloud};
use rayon::prelude::*;
use serde::Serialize;

/// Criteria for points of another pass.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PassOptions {
    /// Minimum time between two passes, seconds.
    pub gap: f64,
    /// Maximum distance between points of one surface, metres.
    pub max_distance: f64,
}

impl Default for PassOptions {
    fn default() -> Self {
        Self { gap: 10.0, max_distance: 0.5 }
    }
}

/// Distances from planar places of a cloud to the nearest points of other passes, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PassDistances {
    /// Options used.
    pub options: PassOptions,
    /// Number of planar places that were examined.
    pub places: usize,
    /// Fraction of them with a point of another pass nearby, 0 to 1.
    pub seen_again: f64,
    /// Median distance of the nearest points; depends on the density of points.
    pub median_distance: f64,
    /// Median of this distance across the surface; does not depend on the density.
    pub median_across: f64,
    /// Mean distance across the surface.
    pub mean_across: f64,
    /// 95th percentile of the distance across the surface.
    pub percentile_95_across: f64,
}

/// The distance at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassDistance {
    /// Index of the point in the cloud.
    pub index: u32,
    /// Distance to the nearest point of another pass, metres.
    pub distance: f64,
    /// Component of this distance across the surface, metres.
    pub across: f64,
}

/// Measures at the planar ones among the neighbourhoods of a cloud; `seconds` are the times of all points of
/// the cloud. The summary is `None` if no place has a point of another pass nearby.
pub fn pass_distances(
    cloud: &ThinnedCloud,
    neighbourhoods: &[Neighbourhood],
    seconds: &[f64],
    options: PassOptions,
) -> (Option<PassDistances>, Vec<PassDistance>) {
    let planar: Vec<&Neighbourhood> = neighbourhoods.iter().filter(|n| n.is_planar()).collect();
    let found: Vec<Option<PassDistance>> =
        planar.par_iter().map(|n| pass_distance(cloud, n, seconds, &options)).collect();
    let found: Vec<PassDistance> = found.into_iter().flatten().collect();
    if found.is_empty() {
        return (None, found);
    }
    let count = found.len();
    let sorted = |value: fn(&PassDistance) -> f64| {
        let mut values: Vec<f64> = found.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let (distances, across) = (sorted(|d| d.distance), sorted(|d| d.across));
    let summary = PassDistances {
        options,
        places: planar.len(),
        seen_again: count as f64 / planar.len() as f64,
        median_distance: distances[count / 2],
        median_across: across[count / 2],
        mean_across: across.iter().sum::<f64>() / count as f64,
        percentile_95_across: across[(count - 1) * 95 / 100],
    };
    (Some(summary), found)
}

fn pass_distance(
    cloud: &ThinnedCloud,
    place: &Neighbourhood,
    seconds: &[f64],
    options: &PassOptions,
) -> Option<PassDistance> {
    let own = cloud.chosen().binary_search(&place.index).ok()?;
    let time = *seconds.get(place.index as usize)?;
    let query = cloud.near()[own];
    let hit = cloud.tree().nearest_where(query, options.max_distance as f32, |other| {
        let other = cloud.chosen()[other as usize] as usize;
        seconds.get(other).is_some_and(|t| (t - time).abs() >= options.gap)
    })?;
    let partner = cloud.near()[hit.index as usize];
    let across = (0..3).map(|k| place.normal[k] * f64::from(partner[k] - query[k])).sum::<f64>().abs();
    Some(PassDistance { index: place.index, distance: f64::from(hit.squared_distance).sqrt(), across })
}

impl fmt::Display for PassDistances {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "Passes at least {} s apart: {:.0} % of {} planar places seen again within {} m",
            self.options.gap,
            100.0 * self.seen_again,
            self.places,
            self.options.max_distance
        )?;
        write!(
            f,
            "  across the surface: median {:.2} cm  mean {:.2} cm  95 % {:.2} cm  (nearest point: median {:.2} cm)",
            100.0 * self.median_across,
            100.0 * self.mean_across,
            100.0 * self.percentile_95_across,
            100.0 * self.median_distance
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_spatial::SharpnessOptions;

    /// A wall seen in two passes, the second time `offset` metres behind the first.
    fn walls(offset: f64) -> (Vec<[f64; 3]>, Vec<f64>) {
        (0..20_000)
            .map(|i| {
                let pass = f64::from(i % 2);
                let random = |k: f64| (f64::from(i) * k).fract();
                ([offset * pass, 4.0 * random(0.754_877_666), 3.0 * random(0.569_840_291)], 100.0 * pass)
            })
            .unzip()
    }

    #[test]
    fn the_distance_between_two_passes_is_found() {
        for offset in [0.0, 0.01] {
            let (points, seconds) = walls(offset);
            let cloud = ThinnedCloud::new(&points, 1_000_000);
            let options = SharpnessOptions::default();
            let places = cloud.neighbourhoods(&SharpnessOptions { queries: 500, ..options });
            let (summary, each) = pass_distances(&cloud, &places, &seconds, PassOptions::default());
            // Where the thickness is exactly zero there is no entropy.
            if offset == 0.0 {
                assert!(summary.is_none() && each.is_empty());
                continue;
            }
            let summary = summary.unwrap();
            assert!((summary.median_across - offset).abs() < 1e-3, "{summary}");
            assert!(summary.seen_again > 0.99);
            let same_time = vec![0.0; points.len()];
            assert!(pass_distances(&cloud, &places, &same_time, PassOptions::default()).0.is_none());
        }
    }
}
