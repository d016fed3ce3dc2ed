//! Sharpness of a cloud without ground truth: mean map entropy and mean plane variance (Razlaw et al.,
//! "Evaluation of registration methods for sparse 3D laser scans", 2015).

use std::fmt;

use nalgebra::Matrix3;
use portolan_geometry::Vector3;
use portolan_numeric::Lcg64;
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use serde::Serialize;

use crate::{KdTree, Moments};

/// Limit of the points visited in all neighbourhoods together: some seconds. Usual clouds need a thousandth
/// of it.
const MOST_VISITS: usize = 1_000_000_000;
/// Number of neighbourhoods that are counted to estimate the size of all.
const PROBES: usize = 50;

/// Options of the measurement. Values can only be compared between clouds of equal density that were measured
/// with equal options.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SharpnessOptions {
    /// Radius of a neighbourhood, metres.
    pub radius: f64,
    /// Minimum number of points in a neighbourhood, its centre included.
    pub min_neighbours: usize,
    /// Maximum number of points; larger clouds are thinned first.
    pub max_points: usize,
    /// Number of points at which the neighbourhood is examined.
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
    /// Standard error of the mean map entropy.
    pub entropy_standard_error: f64,
    /// Number of points after thinning.
    pub points: usize,
    /// Number of neighbourhoods with enough points.
    pub neighbourhoods: usize,
    /// Mean number of points in them.
    pub mean_neighbours: f64,
    /// Options of the measurement.
    pub options: SharpnessOptions,
}

/// `wanted` of `count` indices in ascending order, spread evenly, but not in step with a regular order of the
/// points. The result is reproducible.
pub fn spread_sample(count: usize, wanted: usize) -> Vec<u32> {
    if count <= wanted {
        return (0..count as u32).collect();
    }
    // One index out of each of `wanted` equal parts, at a pseudo-random position within the part.
    let mut random = Lcg64::new(0x2545_f491_4f6c_dd1d);
    let part = count as f64 / wanted as f64;
    (0..wanted).map(|i| (((i as f64 + random.uniform()) * part) as usize).min(count - 1) as u32).collect()
}

/// The neighbourhood of one point of a cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbourhood {
    /// Index of the point in the cloud.
    pub index: u32,
    /// `½ ln det(2πe Σ)` of the points in the neighbourhood.
    pub entropy: f64,
    /// Eigenvalues of their covariance, ascending, square metres.
    pub variances: [f64; 3],
    /// Unit normal of the plane through them; its sign is arbitrary.
    pub normal: [f64; 3],
    /// Number of points in the neighbourhood.
    pub count: f64,
}

impl Neighbourhood {
    /// Whether the points are on one surface: wide in two directions and thin in the third.
    pub fn is_planar(&self) -> bool {
        let [across, middle, along] = self.variances;
        middle > 0.1 * along && across < 0.1 * middle
    }
}

/// A thinned cloud with a search tree.
#[derive(Clone, Debug)]
pub struct ThinnedCloud {
    chosen: Vec<u32>,
    /// Positions relative to one of the points, so that single precision suffices for the search.
    near: Vec<[f32; 3]>,
    tree: KdTree,
}

impl ThinnedCloud {
    /// Thins a cloud (metres, any frame) to at most `max_points` points, spread evenly over their order.
    pub fn new(points: &[[f64; 3]], max_points: usize) -> Self {
        let chosen = spread_sample(points.len(), max_points);
        let is_finite = |p: &&[f64; 3]| p.iter().all(|v| v.is_finite());
        let origin = points.iter().find(is_finite).copied().unwrap_or_default();
        let near: Vec<[f32; 3]> = chosen
            .iter()
            .map(|i| std::array::from_fn(|k| (points[*i as usize][k] - origin[k]) as f32))
            .collect();
        let tree = KdTree::new(&near);
        Self { chosen, near, tree }
    }

    /// Indices of the points in the original cloud, ascending.
    pub fn chosen(&self) -> &[u32] {
        &self.chosen
    }

    /// Positions of the points relative to one of them, metres.
    pub fn near(&self) -> &[[f32; 3]] {
        &self.near
    }

    /// The search tree of the points.
    pub fn tree(&self) -> &KdTree {
        &self.tree
    }

    /// The neighbourhoods of some of the points, spread evenly, in the order of the points. Those with too
    /// few points are left out. The result does not depend on the number of threads.
    pub fn neighbourhoods(&self, options: &SharpnessOptions) -> Vec<Neighbourhood> {
        let queries = self.affordable(spread_sample(self.near.len(), options.queries), options.radius as f32);
        // Points at the same position have the same neighbourhood. It is computed once, because there may be
        // very many such points.
        let (mut number_at, mut distinct) = (FxHashMap::default(), Vec::new());
        let number = |i: &u32| {
            *number_at.entry(self.near[*i as usize].map(f32::to_bits)).or_insert_with(|| {
                distinct.push(*i as usize);
                distinct.len() - 1
            })
        };
        let numbers: Vec<usize> = queries.iter().map(number).collect();
        let found: Vec<Option<Neighbourhood>> =
            distinct.par_iter().map(|i| self.neighbourhood(*i, options)).collect();
        let of_query =
            |(i, n): (&u32, &usize)| Some(Neighbourhood { index: self.chosen[*i as usize], ..found[*n]? });
        queries.iter().zip(&numbers).filter_map(of_query).collect()
    }

    /// As many of the queries, spread evenly, as visit at most [`MOST_VISITS`] points in their
    /// neighbourhoods. These are all queries, unless very many points are at one position.
    fn affordable(&self, queries: Vec<u32>, radius: f32) -> Vec<u32> {
        let probes = spread_sample(queries.len(), PROBES);
        let visits = probes.iter().map(|i| {
            let query = self.near[queries[*i as usize] as usize];
            self.tree.count_within(query, radius, MOST_VISITS / PROBES)
        });
        let mean = visits.sum::<usize>() / probes.len().max(1);
        match MOST_VISITS / mean.max(1) {
            most if most >= queries.len() => queries,
            most => spread_sample(queries.len(), most.max(1)).iter().map(|i| queries[*i as usize]).collect(),
        }
    }

    fn neighbourhood(&self, query: usize, options: &SharpnessOptions) -> Option<Neighbourhood> {
        let centre = self.near[query];
        let mut moments = Moments::default();
        self.tree.within(centre, options.radius as f32, |n| {
            let p = self.near[n.index as usize];
            moments.add(&Vector3::from(std::array::from_fn::<f64, 3, _>(|k| f64::from(p[k] - centre[k]))));
        });
        if moments.count < options.min_neighbours.max(4) as f64 {
            return None;
        }
        // The unbiased covariance, as in the published figures.
        let unbiased = moments.covariance() * (moments.count / (moments.count - 1.0));
        let scaled: Matrix3<f64> = unbiased * (2.0 * std::f64::consts::PI * std::f64::consts::E);
        let determinant = scaled.determinant();
        let plane = moments.plane()?;
        (determinant > 0.0).then(|| Neighbourhood {
            index: self.chosen[query],
            entropy: 0.5 * determinant.ln(),
            variances: plane.variances,
            normal: plane.normal.into(),
            count: moments.count,
        })
    }
}

/// Measures the sharpness of a cloud (metres, any frame); `None` if no neighbourhood has enough points.
pub fn sharpness(points: &[[f64; 3]], options: SharpnessOptions) -> Option<Sharpness> {
    let cloud = ThinnedCloud::new(points, options.max_points);
    Sharpness::of(&cloud.neighbourhoods(&options), cloud.near.len(), options)
}

impl Sharpness {
    /// Averages over the neighbourhoods of a cloud that was thinned to `points` points; `None` without
    /// neighbourhoods.
    pub fn of(found: &[Neighbourhood], points: usize, options: SharpnessOptions) -> Option<Self> {
        if found.is_empty() {
            return None;
        }
        let count = found.len() as f64;
        let mean = |value: fn(&Neighbourhood) -> f64| found.iter().map(value).sum::<f64>() / count;
        let mean_map_entropy = mean(|f| f.entropy);
        let variance = found.iter().map(|f| (f.entropy - mean_map_entropy).powi(2)).sum::<f64>() / count;
        Some(Self {
            mean_map_entropy,
            mean_plane_variance: mean(|f| f.variances[0]),
            entropy_standard_error: (variance / count).sqrt(),
            points,
            neighbourhoods: found.len(),
            mean_neighbours: mean(|f| f.count),
            options,
        })
    }
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
    fn many_points_at_one_place_are_sampled() {
        let points = vec![[1.0, 2.0, 3.0]; 200_000];
        let cloud = ThinnedCloud::new(&points, points.len());
        let queries = cloud.affordable((0..20_000).collect(), 0.15);
        assert_eq!(queries.len(), 5000);
        let few = ThinnedCloud::new(&points[..1000], 1000);
        assert_eq!(few.affordable((0..1000).collect(), 0.15).len(), 1000);
        assert!(few.affordable(Vec::new(), 0.15).is_empty());
    }

    #[test]
    fn points_at_one_place_share_their_surroundings() {
        let at = |i: usize| [0.01 * (i % 7) as f64, 0.02 * (i % 5) as f64, 0.001 * (i % 3) as f64];
        let points: Vec<[f64; 3]> = (0..400).map(|i| at(i % 90)).collect();
        let (cloud, options) = (ThinnedCloud::new(&points, points.len()), SharpnessOptions::default());
        let each: Vec<Neighbourhood> =
            (0..points.len()).filter_map(|i| cloud.neighbourhood(i, &options)).collect();
        assert_eq!(each.len(), points.len());
        assert_eq!(cloud.neighbourhoods(&options), each);
    }

    #[test]
    fn samples_are_spread_and_distinct() {
        let chosen = spread_sample(1000, 100);
        assert_eq!(chosen.len(), 100);
        assert!(chosen.windows(2).all(|w| w[0] < w[1]) && chosen[0] < 10 && chosen[99] >= 990);
        assert_eq!(spread_sample(3, 10), [0, 1, 2]);
    }
}
